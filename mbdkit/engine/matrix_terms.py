"""Terms of the stage matrix: the index of each value in the working arrays, its position in the matrix and its factor.

The matrix of a stage with rate ``h mu`` is

    [ M + h mu C + (h mu)^2 K                     Phi_q^T ]
    [ Phi_q - h mu gamma_v + (h mu)^2 res_q       0       ]

With ``h mu = 0`` this is the matrix of the index-1 system.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels import element_kernels as e
from mbdkit.engine.kernels.applied_forces import BODY_FORCE, COUPLED, PATHWAYS, POINT_FORCE
from mbdkit.engine.kernels.constraints import KINDS
from mbdkit.engine.kernels.cross_sections import NODES

CONSTANT, RATE, MINUS_RATE, RATE_SQUARED = range(4)
"""Classes of factors: 1, h mu, -h mu and (h mu)^2."""


@dataclass(frozen=True)
class MatrixTerms:
    """The N terms of the stage matrix.

    Attributes
    ----------
    source : (N,) int array
        Index of the value in ``Scratch.source``.
    row, column : (N,) int arrays
        Position in the matrix.
    factor : (N,) int array
        Class of the factor: CONSTANT, RATE, MINUS_RATE or RATE_SQUARED.
    """

    source: np.ndarray
    row: np.ndarray
    column: np.ndarray
    factor: np.ndarray

    def chosen(self, *, tangents: bool) -> MatrixTerms:
        """Return all terms if `tangents`, otherwise those of the index-1 system."""
        return self if tangents else self.kept(self.factor == CONSTANT)

    def kept(self, keep: np.ndarray) -> MatrixTerms:
        """Return the terms for which `keep` (N,) is true."""
        return MatrixTerms(self.source[keep], self.row[keep], self.column[keep], self.factor[keep])

    def coefficients(self, rate: complex) -> np.ndarray:
        """Return the factor of each term for ``rate = h mu``."""
        return np.array([1.0, rate, -rate, rate * rate])[self.factor]


def matrix_terms(mechanism: CompiledMechanism, offsets: dict[str, int], *, stabilized: bool) -> MatrixTerms:
    """Return every term of the stage matrix.

    Parameters
    ----------
    mechanism
        The compiled mechanism.
    offsets
        Index in ``Scratch.source`` at which each array of terms begins.
    stabilized
        Whether Baumgarte's terms are part of gamma, whose derivatives then have at least the pattern of the Jacobian.
    """
    top = mechanism.topology
    tables = (top.pairs, top.rows, top.spare, top.springs, top.couplings, top.loads, top.sections, mechanism.row_index)
    return _terms(len(mechanism.bodies), tuple(map(_Table.of, tables)), tuple(offsets.items()), stabilized)


@dataclass(frozen=True)
class _Table:
    """An array of integers that can be compared and hashed."""

    values: bytes
    shape: tuple[int, ...]

    @classmethod
    def of(cls, array: np.ndarray) -> _Table:
        return cls(array.astype(np.int64).tobytes(), array.shape)

    @property
    def array(self) -> np.ndarray:
        return np.frombuffer(self.values, np.int64).reshape(self.shape)


@lru_cache(maxsize=4)
def _terms(
    count: int, tables: tuple[_Table, ...], places: tuple[tuple[str, int], ...], stabilized: bool
) -> MatrixTerms:
    """Return the terms of a mechanism with these integers; cached, because the runs of a study usually have the
    same.
    """
    of_pairs, of_rows, spare, springs, couplings, loads, sections, row_index = (table.array for table in tables)
    offsets = dict(places)
    n3 = 3 * count
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray, int]] = []

    def add(source: np.ndarray, row: np.ndarray, column: np.ndarray, factor: int) -> None:
        keep = ((row < n3) | (row >= n3 + 3)) & ((column < n3) | (column >= n3 + 3))
        parts.append((source[keep], row[keep], column[keep], factor))

    def coordinate(bodies: np.ndarray, column: int) -> np.ndarray:
        return 3 * bodies[:, column // 3] + column % 3

    def multiplier(members: np.ndarray, place: int) -> np.ndarray:
        return (
            row_index[members, place] + 3
        )  # three columns are reserved for the coordinates of ground and removed below

    diagonal = np.arange(n3)
    add(diagonal, diagonal, diagonal, CONSTANT)
    for kind, code in KINDS.items():
        members = np.flatnonzero(of_pairs[:, 0] == code)
        bodies = of_pairs[members, 1:3]
        reduced = np.isin(members, spare[:, 0])
        for entry in range(12):
            # If one of two rows is redundant, the other is a combination of both and has no structural zeros. A pair
            # without rows has no multiplier.
            taken = np.where(reduced, (entry < 6) & (of_rows[members] == 1), entry in e.JACOBIAN_ENTRIES[kind])
            some, ends = members[taken], bodies[taken]
            row, column = multiplier(some, entry // 6), coordinate(ends, entry % 6)
            add(offsets["jac"] + 12 * some + entry, row, column, CONSTANT)
            add(offsets["jac"] + 12 * some + entry, column, row, CONSTANT)
            if stabilized:
                add(offsets["gamma_v"] + 12 * some + entry, row, column, MINUS_RATE)
                add(offsets["res_q"] + 12 * some + entry, row, column, RATE_SQUARED)
        for entry in e.STIFFNESS_ENTRIES[kind]:
            add(
                offsets["stiff"] + 36 * members + entry,
                coordinate(bodies, entry // 6),
                coordinate(bodies, entry % 6),
                RATE_SQUARED,
            )
        for name, written, factor in (
            ("gamma_v", e.GAMMA_V_ENTRIES, MINUS_RATE),
            ("res_q", e.RESIDUAL_Q_ENTRIES, RATE_SQUARED),
        ):
            for entry in written[kind]:
                held = row_index[members, entry // 6] >= 0
                if stabilized:  # the entries of the Jacobian are listed above
                    listed = entry in e.JACOBIAN_ENTRIES[kind]
                    held &= ~np.where(reduced, (entry < 6) & (of_rows[members] == 1), listed)
                add(
                    offsets[name] + 12 * members[held] + entry,
                    multiplier(members[held], entry // 6),
                    coordinate(bodies[held], entry % 6),
                    factor,
                )
    for path, code in PATHWAYS.items():
        members = np.flatnonzero(springs[:, 0] == code)
        bodies = springs[members, 1:3]
        for i in e.GRADIENT_ENTRIES[path]:
            for j in e.GRADIENT_ENTRIES[path]:
                entry = 6 * i + j
                add(
                    offsets["spring_stiff"] + 36 * members + entry,
                    coordinate(bodies, i),
                    coordinate(bodies, j),
                    RATE_SQUARED,
                )
                add(offsets["spring_damp"] + 36 * members + entry, coordinate(bodies, i), coordinate(bodies, j), RATE)
    number = np.arange(len(couplings))
    of_couplings = [springs[couplings[:, side], 1:3] for side in range(2)]
    for i in e.GRADIENT_ENTRIES[COUPLED]:
        for j in e.GRADIENT_ENTRIES[COUPLED]:
            row, column, place = coordinate(of_couplings[0], i), coordinate(of_couplings[1], j), 36 * number + 6 * i + j
            add(offsets["coupled_stiff"] + place, row, column, RATE_SQUARED)
            add(offsets["coupled_damp"] + place, row, column, RATE)
    for kind_of_load, entries in ((POINT_FORCE, (2,)), (BODY_FORCE, (0, 1))):
        members = np.flatnonzero(loads[:, 0] == kind_of_load)
        first = 3 * loads[members, 1]
        for entry in entries:
            add(offsets["load_stiff"] + 3 * members + entry, first + entry, first + 2, RATE_SQUARED)
    for count in range(2, NODES + 1):
        members = np.flatnonzero(sections[:, 1] == count)
        nodes = sections[members, 2:]
        for i in range(3 * count):
            for j in range(3 * count):
                row, column, place = coordinate(nodes, i), coordinate(nodes, j), 81 * members + 9 * i + j
                add(offsets["beam_stiff"] + place, row, column, RATE_SQUARED)
                add(offsets["beam_damp"] + place, row, column, RATE)

    source, row, column = (np.concatenate([part[i] for part in parts]).astype(np.int64) for i in range(3))
    factors = np.concatenate([np.full(len(part[0]), part[3], dtype=np.int64) for part in parts])
    return MatrixTerms(source, np.where(row >= n3, row - 3, row), np.where(column >= n3, column - 3, column), factors)
