"""One run's hold on a compiled mechanism: working arrays, the solver in use, and how its pivots are chosen."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.elimination_order import (
    empty_pattern,
    empty_schur,
    new_factors,
    pivot_order,
    power_of_two,
    schur_schedule,
    symbolic_lu,
)
from mbdkit.engine.jit.bundle import PinnedBundle
from mbdkit.engine.kernels import element_kernels as e
from mbdkit.engine.kernels.constraints import KINDS
from mbdkit.engine.kernels.forces import BODY_FORCE, PATHWAYS, POINT_FORCE
from mbdkit.engine.kernels.lu import Factors, Pattern
from mbdkit.engine.kernels.motions import MAX_DEPTH
from mbdkit.engine.kernels.system import Engine, Scatter, Scratch, Solver, Topology
from mbdkit.engine.stabilization import NONE, Stabilization

MOST_COUPLINGS = 60
"""Couplings per pair of rows above which a body has too many joints for the Schur complement."""


@dataclass(frozen=True)
class Terms:
    """The entries of the stage matrix: ``source`` number of each term, its row and column, and its factor's class."""

    source: np.ndarray
    row: np.ndarray
    column: np.ndarray
    factor: np.ndarray

    def chosen(self, *, tangents: bool) -> Terms:
        """Return all terms, or without `tangents` those of the bare KKT matrix."""
        return self if tangents else self.kept(self.factor == 0)

    def kept(self, keep: np.ndarray) -> Terms:
        """Return the terms for which `keep` (N,) is true."""
        return Terms(self.source[keep], self.row[keep], self.column[keep], self.factor[keep])

    def coefficients(self, rate: complex) -> np.ndarray:
        """Return the factor of each term for ``rate = h mu``."""
        return np.array([1.0, rate, -rate, rate * rate])[self.factor]


@dataclass
class Workspace:
    """A compiled mechanism with the arrays and the solver of one run.

    Parameters
    ----------
    mechanism
        The compiled mechanism.
    t0
        Start time [s].
    q0, v0
        (3 (B + 1),) consistent start: positions and velocities, ground last.
    formulation
        Of the equations that are stepped.
    stabilization
        What is done against the drift of constraints.
    """

    mechanism: CompiledMechanism
    t0: float
    q0: np.ndarray
    v0: np.ndarray
    formulation: str = "index-1"
    stabilization: Stabilization = NONE
    stepping_topology: Topology = field(init=False)
    """The mechanism as it is stepped: with Baumgarte's terms, if so stabilized. What is recorded is taken without."""
    scratch: Scratch = field(init=False)
    solver: Solver = field(init=False)
    terms: Terms = field(init=False)
    pivotings: int = field(init=False, default=0)
    """How often pivots were chosen by numbers."""

    def __post_init__(self) -> None:
        self.scratch, offsets = new_scratch(self.mechanism)
        top = self.mechanism.topology
        self.stepping_topology = top._replace(baumgarte=self.stabilization.coefficients)
        stabilized = bool(np.any(self.stepping_topology.baumgarte))
        self.terms = _stage_terms(self.mechanism, offsets, stabilized=stabilized)
        pairs = [(int(a), int(b)) for a, b in top.pairs[:, 1:3]]
        on_body = np.bincount(top.pairs[:, 1:3].ravel(), minlength=len(top.mass))[:-1]
        crowded = int(np.sum(on_body**2)) > MOST_COUPLINGS * max(len(pairs), 1)
        pivoted = crowded or not self.mechanism.well_scaled
        ground = len(self.mechanism.bodies)
        below = [set(later) for later in self.mechanism.below]
        self.solver = Solver(
            pivoted=np.array([int(pivoted)]),
            schur=empty_schur() if pivoted else schur_schedule(pairs, ground, self.mechanism.order, below),
            pattern=empty_pattern(),
            factors=new_factors(empty_pattern(), np.float64),
            scatter=_scatter(self.terms.chosen(tangents=False), np.zeros(0, dtype=np.int64)),
            row_index=self.mechanism.row_index,
            failed=np.array([-1]),
        )
        self._engine = PinnedBundle(Engine(top, self.scratch, self.solver))
        self._stepping_engine = PinnedBundle(Engine(self.stepping_topology, self.scratch, self.solver))

    @property
    def engine(self) -> int:
        """Where kernels find the mechanism, the working arrays and the solver in use."""
        return self._engine.address

    @property
    def stepping_engine(self) -> int:
        """Where they find the mechanism as it is stepped, with the same arrays and solver."""
        return self._stepping_engine.address

    @property
    def has_power(self) -> bool:
        """Whether loads, drivers, dampers or laws act, so that work and dissipated energy change."""
        top = self.mechanism.topology
        return bool(len(top.loads) or np.any(top.pairs[:, 3] >= 0) or np.any(top.linear[:, 1]) or len(top.laws))

    @property
    def unknowns(self) -> int:
        """Number of accelerations and multipliers, 3 B + m."""
        return self.mechanism.unknowns

    def choose_pivots(self, rate: complex | None = None) -> tuple[Pattern, Factors, Scatter]:
        """Choose pivots for the numbers that stand in ``scratch.source`` now.

        Parameters
        ----------
        rate
            ``h mu`` of a stage matrix, real or complex; None for the bare KKT matrix.

        Returns
        -------
        Pattern, Factors, Scatter
            What `mbdkit.engine.kernels.lu` and `gather_values` need.

        Raises
        ------
        SingularSystemError
            Where the matrix is singular.
        """
        terms = self.terms.chosen(tangents=rate is not None)
        pattern, position = self.pivots_of(terms, terms.coefficients(0.0 if rate is None else rate))
        return pattern, new_factors(pattern, complex if isinstance(rate, complex) else float), _scatter(terms, position)

    def pivots_of(self, terms: Terms, coefficients: np.ndarray) -> tuple[Pattern, np.ndarray]:
        """Choose pivots for the sum of `terms` with their `coefficients`, by the numbers that stand in ``source`` now.

        Returns
        -------
        Pattern
            Patterns of the matrix and of its factors.
        position : int array
            Where each term goes among the values of the matrix.

        Raises
        ------
        SingularSystemError
            Where the matrix is singular.
        """
        self.pivotings += 1
        n = self.unknowns
        flat = terms.row * n + terms.column
        entries, which = np.unique(flat, return_inverse=True)
        row, column = entries // n, entries % n
        values = np.zeros(len(entries), dtype=coefficients.dtype)
        np.add.at(values, which, coefficients * self.scratch.source[terms.source])
        scales = (np.ones(n), self._inertial_scale())
        choice = pivot_order(n, row, column, values, self.mechanism.natural_order, scales)
        pattern, position = symbolic_lu(n, row, column, choice)
        return pattern, position[which]

    def _inertial_scale(self) -> np.ndarray:
        """Return (n,) powers of two near M^-1/2 for coordinates and diag(Phi_q M^-1 Phi_q^T)^-1/2 for multipliers."""
        top, jac = self.mechanism.topology, self.scratch.jac.reshape(-1, 2, 2, 3)
        weight = top.weight[top.pairs[:, 1:3]]
        diagonal = np.einsum("krsc,ksc->kr", jac**2, weight)
        scale = np.ones(self.unknowns)
        scale[: 3 * len(self.mechanism.bodies)] = np.sqrt(top.weight[:-1].ravel())
        for index, value in zip(self.mechanism.row_index.ravel(), diagonal.ravel(), strict=True):
            if index >= 0 and 0 < value < np.inf:
                scale[index] = 1 / np.sqrt(value)
        return power_of_two(scale)

    def is_finite(self) -> bool:
        """Return whether the terms that were evaluated last are finite numbers."""
        w = self.scratch
        return bool(all(np.all(np.isfinite(x)) for x in (w.source, w.gamma, w.force)))

    def motions_are_finite(self) -> bool:
        """Return whether drivers and loads were finite numbers where they were evaluated last."""
        return finite_motions(self.mechanism.topology, self.scratch.u)

    def unusable_law(self) -> str | None:
        """Return the name of the last force whose law gave no finite number, if any."""
        law = int(self.scratch.faulty[0])
        return self.mechanism.laws[law][0] if law >= 0 else None

    def with_own_pivots(self) -> Workspace:
        """Return a workspace that shares the arrays of this one, but whose pivots are chosen independently."""
        other = copy(self)
        other.pivotings = 0
        other.solver = self.solver._replace(pivoted=self.solver.pivoted.copy())
        other._engine = PinnedBundle(self._engine.bundle._replace(solver=other.solver))
        other._stepping_engine = PinnedBundle(self._stepping_engine.bundle._replace(solver=other.solver))
        return other

    def use_pivots(self) -> None:
        """Solve for accelerations with newly chosen pivots from now on; raises SingularSystemError."""
        pattern, factors, scatter = self.choose_pivots()
        self.solver.pivoted[0] = 1
        self.solver = self.solver._replace(pattern=pattern, factors=factors, scatter=scatter)
        for hold in (self._engine, self._stepping_engine):
            hold.replace(hold.bundle._replace(solver=self.solver))


def finite_motions(top: Topology, u: np.ndarray) -> bool:
    """Return whether all values of `u` (motions, 3) that are in use are finite: derivatives count for drivers only."""
    driven = np.unique(top.pairs[:, 3][top.pairs[:, 3] >= 0])
    return bool(np.all(np.isfinite(u[:, 0])) and np.all(np.isfinite(u[driven])))


def new_scratch(mechanism: CompiledMechanism) -> tuple[Scratch, dict[str, int]]:
    """Return working arrays, and where each array of terms begins in `source`."""
    top = mechanism.topology
    n3, p, s, loads = 3 * len(mechanism.bodies), len(top.pairs), len(top.springs), len(top.loads)
    shapes = {
        "jac": (p, 12), "stiff": (p, 36), "gamma_v": (p, 12), "res_q": (p, 12),
        "spring_stiff": (s, 36), "spring_damp": (s, 36), "load_stiff": (loads, 3),
    }  # fmt: skip
    offsets, total = {"mass": 0}, n3
    for name, (rows, columns) in shapes.items():
        offsets[name] = total
        total += rows * columns
    source = np.zeros(total)
    source[:n3] = top.mass[:-1].ravel()
    views = {name: source[offsets[name] : offsets[name] + r * c].reshape(r, c) for name, (r, c) in shapes.items()}
    cs = np.zeros((len(mechanism.bodies) + 1, 2))
    cs[:, 0] = 1.0
    unknowns = mechanism.unknowns
    scratch = Scratch(
        time=np.zeros(1),
        cs=cs,
        u=np.zeros((len(top.motion_start) - 1, 3)),
        stack=np.zeros((MAX_DEPTH, 3)),
        force=np.zeros(mechanism.size),
        phi=np.zeros((p, 2)),
        phi_t=np.zeros((p, 2)),
        gamma=np.zeros((p, 2)),
        refinement=np.zeros((p, 2)),
        s=np.zeros((s, 1)),
        grad=np.zeros((s, 6)),
        hess=np.zeros((s, 36)),
        tension=np.zeros((s + 1, 4)),
        faulty=np.array([-1]),
        source=source,
        loose=np.zeros((len(top.spare), 6)),
        push=np.zeros(mechanism.size),
        right=np.zeros(unknowns),
        solution=np.zeros(unknowns),
        correction=np.zeros(unknowns),
        **views,
    )
    return scratch, offsets


def _stage_terms(mechanism: CompiledMechanism, offsets: dict[str, int], *, stabilized: bool) -> Terms:
    """List every term of the stage matrix; factor classes 0..3 are 1, h mu, -h mu and h^2 mu^2.

    Where Baumgarte's terms stabilize it, the derivatives of gamma have entries wherever the Jacobian has.
    """
    top, row_index = mechanism.topology, mechanism.row_index
    n3 = 3 * len(mechanism.bodies)
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray, int]] = []

    def add(source: np.ndarray, row: np.ndarray, column: np.ndarray, factor: int) -> None:
        keep = ((row < n3) | (row >= n3 + 3)) & ((column < n3) | (column >= n3 + 3))
        parts.append((source[keep], row[keep], column[keep], factor))

    def coordinate(bodies: np.ndarray, column: int) -> np.ndarray:
        return 3 * bodies[:, column // 3] + column % 3

    def multiplier(members: np.ndarray, place: int) -> np.ndarray:
        return row_index[members, place] + 3  # ground's three coordinates come between, and go out again below

    diagonal = np.arange(n3)
    add(diagonal, diagonal, diagonal, 0)
    for kind, code in KINDS.items():
        members = np.flatnonzero(top.pairs[:, 0] == code)
        bodies = top.pairs[members, 1:3]
        reduced = np.isin(members, top.spare[:, 0])
        for entry in range(12):
            # two rows folded into one fill it; a pair without rows that are solved for has no multiplier
            taken = np.where(reduced, (entry < 6) & (top.rows[members] == 1), entry in e.JACOBIAN_ENTRIES[kind])
            some, ends = members[taken], bodies[taken]
            row, column = multiplier(some, entry // 6), coordinate(ends, entry % 6)
            add(offsets["jac"] + 12 * some + entry, row, column, 0)
            add(offsets["jac"] + 12 * some + entry, column, row, 0)
            if stabilized:
                add(offsets["gamma_v"] + 12 * some + entry, row, column, 2)
                add(offsets["res_q"] + 12 * some + entry, row, column, 3)
        for entry in e.STIFFNESS_ENTRIES[kind]:
            add(
                offsets["stiff"] + 36 * members + entry,
                coordinate(bodies, entry // 6),
                coordinate(bodies, entry % 6),
                3,
            )
        for name, written, level in (("gamma_v", e.GAMMA_V_ENTRIES, 2), ("res_q", e.RESIDUAL_Q_ENTRIES, 3)):
            for entry in written[kind]:
                held = row_index[members, entry // 6] >= 0
                if stabilized:  # what the Jacobian has is listed already
                    listed = entry in e.JACOBIAN_ENTRIES[kind]
                    held &= ~np.where(reduced, (entry < 6) & (top.rows[members] == 1), listed)
                add(
                    offsets[name] + 12 * members[held] + entry,
                    multiplier(members[held], entry // 6),
                    coordinate(bodies[held], entry % 6),
                    level,
                )
    for path, code in PATHWAYS.items():
        members = np.flatnonzero(top.springs[:, 0] == code)
        bodies = top.springs[members, 1:3]
        for i in e.GRADIENT_ENTRIES[path]:
            for j in e.GRADIENT_ENTRIES[path]:
                entry = 6 * i + j
                add(offsets["spring_stiff"] + 36 * members + entry, coordinate(bodies, i), coordinate(bodies, j), 3)
                add(offsets["spring_damp"] + 36 * members + entry, coordinate(bodies, i), coordinate(bodies, j), 1)
    for load, entries in ((POINT_FORCE, (2,)), (BODY_FORCE, (0, 1))):
        members = np.flatnonzero(top.loads[:, 0] == load)
        first = 3 * top.loads[members, 1]
        for entry in entries:
            add(offsets["load_stiff"] + 3 * members + entry, first + entry, first + 2, 3)

    source, row, column = (np.concatenate([part[i] for part in parts]).astype(np.int64) for i in range(3))
    factor = np.concatenate([np.full(len(part[0]), part[3], dtype=np.int64) for part in parts])
    return Terms(source, np.where(row >= n3, row - 3, row), np.where(column >= n3, column - 3, column), factor)


def _scatter(terms: Terms, target: np.ndarray) -> Scatter:
    """Sort terms by their factor into the lists that `gather_values` runs through."""
    if len(target) == 0:
        target = np.zeros(len(terms.source), dtype=np.int64)
    both = np.column_stack([terms.source, target]).astype(np.int64)
    return Scatter(*(np.ascontiguousarray(both[terms.factor == factor]) for factor in range(4)))
