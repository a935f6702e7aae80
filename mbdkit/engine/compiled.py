"""A mechanism compiled to flat arrays: numbers instead of names, and the way back from numbers to names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.engine.analysis import minimum_degree, neighbours
from mbdkit.engine.constraints import KINDS
from mbdkit.engine.forces import PATHWAYS, POINT_FORCE, TORQUE
from mbdkit.engine.motions import OPCODES
from mbdkit.engine.system import Topology
from mbdkit.mechanism.elements import Distance, Driver, PointForce, Revolute, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.expression import Expression
from mbdkit.mechanism.mechanism import Mechanism

Numbers = tuple[float, ...]

WELL_SCALED = 1e6
"""Largest ratio of masses (and of inertias over squared arms) at which the Schur complement keeps its digits."""


@dataclass(frozen=True)
class Row:
    """One constraint row: the pair and the place in it, its label ``joint.row`` and its unit."""

    pair: int
    place: int
    label: str
    unit: str


@dataclass(frozen=True)
class CompiledMechanism:
    """A mechanism as the kernels see it; immutable, shared by any number of runs.

    Attributes
    ----------
    topology
        Flat arrays.
    bodies, joints
        Names, in the order of the mechanism.
    joint_bodies
        (J,) names of the first and the second body of each joint.
    rows
        Constraint rows in the order of the mechanism's joints; row i is unknown ``3 B + i`` of a pivoted system.
    joint_pairs
        (J,) the pairs of rows that make up each joint.
    motions
        What each motion was written as.
    order, below
        Order of elimination of the pairs and the fill that goes with it.
    well_scaled
        Whether the Schur complement may serve.
    """

    topology: Topology
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    joint_bodies: tuple[tuple[str, str], ...]
    rows: tuple[Row, ...]
    joint_pairs: tuple[tuple[int, ...], ...]
    motions: tuple[float | str, ...]
    order: tuple[int, ...]
    below: tuple[frozenset[int], ...]
    well_scaled: bool

    @property
    def size(self) -> int:
        """Length of a state vector, 3 (B + 1)."""
        return 3 * (len(self.bodies) + 1)

    @property
    def row_index(self) -> np.ndarray:
        """(P, 2) unknown of each multiplier in a pivoted system, -1 for an empty row."""
        index = np.full((len(self.topology.pairs), 2), -1, dtype=np.int64)
        for i, row in enumerate(self.rows):
            index[row.pair, row.place] = 3 * len(self.bodies) + i
        return index

    @property
    def natural_order(self) -> np.ndarray:
        """(n,) unknowns of a pivoted system with bodies first, then multipliers in order of elimination."""
        multipliers = self.row_index.ravel()
        return np.concatenate([np.arange(3 * len(self.bodies)), multipliers[multipliers >= 0]])

    def unknown_name(self, index: int) -> str:
        """Return in words which body or joint an unknown of a pivoted system belongs to."""
        if 0 <= index < 3 * len(self.bodies):
            return f"body {self.bodies[index // 3]!r}{self._joints_on(index // 3)}"
        if index >= 0 and index - 3 * len(self.bodies) < len(self.rows):
            return f"joint {self.rows[index - 3 * len(self.bodies)].label.split('.')[0]!r}"
        return "the mechanism"

    def _joints_on(self, body: int) -> str:
        """Return in words which joints hold a body."""
        pairs = self.topology.pairs
        held = [
            name
            for name, members in zip(self.joints, self.joint_pairs, strict=True)
            if any(body in pairs[k, 1:3] for k in members)
        ]
        if not held:
            return ""
        listed = ", ".join(held[:4]) + (", ..." if len(held) > 4 else "")
        return f" (joint{'s' * (len(held) > 1)} {listed})"


class _Motions:
    """Collects the motions of a mechanism as one program store; equal motions share a number."""

    def __init__(self) -> None:
        self.numbers: dict[float | str, int] = {}
        self.start, self.ops, self.values = [0], [], []  # type: list[int], list[int], list[float]

    def add(self, motion: float | str) -> int:
        if motion not in self.numbers:
            program = Expression.parse(motion).program if isinstance(motion, str) else (("const", float(motion)),)
            self.ops += [OPCODES[name] for name, _ in program]
            self.values += [float(value) for _, value in program]
            self.start.append(len(self.ops))
            self.numbers[motion] = len(self.start) - 2
        return self.numbers[motion]


def compile_mechanism(mechanism: Mechanism) -> CompiledMechanism:
    """Compile a validated mechanism to flat arrays.

    Parameters
    ----------
    mechanism
        Bodies, joints and forces by name.

    Returns
    -------
    CompiledMechanism
        With the pairs of constraint rows numbered in order of elimination.
    """
    bodies = tuple(mechanism.bodies)
    number = {name: i for i, name in enumerate(bodies)}
    ground = number["ground"] = len(bodies)
    motions = _Motions()
    kinds, ends, parameters, driven = _constraints(mechanism, number, motions)
    order, below = minimum_degree(neighbours(ends, ground))
    place = {pair: k for k, pair in enumerate(order)}

    rows = [
        Row(place[written], r, f"{name}.{row}", unit)
        for written, (name, joint) in enumerate(mechanism.joints.items())
        for r, (row, unit) in enumerate(zip(joint.rows, joint.units, strict=True))
    ]
    joint_pairs = [(place[written],) for written in range(len(mechanism.joints))]
    row_counts = [len(joint.rows) for joint in mechanism.joints.values()]

    springs, spring_points, spring_laws, loads, load_points = _forces(mechanism, number, motions)
    mass = np.ones((len(bodies) + 1, 3))
    for i, body in enumerate(mechanism.bodies.values()):
        mass[i] = (body.mass, body.mass, 1.0 if body.inertia is None else body.inertia)
    weight = 1 / mass
    weight[ground] = 0.0
    topology = Topology(
        mass=mass,
        weight=weight,
        gravity=np.array(mechanism.gravity, dtype=float),
        pairs=np.array([(KINDS[kinds[k]], *ends[k], driven[k]) for k in order], dtype=np.int64).reshape(-1, 4),
        rows=np.array([row_counts[k] for k in order], dtype=np.int64),
        pair_parameters=np.array([parameters[k] for k in order], dtype=float).reshape(-1, 6),
        springs=np.array(springs, dtype=np.int64).reshape(-1, 3),
        spring_points=np.array(spring_points, dtype=float).reshape(-1, 6),
        spring_laws=np.array(spring_laws, dtype=float).reshape(-1, 3),
        loads=np.array(loads, dtype=np.int64).reshape(-1, 5),
        load_points=np.array(load_points, dtype=float).reshape(-1, 2),
        motion_start=np.array(motions.start, dtype=np.int64),
        motion_ops=np.array(motions.ops, dtype=np.int64),
        motion_values=np.array(motions.values, dtype=float),
    )
    return CompiledMechanism(
        topology=topology,
        bodies=bodies,
        joints=tuple(mechanism.joints),
        joint_bodies=tuple(joint.bodies for joint in mechanism.joints.values()),
        rows=tuple(rows),
        joint_pairs=tuple(joint_pairs),
        motions=tuple(motions.numbers),
        order=tuple(order),
        below=tuple(frozenset(b) for b in below),
        well_scaled=_is_well_scaled(mechanism),
    )


def _constraints(
    mechanism: Mechanism, number: dict[str, int], motions: _Motions
) -> tuple[list[str], list[tuple[int, int]], list[Numbers], list[int]]:
    """Return kind, bodies, parameters and motion of every pair of rows, in the order of the joints."""
    kinds: list[str] = []
    ends: list[tuple[int, int]] = []
    parameters: list[Numbers] = []
    driven: list[int] = []
    for joint in mechanism.joints.values():
        a, b = (number[name] for name in joint.bodies)
        motion, last = -1, 0.0
        if isinstance(joint, Driver):
            kind, points = f"driver_{joint.coordinate}", ((0.0, 0.0), joint.point)
            motion = motions.add(joint.motion)
        elif isinstance(joint, Distance):
            kind, points, last = "distance", joint.points, joint.length
        else:
            assert isinstance(joint, Revolute)
            kind, points = "revolute", joint.points
        kinds.append(kind)
        ends.append((a, b))
        parameters.append((*points[0], *points[1], last, 0.0))
        driven.append(motion)
    return kinds, ends, parameters, driven


def _forces(
    mechanism: Mechanism, number: dict[str, int], motions: _Motions
) -> tuple[list[Numbers], list[Numbers], list[Numbers], list[Numbers], list[Numbers]]:
    """Return force elements (topology, points, laws) and loads (topology, points)."""
    springs: list[Numbers] = []
    spring_points: list[Numbers] = []
    spring_laws: list[Numbers] = []
    loads: list[Numbers] = []
    load_points: list[Numbers] = []
    for force in mechanism.forces.values():
        if isinstance(force, SpringDamper):
            springs.append((PATHWAYS["two_points"], *(number[name] for name in force.bodies)))
            spring_points.append((*force.points[0], *force.points[1], 0.0, 0.0))
            spring_laws.append((force.stiffness, force.damping, force.free_length))
        elif isinstance(force, TorsionSpring):
            springs.append((PATHWAYS["relative_angle"], *(number[name] for name in force.bodies)))
            spring_points.append((0.0,) * 6)
            spring_laws.append((force.stiffness, force.damping, force.free_angle))
        elif isinstance(force, Torque):
            reaction = number[force.reaction_body] if force.reaction_body is not None else number["ground"]
            loads.append((TORQUE, number[force.body], reaction, motions.add(force.value), -1))
            load_points.append((0.0, 0.0))
        else:
            assert isinstance(force, PointForce)
            loads.append((POINT_FORCE, number[force.body], number["ground"], *(motions.add(x) for x in force.value)))
            load_points.append(force.point)
    return springs, spring_points, spring_laws, loads, load_points


def _is_well_scaled(mechanism: Mechanism) -> bool:
    """Return whether masses, and inertias over squared arms, lie within `WELL_SCALED` of each other."""
    arms = dict.fromkeys(mechanism.bodies, 0.0)
    for joint in mechanism.joints.values():
        for _, name, (x, y) in joint.attachments():
            if name in arms:
                arms[name] = max(arms[name], x * x + y * y)
    scales = [body.mass for body in mechanism.bodies.values()]
    scales += [body.inertia / arms[name] for name, body in mechanism.bodies.items() if body.inertia and arms[name] > 0]
    return not scales or max(scales) <= WELL_SCALED * min(scales)
