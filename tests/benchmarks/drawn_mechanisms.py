"""Random mechanisms that move as drivers prescribe, with the exact motion and loads of a forward run.

The drivers of the forward run replace the actuators: their torques are the true values, and their motion is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import mbdkit
from mbdkit.mechanism.quantity_names import QuantityNames

RATE = 120.0
"""Samples per second."""

KINDS = ("chain", "free chain", "driven chain", "four-bar", "five-bar", "slider-crank")
"""Kinds of mechanisms: chains that are pinned, free in the plane, or partly moved by a driver of the model; loops."""

COLUMNS = ("exact", "other", "more", "markers")
"""What is measured: the actuated coordinates; as many others; the former and markers; markers alone."""


@dataclass
class Drawn:
    """A mechanism, its exact motion and its exact loads in T rows.

    Attributes
    ----------
    kind, columns
        One of `KINDS` and of `COLUMNS`.
    model
        Section `model` of the spec of inverse dynamics, without drivers in place of actuators.
    actuators
        Section `actuators`; residual actuators are added by mbdkit.
    values
        Times and exact values of the measured quantities, by heading.
    torques
        Exact values of the actuators by name, (T,).
    force
        (T, J, 2) exact forces of the joints.
    highest
        Highest frequency of the motion [Hz].
    poses
        (T, 3) exact x, y and angle of each body.
    """

    kind: str
    columns: str
    model: dict[str, Any]
    actuators: dict[str, Any]
    values: dict[str, np.ndarray]
    torques: dict[str, np.ndarray]
    force: np.ndarray
    highest: float
    poses: dict[str, np.ndarray]


def wave(random: np.random.Generator, amplitude: float, highest: float) -> str:
    """Return a random motion as an expression of t, with three frequencies up to `highest`."""
    terms = []
    for share in (0.3, 0.6, 1.0):
        size, phase = amplitude * random.normal(0, 0.5) * 0.3 / share, random.uniform(0, 2 * np.pi)
        terms.append(f"{size!r}*sin({2 * np.pi * share * highest!r}*t+{phase!r})")
    return "+".join(terms).replace("+-", "-")


def _link(m: mbdkit.Mechanism, random: np.random.Generator, name: str, a: complex, b: complex) -> None:
    """Add a rod from a to b, with three markers that are not on a line."""
    centre, length = (a + b) / 2, abs(b - a)
    mass = random.uniform(0.5, 5.0)
    angle = float(np.angle(b - a))
    inertia = mass * length**2 * random.uniform(0.05, 0.15)
    m.body(name, mass=mass, inertia=inertia, position=(centre.real, centre.imag), angle=angle)
    for number, (x, y) in enumerate(((-0.4, 0.1), (0.4, 0.1), (0.0, -0.15))):
        m.marker(f"{name}{number}", name, point=(x * length, y * length))


def _pin(m: mbdkit.Mechanism, name: str, a: Any, b: str, at: complex) -> None:
    m.revolute(name, a, b, at=(at.real, at.imag))


def _chain(m: mbdkit.Mechanism, random: np.random.Generator, *, free: bool) -> list[str]:
    """Add a chain of links, and return its actuated joints, the root first."""
    count = int(random.integers(2, 6))
    at, names = 0j, []
    for number in range(count):
        end = at + random.uniform(0.2, 0.6) * np.exp(1j * (-np.pi / 2 + random.uniform(-0.8, 0.8)))
        _link(m, random, f"link{number}", at, end)
        if number or not free:
            _pin(m, f"J{number}", f"link{number - 1}" if number else m.ground, f"link{number}", at)
            names.append(f"J{number}")
        at = end
    return names


def _loop(m: mbdkit.Mechanism, random: np.random.Generator, kind: str) -> list[str]:
    """Add a loop far from singular positions, and return its actuated joints."""
    scale = random.uniform(0.5, 1.5)
    if kind == "slider-crank":
        crank, rod = 0.3 * scale * np.exp(1j * random.uniform(0.8, 2.2)), random.uniform(0.7, 1.0) * scale
        slide = complex(crank.real + np.sqrt(rod**2 - crank.imag**2), 0.0)
        _link(m, random, "crank", 0j, crank)
        _link(m, random, "rod", crank, slide)
        m.body("slider", mass=random.uniform(0.5, 5), inertia=0.1, position=(slide.real, slide.imag))
        _pin(m, "A", m.ground, "crank", 0j)
        _pin(m, "B", "crank", "rod", crank)
        _pin(m, "C", "rod", "slider", slide)
        m.prismatic("D", m.ground, "slider", at=(slide.real, slide.imag), axis=(1, 0))
        return ["A"]
    base = scale * (1.0 if kind == "four-bar" else 0.8)
    first = 0.5 * scale * np.exp(1j * random.uniform(1.3, 1.8))
    last = base + 0.6 * scale * np.exp(1j * random.uniform(1.2, 1.7))
    _link(m, random, "left", 0j, first)
    _link(m, random, "right", complex(base), last)
    _pin(m, "A", m.ground, "left", 0j)
    _pin(m, "D", m.ground, "right", complex(base))
    if kind == "four-bar":
        _link(m, random, "coupler", first, last)
        _pin(m, "B", "left", "coupler", first)
        _pin(m, "C", "coupler", "right", last)
        return ["A"]
    top = (first + last) / 2 + 0.5j * scale
    _link(m, random, "upper left", first, top)
    _link(m, random, "upper right", top, last)
    _pin(m, "B", "left", "upper left", first)
    _pin(m, "E", "upper left", "upper right", top)
    _pin(m, "C", "upper right", "right", last)
    return ["A", "D"]


def _biped(m: mbdkit.Mechanism, random: np.random.Generator) -> list[str]:
    """Add a trunk with two legs that stand on y = 0, and return the joints, those of the left leg first."""
    size, joints = random.uniform(0.8, 1.2), []
    hip = 0.9j * size
    _link(m, random, "link0", hip, hip + 0.5j * size)
    for side, ahead in (("left", 0.15), ("right", -0.15)):
        ankle = ahead * size + 0.08j * size
        knee = (hip + ankle) / 2 + 0.05 * size
        heel, toe = ankle - (0.08 + 0.06j) * size, ankle + (0.2 - 0.06j) * size
        _link(m, random, f"thigh {side}", hip, knee)
        _link(m, random, f"shank {side}", knee, ankle)
        _link(m, random, f"foot {side}", heel, toe)
        for name, bodies, at in (
            ("hip", ("link0", f"thigh {side}"), hip),
            ("knee", (f"thigh {side}", f"shank {side}"), knee),
            ("ankle", (f"shank {side}", f"foot {side}"), ankle),
        ):
            _pin(m, f"{name} {side}", *bodies, at)
            joints.append(f"{name} {side}")
    return joints


def draw(random: np.random.Generator, kind: str, columns: str) -> Drawn:
    """Draw a mechanism of one of `KINDS` or a biped, move it, and return what is measured and what acts."""
    m = mbdkit.Mechanism()
    free, biped = kind in ("free chain", "biped"), kind == "biped"
    if biped:
        joints = _biped(m, random)
    else:
        joints = _chain(m, random, free=free) if "chain" in kind else _loop(m, random, kind)
    highest, end = random.uniform(0.8, 2.0) * (0.6 if biped else 1.0), random.uniform(1.5, 2.5)
    if kind == "driven chain":
        m.driver("moved", m.ground, "link0", coordinate="angle", motion=_about(m, random, "J0", highest))
        joints = joints[1:]
    model, actuators = m.to_spec(), {name: {"joint": name} for name in joints}
    amplitude = 0.08 if biped else 0.6 if "chain" in kind else 0.3
    drivers: dict[str, str] = {}
    for name in joints:
        first, second = m.joints[name].bodies
        start = m.bodies[second].angle - (m.bodies[first].angle if first != "ground" else 0.0)
        motion = f"{start!r}+{wave(random, amplitude, highest)}"
        m.driver(f"on {name}", first, second, coordinate="angle", motion=motion)
        drivers[name] = f"on {name}"
    if free:
        body = m.bodies["link0"]
        for axis, start in (("x", body.position[0]), ("y", body.position[1]), ("angle", body.angle)):
            motion = f"{start!r}+{wave(random, 0.06 if biped else 0.2, highest)}"
            m.driver(f"on root {axis}", m.ground, "link0", coordinate=axis, motion=motion)
            drivers[f"root.{axis}"] = f"on root {axis}"
    method = {"integrator": {"name": "gauss", "stages": 3}, "stabilization": {"name": "projection", "every": 1}}
    run = mbdkit.run({"mbdkit": 1, "model": m.to_spec(), **method}, time={"steps": int(end * RATE), "step": 1 / RATE})
    run.check()
    names, q = QuantityNames(m), run.array("trajectory/position")
    measured = _measured(random, model, joints, columns, free=free)
    values = {name: names.find(name, "columns").value(q.reshape(len(q), -1)) for name in measured}
    torques = {name: _driven(run, driver) for name, driver in drivers.items()}
    force = run.array("joints/reaction_force")[:, [run.joint_names.index(name) for name in model["joints"]]]
    poses = {name: q[:, number] for number, name in enumerate(m.bodies)}
    return Drawn(kind, columns, model, actuators, {"time": run.time, **values}, torques, force, highest, poses)


def _about(m: mbdkit.Mechanism, random: np.random.Generator, joint: str, highest: float) -> str:
    return f"{m.bodies[m.joints[joint].bodies[1]].angle!r}+{wave(random, 0.5, highest)}"


def _driven(run: mbdkit.Run, driver: str) -> np.ndarray:
    """Return the force or torque of a driver on its second body."""
    joint = run.joints[driver]
    if driver[-2:] in (" x", " y"):
        return np.asarray(joint.reaction_force[:, "xy".index(driver[-1])])
    return np.asarray(joint.reaction_torque)


def _measured(
    random: np.random.Generator, model: dict[str, Any], joints: list[str], columns: str, *, free: bool
) -> list[str]:
    """Return the names of the measured quantities."""
    root = ["link0.x", "link0.y", "link0.angle"] if free else []
    own = [*root, *(f"{name}.angle" for name in joints)]
    markers = [f"{name}.{axis}" for name in model["markers"] for axis in "xy"]
    if columns == "exact":
        return own
    if columns == "other":  # absolute angles in place of relative ones
        return [*root, *(f"{model['joints'][name]['bodies'][1]}.angle" for name in joints)]
    if columns == "markers":
        return markers
    extra = random.permutation(len(markers))[: int(random.integers(1, 5))]
    return [*own, *(markers[place] for place in sorted(extra))]
