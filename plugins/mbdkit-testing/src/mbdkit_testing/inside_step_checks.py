"""Checks of what a step contains besides its end: dense output, error estimate, quadrature nodes, work."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.integrators.interface import Moment
from mbdkit.methods.kinds import ExplicitRungeKutta
from mbdkit.methods.step_methods import ExternalMethod, StepMethod
from mbdkit_report import observed_order
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Figure, Result, failed, passed, warned
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, require_complete
from mbdkit_testing.order_checks import ABOVE, BELOW, BELOW_HIGH
from mbdkit_testing.single_steps import (
    FLOOR,
    HISTORY,
    LATER_FLOOR,
    SHARES,
    STEPS,
    SingleStep,
    equations_for,
    has_memory,
    later_steps,
    looked_into,
    model_for,
    moved,
    reference_states,
    single_steps,
    steps_on,
)
from mbdkit_testing.trial_models import DRIVEN_PENDULUM, FORCED_PENDULUM, LAGGING_PENDULUM

INTERVAL = 0.03  #: Interval of rows [s].
HIGH = 5  #: For dense output of orders above this, few steps are neither too coarse nor dominated by round-off.
JOINED = 1e-10  #: Gap between dense output and the ends of a step that counts as rounding.
TOO_SMALL = 2.0  #: Largest ratio of an error to its estimate, at the middle of the steps that show the order.
#: Number of steps of a library that are checked, and the largest error inside them, as a multiple of the tolerance and
#: of the largest error at their ends.
LIBRARY_STEPS, LIBRARY_TIMES, LIBRARY_SHARE = 20, 300.0, 30.0
FEWEST = 5  #: Fewest sizes of steps with history that show an order; otherwise the first step is taken.
LEAST = 2.0  #: Order that is required of quadrature nodes and of work, unless the method has a lower one.


@check("order.dense-output")
def dense_output(integrator: IntegratorUnderTest) -> Result:
    """Rows of ``output.interval`` are at its multiples, dense output joins the ends of a step, and within a step it
    converges with the claimed order, or at least with order 1 if none is claimed, first-order states included. For a
    method with memory, this is a step with history, because multistep methods may start with a lower order.
    """
    claimed = integrator.claims.dense_order
    if not integrator.plugin.dense_output:
        if claimed is not None:
            return failed("it claims an order of dense output, but the plugin says that it has none")
        raise Skip("it has no dense output")
    time = {"end": 10 * INTERVAL} if integrator.claims.adaptive else {"end": 10 * INTERVAL, "step": 2.5 * INTERVAL}
    with integrator.run(FORCED_PENDULUM, time, output={"interval": INTERVAL}) as run:
        require_complete(run, "with output.interval a run", MbdkitError)
        times = run.time
    if len(times) != 11 or not np.allclose(times, INTERVAL * np.arange(11), rtol=0, atol=1e-12):
        return failed(f"it ignores output.interval: {len(times)} rows instead of 11 at multiples of the interval")
    method = integrator.method()
    if isinstance(method, StepMethod):
        steps = single_steps(integrator)
        if steps[0].inside:
            return _joined(integrator) or _order_of_dense(integrator, steps)
        if claimed is not None and integrator.claims.adaptive:
            return failed("it claims an order of dense output, but its steps have none")
    if isinstance(method, ExternalMethod):
        return _inside_steps_of_library(integrator, method)
    if integrator.claims.adaptive:
        raise Skip("it is adaptive: its steps cannot be made small")
    return _order_inside(integrator, _by_framework(integrator), "in the first step")


def _order_of_dense(integrator: IntegratorUnderTest, first: tuple[SingleStep, ...]) -> Result:
    """Compare the order of dense output in the first step. If it is too low there, or if the method has memory, whose
    start may be of a lower order, compare it in finer steps after others.
    """
    result = _order_inside(integrator, _insides(first), "in the first step")
    if result.outcome == "fail" or has_memory(integrator):
        steps, where = _insides(later_steps(integrator)), f"in the step after {HISTORY} others"
        if not all(inside for _, inside, _ in steps):
            return failed(f"{where} it has no dense output")
        later = _order_inside(integrator, steps, where, LATER_FLOOR) if len(steps) >= FEWEST else result
        return result if "coarsest" in later.figures else later  # no order was found
    return result


def _insides(steps: tuple[SingleStep, ...]) -> _Inside:
    return [(step.size, step.inside, step.exact) for step in steps]


#: Size of each step [s], and the states found and those expected in `SHARES`.
_Inside = list[tuple[float, tuple[Moment, ...], tuple[Moment, ...]]]


def _by_framework(integrator: IntegratorUnderTest) -> _Inside:
    """Return the states inside single steps of a method with fixed steps, as the framework gives them."""
    model, found = model_for(integrator), _Inside()
    workspace = integrator.workspace(model)
    n = len(workspace.q0) - 3
    for size, exact in zip(STEPS, reference_states(with_state=model is LAGGING_PENDULUM), strict=True):
        stepper = integrator.stepper(workspace, workspace.t0 + size, 1, single=True)
        stepper.advance()
        if stepper.last_step is not None:
            inside = [stepper.inside(share) for share in SHARES[:-1]]
            found.append((size, tuple((q[:n].copy(), v[:n].copy(), z.copy()) for q, v, z in inside), exact))
    return found


def _order_inside(integrator: IntegratorUnderTest, steps: _Inside, where: str, floor: float = FLOOR) -> Result:
    """Compare the order of dense output with the claimed one, for motions and for first-order states."""
    claimed, figures = integrator.claims.dense_order, dict[str, Figure]()
    least = 1.0 if claimed is None else claimed
    least -= BELOW if least <= HIGH else BELOW_HIGH
    sizes, high = np.array([size for size, _, _ in steps]), False
    for what, parts in (("", (0, 1)), ("first-order states in ", (2,))):
        if parts == (2,) and not integrator.claims.states:
            continue
        errors = np.array([_largest(inside, exact, parts) for _, inside, exact in steps])
        if not (observed := observed_order(sizes, errors, floor=floor)).found:
            return failed(f"{where} {what}its dense output follows no power of the step", coarsest=errors[0])
        measured = observed.order - 1  # errors of one step have one order more
        figures["measured_states" if what else "measured"] = round(measured, 3)
        if measured < least:
            its = f"{what}its dense output {'have' if what else 'has'}"
            claim = "" if claimed is None else f"it claims dense output of order {claimed:g}, but "
            return failed(f"{claim}{its} the order {measured:.2f} {where}", **figures)
        high = high or (claimed is not None and measured > claimed + ABOVE)
    if high and not integrator.claims.states:
        return warned(f"it claims dense output of order {claimed:g}, but has a higher one", **figures)
    return passed(**figures).within(dict.fromkeys(figures, f"at least {least:g}"))


def _largest(found: tuple[Moment, ...], exact: tuple[Moment, ...], parts: tuple[int, ...]) -> float:
    return max(float(np.max(np.abs(a[k] - b[k]))) for a, b in zip(found, exact, strict=False) for k in parts)


def _joined(integrator: IntegratorUnderTest) -> Result | None:
    """Return a failure if dense output does not join the ends of steps, or has changed since the steps were taken."""
    steps, tolerances = single_steps(integrator), integrator.method().traits.tolerances
    limit = JOINED if tolerances is None else max(JOINED, tolerances.rtol)  # to which implicit steps are solved
    for one in steps:
        assert one.made.dense is not None
        for where, name, end in ((0.0, "start", one.begin), (1.0, "end", one.made.state)):
            gap = max(_gap(x, y) for x, y in zip(one.made.dense(where)[:3], (end.q, end.v, end.z), strict=True))
            if not gap <= limit:
                why = f"its dense output differs from the state at the {name} of a step of {one.size:.2g} s"
                return failed(why, gap=gap)
    for one in steps[:3]:
        if any(_gap(x, y) for before, now in zip(one.inside, looked_into(one.made), strict=True)
               for x, y in zip(before, now, strict=True)):  # fmt: skip
            return failed("the dense output of a step changes when further steps are taken")
    return None


def _gap(x: np.ndarray, y: np.ndarray) -> float:
    return float(np.max(np.abs(np.subtract(x, y)), initial=0.0))


def _inside_steps_of_library(integrator: IntegratorUnderTest, method: ExternalMethod) -> Result:
    """Compare states inside the steps that a library chooses, by its dense output and its `cut`, with tight runs."""
    equations, _ = equations_for(integrator, model_for(integrator))
    workspace, tolerances, n = integrator.workspace(model_for(integrator)), method.tolerances, equations.n
    assert tolerances is not None
    stepper = integrator.stepper(workspace, workspace.t0 + STEPS[0], 1, single=True)
    errors: dict[str, list[float]] = {"end": [], "dense output": [], "`cut`": []}
    size = 1.0
    while not stepper.finished and stepper.failure is None and len(errors["end"]) < LIBRARY_STEPS:
        stepper.advance()
        step = stepper.last_step
        assert step is not None
        begin = step.q0[:n], step.v0[:n], step.z0
        size = max(size, float(np.max(np.abs(np.concatenate(begin)))))
        for share in (0.4, 1.0):
            exact, ways = moved(equations, step.t0, begin, share * (step.t1 - step.t0)), {"end": stepper.inside}
            if share < 1.0:
                ways = {"dense output": stepper.inside, "`cut`": stepper.within}
            for name, way in ways.items():
                q, v, z = way(share)
                errors[name].append(_gap(np.concatenate([q[:n], v[:n], z]), exact))
    if stepper.failure is not None:
        raise Skip(f"the steps could not be taken: {stepper.failure.sentence}".rstrip("."))
    limit = max(LIBRARY_TIMES * max(tolerances.rtol, tolerances.atol) * size, LIBRARY_SHARE * max(errors["end"]))
    for name in ("dense output", "`cut`"):
        if not max(errors[name]) <= limit:
            return failed(f"inside the steps of its library its {name} is wrong", error=max(errors[name]), limit=limit)
    return passed(error=max(errors["dense output"])).within({"error": limit})


@check("tolerance.error-estimate")
def error_estimate(integrator: IntegratorUnderTest) -> Result:
    """The error estimate of a step has the order that the method says, first-order states included, and is not much
    smaller than the error of a small step.
    """
    method = integrator.method()
    if isinstance(method, StepMethod):
        return _estimate_of_steps(integrator, method)
    if not isinstance(method, ExplicitRungeKutta) or method.pair is None or not len(method.pair.error):
        raise Skip("its steps have no error estimate that can be seen")
    pair, equations = method.pair, EquationsOfMotion(integrator.workspace(FORCED_PENDULUM))
    a, b, c = method.tableau.floats()
    start = np.concatenate([equations.q0, equations.v0])
    estimates, errors = np.zeros(len(STEPS)), np.zeros(len(STEPS))
    for i, (step, states) in enumerate(zip(STEPS, reference_states(with_state=False), strict=True)):
        slopes = _slopes(equations, a, c, equations.t0, start, step)
        errors[i] = np.max(np.abs(start + step * b @ slopes - np.concatenate(states[-1][:2])))
        higher, *lower = (float(np.max(np.abs(step * weights @ slopes))) for weights in pair.error)
        # two estimates are combined as in Hairer, Norsett and Wanner (1993), section II.10
        estimates[i] = higher**2 / np.hypot(higher, 0.1 * lower[0]) if lower else higher
    return _compare_estimates(np.array(STEPS), estimates, errors, pair.estimate_order, 1.0)


def _estimate_of_steps(integrator: IntegratorUnderTest, method: StepMethod) -> Result:
    steps = [step for step in single_steps(integrator) if step.made.error is not None]  # of the first order it uses
    if not steps:
        raise Skip("its first step has no error estimate")
    n, results, solved = 2 * len(steps[0].begin.q), list[Result](), method.tolerances.rtol if method.tolerances else 0.0
    for part in (slice(n), slice(n, None))[: 1 + integrator.claims.states]:
        estimates, errors = np.zeros((2, len(steps)))
        for i, one in enumerate(steps):
            state, exact = one.made.state, np.concatenate(one.exact[-1])
            estimates[i] = np.max(np.abs(np.asarray(one.made.error)[part]))
            errors[i] = np.max(np.abs(np.concatenate([state.q, state.v, state.z]) - exact)[part])
        sizes = np.array([step.size for step in steps])
        results.append(_compare_estimates(sizes, estimates, errors, method.error_order + 1, TOO_SMALL, solved))
    if len(results) == 2 and results[1].outcome == "fail" and results[0].outcome != "fail":
        return failed(f"for first-order states, {results[1].cause}", **results[1].figures)
    return results[0]


def _compare_estimates(
    sizes: np.ndarray, estimates: np.ndarray, errors: np.ndarray, claimed: float, most: float, solved: float = 0.0
) -> Result:
    """Compare estimates (K,) of the errors (K,) of single steps with the claimed order and with the errors.

    An error may be at most `most` times its estimate, unless it is below `solved`, as those of iterations are.
    """
    if not np.any(estimates):
        return failed("its error estimate is zero", largest_error=float(errors[0]))
    if not (observed := observed_order(sizes, estimates, floor=FLOOR)).found:
        return failed("its error estimate follows no power of the step", claimed=claimed)
    low, high = min(observed.steps), max(observed.steps)
    window = np.flatnonzero((0.99 * low < sizes) & (sizes < 1.01 * high))
    shown = window[errors[window] > solved] if np.any(errors[window] > solved) else window
    middle = int(shown[len(shown) // 2])
    size = float(errors[middle] / estimates[middle])
    figures = {"measured": round(observed.order, 3), "claimed": claimed, "error_by_estimate": size}
    cause = f"its error estimate should be of order {claimed:g}, but has order {observed.order:.2f}"
    if observed.order < claimed - ABOVE:
        return failed(cause, **figures)
    if size > most and errors[middle] > solved:
        return failed(f"in a step of {sizes[middle]:.2g} s its error is {size:.2g} times its estimate", **figures)
    if observed.order > claimed + ABOVE:
        return warned(cause, **figures)
    return passed(**figures).within({"error_by_estimate": most})


def _slopes(
    equations: EquationsOfMotion, a: np.ndarray, c: np.ndarray, t: float, y: np.ndarray, step: float
) -> np.ndarray:
    """Return the slopes (stages, 2 n) of the stages of an explicit tableau."""
    slopes = np.zeros((len(c), len(y)))
    for i in range(len(c)):
        q, v = np.split(y + step * a[i, :i] @ slopes[:i], 2)
        slopes[i] = np.concatenate([v, equations.accelerations(t + c[i] * step, q, v)[0]])
    return slopes


@check("order.quadrature-nodes")
def quadrature_nodes(integrator: IntegratorUnderTest) -> Result:
    """The nodes that a step returns for integrals over time lie in the step, their weights add up to its size, and the
    integral of the velocity converges to the change of position.
    """
    steps, errors = [step for step in single_steps(integrator) if step.made.stages is not None], list[float]()
    if not steps:
        raise Skip("its steps return no nodes")
    start = equations_for(integrator, model_for(integrator))[0].t0
    for one in steps:
        assert one.made.stages is not None
        times, weights, (_, v) = (one.made.stages[0], one.made.stages[1], one.made.stages[2])
        if np.min(times) < start - JOINED or np.max(times) > start + one.size + JOINED:
            return failed("the times of its nodes lie outside the step")
        if abs(float(np.sum(weights)) / one.size - 1.0) > JOINED:
            return failed(f"the weights of its nodes add up to {np.sum(weights) / one.size:.6g} times the step")
        errors.append(float(np.max(np.abs(one.begin.q + np.asarray(weights) @ v - one.exact[-1][0]))))
    return _at_least(integrator, np.array([one.size for one in steps]), np.array(errors), "the integral over its nodes")


@check("order.work")
def work(integrator: IntegratorUnderTest) -> Result:
    """The work and the dissipated energy that a step returns balance the change of energy, with an order of at least 2,
    or that of the method.
    """
    equations, _ = equations_for(integrator, DRIVEN_PENDULUM)
    sizes, errors = list[float](), list[float]()
    for size, begin, made in steps_on(integrator, DRIVEN_PENDULUM):
        if (end := made.state).work is None or end.dissipated is None:
            raise Skip("its steps return no work and dissipated energy")
        kinetic = equations.kinetic(end.v) - equations.kinetic(begin.v)
        potential = equations.potential(equations.t0 + size, end.q) - equations.potential(equations.t0, begin.q)
        sizes.append(size)
        errors.append(abs(kinetic + potential - end.work + end.dissipated))
    return _at_least(integrator, np.array(sizes), np.array(errors), "the energy balance of a step")


def _at_least(integrator: IntegratorUnderTest, sizes: np.ndarray, errors: np.ndarray, what: str) -> Result:
    """Return whether errors of single steps have the order `LEAST`, or that of the method if it is lower."""
    if np.max(errors) < JOINED:
        return passed(largest_error=float(np.max(errors)))
    least, observed = min(integrator.claims.order or LEAST, LEAST), observed_order(sizes, errors, floor=FLOOR)
    order = observed.order - 1 if observed.found else math.nan
    if not order > least - BELOW:
        found = f"has the order {order:.2f}, not {least:g}" if observed.found else "follows no power of the step"
        return failed(f"{what} {found}", largest_error=float(errors[0]))
    return passed(measured=round(order, 3)).within({"measured": f"at least {least - BELOW:g}"})


CHECKS = (dense_output, error_estimate, quadrature_nodes, work)
