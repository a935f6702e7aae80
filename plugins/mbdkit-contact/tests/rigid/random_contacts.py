"""Random mechanisms with rigid contacts, and what must hold in each of their runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import mbdkit

G = 9.81
END = 0.6
"""Duration of the runs [s]."""
STEP = 0.01
"""Step of the event-driven runs [s]."""
STEPS = (2e-3, 1e-3, 5e-4)
"""Steps of the runs by time-stepping [s]."""
SHIFT = 1e-7
"""Change of initial velocities [m/s] whose effect on positions measures how well the motion is determined."""
WELL_DETERMINED = 100.0
"""Change of positions over that of initial velocities [s] up to which motions are compared."""
MOST = 17
"""Largest number of contacts with lines; circles with each other add up to three."""
FLOOR = {"line": {"normal": [0.0, 1.0]}}


def _rod(mass: float, length: float, at: np.ndarray, angle: float) -> dict[str, Any]:
    return {"mass": mass, "inertia": mass * length**2 / 12.0, "position": at.tolist(), "angle": angle}


def _law(random: np.random.Generator) -> dict[str, Any]:
    """Return coefficients of restitution and friction; every second contact has more static than kinetic friction."""
    mu = float(random.uniform(0.0, 0.8)) if random.random() < 0.8 else 0.0
    friction: Any = {"static": 1.3 * mu, "kinetic": mu} if random.random() < 0.5 else mu
    return {"restitution": float(random.choice([0.0, 0.3, 0.6, 0.9])), "friction": friction}


def _polygon(random: np.random.Generator, size: float) -> list[list[float]]:
    """Return the corners of a convex polygon on an ellipse."""
    count = int(random.integers(3, 6))
    turns = 2.0 * np.pi * (np.arange(count) + random.uniform(-0.2, 0.2, count)) / count
    return [[float(size * np.cos(x)), float(0.7 * size * np.sin(x))] for x in turns]


def _shape(random: np.random.Generator, size: float, place: list[float]) -> dict[str, Any]:
    kind = random.integers(3)
    if kind == 0:
        return {"point": place}
    if kind == 1:
        return {"circle": {"center": place, "radius": 0.3 * size}}
    return {"polygon": [[place[0] + x, place[1] + y] for x, y in _polygon(random, 0.4 * size)]}


def free_bodies(random: np.random.Generator) -> dict[str, Any]:
    """Return bodies that fall on a floor between two walls; circles also touch each other."""
    bodies, contacts, circles = {}, {}, {}
    count = int(random.integers(1, 4))
    for i in range(count):
        name, size = f"b{i}", float(random.uniform(0.1, 0.2))
        mass = float(random.uniform(0.5, 2.0))
        bodies[name] = {
            "mass": mass, "inertia": 0.4 * mass * size**2, "position": [0.5 * i, float(random.uniform(0.3, 0.6))],
            "angle": float(random.uniform(-3.0, 3.0)), "velocity": random.uniform(-1.0, 1.0, 2).tolist(),
            "angular_velocity": float(random.uniform(-3.0, 3.0)),
        }  # fmt: skip
        if random.random() < 0.5:
            shape: dict[str, Any] = circles.setdefault(name, {"circle": {"radius": size}})
        else:
            shape = {"polygon": _polygon(random, size)}
        law = _law(random)
        walls = {
            "floor": FLOOR,
            "left": {"line": {"point": [-0.4, 0.0], "normal": [1.0, 0.3]}},
            "right": {"line": {"point": [0.5 * count, 0.0], "normal": [-1.0, 0.0]}},
        }
        for wall, line in walls.items():
            contacts[f"{wall}{i}"] = {"bodies": ["ground", name], "shapes": [line, shape]} | law
    if len(circles) > 1:
        contacts["balls"] = {"among": list(circles), "shapes": circles} | _law(random)
    return {"bodies": bodies, "contacts": contacts}


def chain(random: np.random.Generator) -> dict[str, Any]:
    """Return a chain of rods, free or hung, whose ends touch a floor."""
    count, angle = int(random.integers(1, 6)), float(random.uniform(-0.5, 0.5))
    length, at = 0.4, np.array([0.0, float(random.uniform(0.5, 1.0))])
    bodies, joints, contacts = {}, {}, {}
    start, speed = at.copy(), random.uniform(-1.0, 1.0, 2)
    is_hung = random.random() < 0.5
    for i in range(count):
        angle += float(random.uniform(-0.8, 0.8))
        along = 0.5 * length * np.array([np.cos(angle), np.sin(angle)])
        bodies[f"r{i}"] = _rod(float(random.uniform(0.5, 2.0)), length, at + along, angle)
        at = at + 2 * along
        ends = [("ground", start.tolist())] if i == 0 else [(f"r{i - 1}", [0.5 * length, 0.0])]
        if i or is_hung:
            (other, point), tip = ends[0], [-0.5 * length, 0.0]
            joints[f"j{i}"] = {"type": "revolute", "bodies": [other, f"r{i}"], "points": [point, tip]}
        contacts[f"c{i}"] = {
            "bodies": ["ground", f"r{i}"], "shapes": [FLOOR, _shape(random, length / 3, [0.5 * length, 0.0])],
        } | _law(random)  # fmt: skip
    if not is_hung:
        for one in bodies.values():
            one["velocity"] = speed.tolist()
    return _lifted({"bodies": bodies, "joints": joints, "contacts": contacts})


def loop(random: np.random.Generator) -> dict[str, Any]:
    """Return four rods in a closed loop, pinned to the ground or free, whose corners touch a floor."""
    a, b = random.uniform(0.3, 0.6, 2)
    turn, lean = float(random.uniform(-0.5, 0.5)), float(random.uniform(1.0, 2.0))
    along, up = (x * np.array([np.cos(y), np.sin(y)]) for x, y in ((a, turn), (b, turn + lean)))
    corners = [np.zeros(2), along, along + up + random.uniform(-0.1, 0.1, 2), up]
    base = np.array([0.0, 0.4])
    bodies, joints, contacts = {}, {}, {}
    for i in range(4):
        begin, end = corners[i], corners[(i + 1) % 4]
        step = end - begin
        length, angle = float(np.hypot(*step)), float(np.arctan2(step[1], step[0]))
        bodies[f"r{i}"] = _rod(float(random.uniform(0.5, 2.0)), length, base + 0.5 * (begin + end), angle)
        contacts[f"c{i}"] = {
            "bodies": ["ground", f"r{i}"], "shapes": [FLOOR, _shape(random, 0.15, [-0.5 * length, 0.0])],
        } | _law(random)  # fmt: skip
    for i in range(4):
        points = [base + corners[(i + 1) % 4]] * 2
        joints[f"j{i}"] = {"type": "revolute", "bodies": [f"r{i}", f"r{(i + 1) % 4}"], "at": points[0].tolist()}
    if random.random() < 0.5:
        joints["pin"] = {"type": "revolute", "bodies": ["ground", "r0"], "at": base.tolist()}
    else:
        for one in bodies.values():
            one["velocity"] = [0.5, -0.5]
    return _lifted({"bodies": bodies, "joints": joints, "contacts": contacts})


def _lifted(model: dict[str, Any]) -> dict[str, Any]:
    """Move the floor of a model to just below its lowest shape."""
    lowest = np.inf
    for contact in model["contacts"].values():
        body, shape = model["bodies"][contact["bodies"][1]], contact["shapes"][1]
        c, s = np.cos(body["angle"]), np.sin(body["angle"])
        around = [shape["point"]] if "point" in shape else shape.get("polygon")
        radius = 0.0
        if "circle" in shape:
            around, radius = [shape["circle"]["center"]], shape["circle"]["radius"]
        lowest = min(lowest, *(body["position"][1] + s * x + c * y - radius for x, y in around))
    floor = {"line": {"point": [0.0, float(lowest - 0.05)], "normal": [0.0, 1.0]}}
    for contact in model["contacts"].values():
        contact["shapes"][0] = floor
    return model


def pile(random: np.random.Generator) -> dict[str, Any]:
    """Return polygons that fall on a floor and on each other."""
    count = int(random.integers(2, 4))
    bodies, contacts, shapes = {}, {}, {}
    for i in range(count):
        name, size = f"b{i}", float(random.uniform(0.1, 0.2))
        mass = float(random.uniform(0.5, 2.0))
        bodies[name] = {
            "mass": mass, "inertia": 0.3 * mass * size**2,
            "position": [float(random.uniform(-0.1, 0.1)), 0.25 + 0.42 * i],
            "angle": float(random.uniform(-3.0, 3.0)), "velocity": random.uniform(-1.0, 0.0, 2).tolist(),
        }  # fmt: skip
        shapes[name] = {"polygon": _polygon(random, size)}
        contacts[f"floor{i}"] = {"bodies": ["ground", name], "shapes": [FLOOR, shapes[name]]} | _law(random)
    contacts["others"] = {"among": list(bodies), "shapes": shapes} | _law(random)
    return {"bodies": bodies, "contacts": contacts}


def hill(random: np.random.Generator) -> dict[str, Any]:
    """Return one or two bodies that fall on uneven ground, with vertical steps in half of the cases."""
    count = int(random.integers(3, 20))
    x = np.sort(random.uniform(-1.0, 1.0, count))
    if random.random() < 0.5:
        x[1::3] = x[0::3][: len(x[1::3])]
    y = random.choice([0.02, 0.1, 0.2]) * random.standard_normal(count)
    points = np.column_stack([[-2.0, *x, 2.0], [y[0], *y, y[-1]]])  # with level ends
    ground = {"polyline": points.tolist()}
    bodies, contacts = {}, {}
    for i in range(int(random.integers(1, 3))):
        name, mass, size = f"b{i}", float(random.uniform(0.5, 2.0)), float(random.uniform(0.1, 0.3))
        bodies[name] = {
            "mass": mass, "inertia": 0.1 * mass * size**2,
            "position": [float(random.uniform(-0.8, 0.8)), float(np.max(y)) + 0.5],
            "angle": float(random.uniform(-3.0, 3.0)), "velocity": random.uniform(-1.0, 1.0, 2).tolist(),
            "angular_velocity": float(random.uniform(-4.0, 4.0)),
        }  # fmt: skip
        shape = _shape(random, size, random.uniform(-0.02, 0.02, 2).tolist())
        contacts[f"floor{i}"] = {"bodies": ["ground", name], "shapes": [ground, shape]} | _law(random)
    return {"bodies": bodies, "contacts": contacts}


Kinds = Sequence[Callable[[np.random.Generator], dict[str, Any]]]

KINDS: Kinds = (free_bodies, chain, loop)
PILES: Kinds = (pile,)
HILLS: Kinds = (hill,)


def drawn(seed: int, kinds: Kinds = KINDS) -> dict[str, Any]:
    """Return the model of a seed."""
    random = np.random.default_rng(seed)
    model = {"name": "mechanism"} | kinds[seed % len(kinds)](random)
    contacts = model["contacts"]
    while sum(len(one["shapes"][1].get("polygon", [0])) for one in contacts.values() if "bodies" in one) > MOST:
        contacts.pop(random.choice([name for name in contacts if not name.startswith("floor")]))
    return model


def computed(model: dict[str, Any], treatment: str, step: float, end: float = END, law: str = "newton") -> mbdkit.Run:
    """Return the run of a model."""
    method = "moreau-jean" if treatment == "time-stepping" else "dop853"
    return mbdkit.run(
        {"mbdkit": 1, "model": model}, integrator={"name": method}, time={"end": end, "step": step},
        contact={"treatment": treatment} | ({"impact_law": law} if treatment == "event-driven" else {}),
        output={"every": max(1, round(STEP / step))},
    )  # fmt: skip


def moved(model: dict[str, Any], by: float) -> dict[str, Any]:
    """Return the model with other initial velocities, which change by `by` [m/s] at most."""
    random = np.random.default_rng(1)
    bodies = {}
    for name, body in model["bodies"].items():
        velocity = np.array(body.get("velocity", [0.0, 0.0])) + by * random.uniform(-1.0, 1.0, 2)
        bodies[name] = body | {"velocity": velocity.tolist()}
    return model | {"bodies": bodies}


def positions(run: mbdkit.Run) -> np.ndarray:
    """Return all positions and angles (T, 3 B)."""
    return np.concatenate([np.column_stack([run[name].position, run[name].angle]) for name in run.bodies], axis=1)


@dataclass
class Found:
    """What was found in one mechanism.

    Attributes
    ----------
    faults
        Sentences about what does not hold.
    contacts, impacts
        Numbers of rows of contacts, and of impacts.
    outcome
        Status and reason of the event-driven run.
    changed
        Whether another law of impact was used.
    known
        Share of the time in which the motion is well determined, and the order of impacts too.
    ratios
        Largest differences between the treatments over the steps [m/s], up to that time; one more if they grow.
    """

    faults: list[str]
    contacts: int
    impacts: int
    outcome: str
    changed: bool = False
    known: float = 0.0
    ratios: tuple[float, ...] = ()


def _event_faults(run: mbdkit.Run, static: dict[str, float]) -> list[str]:
    """Return what does not hold in an event-driven run."""
    faults = []
    size = max(float(np.max(run.energy.kinetic)), 1e-6)
    if run.status != "complete":
        faults.append(f"{run.status}: {run.status_reason}")
    lost = run.impacts.energy_lost
    if len(lost) and np.min(lost) < -1e-10 * size:
        faults.append(f"an impact gains {-np.min(lost):.3g} J")
    for name in run.contacts:
        one = run.contacts[name]
        largest = 1e-6 * max(1.0, float(np.max(one.normal_force)))
        if np.min(one.gap) < -1e-9:
            faults.append(f"'{name}' overlaps by {-np.min(one.gap):.3g} m")
        if np.min(one.normal_force) < -largest:
            faults.append(f"'{name}' pulls with {-np.min(one.normal_force):.3g} N")
        if np.any((one.gap > 1e-8) & (one.normal_force > largest)):
            faults.append(f"'{name}' pushes at a distance")
        if np.any((one.mode == 1.0) & (np.abs(one.slip) > 1e-8)):
            faults.append(f"'{name}' creeps with {np.max(np.abs(one.slip[one.mode == 1.0])):.3g} m/s")
        limit = static[name] * one.normal_force + largest
        if np.any(np.abs(one.friction_force) > limit):
            faults.append(f"the friction of '{name}' is beyond its limit")
    return faults + _open_joints(run, 1e-10)


def _energy_faults(run: mbdkit.Run, model: dict[str, Any], law: str) -> list[str]:
    """Return whether energy changes between impacts by more than the error of the method, which steps reduce."""
    size = max(float(np.max(run.energy.kinetic)), 1e-6)
    off = float(np.max(np.abs(run.energy.balance)))
    if off <= 1e-6 * size:
        return []
    finer = float(np.max(np.abs(computed(model, "event-driven", STEP / 5, law=law).energy.balance)))
    if finer < 1e-6 * size + 0.01 * off:
        return []
    return [f"energy is off by {off:.3g} of {size:.3g} J, with smaller steps by {finer:.3g} J"]


def _open_joints(run: mbdkit.Run, limit: float) -> list[str]:
    worst = max((float(np.max(run.joints[name].misalignment)) for name in run.joints), default=0.0)
    return [f"joints open by {worst:.3g} m"] if worst > limit else []


def examined(seed: int, law: str = "newton", *, compare: bool = True, kinds: Kinds = KINDS) -> Found:
    """Return what was found in the mechanism of a seed.

    Parameters
    ----------
    law
        Law of impact of the event-driven runs.
    compare
        Whether to compare event-driven runs with time-stepping.
    kinds
        Functions that draw mechanisms, used in turn.
    """
    model = drawn(seed, kinds)
    run = computed(model, "event-driven", STEP, law=law)
    static = {}
    for name in run.contacts:
        friction = model["contacts"][name.split(".")[0]]["friction"]
        static[name] = friction["static"] if isinstance(friction, dict) else friction
    faults = _event_faults(run, static) + _energy_faults(run, model, law)
    found = Found(faults, len(run.contacts), len(run.impacts.time), run.status_reason or run.status)
    found.changed = any("would have created energy" in text for text in run.warnings)
    if not compare or law != "newton":
        return found
    other = computed(moved(model, SHIFT), "event-driven", STEP)
    rows = min(len(run.time), len(other.time))
    growth = np.max(np.abs(positions(run)[:rows] - positions(other)[:rows]), axis=1) / SHIFT
    known = int(np.argmax(growth > WELL_DETERMINED)) if np.any(growth > WELL_DETERMINED) else rows
    if found.changed:  # the two treatments replace the law of impact in different ways where several contacts touch
        known = 1
    found.known = (known - 1) / round(END / STEP)
    differences, steps = [], []
    for step in (*STEPS, 0.25 * STEPS[-1]):
        if len(steps) == len(STEPS) and _is_bounded(_ratios(differences, steps, known)):
            break
        coarse = computed(model, "time-stepping", step)
        found.faults += _stepping_faults(coarse, step)
        rows = min(len(run.time), len(coarse.time))
        differences.append(np.max(np.abs(positions(coarse)[:rows] - positions(run)[:rows]), axis=1))
        steps.append(step)
    if not _is_bounded(_ratios(differences, steps, known)):
        # other contacts that strike within a step strike together in time-stepping, where their order may decide
        pairs = zip(run.impacts.time, run.impacts.time[1:], run.impacts.contact, run.impacts.contact[1:], strict=False)
        unclear = [first for first, then, a, b in pairs if a != b and 0.0 < then - first < 2.0 * steps[-1]]
        unclear += _held_by_static_friction(run, model)
        if unclear:
            known = min(known, int(min(unclear) / STEP))
            found.known = (known - 1) / round(END / STEP)
    found.ratios = _ratios(differences, steps, known)
    if not _is_bounded(found.ratios):
        found.faults.append("the treatments do not converge to each other")
    return found


def _held_by_static_friction(run: mbdkit.Run, model: dict[str, Any]) -> list[float]:
    """Return the times of impacts after which a contact sticks that any slip, however small, would let slide away.

    Its friction is beyond the kinetic coefficient, so that the motion does not depend continuously on the velocities
    after the impact: they decide whether the contact sticks, and have errors in time-stepping.
    """
    times = []
    for time, name in zip(run.impacts.time, run.impacts.contact, strict=True):
        friction, one = model["contacts"][name.split(".")[0]]["friction"], run.contacts[name]
        row = int(np.searchsorted(run.time, time))
        sticks = row < len(run.time) and one.mode[row] == 1.0
        kinetic = friction["kinetic"] if isinstance(friction, dict) else np.inf
        if sticks and abs(one.friction_force[row]) > kinetic * one.normal_force[row]:
            times.append(float(time))
    return times


def _ratios(differences: list[np.ndarray], steps: list[float], known: int) -> tuple[float, ...]:
    """Return the largest differences in the rows that are known, over the steps."""
    return tuple(float(np.max(one[: max(known, 1)])) / step for one, step in zip(differences, steps, strict=True))


def _is_bounded(ratios: tuple[float, ...]) -> bool:
    """Return whether differences that shrink with the step do so in proportion, but for the place of impacts in it."""
    return ratios[-1] <= 1.6 * max(ratios[:-1]) + 1e-6


def _stepping_faults(run: mbdkit.Run, step: float) -> list[str]:
    """Return what does not hold in a run by time-stepping."""
    faults = _open_joints(run, 1e-10)
    if run.status != "complete":
        faults.append(f"{run.status}: {run.status_reason}")
    if (depth := -min(float(np.min(run.contacts[name].gap)) for name in run.contacts)) > 1e-9:
        faults.append(f"shapes overlap by {depth:.3g} m")
    off, lost = float(np.max(np.abs(run.energy.balance))), float(run.energy.dissipated[-1])
    if not run.joint_names and off > 1e-3 * lost + 1e-9:  # with joints, the method has an error of order 1
        faults.append(f"energy is off by {off:.3g} J, of {lost:.3g} J dissipated")
    return [f"time-stepping with {step:g} s: {fault}" for fault in faults]
