"""Mechanisms with known motions, for the test of estimated errors: models of mbdkit, and their true states."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from tests.witness.car_axis import L, R, W, car_axis, in_two_coordinates
from tests.witness.six_bar import FOUR_BAR, PHI, RATE, SIX_BAR

from .minimal_coordinates import TIME, MinimalSystem, coordinates
from .pendulum import Pendulum
from .problems import DRIVEN_PENDULUM, FORCED_PENDULUM, Problem

Array = NDArray[np.floating[Any]]
States = tuple[Array, Array]
G = 9.81


@dataclass(frozen=True)
class Known:
    """A mechanism with a known motion.

    Parameters
    ----------
    name
        Name of the problem.
    model
        The `model:` mapping of its spec.
    end
        End of the run [s].
    step
        Step [s] of moderate accuracy; tests also use multiples of it.
    solve
        Returns the true positions and velocities (T, B, 3) at times (T,).
    again
        The same with other rounding errors, for a motion that multiplies them.
    """

    name: str
    model: dict[str, Any]
    end: float
    step: float
    solve: Callable[[Array], States]
    again: Callable[[Array], States] | None = None


def _bodies(system: MinimalSystem, names: list[str]) -> dict[str, Any]:
    """Return the bodies of a spec in the start of a minimal system."""
    q, v = system.state(0.0, np.array(system.start, float), np.array(system.rates, float))
    return {
        name: {
            "mass": system.masses[k],
            **({"inertia": system.inertias[k]} if system.inertias[k] else {}),
            "position": q[k, :2].tolist(),
            **({"angle": float(q[k, 2])} if system.inertias[k] else {}),
            "velocity": v[k, :2].tolist(),
            **({"angular_velocity": float(v[k, 2])} if system.inertias[k] else {}),
        }
        for k, name in enumerate(names)
    }


def _revolute(a: str, b: str, at_a: tuple[float, float], at_b: tuple[float, float]) -> dict[str, Any]:
    return {"type": "revolute", "bodies": [a, b], "points": [list(at_a), list(at_b)]}


def _slide(a: str, b: str, at: tuple[float, float] = (0.0, 0.0), axis: tuple[float, float] = (1.0, 0.0)) -> Any:
    return {"type": "prismatic", "bodies": [a, b], "points": [list(at), [0.0, 0.0]], "axis": list(axis)}


def _known(
    name: str,
    system: MinimalSystem,
    names: list[str],
    joints: dict[str, Any],
    forces: dict[str, Any],
    end: float,
    step: float,
) -> Known:
    model = {
        "name": "mechanism",
        "gravity": [0.0, -system.gravity],
        "bodies": _bodies(system, names),
        "joints": joints,
        "forces": forces,
    }
    return Known(name, model, end, step, system.solve, partial(system.solve, max_step=step))


def pendulum(name: str, angle: float, rate: float, end: float, step: float) -> Known:
    """Return a rod of 1 m on a pin, in closed form by elliptic functions."""
    witness = Pendulum.rod(angle=angle, rate=rate)

    def solve(times: Array) -> States:
        theta, omega = witness.motion(times)
        c, s = 0.5 * np.cos(theta), 0.5 * np.sin(theta)
        return np.stack([c, s, theta], -1)[:, None], np.stack([-s * omega, c * omega, omega], -1)[:, None]

    return Known(name, {"name": "single-pendulum", "angle": angle, "rate": rate}, end, step, solve)


def rods(name: str, lengths: list[float], masses: list[float], angles: list[float], end: float, step: float) -> Known:
    """Return a chain of rods from the origin, released at rest."""
    s = coordinates(len(lengths))
    poses, x, y = [], sympy.Integer(0), sympy.Integer(0)
    for length, angle in zip(lengths, s, strict=True):
        dx, dy = length * sympy.cos(angle), length * sympy.sin(angle)
        poses.append((x + dx / 2, y + dy / 2, angle))
        x, y = x + dx, y + dy
    inertias = [m * length**2 / 12 for m, length in zip(masses, lengths, strict=True)]
    system = MinimalSystem(poses, masses, inertias, angles, [0.0] * len(s))
    names = [f"rod{k + 1}" for k in range(len(s))]
    joints = {}
    for k, length in enumerate(lengths):
        before = ("ground", (0.0, 0.0)) if k == 0 else (names[k - 1], (lengths[k - 1] / 2, 0.0))
        joints[f"J{k + 1}"] = _revolute(before[0], names[k], before[1], (-length / 2, 0.0))
    return _known(name, system, names, joints, {}, end, step)


def two_rods(name: str, problem: Problem, end: float, step: float) -> Known:
    """Return the forced or the driven double pendulum, in minimal coordinates."""

    def solve(times: Array) -> States:
        rows = problem.solve(times)
        states = np.array([problem.state(row[:2], row[2:4]) for row in rows]).reshape(-1, 2, 2, 3)
        return states[:, 0], states[:, 1]

    return Known(name, problem.model(), end, step, solve)


def linkage(name: str, which: Any, end: float, step: float) -> Known:
    """Return a linkage that a motor drives, in the crank's angle."""

    def solve(times: Array) -> States:
        q, v = [], []
        for phi, rate, _ in which.solve(PHI, RATE, times):
            poses = which.poses(phi).values()
            q.append([[p.centre[0].real, p.centre[0].imag, p.angle[0]] for p in poses])
            v.append([[p.centre[1].real * rate, p.centre[1].imag * rate, p.angle[1] * rate] for p in poses])
        angles = np.array(q)
        angles[:, :, 2] = np.unwrap(angles[:, :, 2], axis=0)
        return angles, np.array(v)

    return Known(name, which.model(PHI, RATE), end, step, solve)


def axis_of_a_car(end: float, step: float) -> Known:
    """Return the car axis of the Test Set for IVP Solvers, in two coordinates."""

    def solve(times: Array) -> States:
        rows = in_two_coordinates(times)
        sine = R / L * np.sin(W * times)
        road = np.stack([0 * times, 0 * times, np.arcsin(sine)], -1)
        turning = np.stack([0 * times, 0 * times, R / L * W * np.cos(W * times) / np.sqrt(1 - sine**2)], -1)
        zero = np.zeros((len(times), 1))
        q = [road, np.hstack([rows[:, 0:2], zero]), np.hstack([rows[:, 2:4], zero])]
        v = [turning, np.hstack([rows[:, 4:6], zero]), np.hstack([rows[:, 6:8], zero])]
        return np.stack(q, 1), np.stack(v, 1)

    return Known("car axis", car_axis(), end, step, solve)


def slider_crank(end: float, step: float) -> Known:
    """Return a crank of 0.3 m, a rod of 1 m and a slider on the x axis, driven by a torque."""
    (phi,) = coordinates(1)
    psi = -sympy.asin(0.3 * sympy.sin(phi))
    pin = (0.3 * sympy.cos(phi), 0.3 * sympy.sin(phi))
    slider = pin[0] + sympy.cos(psi)
    poses = [
        (pin[0] / 2, pin[1] / 2, phi),
        (pin[0] + sympy.cos(psi) / 2, pin[1] + sympy.sin(psi) / 2, psi),
        (slider, 0, 0),
    ]

    def load(t: float, q: Array, v: Array) -> Array:
        return np.array([0, 0, 0.8 * math.sin(2 * t), 0, 0, 0, 0, 0, 0.0])

    system = MinimalSystem(poses, [1.0, 2.0, 1.5], [0.0075, 1 / 6, 0.01], [0.4], [9.0], load)
    joints = {
        "A": _revolute("ground", "crank", (0, 0), (-0.15, 0)),
        "B": _revolute("crank", "rod", (0.15, 0), (-0.5, 0)),
        "C": _revolute("rod", "slider", (0.5, 0), (0, 0)),
        "D": _slide("ground", "slider"),
    }
    forces = {"motor": {"type": "torque", "body": "crank", "value": "0.8*sin(2*t)"}}
    return _known("slider-crank", system, ["crank", "rod", "slider"], joints, forces, end, step)


def cart_and_pole(end: float, step: float) -> Known:
    """Return a cart of 2 kg on a rail, on a spring, with a pole that falls over."""
    x, angle = coordinates(2)
    poses = [(x, 0, 0), (x + 0.5 * sympy.cos(angle), 0.5 * sympy.sin(angle), angle)]

    def load(t: float, q: Array, v: Array) -> Array:
        length = math.hypot(q[0] + 2.0, q[1])
        return np.array([-40.0 * (length - 2.0) - 0.5 * v[0], 0, 0, 0, 0, 0])

    system = MinimalSystem(poses, [2.0, 1.0], [0.1, 1 / 12], [0.0, 1.2], [0.0, 0.0], load)
    joints = {"rail": _slide("ground", "cart"), "pin": _revolute("cart", "pole", (0, 0), (-0.5, 0))}
    spring = {"type": "spring-damper", "bodies": ["ground", "cart"], "points": [[-2.0, 0], [0, 0]]}
    forces = {"spring": spring | {"stiffness": 40.0, "damping": 0.5, "free_length": 2.0}}
    return _known("cart and pole", system, ["cart", "pole"], joints, forces, end, step)


def shaken_pin(end: float, step: float) -> Known:
    """Return a rod whose pin two drivers shake."""
    (angle,) = coordinates(1)
    x, y = 0.3 * sympy.sin(3 * TIME), 0.2 * sympy.cos(5 * TIME) - 0.2
    system = MinimalSystem(
        [(x + sympy.cos(angle) / 2, y + sympy.sin(angle) / 2, angle)], [1.0], [1 / 12], [-0.4], [0.0]
    )
    driver = {"type": "driver", "bodies": ["ground", "rod"], "points": [[0, 0], [-0.5, 0]]}
    joints = {
        "x": driver | {"coordinate": "x", "motion": "0.3*sin(3*t)"},
        "y": driver | {"coordinate": "y", "motion": "0.2*cos(5*t) - 0.2"},
    }
    return _known("shaken pin", system, ["rod"], joints, {}, end, step)


def driven_rod(end: float, step: float) -> Known:
    """Return a rod whose motion a driver prescribes, in closed form."""

    def solve(times: Array) -> States:
        theta, omega = 0.3 + 0.8 * np.sin(2 * times), 1.6 * np.cos(2 * times)
        c, s = 0.5 * np.cos(theta), 0.5 * np.sin(theta)
        return np.stack([c, s, theta], -1)[:, None], np.stack([-s * omega, c * omega, omega], -1)[:, None]

    q, v = (x[0, 0] for x in solve(np.zeros(1)))
    rod = {"mass": 1.0, "inertia": 1 / 12, "position": q[:2].tolist(), "angle": q[2], "velocity": v[:2].tolist()}
    motor = {"type": "driver", "bodies": ["ground", "rod"], "coordinate": "angle", "motion": "0.3 + 0.8*sin(2*t)"}
    joints = {"pin": _revolute("ground", "rod", (0, 0), (-0.5, 0)), "motor": motor}
    model = {"name": "mechanism", "bodies": {"rod": rod | {"angular_velocity": v[2]}}, "joints": joints}
    return Known("driven rod", model, end, step, solve)


def turntable(end: float, step: float) -> Known:
    """Return a mass driven in a turning frame, in closed form."""

    def solve(times: Array) -> States:
        w, dw = 1 + 0.1 * np.sin(2 * times) + 0.2j, 0.2 * np.cos(2 * times)
        z, dz = w * np.exp(1.5j * times), (dw + 1.5j * w) * np.exp(1.5j * times)
        zero = 0 * times
        q = [np.stack([zero, zero, 1.5 * times], -1), np.stack([z.real, z.imag, zero], -1)]
        v = [np.stack([zero, zero, zero + 1.5], -1), np.stack([dz.real, dz.imag, zero], -1)]
        return np.stack(q, 1), np.stack(v, 1)

    pair = ["table", "mass"]
    model = {
        "name": "mechanism",
        "gravity": [0.0, 0.0],
        "bodies": {
            "table": {"mass": 2.0, "inertia": 0.5, "angular_velocity": 1.5},
            "mass": {"mass": 0.3, "position": [1.0, 0.2], "velocity": [-0.1, 1.5]},
        },
        "joints": {
            "axle": _revolute("ground", "table", (0, 0), (0, 0)),
            "motor": {"type": "driver", "bodies": ["ground", "table"], "coordinate": "angle", "motion": "1.5*t"},
            "along": {"type": "driver", "bodies": pair, "coordinate": "x", "motion": "1 + 0.1*sin(2*t)"},
            "across": {"type": "driver", "bodies": pair, "coordinate": "y", "motion": 0.2},
        },
    }
    return Known("turntable", model, end, step, solve)


def mass_on_a_spring(end: float, step: float) -> Known:
    """Return a point mass on a damped spring that swings and bounces."""
    x, y = coordinates(2)

    def load(t: float, q: Array, v: Array) -> Array:
        length = math.hypot(q[0], q[1])
        pull = (60.0 * (length - 0.6) + 0.4 * (q[0] * v[0] + q[1] * v[1]) / length) / length
        return np.array([-pull * q[0], -pull * q[1], 0.0])

    system = MinimalSystem([(x, y, 0)], [0.7], [0.0], [0.8, 0.1], [0.0, -0.5], load)
    spring = {"type": "spring-damper", "bodies": ["ground", "bob"], "points": [[0, 0], [0, 0]]}
    forces = {"spring": spring | {"stiffness": 60.0, "damping": 0.4, "free_length": 0.6}}
    return _known("mass on a spring", system, ["bob"], {}, forces, end, step)


def forced_oscillator(name: str, stiffness: float, damping: float, end: float, step: float) -> Known:
    """Return a slider of 1 kg on a rail with spring, damper and a harmonic force, in closed form."""
    force, omega, x0, v0 = 3.0, 4.0, 0.2, 0.0
    steady = force / complex(stiffness - omega**2, damping * omega)
    decay = 0.5 * damping
    ring = np.sqrt(complex(stiffness - decay**2))
    roots = np.array([-decay + 1j * ring, -decay - 1j * ring])
    rest = np.array([x0 - steady.real, v0 - (1j * omega * steady).real])
    share = np.linalg.solve(np.array([[1, 1], roots]), rest)

    def solve(times: Array) -> States:
        wave = steady * np.exp(1j * omega * times)
        free = share * np.exp(np.outer(times, roots))
        x, v = wave.real + free.sum(1).real, (1j * omega * wave).real + (free @ roots).real
        zero = 0 * times
        return np.stack([x, zero, zero], -1)[:, None], np.stack([v, zero, zero], -1)[:, None]

    spring = {"type": "spring-damper", "bodies": ["ground", "mass"], "points": [[-5.0, 0.0], [0.0, 0.0]]}
    model = {
        "name": "mechanism",
        "bodies": {"mass": {"mass": 1.0, "inertia": 0.1, "position": [x0, 0.0], "velocity": [v0, 0.0]}},
        "joints": {"rail": _slide("ground", "mass")},
        "forces": {
            "spring": spring | {"stiffness": stiffness, "damping": damping, "free_length": 5.0},
            "push": {"type": "force", "body": "mass", "point": [0.0, 0.0], "value": ["3*cos(4*t)", 0.0]},
        },
    }
    return Known(name, model, end, step, solve)


def spinning_bodies(end: float, step: float) -> Known:
    """Return two discs that spin on one axle, coupled by a torsion spring, in closed form."""
    j1, j2, k = 0.4, 0.1, 30.0
    ring = math.sqrt(k * (1 / j1 + 1 / j2))

    def solve(times: Array) -> States:
        # total angular momentum is constant; the difference of the angles rings
        mean, slip = (j1 * 20.0 + j2 * -5.0) / (j1 + j2), -25.0
        between, rate = slip / ring * np.sin(ring * times), slip * np.cos(ring * times)
        first = mean * times - j2 / (j1 + j2) * between
        w1 = mean - j2 / (j1 + j2) * rate
        zero = 0 * times
        q = [np.stack([zero, zero, angle], -1) for angle in (first, first + between)]
        v = [np.stack([zero, zero, w], -1) for w in (w1, w1 + rate)]
        return np.stack(q, 1), np.stack(v, 1)

    model = {
        "name": "mechanism",
        "bodies": {
            "first": {"mass": 3.0, "inertia": j1, "angular_velocity": 20.0},
            "second": {"mass": 1.0, "inertia": j2, "angular_velocity": -5.0},
        },
        "joints": {
            "axle1": _revolute("ground", "first", (0, 0), (0, 0)),
            "axle2": _revolute("ground", "second", (0, 0), (0, 0)),
        },
        "forces": {"shaft": {"type": "torsion-spring", "bodies": ["first", "second"], "stiffness": k}},
    }
    return Known("spinning discs", model, end, step, solve)


def beam_pendulum(end: float, step: float) -> Known:
    """Return three rods with stiff torsion springs and dampers between them, a beam that swings."""
    s = coordinates(3)
    poses, x, y = [], sympy.Integer(0), sympy.Integer(0)
    for angle in s:
        dx, dy = 0.4 * sympy.cos(angle), 0.4 * sympy.sin(angle)
        poses.append((x + dx / 2, y + dy / 2, angle))
        x, y = x + dx, y + dy

    def load(t: float, q: Array, v: Array) -> Array:
        angle, rate = q[2::3], v[2::3]
        torque = 80.0 * np.diff(angle) + 0.1 * np.diff(rate)
        return np.array([0, 0, torque[0], 0, 0, torque[1] - torque[0], 0, 0, -torque[1]])

    system = MinimalSystem(poses, [0.5] * 3, [0.5 * 0.16 / 12] * 3, [0.0] * 3, [0.0] * 3, load)
    names = ["a", "b", "c"]
    joints = {
        "root": _revolute("ground", "a", (0, 0), (-0.2, 0)),
        "ab": _revolute("a", "b", (0.2, 0), (-0.2, 0)),
        "bc": _revolute("b", "c", (0.2, 0), (-0.2, 0)),
    }
    springs = {
        f"{a}{b}": {"type": "torsion-spring", "bodies": [a, b], "stiffness": 80.0, "damping": 0.1}
        for a, b in (("a", "b"), ("b", "c"))
    }
    return _known("beam pendulum", system, names, joints, springs, end, step)


def trammel(end: float, step: float) -> Known:
    """Return the elliptic trammel: a rod whose ends slide along both axes, on a torsion spring."""
    (phi,) = coordinates(1)
    c, s = sympy.cos(phi), sympy.sin(phi)
    poses = [(c, s, -phi), (2 * c, 0, 0), (0, 2 * s, 0)]
    system = MinimalSystem(poses, [1.0, 0.2, 0.3], [1 / 3, 0.01, 0.01], [0.6], [4.0])
    joints = {
        "X": _slide("ground", "x"),
        "Y": _slide("ground", "y", axis=(0.0, 1.0)),
        "XR": _revolute("x", "rod", (0, 0), (1, 0)),
        "YR": _revolute("y", "rod", (0, 0), (-1, 0)),
    }
    return _known("trammel", system, ["rod", "x", "y"], joints, {}, end, step)


@cache
def known_motions() -> tuple[Known, ...]:
    """Return all problems."""
    return (
        pendulum("pendulum", 0.0, 0.0, 10.0, 0.02),
        pendulum("pendulum going round", 0.0, 9.0, 10.0, 0.02),
        rods("double pendulum, small", [1.0, 1.0], [1.0, 1.0], [-1.2, -1.0], 10.0, 0.02),
        rods("double pendulum, chaotic", [1.0, 1.0], [1.0, 1.0], [1.5, 1.6], 10.0, 0.01),
        rods("triple pendulum", [0.6, 0.5, 0.4], [1.0, 0.7, 0.5], [-0.3, 0.1, 0.4], 5.0, 0.01),
        two_rods("forced double pendulum", FORCED_PENDULUM, 6.0, 0.02),
        two_rods("driven double pendulum", DRIVEN_PENDULUM, 6.0, 0.02),
        axis_of_a_car(3.0, 0.005),
        linkage("four-bar", FOUR_BAR, 3.0, 0.01),
        linkage("six-bar", SIX_BAR, 2.0, 0.01),
        slider_crank(3.0, 0.01),
        cart_and_pole(6.0, 0.02),
        shaken_pin(5.0, 0.02),
        driven_rod(5.0, 0.02),
        turntable(5.0, 0.02),
        mass_on_a_spring(5.0, 0.01),
        forced_oscillator("forced oscillator", 50.0, 0.5, 10.0, 0.02),
        forced_oscillator("stiff oscillator", 4e4, 20.0, 1.0, 0.002),
        spinning_bodies(5.0, 0.01),
        beam_pendulum(3.0, 0.005),
        trammel(5.0, 0.01),
    )
