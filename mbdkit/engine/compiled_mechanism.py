"""A compiled mechanism: flat arrays of numbers instead of names, and the way back from numbers to names."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from mbdkit.engine.jit.law_compiler import CompiledLaw
from mbdkit.engine.kernels.system import Topology
from mbdkit.mechanism.values import Motion
from mbdkit.text import counted, listed


@dataclass(frozen=True)
class Row:
    """One constraint row: the pair and the place in it, its label ``joint.row`` and its unit."""

    pair: int
    place: int
    label: str
    unit: str


@dataclass(frozen=True)
class Redundancy:
    """What a mechanism has more of than it needs: nothing, to begin with.

    Attributes
    ----------
    rows
        Number of redundant constraint rows, which are not solved for.
    joints
        Joints that they belong to, drivers included, in the order of the mechanism.
    not_unique
        Joints whose reactions are not determined by the motion.
    """

    rows: int = 0
    joints: tuple[str, ...] = ()
    not_unique: tuple[str, ...] = ()

    def describe(self, drivers: Collection[str] = ()) -> str:
        """Return it in words, such as ``1 redundant row: joint D``; empty where there is none."""
        if not self.rows:
            return ""
        kinds = (
            ("joint", [name for name in self.joints if name not in drivers]),
            ("driver", [name for name in self.joints if name in drivers]),
        )
        named = [f"{kind}{'s' * (len(names) > 1)} {listed(names, 'and')}" for kind, names in kinds if names]
        return f"{counted(self.rows, 'redundant row')}: {listed(named, 'and')}"


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
        Constraint rows in the order of the mechanism's joints, redundant ones included.
    joint_pairs
        (J,) the pairs of rows that make up each joint.
    drivers
        Names of the joints that are drivers.
    coordinates
        Number of coordinates that mean something: 3 for each body, 2 for each point mass.
    length
        The largest distance of two joint points on one body, or of a joint point from its body's centre of mass [m];
        1 where there is none.
    motions
        What each motion was written as.
    laws
        The force laws that are no linear springs, in the order of the topology's rows: the force and its law.
    order, below
        Order of elimination of the pairs and the fill that goes with it.
    well_scaled
        Whether the Schur complement may serve.
    redundancy
        What is not solved for because it follows from the rest.
    """

    topology: Topology
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    joint_bodies: tuple[tuple[str, str], ...]
    rows: tuple[Row, ...]
    joint_pairs: tuple[tuple[int, ...], ...]
    drivers: frozenset[str]
    coordinates: int
    length: float
    motions: tuple[Motion, ...]
    laws: tuple[tuple[str, CompiledLaw], ...]
    order: tuple[int, ...]
    below: tuple[frozenset[int], ...]
    well_scaled: bool
    redundancy: Redundancy = Redundancy()

    def freedoms(self) -> str:
        """Return in words the degrees of freedom by rank, as in ``1 degree of freedom, 10 joints, 1 driver``."""
        number = self.coordinates - int(np.sum(self.topology.rows))
        parts = [
            counted(number, "degree of freedom", "degrees of freedom"),
            counted(len(self.joints) - len(self.drivers), "joint"),
            counted(len(self.drivers), "driver") if self.drivers else "",
            self.redundancy.describe(self.drivers),
        ]
        return ", ".join(part for part in parts if part)

    @property
    def size(self) -> int:
        """Length of a state vector, 3 (B + 1)."""
        return 3 * (len(self.bodies) + 1)

    @property
    def unknowns(self) -> int:
        """Number of accelerations and of multipliers that are solved for."""
        return 3 * len(self.bodies) + int(np.sum(self.topology.rows))

    @property
    def row_index(self) -> np.ndarray:
        """(P, 2) unknown of each multiplier in a pivoted system, -1 for a row that is not solved for."""
        index = np.full((len(self.topology.pairs), 2), -1, dtype=np.int64)
        for i, row in enumerate(self.solved_rows):
            index[row.pair, row.place] = 3 * len(self.bodies) + i
        return index

    @property
    def solved_rows(self) -> list[Row]:
        """Rows of a pivoted system; in a pair with a redundant direction the place is not that of its own row."""
        return [row for row in self.rows if row.place < self.topology.rows[row.pair]]

    @property
    def natural_order(self) -> np.ndarray:
        """(n,) unknowns of a pivoted system with bodies first, then multipliers in order of elimination."""
        multipliers = self.row_index.ravel()
        return np.concatenate([np.arange(3 * len(self.bodies)), multipliers[multipliers >= 0]])

    def unknown_name(self, index: int) -> str:
        """Return in words which body or joint an unknown of a pivoted system belongs to."""
        if 0 <= index < 3 * len(self.bodies):
            return f"body {self.bodies[index // 3]!r}{self._joints_on(index // 3)}"
        if index >= 0 and index < self.unknowns:
            return f"joint {self.solved_rows[index - 3 * len(self.bodies)].label.split('.')[0]!r}"
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
