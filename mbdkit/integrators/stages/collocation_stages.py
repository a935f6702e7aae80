"""The stages of a collocation step as one bundle (a named tuple of arrays for kernels), shared by all formulations."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from mbdkit.engine.elimination_order import empty_pattern, new_factors
from mbdkit.engine.formulation import INDEX_1, Formulation
from mbdkit.engine.kernels.bundle_types import RECORD, STATE, RealMatrix, State
from mbdkit.engine.kernels.engine_bundles import Scatter, Topology
from mbdkit.engine.kernels.lu import Factors, Pattern
from mbdkit.engine.kernels.table_rows import SECTION
from mbdkit.engine.linear_systems import inverse_of
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import inlined
from mbdkit.engine.workspace import example_workspace
from mbdkit.integrators.stages.convergence import IterationLimit, new_limit
from mbdkit.integrators.stages.element_states import is_coupled
from mbdkit.integrators.stages.relative import OnTree, new_on_tree
from mbdkit.integrators.stages.stage_polynomials import collocation_polynomials
from mbdkit.methods.tableau import ButcherTableau

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace

NEWTON, FIXED_POINT = range(2)  #: Codes of the ways to solve the stage equations.

POSITION, VELOCITY = range(2)  #: Items of `Settings.holds`.


class StageKernels(NamedTuple):
    """The parts of stage equations that `mbdkit.integrators.stages.stage_iteration` and a collocation step call.

    Numba compiles the kernels that receive such a record once for each record. `c` is the bundle of the run, `m` that
    of the stages. `tangents`, `changes` and `powers` return a status. *Lanes* are runs that advance together, one in
    each element of a SIMD vector.
    """

    #: ``(c, m, t, h, at_start, wanted)``: evaluate and factorize the stage matrices, if there are any. The state is
    #: that at the start of the step, with the multipliers of all pairs, or the mean of the stages. In lanes, matrices
    #: change only where `wanted`.
    tangents: Callable[..., int]
    #: ``(c, m, t, h, before)``: write the change of the stages by one iteration into ``m.change``; multipliers that are
    #: unknowns are changed in place. `before` is the relative change by the previous iteration, infinite in the first.
    changes: Callable[..., int]
    #: ``(c, m, h, active)``: change the accelerations, in lanes only where `active`, and evaluate the stages.
    move: Callable[..., None]
    #: ``(c, m, h)``: return the relative change that has to converge, and that of the positions.
    sizes: Callable[..., tuple[float, float]]
    #: ``(now)``: return whether a change that no longer decreases, of this relative size, counts as idle, that is, as
    #: possible round-off.
    counts_as_idle: Callable[..., bool]
    #: ``(c, m, h, now, moved, idle)``: return whether a change that no longer decreases is round-off. `now` is the
    #: relative change, `moved` that of the positions, and `idle` the number of idle changes so far.
    round_off: Callable[..., bool]
    powers: Callable[..., int] | None = None  #: ``(c, m, t, h)``: evaluate the powers of the stages into ``m.power``.
    #: ``(c, m, z, b)``: write the right-hand side of the system that filters an estimate `z` of the error of
    #: velocities.
    estimate_side: Callable[..., None] | None = None


class StageCoefficients(NamedTuple):
    """A fully implicit method of s stages, and eigenvalues of its matrix: real ones, and one of each complex pair."""

    a: np.ndarray
    a2: np.ndarray  #: (s, s) A and A A: weights of accelerations in velocities and positions of the stages.
    b: np.ndarray
    #: (s,) b and A^T b: weights of accelerations in the velocities and positions at the end of the step.
    b2: np.ndarray
    c: np.ndarray
    inverse: np.ndarray  #: (s, s) A^-1 for stiffly accurate methods; NaN otherwise.
    dense_v: np.ndarray
    #: (s, s) and (s, s + 1) polynomials of dense output (`collocation_polynomials`); zeros where nodes coincide.
    dense_q: np.ndarray
    t_real: np.ndarray
    t_real_inv: np.ndarray
    mu_real: np.ndarray
    t_complex: np.ndarray
    t_complex_inv: np.ndarray
    mu_complex: np.ndarray


@lru_cache(maxsize=32)
def coefficients_of(tableau: ButcherTableau) -> StageCoefficients:
    """Return the coefficients of a diagonalisable tableau as the kernels take them."""
    a, b, c = tableau.floats()
    a2, b2 = tableau.second_order_floats()
    s = tableau.stages
    distinct = len(set(c.tolist())) == s
    dense_v, dense_q = collocation_polynomials(c) if distinct else (np.zeros((s, s)), np.zeros((s, s + 1)))
    values, vectors, inverse = tableau.eigensystem()
    real = np.abs(values.imag) < 1e-12
    upper = ~real & (values.imag > 0)
    return StageCoefficients(
        a, a2, b, b2, c,
        inverse_of(a) if tableau.is_stiffly_accurate else np.full((s, s), np.nan),
        dense_v, dense_q,
        np.ascontiguousarray(vectors[:, real].real),
        np.ascontiguousarray(inverse[real].real),
        np.ascontiguousarray(values[real].real),
        np.ascontiguousarray(vectors[:, upper].astype(complex)),
        np.ascontiguousarray(inverse[upper].astype(complex)),
        np.ascontiguousarray(values[upper].astype(complex)),
    )  # fmt: skip


class Systems(NamedTuple):
    """The linear systems of simplified Newton, one for each eigenvalue; they share one pattern."""

    pattern: Pattern
    scatter: Scatter  #: Index of each term in the matrices, grouped by factor.
    real: Factors
    cplx: Factors  #: Factors of the matrices, stacked.
    b_real: np.ndarray  #: (n + m,) right-hand side, and solution.
    x_real: np.ndarray
    b_complex: np.ndarray
    x_complex: np.ndarray
    z_real: np.ndarray  #: Transformed residual; entries of the ground are zero.
    z_complex: np.ndarray


def new_systems(method: StageCoefficients, pattern: Pattern, scatter: Scatter, unknowns: int) -> Systems:
    """Return storage for the systems of a method, of one pattern and `unknowns` accelerations and multipliers."""
    real, cplx = (_stacked(pattern, len(x), x.dtype.type) for x in (method.mu_real, method.mu_complex))
    b_real, x_real = np.zeros((2, unknowns))
    b_complex, x_complex = np.zeros((2, unknowns), dtype=complex)
    z_real, z_complex = np.zeros(unknowns + 3), np.zeros(unknowns + 3, dtype=complex)
    return Systems(pattern, scatter, real, cplx, b_real, x_real, b_complex, x_complex, z_real, z_complex)


def _stacked(pattern: Pattern, count: int, dtype: type) -> Factors:
    """Return storage for the factors of `count` matrices of one pattern."""
    single = new_factors(pattern, dtype)
    return Factors(*(np.zeros((count, len(x)), x.dtype) for x in single))


class Settings(NamedTuple):
    """How the stage equations are set up and solved; arrays of one item unless a shape is given."""

    #: (2,) whether the constraints are imposed on the positions and on the velocities of the stages; neither for
    #: index-1. See `mbdkit.engine.formulation`.
    holds: np.ndarray
    solver: np.ndarray  #: NEWTON or FIXED_POINT.
    limit: Annotated[IterationLimit, RECORD]
    tolerance: np.ndarray  #: Relative change at which the iteration ends.


class PreviousStep(NamedTuple):
    """The step to which the stage values belong; arrays of one item."""

    begin: np.ndarray  #: Time at which this step began [s].
    size: np.ndarray  #: Size of this step [s]; NaN if there are no stage values to extrapolate.


class FirstAcceleration(NamedTuple):
    """The acceleration at the beginning of a step, for the error estimate."""

    acc: np.ndarray  #: (3 (B + 1),).
    lam: Annotated[RealMatrix, 2]  #: (P, 2) its multipliers.
    known: np.ndarray  #: (1,) whether it has been evaluated.


class TangentState(NamedTuple):
    """The state at which the tangents are evaluated: the start of the step, or the mean of all stages."""

    time: np.ndarray  #: (1,) time [s].
    q: np.ndarray
    v: np.ndarray
    acc: np.ndarray
    lam: Annotated[RealMatrix, 2]
    jac: Annotated[RealMatrix, 12]  #: (P, 12) constraint Jacobian at this state.


class StageStates(NamedTuple):
    """First-order states of force elements at the stages; see `mbdkit.integrators.stages.element_states`."""

    rate: State  #: (s, Z) derivatives with respect to time, which are unknowns of the stages.
    first_rate: State  #: (Z,) derivatives at the beginning of the step.
    z: np.ndarray  #: (s, Z) states.
    length: np.ndarray  #: (s, Z) length of the pathway of the element of each state, and its rate.
    speed: np.ndarray
    slope: np.ndarray  #: (Z,) derivative of each rate with respect to its own state, at the last stage.
    matrix: np.ndarray  #: (s n, s n) matrix, and (s n,) right side, of the equations of an element with n states.
    right: np.ndarray


class Constraints(NamedTuple):
    """Arrays of formulations that impose the constraints on the stages; empty for index 1."""

    #: (N, 4) derivatives of the equations with respect to positions: index in ``Scratch.source``, row, column, class.
    by_position: np.ndarray
    jac: np.ndarray  #: (s, P, 12) Jacobians of the stages.
    phi: np.ndarray  #: (s, P, 2) Phi of the stages.
    mu: State  #: (s, P, 2) the additional multipliers mu of ggl.
    shift: State  #: (s, 3 (B + 1)) ``w = M^-1 Phi_q^T mu`` of the stages (ggl); no rows in other formulations.
    shift_change: np.ndarray  #: Change of w by the last iteration.


class LaneKept(NamedTuple):
    """Copies of values, which are restored in lanes that have converged; see
    `mbdkit.integrators.stages.stage_iteration`.

    Single runs do not use them.
    """

    lam: np.ndarray  #: (s, P, 2) multipliers of the stages.
    counts: np.ndarray  #: (5,) counts.
    diverged: np.ndarray  #: (1,) 1 in lanes in which the iteration of the last step has diverged with finite changes.


class Stages(NamedTuple):
    """A collocation method of s stages for one mechanism with B bodies, ground, and P pairs of constraint rows.

    In the coordinates of a tree, `acc`, `residual` and `change` of index 1, and ``first.acc`` are those of the
    coordinates; `q_stage` and `v_stage` belong to the bodies.
    """

    rk: StageCoefficients
    systems: Systems
    settings: Settings
    previous: Annotated[PreviousStep, STATE]
    #: (1,) number of iterations in which `mbdkit.integrators.stages.coupled_newton` has solved for the stages of the
    #: next attempt, which are then in `acc` and `lam`; 0 if it has not.
    solved_apart: State
    #: (1,) whether the tangents of the stages turn with the nodes of beams (`mbdkit.integrators.stages.turning_beams`).
    turning: State
    nodes: np.ndarray  #: Indices of the bodies that are nodes of beams.
    acc: State  #: (s, 3 (B + 1)) accelerations of the stages.
    lam: State  #: (s, P, 2) multipliers of the stages: of the pairs (index 1), or of the rows that are solved for.
    q_stage: np.ndarray
    v_stage: np.ndarray
    residual: np.ndarray  #: (s, u) residual of the stage equations; u = 3 B (index 1) or 3 B + m unknowns a stage.
    change: np.ndarray  #: (s, u) change of accelerations, and of multipliers that are unknowns, by the last iteration.
    states: StageStates
    constraints: Constraints
    first: Annotated[FirstAcceleration, STATE]
    tangent: TangentState
    power: State  #: (s, 2) powers of the stages [W].
    weights: np.ndarray  #: (s, s) scratch: weights of extrapolation.
    dense_weights: np.ndarray  #: (s,) scratch: weights of dense output.
    spread: np.ndarray  #: (s, 3 (B + 1)) scratch.
    pairs: np.ndarray  #: (P, 2) scratch.
    on_tree: OnTree
    kept: LaneKept


@inlined
def solves_multipliers(m):
    """Return whether multipliers are unknowns of the stage equations; otherwise they follow from accelerations."""
    return m.settings.holds[POSITION] != 0 or m.settings.holds[VELOCITY] != 0


@inlined
def solves_positions_only(m):
    """Return whether the constraints are imposed on the positions of the stages only (index 3)."""
    return m.settings.holds[VELOCITY] == 0


@inlined
def is_shifted(m):
    """Return whether the constraints are imposed on positions and velocities, so that positions are shifted (ggl)."""
    return m.settings.holds[POSITION] != 0 and m.settings.holds[VELOCITY] != 0


def new_stages(
    rk: StageCoefficients,
    workspace: Workspace,
    settings: Settings,
    by_position: np.ndarray,
    tree: np.ndarray | None = None,
) -> Stages:
    """Return the bundle of a method for a mechanism, without pivots.

    Parameters
    ----------
    rk
        The method.
    workspace
        The mechanism.
    settings
        How stage equations are set up and solved.
    by_position
        See `Constraints`.
    tree
        The spanning tree whose coordinates are used; None for the coordinates of the bodies.
    """
    s, size, pairs = len(rk.c), workspace.mechanism.size, len(workspace.mechanism.topology.pairs)
    width = workspace.unknowns if settings.holds.any() else size - 3
    constrained = s if settings.holds.any() else 0
    shifted = s if settings.holds.all() else 0

    def vectors(count: int) -> np.ndarray:
        return np.zeros((count, size))

    empty = np.zeros((0, 2), dtype=np.int64)
    return Stages(
        rk=rk,
        systems=new_systems(rk, empty_pattern(), Scatter(empty, empty, empty, empty), workspace.unknowns),
        settings=settings,
        previous=PreviousStep(begin=np.zeros(1), size=np.full(1, np.nan)),
        solved_apart=np.zeros(1, dtype=np.int64),
        turning=np.zeros(1, dtype=np.int64), nodes=nodes_of_beams(workspace.mechanism.topology),
        acc=vectors(s), lam=np.zeros((s, pairs, 2)), q_stage=vectors(s), v_stage=vectors(s),
        residual=np.zeros((s, width)), change=np.zeros((s, width)),
        states=_new_states(workspace, s),
        constraints=Constraints(
            by_position=by_position, jac=np.zeros((constrained, pairs, 12)), phi=np.zeros((constrained, pairs, 2)),
            mu=np.zeros((shifted, pairs, 2)), shift=vectors(shifted), shift_change=vectors(shifted),
        ),
        first=FirstAcceleration(np.zeros(size), np.zeros((pairs, 2)), np.zeros(1, dtype=np.int64)),
        tangent=TangentState(
            np.zeros(1), np.zeros(size), np.zeros(size), np.zeros(size), np.zeros((pairs, 2)), np.zeros((pairs, 12))
        ),
        power=np.zeros((s, 2)), weights=np.zeros((s, s)), dense_weights=np.zeros(s),
        spread=vectors(s), pairs=np.zeros((pairs, 2)), on_tree=new_on_tree(s, size, tree),
        kept=LaneKept(np.zeros((0, pairs, 2)), np.zeros(0), np.zeros(0)),
    )  # fmt: skip


def nodes_of_beams(top: Topology) -> np.ndarray:
    """Return the indices of the bodies that are nodes of beams."""
    nodes = [row[SECTION.node : SECTION.node + row[SECTION.node_count]] for row in top.sections]
    return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *nodes]))


def _new_states(workspace: Workspace, stages: int) -> StageStates:
    top = workspace.mechanism.topology
    states = top.states
    together = len(states) if is_coupled(top) else max(np.unique(states[:, 0], return_counts=True)[1], default=0)
    most = int(together) * stages
    rate, z, length, speed = np.zeros((4, stages, len(states)))
    first_rate, slope = np.zeros((2, len(states)))
    return StageStates(rate, first_rate, z, length, speed, slope, np.zeros((most, most)), np.zeros(most))


def new_settings(formulation: Formulation, solver: int, most_iterations: int | None, tolerance: float) -> Settings:
    """Return settings as kernels take them."""
    return Settings(
        holds=np.array([level in formulation.holds for level in ("position", "velocity")], dtype=np.int64),
        solver=np.array([solver], dtype=np.int64),
        limit=new_limit(most_iterations),
        tolerance=np.array([float(tolerance)]),
    )


def example_stages() -> Stages:
    """Return a bundle of the type that all methods and formulations share."""
    midpoint = coefficients_of(ButcherTableau("midpoint", [["1/2"]], [1], ["1/2"], 2, ""))
    settings = new_settings(INDEX_1, NEWTON, 1, 0.0)
    by_position = np.zeros((0, 4), dtype=np.int64)
    return new_stages(midpoint, example_workspace(), settings, by_position)


load_stages = bundle_loader(example_stages)
