"""Differentiated steps of explicit Runge-Kutta methods and of collocation methods; see
`mbdkit.integrators.duals.dual_run`.

In a collocation method, the stages of the run satisfy their equations. Their derivatives follow from the same iteration
with the same factors: the residual is evaluated with dual numbers, so that its derivatives are exact, and the iteration
continues until the derivatives of the stages no longer change.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.engine.kernels.applied_forces import applied_forces
from mbdkit.engine.kernels.system import DIVERGED, OK, prepare
from mbdkit.engine.native.arithmetic import with_value
from mbdkit.engine.native.bundle import PinnedBundle, bundle_loader
from mbdkit.engine.native.functions import inlined, kernel, subkernel
from mbdkit.engine.native.number_arrays import new_duals
from mbdkit.engine.workspace import example_workspace
from mbdkit.integrators.duals.dual_run import advance, load_dual_run, relative_change, take_base, with_derivatives
from mbdkit.integrators.run.run_state import load_run_state
from mbdkit.integrators.stages import collocation_constrained, collocation_index1, explicit
from mbdkit.integrators.stages.collocation_stages import (
    NEWTON,
    Stages,
    example_stages,
    is_shifted,
    load_stages,
    solves_positions_only,
)
from mbdkit.integrators.stages.collocation_step import complete_step, evaluate_stages, keep_stages
from mbdkit.integrators.stages.compiled_method import DualForm
from mbdkit.integrators.stages.element_states import (
    add_up_states,
    end_of_element,
    is_coupled,
    is_held,
    linearize,
    put_state,
    solve_dense,
    state_rate,
    take_lengths,
)
from mbdkit.integrators.stages.explicit import Explicit, new_explicit
from mbdkit.integrators.stages.shifted_positions import change_shift
from mbdkit.integrators.stages.simplified_newton import newton_changes
from mbdkit.integrators.stages.stage_polynomials import extrapolate, extrapolation_weights
from mbdkit.integrators.stages.turning_beams import turn_accelerations_back, turn_residual_back, turns_stages

if TYPE_CHECKING:
    from mbdkit.integrators.stages.collocation import CompiledCollocation


def dual_explicit(method: Explicit) -> Explicit:
    """Return the bundle of an explicit method with stages of dual numbers; its coefficients are numbers."""
    stages = ("rates", "accelerations", "z_rates", "q_stage", "z_stage", "lam", "power")
    return method._replace(
        **{name: new_duals(*getattr(method, name).shape) for name in stages},
        status=method.status.copy(),
        relative=with_derivatives(method.relative),
    )


def _example() -> Explicit:
    from mbdkit.methods import rk4
    from mbdkit.methods.kinds import ExplicitRungeKutta

    return dual_explicit(new_explicit(ExplicitRungeKutta(rk4.tableau()), 6, len(example_workspace().scratch.phi)))


load_dual_explicit = bundle_loader(_example)


@kernel
def explicit_step(dual: int, run: int, method: int, t: float, h: float, row: int) -> int:
    """Differentiate a step that a run has taken; return a status. See `differentiated_explicit`."""
    return differentiated_explicit(dual, run, method, t, h, row)


@subkernel
def differentiated_explicit(dual: int, run: int, method: int, t: float, h: float, row: int) -> int:
    """Differentiate the step of size `h` from `t` that a run has taken; return a status.

    Parameters
    ----------
    dual, run, method
        Addresses of the `DualRun`, of the `RunState` and of the method's bundle of dual numbers.
    row
        Index at which the end of the step is recorded; -1 if it is not.
    """
    c, n, m = load_dual_run(dual), load_run_state(run), load_dual_explicit(method)
    take_base(c, n)
    stages = len(m.b)
    first = explicit.reuse_first_stage(c, m)
    status = explicit.evaluate_stages(c, m, t, h, first, stages)
    if status != OK:
        return status
    m.status[1] = stages
    explicit.add_up_stages(c, m, t, h)
    if c.nodes[0] != 0:
        explicit.keep_stages(c, m, t, h)
    return advance(c, n, row)


#: Newton iterations for the derivatives of first-order states in each iteration for those of the accelerations.
STATE_ITERATIONS = 2
MOST_ITERATIONS = 100
#: The iteration ends when its rate of convergence predicts that the derivatives of the step will change by less than
#: this relative amount.
SMALL = 1e-14
#: A relative change counts as round-off if it is below `NEGLIGIBLE`, and its ratio to the previous change exceeds
#: `STALLED`.
STALLED, NEGLIGIBLE = 0.5, 1e-9
#: A change whose ratio to the previous one exceeds `STALLED` is also round-off if it moves positions by less than this.
#:
#: Forces that cancel, as in a driven mechanism, leave their round-off in accelerations that are small.
FEW_ROUNDINGS = 1e-15
#: After `PATIENCE` iterations, relative changes of positions below `MOST_ROUNDINGS` count as round-off, whatever the
#: ratio of successive changes.
#:
#: In beams, whose forces are small differences of large ones, the changes vary between 1e-15 and 5e-15.
PATIENCE, MOST_ROUNDINGS = 30, 1e-13


def dual_stages(m: Stages) -> Stages:
    """Return the bundle of a collocation method with stages of dual numbers; coefficients and factors are numbers."""
    names = (
        "acc",
        "lam",
        "q_stage",
        "v_stage",
        "residual",
        "change",
        "states",
        "constraints",
        "power",
        "spread",
        "pairs",
    )
    systems = m.systems
    factors = {name: getattr(systems, name) for name in ("real", "cplx")}
    work = {name: with_derivatives(getattr(systems, name)) for name in systems._fields[4:]}
    factors = {name: factor._replace(work=with_derivatives(factor.work)) for name, factor in factors.items()}
    own = m.previous._replace(begin=np.zeros(1), size=np.full(1, np.nan))
    return m._replace(
        **{name: with_derivatives(getattr(m, name)) for name in names},
        systems=systems._replace(**factors, **work),
        previous=own,
        weights=m.weights.copy(),
        on_tree=with_derivatives(m.on_tree)._replace(arms=m.on_tree.arms),
    )


load_dual_stages = bundle_loader(lambda: dual_stages(example_stages()))


@subkernel
def _predict(m, t, h):
    size = m.previous.size[0]
    if abs(size) > 0.0:
        extrapolation_weights((t - m.previous.begin[0]) / size, h / size, m.rk.c, m.weights)
        extrapolate(m.weights, m.acc, m.spread)
    m.previous.begin[0], m.previous.size[0] = t, h


@subkernel
def _take_values(m, k):
    for i in range(len(m.acc)):
        for d in range(len(m.acc[0])):
            m.acc[i, d] = with_value(m.acc[i, d], k.acc[i, d])
        for p in range(len(m.lam[0])):
            for r in range(2):
                m.lam[i, p, r] = with_value(m.lam[i, p, r], k.lam[i, p, r])
        for e in range(len(m.states.rate[0])):
            m.states.rate[i, e] = with_value(m.states.rate[i, e], k.states.rate[i, e])
    _take_shifts(m, k)


@subkernel
def _change_states(c, n, m, k, t, h):
    """Change the derivatives of the first-order states of all stages by Newton's method; return a status.

    The values are those of the run, which satisfy the equations, and the matrix is evaluated at these values. After an
    iteration, the derivatives satisfy the equations, apart from the errors of the difference quotients in the matrix.
    """
    count = len(c.from_z)
    if count == 0:
        return OK
    take_lengths(c, m, t, h)
    first = 0
    while first < count:
        if is_held(c.top, first):
            first += 1
            continue
        last = end_of_element(c.top, first)
        for _ in range(STATE_ITERATIONS):
            add_up_states(c, m, h, first, last)
            _lack(c, m, t, h, first, last)
            linearize(n, k, t, h, first, last)
            if not solve_dense(k.states.matrix, m.states.right, len(m.rk.c) * (last - first)):
                return DIVERGED
            for i in range(len(m.rk.c)):
                for e in range(first, last):
                    changed = m.states.rate[i, e] + m.states.right[i * (last - first) + e - first]
                    m.states.rate[i, e] = with_value(changed, k.states.rate[i, e])
        first = last
    add_up_states(c, m, h, 0, count)
    return OK


@subkernel
def _lack(c, m, t, h, first, last):
    """Write the residual ``g - k`` of the states `first` to `last - 1` at every stage, in the order of `linearize`.

    Here g is the rate that the law of a state gives, and k the derivative that is solved for.
    """
    for i in range(len(m.rk.c)):
        at = t + m.rk.c[i] * h
        for e in range(first, last):
            put_state(c, e, m.states.z[i, e])
        if is_coupled(c.top):
            prepare(c.top, c.w, at, m.q_stage[i])
            applied_forces(c.top, c.w, m.q_stage[i], m.v_stage[i])
        for e in range(first, last):
            m.states.right[i * (last - first) + e - first] = state_rate(c, m, i, e, at) - m.states.rate[i, e]


@subkernel
def _take_shifts(m, k):
    """Copy the values of the additional multipliers of ggl, and of the shifts of positions, from those of the run."""
    for i in range(len(m.constraints.shift)):
        for d in range(len(m.acc[0])):
            m.constraints.shift[i, d] = with_value(m.constraints.shift[i, d], k.constraints.shift[i, d])
        for p in range(len(m.lam[0])):
            for r in range(2):
                m.constraints.mu[i, p, r] = with_value(m.constraints.mu[i, p, r], k.constraints.mu[i, p, r])


@subkernel
def _change_accelerations(m, k):
    for i in range(len(m.change)):
        for d in range(len(m.acc[0]) - 3):
            m.acc[i, d] = with_value(m.acc[i, d] + m.change[i, d], k.acc[i, d])


@subkernel
def _index1_sizes(c, m, h):
    """Return the relative change of the derivatives of the accelerations, and that of the positions."""
    now = moved = 0.0
    for i in range(len(m.change)):
        now = max(now, relative_change(c, m.change[i], m.acc[i], 1.0))
        moved = max(moved, relative_change(c, m.change[i], m.q_stage[i], h * h))
    return now, moved


@subkernel
def _constrained_sizes(c, m, h):
    """Return the relative change of the derivatives of the velocities (of positions for index 3), and of the positions.

    Multipliers and accelerations have the round-off of positions over h^2, or of velocities over h.
    """
    now = moved = 0.0
    for i in range(len(m.change)):
        moved = max(moved, relative_change(c, m.change[i], m.q_stage[i], h * h))
        if not solves_positions_only(m):
            now = max(now, relative_change(c, m.change[i], m.v_stage[i], h))
    for i in range(len(m.constraints.shift)):
        now = max(now, relative_change(c, m.constraints.shift_change[i], m.v_stage[i], 1.0))
        moved = max(moved, relative_change(c, m.constraints.shift_change[i], m.q_stage[i], h))
    return max(now, moved), moved


@subkernel
def _index1_changes(c, n, m, k, t, h):
    """Write the changes of the derivatives of the stages by one iteration; return a status."""
    status = collocation_index1.evaluate_accelerations(c, m, t, h, False, False)
    if status != OK:
        return status
    newton = m.settings.solver[0] == NEWTON
    for i in range(len(m.residual)):
        for d in range(len(c.q) - 3):
            lack = m.acc[i, d] - m.spread[i, d]
            m.residual[i, d] = lack
            m.change[i, d] = -lack
    if newton:
        if turns_stages(m):
            turn_accelerations_back(m)
        newton_changes(n, m, h, collocation_index1.right_side)
    return OK


@subkernel
def _constrained_changes(c, n, m, k, t, h):
    """Write the changes of the derivatives of the stages by one iteration, and change the multipliers."""
    collocation_constrained.evaluate_residual(c, m, m.acc, t, h)
    if turns_stages(m):
        turn_residual_back(m)
    if is_shifted(m):
        status = change_shift(c, m, h, n.w.source, c.push)
        if status != OK:
            return status
        _take_shifts(m, k)
    newton_changes(n, m, h, collocation_constrained.right_side)
    for i in range(len(m.change)):
        for p in range(len(c.top.pairs)):
            for r in range(c.top.rows[p]):
                changed = m.lam[i, p, r] + m.change[i, c.solver.row_index[p, r]]
                m.lam[i, p, r] = with_value(changed, k.lam[i, p, r])
    return OK


class _Formulation(NamedTuple):
    """The parts of a formulation that `_step` calls; Numba compiles `_step` once for each of these records."""

    #: ``(c, n, m, k, t, h)``: write the changes of the derivatives by one iteration; return a status.
    changes: Callable[..., int]
    #: ``(c, m, h)``: return the relative change that has to converge, and that of the positions.
    sizes: Callable[..., tuple[float, float]]
    powers: Callable[..., int]  #: ``(c, m, t, h)``: evaluate the powers of the stages; return a status.


@inlined
def _step(dual, run, method, plain, t, h, row, formulation):
    """Differentiate a step of a collocation method on a formulation; see `collocation_step`."""
    c, n, m, k = load_dual_run(dual), load_run_state(run), load_dual_stages(method), load_stages(plain)
    take_base(c, n)
    _predict(m, t, h)
    _take_values(m, k)
    before = 0.0
    converged = False
    for iteration in range(MOST_ITERATIONS):
        evaluate_stages(c, m, h)
        status = _change_states(c, n, m, k, t, h)
        if status != OK:
            return status
        status = formulation.changes(c, n, m, k, t, h)
        if status != OK:
            return status
        _change_accelerations(m, k)
        now, moved = formulation.sizes(c, m, h)
        ratio = now / before
        converges_to_it = ratio < 1.0 and now * ratio / (1.0 - ratio) < SMALL
        is_round_off = ratio > STALLED and (now < NEGLIGIBLE or moved < FEW_ROUNDINGS)
        wanders = iteration >= PATIENCE and moved < MOST_ROUNDINGS
        if now == 0.0 or (iteration > 0 and (converges_to_it or is_round_off or wanders)):
            converged = True
            break
        before = now
    if not converged:
        return DIVERGED
    evaluate_stages(c, m, h)
    status = complete_step(c, m, t, h, formulation)
    if status != OK:
        return status
    keep_stages(c, m, t, h)
    return advance(c, n, row)


_INDEX_1 = _Formulation(_index1_changes, _index1_sizes, collocation_index1.stage_powers)
_CONSTRAINED = _Formulation(_constrained_changes, _constrained_sizes, collocation_constrained.stage_powers)


@kernel
def collocation_step(
    dual: int, run: int, method: int, plain: int, t: float, h: float, row: int, solves_multipliers: bool
) -> int:
    """Differentiate the step of size `h` from `t` that a run has taken by a collocation method; return a status.

    One kernel serves both kinds of equations, so that the machine code that they share is stored once.

    Parameters
    ----------
    dual, run, method, plain
        Addresses of the `DualRun`, of the `RunState`, and of the method's bundles of dual numbers and of numbers.
    row
        Index at which the end of the step is recorded; -1 if it is not.
    solves_multipliers
        Whether the step is one on the constraints themselves (index 2, index 3 or ggl), not on the index-1 equations.
    """
    if solves_multipliers:
        return _step(dual, run, method, plain, t, h, row, _CONSTRAINED)
    return _step(dual, run, method, plain, t, h, row, _INDEX_1)


class ExplicitDuals(DualForm):
    """Explicit Runge-Kutta methods."""

    def __init__(self, method: explicit.CompiledExplicit):
        self.pinned, self.stages = PinnedBundle(dual_explicit(method.bundle)), len(method.bundle.b)

    def step(self, dual: int, run: int, step: tuple[float, float], row: int) -> int:
        """See `DualForm`."""
        return int(explicit_step(dual, run, self.pinned.address, *step, row))


class CollocationDuals(DualForm):
    """Collocation methods, whose bundle is renewed when new pivots are chosen."""

    def __init__(self, method: CompiledCollocation):
        self._method, self._plain = method, method.bundle
        self.pinned, self.stages = PinnedBundle(dual_stages(method.bundle)), len(method.rk.b)

    def step(self, dual: int, run: int, step: tuple[float, float], row: int) -> int:
        """See `DualForm`."""
        method = self._method
        if method.bundle is not self._plain:  # the derivatives of the last stages remain valid
            new = dual_stages(method.bundle)
            new.acc[...] = self.pinned.bundle.acc
            new.previous.size[:], new.previous.begin[:] = np.nan, 0.0
            self._plain, self.pinned = method.bundle, PinnedBundle(new)
        on_constraints = method.formulation.solves_multipliers
        return int(collocation_step(dual, run, self.pinned.address, method.pinned.address, *step, row, on_constraints))
