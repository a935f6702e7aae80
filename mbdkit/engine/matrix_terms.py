"""Terms of the stage matrix: the index of each value in the working arrays, its position in the matrix and its factor.

The matrix of a stage with rate ``h mu`` is

    [ M + h mu C + (h mu)^2 K                     Phi_q^T ]
    [ Phi_q - h mu gamma_v + (h mu)^2 res_q       0       ]

where h is the step size, mu an eigenvalue of the method's coefficients, M the mass matrix, Phi_q the constraint
Jacobian, and the others are the tangents that `mbdkit.engine.equations_of_motion.Tangents` defines. With ``h mu = 0``
this is the matrix of the index-1 system.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from itertools import product

import numpy as np

from mbdkit.base.frozen import dataclass
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels import element_kernels as e
from mbdkit.engine.kernels.applied_forces import BODY_FORCE, PATHWAYS, POINT_FORCE
from mbdkit.engine.kernels.constraints import KINDS
from mbdkit.engine.kernels.cross_sections import NODES
from mbdkit.engine.kernels.table_rows import BODIES, COUPLING, INTERACTION, LOAD, PAIR, SECTION, SLOPE, SPARE, SPRING

CONSTANT, RATE, MINUS_RATE, RATE_SQUARED = range(4)  #: Classes of factors: 1, h mu, -h mu and (h mu)^2.


@dataclass(frozen=True)
class MatrixTerms:
    """The N terms of the stage matrix.

    `source` ((N,) int array): index of the value in ``Scratch.source``. `row`, `column` ((N,) int arrays): position in
    the matrix. `factor` ((N,) int array): class of the factor: CONSTANT, RATE, MINUS_RATE or RATE_SQUARED.
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

    `offsets`: index in ``Scratch.source`` at which each array of terms begins. `stabilized`: whether gamma includes
    Baumgarte's terms. The pattern of its derivatives then includes that of the Jacobian.
    """
    top = mechanism.topology
    tables = (
        top.pairs, top.rows, top.spare, top.springs, top.couplings, top.loads, top.sections, mechanism.row_index,
        top.slopes, top.inputs, top.interactions,
    )  # fmt: skip
    hashable = tuple([(table.astype(np.int64).tobytes(), table.shape) for table in tables])
    return _terms(len(mechanism.bodies), hashable, tuple(offsets.items()), stabilized)


@lru_cache(maxsize=4)
def _terms(
    count: int, tables: tuple[tuple[bytes, tuple[int, ...]], ...], places: tuple[tuple[str, int], ...], stabilized: bool
) -> MatrixTerms:
    """Return the terms of a mechanism with these integer arrays, each as its bytes and its shape; cached, because runs
    of a study share them.
    """
    pairs, rows, spare, springs, couplings, loads, sections, row_index, slopes, inputs, interactions = (
        np.frombuffer(values, np.int64).reshape(shape) for values, shape in tables
    )
    terms = _Terms(3 * count, row_index, dict(places))
    diagonal = np.arange(3 * count)
    terms.add(diagonal, diagonal, diagonal, CONSTANT)
    for kind, code in KINDS.items():
        terms.add_constraints(kind, np.flatnonzero(pairs[:, PAIR.kind] == code), pairs, rows, spare, stabilized)
    for path, code in PATHWAYS.items():
        members = np.flatnonzero(springs[:, SPRING.pathway] == code)
        bodies = springs[members, BODIES]
        terms.add_tangents("spring", 36 * members, 6, (bodies, bodies), e.GRADIENT_ENTRIES[path])
    for path, code in PATHWAYS.items():
        members = np.flatnonzero(springs[couplings[:, COUPLING.of_force], SPRING.pathway] == code)
        of_force, of_coordinates = couplings[members].T
        sides = springs[of_force, BODIES], springs[of_coordinates, BODIES]
        terms.add_tangents("coupled", 36 * members, 6, sides, e.GRADIENT_ENTRIES[path])
    for kind_of_load, entries in ((POINT_FORCE, (2,)), (BODY_FORCE, (0, 1))):
        members = np.flatnonzero(loads[:, LOAD.kind] == kind_of_load)
        first = 3 * loads[members, LOAD.body]
        for entry in entries:
            terms.add(terms.offsets["load_stiff"] + 3 * members + entry, first + entry, first + 2, RATE_SQUARED)
    if len(slopes):
        given, segment = inputs[slopes[:, SLOPE.input]], slopes[:, SLOPE.segment]
        by_coordinate = np.repeat(given[:, 1:2] // 3, 2, axis=1)
        of_input = np.where(segment[:, None] < 0, by_coordinate, springs[:, BODIES][segment] if len(springs) else 0)
        sides = loads[slopes[:, SLOPE.load], BODIES], of_input
        # If an input is a coordinate, the columns of its second body are zero.
        terms.add_tangents("slope", 36 * np.arange(len(slopes)), 6, sides, range(6))
    both = interactions[:, : INTERACTION.law]
    terms.add_tangents("interaction", 36 * np.arange(len(both)), 6, (both, both), range(6))
    for nodes in range(2, NODES + 1):
        members = np.flatnonzero(sections[:, SECTION.node_count] == nodes)
        bodies = sections[members, SECTION.node :]
        terms.add_tangents("beam", 81 * members, 9, (bodies, bodies), range(3 * nodes))
    return terms.joined()


def _coordinate(bodies: np.ndarray, column: int) -> np.ndarray:
    return 3 * bodies[:, column // 3] + column % 3


class _Terms:
    """Collects the terms of a mechanism with `n3` coordinates.

    Three rows and columns are reserved for the coordinates of the ground, before those of the multipliers. `add` leaves
    out terms in these rows and columns, and `joined` removes the rows and columns.
    """

    def __init__(self, n3: int, row_index: np.ndarray, offsets: dict[str, int]):
        self.n3, self.row_index, self.offsets = n3, row_index, offsets
        self.parts: list[tuple[np.ndarray, np.ndarray, np.ndarray, int]] = []

    def add(self, source: np.ndarray, row: np.ndarray, column: np.ndarray, factor: int) -> None:
        n3 = self.n3
        keep = ((row < n3) | (row >= n3 + 3)) & ((column < n3) | (column >= n3 + 3))
        self.parts.append((source[keep], row[keep], column[keep], factor))

    def add_constraints(
        self, kind: str, members: np.ndarray, pairs: np.ndarray, rows: np.ndarray, spare: np.ndarray, stabilized: bool
    ) -> None:
        """Add the terms of the pairs of one kind of constraint."""
        if not len(members):
            return
        offsets, bodies = self.offsets, pairs[members, BODIES]
        reduced = np.isin(members, spare[:, SPARE.pair])

        def is_listed(entry: int) -> np.ndarray:
            # If one of the two rows is redundant, the other is a combination of both and has no structural zeros. A
            # pair without rows has no multiplier.
            return np.where(reduced, (entry < 6) & (rows[members] == 1), entry in e.JACOBIAN_ENTRIES[kind])

        for entry in range(12):
            taken = is_listed(entry)
            some, ends = members[taken], bodies[taken]
            row, column = self._multiplier(some, entry // 6), _coordinate(ends, entry % 6)
            self.add(offsets["jac"] + 12 * some + entry, row, column, CONSTANT)
            self.add(offsets["jac"] + 12 * some + entry, column, row, CONSTANT)
            if stabilized:
                self.add(offsets["gamma_v"] + 12 * some + entry, row, column, MINUS_RATE)
                self.add(offsets["res_q"] + 12 * some + entry, row, column, RATE_SQUARED)
        for entry in e.STIFFNESS_ENTRIES[kind]:
            row, column = _coordinate(bodies, entry // 6), _coordinate(bodies, entry % 6)
            self.add(offsets["stiff"] + 36 * members + entry, row, column, RATE_SQUARED)
        for name, written, factor in (
            ("gamma_v", e.GAMMA_V_ENTRIES, MINUS_RATE),
            ("res_q", e.RESIDUAL_Q_ENTRIES, RATE_SQUARED),
        ):
            for entry in written[kind]:
                held = self.row_index[members, entry // 6] >= 0
                if stabilized:  # the entries of the Jacobian were added above
                    held &= ~is_listed(entry)
                row, column = self._multiplier(members[held], entry // 6), _coordinate(bodies[held], entry % 6)
                self.add(offsets[name] + 12 * members[held] + entry, row, column, factor)

    def add_tangents(
        self, name: str, first: np.ndarray, width: int, bodies: tuple[np.ndarray, np.ndarray], entries: Iterable[int]
    ) -> None:
        """Add the tangents of one kind of force with respect to positions and velocities.

        - `name`: its arrays are `name` with ``_stiff`` and ``_damp``.
        - `first`: index at which the tangent of each element begins in these arrays; a row of a tangent has `width`
          numbers.
        - `bodies`: for each element, the bodies on which the force acts, and the bodies with respect to whose
          coordinates the force is differentiated.
        - `entries`: indices of the coordinates that occur.
        """
        for i, j in product(entries if len(first) else (), repeat=2):
            place = first + width * i + j
            row, column = _coordinate(bodies[0], i), _coordinate(bodies[1], j)
            self.add(self.offsets[f"{name}_stiff"] + place, row, column, RATE_SQUARED)
            self.add(self.offsets[f"{name}_damp"] + place, row, column, RATE)

    def _multiplier(self, members: np.ndarray, place: int) -> np.ndarray:
        return self.row_index[members, place] + 3

    def joined(self) -> MatrixTerms:
        n3, parts = self.n3, self.parts
        source, row, column = (np.concatenate([part[i] for part in parts]).astype(np.int64) for i in range(3))
        factors = np.concatenate([np.full(len(part[0]), part[3], dtype=np.int64) for part in parts])
        row, column = (np.where(x >= n3, x - 3, x) for x in (row, column))
        return MatrixTerms(source, row, column, factors)
