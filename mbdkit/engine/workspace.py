"""Workspace of one run: a compiled mechanism with its working arrays, its solver and its pivots."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from mbdkit.engine.compile_mechanism import compile_mechanism
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
from mbdkit.engine.input_schedule import InputSchedule
from mbdkit.engine.kernels import table_rows
from mbdkit.engine.kernels.bundle_types import example_of
from mbdkit.engine.kernels.cross_sections import STATE
from mbdkit.engine.kernels.engine_bundles import Engine, Reacting, Scatter, Scratch, Solver, Topology
from mbdkit.engine.kernels.lu import Factors, Pattern
from mbdkit.engine.kernels.motions import OF_CENTER
from mbdkit.engine.kernels.pose_functions import ROWS
from mbdkit.engine.kernels.system import DIVERGED, NOT_FINITE, OK
from mbdkit.engine.matrix_terms import MatrixTerms, matrix_terms
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.python_controllers import PythonControllers
from mbdkit.engine.stabilization import NONE, Stabilization
from mbdkit.expressions.program import MAX_DEPTH
from mbdkit.mechanism.mechanism import Mechanism


@dataclass
class Workspace:
    """A compiled mechanism with the arrays and the solver of one run.

    `t0`: start time [s]. `q0`, `v0`: (3 (B + 1),) consistent start: positions and velocities, ground last.
    `formulation`: name of the formulation of the stepped equations. `stabilization`: stabilization against drift of the
    constraints.
    """

    mechanism: CompiledMechanism
    t0: float
    q0: np.ndarray
    v0: np.ndarray
    formulation: str = "index-1"
    stabilization: Stabilization = NONE
    #: Values of the inputs of the mechanism during the run; without schedules, inputs keep their initial values.
    schedules: tuple[InputSchedule, ...] = ()
    #: Calls the functions of controllers in Python; None if they are not called, so that their outputs are 0.
    python: PythonControllers | None = None
    #: Topology of the integrated equations, with Baumgarte's terms if the run is stabilized by them.
    #:
    #: Recorded accelerations are computed without these terms.
    stepping_topology: Topology = field(init=False)
    scratch: Scratch = field(init=False)
    solver: Solver = field(init=False)
    _offsets: dict[str, int] = field(init=False, repr=False)
    pivotings: int = field(init=False, default=0)  #: Number of times that pivots have been chosen.

    def __post_init__(self) -> None:
        self.scratch, self._offsets = new_scratch(self.mechanism)
        top = self.mechanism.topology
        stabilized = bool(np.any(self.stabilization.coefficients))
        self.stepping_topology = top._replace(baumgarte=self.stabilization.coefficients) if stabilized else top
        pairs = [(int(a), int(b)) for a, b in top.pairs[:, table_rows.BODIES]]
        pivoted = self.mechanism.needs_pivots
        ground = len(self.mechanism.bodies)
        below = [set(later) for later in self.mechanism.below]
        self.solver = Solver(
            pivoted=np.array([int(pivoted)]),
            schur=empty_schur() if pivoted else schur_schedule(pairs, ground, self.mechanism.order, below),
            pattern=empty_pattern(),
            factors=new_factors(empty_pattern(), np.float64),
            scatter=example_of(Scatter),
            row_index=self.mechanism.row_index,
            failed=np.array([-1]),
        )
        self._engine = PinnedBundle(Engine(top, self.scratch, self.solver))
        # Creating bundles takes most of the time of a small workspace; therefore only one is created if both engines
        # are equal.
        self._stepping_engine = (
            PinnedBundle(Engine(self.stepping_topology, self.scratch, self.solver)) if stabilized else self._engine
        )

    @cached_property
    def terms(self) -> MatrixTerms:
        """Terms of the stage matrix; explicit methods and the Schur complement do not need them."""
        stabilized = bool(np.any(self.stepping_topology.baumgarte))
        return matrix_terms(self.mechanism, self._offsets, stabilized=stabilized)

    @property
    def engine(self) -> int:
        """Address of the `Engine` bundle: mechanism, working arrays and solver in use."""
        return self._engine.address

    @property
    def stepping_engine(self) -> int:
        """Address of the bundle of the integrated equations, with the same arrays and solver."""
        return self._stepping_engine.address

    @property
    def unknowns(self) -> int:
        """Number of accelerations and multipliers, 3 B + m."""
        return self.mechanism.unknowns

    def leave_out_held_loads(self) -> None:
        """Integrate equations without the loads that show forces which the method computes itself, and without
        first-order states if there are no others than those that it sets.

        These forces are zero during a step, and the states constant; see
        `mbdkit.engine.compile_forces.Lowering.held_load`.
        """
        top, is_set = self.stepping_topology, [state.by_method for state in self.mechanism.states]
        held = self.mechanism.topology.states[np.flatnonzero(is_set), table_rows.STATE_ROW.parameter]
        of_held = np.isin(top.laws[:, table_rows.LAW_ROW.parameters] + 1, held)
        is_shown = np.isin(top.load_values[:, table_rows.LOAD_VALUE.law], np.flatnonzero(of_held))
        is_held = np.isin(top.loads[:, table_rows.LOAD.x], top.load_values[is_shown, table_rows.LOAD_VALUE.motion])
        loads, laws = (len(some) - np.count_nonzero(some) for some in (is_held, of_held))
        if not all(is_held[loads:]) or not all(of_held[laws:]):  # others have to keep their indices
            return
        top = top._replace(
            laws=top.laws[:laws],
            loads=top.loads[:loads],
            load_points=top.load_points[:loads],
            load_values=np.ascontiguousarray(top.load_values[~is_shown]),
        )
        if all(is_set):
            top = top._replace(states=top.states[:0], state_places=top.state_places[:0])
        self.stepping_topology = top
        self._stepping_engine = PinnedBundle(Engine(self.stepping_topology, self.scratch, self.solver))

    def choose_pivots(self, rate: complex | None = None) -> tuple[Pattern, Factors, Scatter]:
        """Choose pivots for the current values in ``scratch.source``.

        `rate`: ``h mu`` of a stage matrix, real or complex; None for the matrix of the index-1 system. Returns
        arguments of `mbdkit.engine.kernels.lu` and of `gather_values`. Raises SingularSystemError if the matrix is
        singular.
        """
        terms = self.terms.chosen(tangents=rate is not None)
        pattern, position = self.pivots_of(terms, terms.coefficients(0.0 if rate is None else rate))
        return pattern, new_factors(pattern, complex if isinstance(rate, complex) else float), _scatter(terms, position)

    def pivots_of(self, terms: MatrixTerms, coefficients: np.ndarray) -> tuple[Pattern, np.ndarray]:
        """Choose pivots for the sum of `terms` with their `coefficients`, using the current values in
        ``scratch.source``.

        Returns patterns of the matrix and of its factors, and index of each term among the values of the matrix. Raises
        SingularSystemError if the matrix is singular.
        """
        self.pivotings += 1
        n = self.unknowns
        flat = terms.row * n + terms.column
        entries, which = np.unique(flat, return_inverse=True)
        row, column = entries // n, entries % n
        values = np.zeros(len(entries), dtype=coefficients.dtype)
        with np.errstate(all="ignore"):  # values that are not finite are refused as singular
            np.add.at(values, which, coefficients * self.scratch.source[terms.source])
        scales = (np.ones(n), self._inertial_scale())
        choice = pivot_order(n, row, column, values, self.mechanism.natural_order, scales)
        pattern, position = symbolic_lu(n, row, column, choice)
        return pattern, position[which]

    def _inertial_scale(self) -> np.ndarray:
        """Return (n,) powers of two near M^-1/2 for coordinates and diag(Phi_q M^-1 Phi_q^T)^-1/2 for multipliers."""
        top, jac = self.mechanism.topology, self.scratch.jac.reshape(-1, 2, 2, 3)
        diagonal = np.einsum("krsc,ksc->kr", jac**2, top.weight[top.pairs[:, table_rows.BODIES]])
        scale = np.ones(self.unknowns)
        scale[: 3 * len(self.mechanism.bodies)] = np.sqrt(top.weight[:-1].ravel())
        for index, value in zip(self.mechanism.row_index.ravel(), diagonal.ravel(), strict=True):
            if index >= 0 and 0 < value < np.inf:
                scale[index] = 1 / np.sqrt(value)
        return power_of_two(scale)

    def is_finite(self, *, tangents: bool = True) -> bool:
        """Return whether the matrix terms, gamma and forces of the last evaluation are finite.

        `tangents`: whether the derivatives of forces and constraints are checked as well. They are not part of the
        index-1 system, and may belong to an earlier state.
        """
        w = self.scratch
        terms = w.source if tangents else w.source[self.terms.chosen(tangents=False).source]
        return bool(all(np.all(np.isfinite(x)) for x in (terms, w.gamma, w.force)))

    def clamp_motions(self, begin: float, end: float) -> None:
        """From now on, evaluate motions and loads before `begin` as at `begin`, and after `end` as at `end` [s].

        A step between two discontinuities must use the one-sided limits within the step, although its first and last
        stage are at the discontinuities up to rounding errors.
        """
        self.scratch.sides[:] = begin, end

    def take_states(self, z: np.ndarray) -> None:
        """Use the values `z` (Z,) of first-order states in later evaluations of forces."""
        state, index = self.mechanism.topology.state_places.T
        self.scratch.law_values[index] = z[state]

    def unusable(self) -> str:
        """Return a clause that names the force or motion that was not finite in the last evaluation; empty if all were
        finite.
        """
        if self.scratch.faulty[0] in self.mechanism.topology.load_values[:, table_rows.LOAD_VALUE.law]:
            return f"the value of load '{self.unusable_law()}' is not finite"
        if self.scratch.faulty[0] in self.mechanism.topology.interactions[:, table_rows.INTERACTION.law]:
            return f"the force of {self.unusable_law()} is not finite"
        if self.scratch.faulty[0] in self.mechanism.topology.functions[:, table_rows.FUNCTION.law]:
            return f"the constraint of joint '{self.unusable_law()}' is not finite"
        if self.locks:
            return (
                f"the friction and the reaction of joint '{self.unusable_law()}' have no solution: the joint locks "
                "itself,"
            )
        if not finite_motions(self.mechanism.topology, self.scratch.u):
            return "the value of a driver, a load or a moving center is not finite"
        if force := self.unusable_law():
            return f"the law of force '{force}' does not give a finite number"
        return ""

    @property
    def locks(self) -> bool:
        """Whether the last evaluation failed because the friction in the joints has no solution."""
        top = self.mechanism.topology
        return bool(self.scratch.faulty[0] in top.springs[top.frictions, table_rows.SPRING.law])

    @property
    def cause(self) -> Literal["self-locking", "not-finite"]:
        """Failure code that corresponds to `unusable`."""
        return "self-locking" if self.locks else "not-finite"

    def unusable_law(self) -> str | None:
        """Return the name of the force element whose law was the last to return no finite number, or None."""
        law = int(self.scratch.faulty[0])
        return self.mechanism.laws[law][0] if law >= 0 else None

    def use_pivots(self) -> None:
        """Switch to the pivoted solver, with pivots for the current values; raise SingularSystemError if the
        matrix is singular.
        """
        pattern, factors, scatter = self.choose_pivots()
        self.solver.pivoted[0] = 1
        self.use_solver(self.solver._replace(pattern=pattern, factors=factors, scatter=scatter))

    def use_solver(self, solver: Solver) -> None:
        """Replace the solver."""
        self.solver = solver
        for pinned in dict.fromkeys((self._engine, self._stepping_engine)):
            pinned.replace(pinned.bundle._replace(solver=self.solver))

    def for_another_run(self, formulation: str, stabilization: Stabilization) -> Workspace:
        """Return a workspace with the same mechanism and start, and its own arrays and solver.

        `formulation`, `stabilization`: see `Workspace`.
        """
        return replace(self, formulation=formulation, stabilization=stabilization)

    def with_own_pivots(self) -> Workspace:
        """Return a workspace that shares the arrays of this one, but whose pivots are chosen independently.

        The motions of the new workspace are not clamped.
        """
        other = copy(self)
        other.pivotings = 0
        other.scratch = self.scratch._replace(sides=np.array([-np.inf, np.inf]))
        other.solver = self.solver._replace(pivoted=self.solver.pivoted.copy())
        own = {"w": other.scratch, "solver": other.solver}
        other._engine = PinnedBundle(self._engine.bundle._replace(**own))
        is_one = self._stepping_engine is self._engine
        other._stepping_engine = other._engine if is_one else PinnedBundle(self._stepping_engine.bundle._replace(**own))
        return other

    @property
    def failed_unknown(self) -> int:
        """Index of the unknown at which the last pivoted factorization failed; -1 if there is none."""
        failed, order = int(self.solver.failed[0]), self.solver.pattern.column_of
        return int(order[failed]) if 0 <= failed < len(order) else -1

    def retry_with_new_pivots(self, solve: Callable[[], int]) -> int:
        """Call `solve`; if it fails because of unsuitable pivots, choose new ones and call it again.

        `solve`: solves a system with ``engine`` or ``stepping_engine``, read anew in each call, and returns a status of
        `mbdkit.engine.kernels.system`. Returns the last status. If the index-1 system is not finite, or an iteration
        has diverged, new pivots cannot help, and `solve` is called once. Raises SingularSystemError if no pivots can be
        found.
        """
        status = solve()
        if status in (OK, NOT_FINITE, DIVERGED) or not self.is_finite(tangents=False):
            return status
        self.use_pivots()
        return solve()


def finite_motions(top: Topology, u: np.ndarray) -> bool:
    """Return whether all values of `u` (motions, 3) that are used are finite; the derivatives of loads are not used."""
    driven = top.pairs[:, table_rows.PAIR.motion]
    count = len(top.motion_start) - 1
    centers = u[count - OF_CENTER * len(top.centers) : count]
    return all(bool(np.all(np.isfinite(x))) for x in (u[:, 0], u[driven[driven >= 0]], centers))


def new_scratch(mechanism: CompiledMechanism) -> tuple[Scratch, dict[str, int]]:
    """Return working arrays, and the index in ``source`` at which each array of terms begins."""
    top = mechanism.topology
    n3, p, s, loads = 3 * len(mechanism.bodies), len(top.pairs), len(top.springs), len(top.loads)
    couplings, sections = len(top.couplings), len(top.sections)
    shapes = {
        "jac": (p, 12), "stiff": (p, 36), "gamma_v": (p, 12), "res_q": (p, 12),
        "spring_stiff": (s, 36), "spring_damp": (s, 36),
        "coupled_stiff": (couplings, 36), "coupled_damp": (couplings, 36), "load_stiff": (loads, 3),
        "slope_stiff": (len(top.slopes), 36), "slope_damp": (len(top.slopes), 36),
        "interaction_stiff": (len(top.interactions), 36), "interaction_damp": (len(top.interactions), 36),
        "beam_stiff": (sections, 81), "beam_damp": (sections, 81),
    }  # fmt: skip
    offsets, total = {"mass": 0}, n3
    for name, (rows, columns) in shapes.items():
        offsets[name] = total
        total += rows * columns
    source = np.zeros(total)
    source[:n3] = top.mass[:-1].ravel()
    views = {name: source[offsets[name] : offsets[name] + r * c].reshape(r, c) for name, (r, c) in shapes.items()}
    changing = any(map(len, (top.states, top.inputs, top.reactions, top.interactions, top.functions)))
    guides = np.count_nonzero(top.springs[:, table_rows.SPRING.guide] >= 0)
    frictions, reactions = len(top.frictions), mechanism.size if mechanism.reacting is not None else 0
    zeros = {
        "time": 1, "u": (len(top.motion_start) - 1 + ROWS * len(top.functions), 3), "stack": (MAX_DEPTH, 3),
        "force": mechanism.size, "phi": (p, 2), "phi_t": (p, 2), "gamma": (p, 2), "refinement": (p, 2),
        "s": (s, 1), "grad": (s, 6), "hess": (s, 36), "guide": (guides, 9), "tension": (s + 1, len(table_rows.TENSION)),
        "interaction": (len(top.interactions), 6), "interaction_slopes": (1, 72),
        "section": (sections, STATE), "section_force": (sections, 4), "section_stress": (sections, 3),
        "section_energy": (sections, 2), "section_stiff": (sections, 16), "section_damp": (sections, 16),
        "friction": (frictions, frictions + 3), "response": (len(top.reactions), frictions + 1),
        "loose": (len(top.spare), 6), "push": mechanism.size,
        "right": mechanism.unknowns, "solution": mechanism.unknowns, "correction": mechanism.unknowns,
    }  # fmt: skip
    scratch = Scratch(
        sides=np.array([-np.inf, np.inf]),
        cs=np.tile([1.0, 0.0], (len(mechanism.bodies) + 1, 1)),
        law_values=top.law_parameters.copy() if changing else top.law_parameters,
        reacting=_new_reacting(reactions, p if reactions else 0),
        faulty=np.array([-1]),
        source=source,
        **{name: np.zeros(shape) for name, shape in zeros.items()},
        **views,
    )
    return scratch, offsets


def _new_reacting(size: int, pairs: int) -> Reacting:
    words = ("acts", "add_forces", "engine", "elements", "constrain", "run", "stages", "shows")
    return Reacting(
        **{name: np.zeros(1 + 2 * (name == "add_forces"), dtype=np.int64) for name in words},
        **{name: np.zeros(size) for name in ("q", "v", "acc")},
        lam=np.zeros((pairs, 2)),
        power=np.zeros(1),
    )


def scratch_of(mechanism: CompiledMechanism, converted: Callable[[Scratch], Scratch]) -> Scratch:
    """Return working arrays of dual numbers or of lanes.

    `converted`: function that returns an array of such numbers for a given array, with an additional last axis for the
    parts of a number.
    """
    plain, offsets = new_scratch(mechanism)
    scratch = converted(plain)
    views: dict[str, Any] = {}
    for name, begin in offsets.items():
        if name != "mass":
            rows, columns = getattr(plain, name).shape
            views[name] = scratch.source[begin : begin + rows * columns].reshape(
                rows, columns, *scratch.source.shape[1:]
            )
    return scratch._replace(**views)


def _scatter(terms: MatrixTerms, target: np.ndarray) -> Scatter:
    """Group terms by the class of their factor into the lists that `gather_values` reads.

    `target` (N,) is the index of each term among the values of the matrix.
    """
    both = np.column_stack([terms.source, target]).astype(np.int64)
    return Scatter(*(np.ascontiguousarray(both[terms.factor == factor]) for factor in range(4)))


def example_workspace() -> Workspace:
    """Return a workspace of a single free body.

    Its arrays have the types of those of any workspace; kernels are compiled for these types.
    """
    m = Mechanism()
    m.body("body", mass=1.0, inertia=1.0)
    return Workspace(compile_mechanism(m), 0.0, np.zeros(6), np.zeros(6))
