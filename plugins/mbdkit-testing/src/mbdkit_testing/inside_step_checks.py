"""Checks that look inside a step: the order of dense output, and order and size of the error estimate of a pair."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.methods.kinds import ExplicitRungeKutta
from mbdkit_report.analysis.order import observed_order
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, failed, passed, warned
from mbdkit_testing.integrator_under_test import IntegratorUnderTest
from mbdkit_testing.order_checks import ABOVE, BELOW, BELOW_HIGH
from mbdkit_testing.trial_models import FORCED_PENDULUM

STEPS = tuple(0.4 / 1.4**k for k in range(14))
"""Sizes of the single steps from the start [s]."""
SHARES = (0.3, 0.5, 0.8)
"""Shares of a step at which dense output is compared with small steps."""
SMALL = 24
"""Number of small steps."""
FLOOR = 1e-15
INTERVAL = 0.03
"""Interval of rows [s]."""
HIGH = 5
"""For dense output of orders above this, few steps are neither too coarse nor dominated by round-off."""


@check("order.dense-output")
def dense_output(integrator: IntegratorUnderTest) -> Result:
    """Rows of ``output.interval`` are at its multiples, and within a step dense output converges with the claimed
    order, or at least with order 1 if none is claimed.
    """
    claimed = integrator.claims.dense_order
    if not integrator.plugin.dense_output:
        if claimed is not None:
            return failed("it claims an order of dense output, but the plugin says that it has none")
        raise Skip("it has no dense output")
    time = {"end": 10 * INTERVAL} if integrator.claims.adaptive else {"end": 10 * INTERVAL, "step": 2.5 * INTERVAL}
    with integrator.run(FORCED_PENDULUM, time, output={"interval": INTERVAL}) as run:
        if run.status != "complete":
            return failed(f"with output.interval a run did not complete: {run.status_reason}".rstrip("."))
        times = run.time
    if len(times) != 11 or not np.allclose(times, INTERVAL * np.arange(11), rtol=0, atol=1e-12):
        return failed(f"it ignores output.interval: {len(times)} rows instead of 11 at multiples of the interval")
    if integrator.claims.adaptive:
        raise Skip("it is adaptive: its steps cannot be made small")
    workspace = integrator.workspace(FORCED_PENDULUM)
    errors = list[float]()
    for step in STEPS:
        stepper = integrator.stepper(workspace, workspace.t0 + step, 1, single=True)
        stepper.advance()
        if stepper.last_step is None:
            errors.append(np.nan)
            continue
        found = [
            np.array(stepper.inside(share)[:2]) - integrator.moved(workspace, workspace.t0 + share * step, SMALL)
            for share in SHARES
        ]
        errors.append(float(np.max(np.abs(found))))
    observed = observed_order(np.array(STEPS), np.array(errors), floor=FLOOR)
    figures = {"coarsest_error": errors[0], "finest_error": errors[-1]}
    if not observed.found:
        return failed("within a step its dense output follows no power of the step", **figures)
    measured = observed.order - 1  # errors of one step have one order more
    figures["measured"] = round(measured, 3)
    least = 1.0 if claimed is None else claimed
    least -= BELOW if least <= HIGH else BELOW_HIGH
    if measured < least:
        what = "its dense output has" if claimed is None else f"it claims dense output of order {claimed:g}, but it has"
        return failed(f"{what} the order {measured:.2f} within a step", **figures)
    if claimed is not None and measured > claimed + ABOVE:
        return warned(f"it claims dense output of order {claimed:g}, but it has the order {measured:.2f}", **figures)
    return passed(**figures).within({"measured": f"at least {least:g}"})


@check("tolerance.error-estimate")
def error_estimate(integrator: IntegratorUnderTest) -> Result:
    """The error estimate of an embedded pair has the order that the pair says, and in small steps it exceeds the error,
    which has a higher order.
    """
    method = integrator.method()
    if not isinstance(method, ExplicitRungeKutta) or method.pair is None:
        raise Skip("it is not an embedded pair")
    pair, equations = method.pair, EquationsOfMotion(integrator.workspace(FORCED_PENDULUM))
    a, b, c = method.tableau.floats()
    start, t0 = np.concatenate([equations.q0, equations.v0]), equations.t0
    estimates, errors = np.zeros(len(STEPS)), np.zeros(len(STEPS))
    for i, step in enumerate(STEPS):
        slopes, y, small = _slopes(equations, a, c, t0, start, step), start, step / SMALL
        for k in range(SMALL):
            y = y + small * b @ _slopes(equations, a, c, t0 + k * small, y, small)
        errors[i] = np.max(np.abs(start + step * b @ slopes - y))
        higher, *lower = (float(np.max(np.abs(step * weights @ slopes))) for weights in pair.error)
        # two estimates are combined as in Hairer, Norsett and Wanner (1993), section II.10
        estimates[i] = higher**2 / np.hypot(higher, 0.1 * lower[0]) if lower else higher
    observed, claimed = observed_order(np.array(STEPS), estimates, floor=FLOOR), pair.estimate_order
    if not observed.found:
        return failed("its error estimate follows no power of the step", claimed=claimed)
    middle = int(np.argmin(np.abs(np.array(STEPS) - observed.steps[len(observed.steps) // 2])))
    size = float(errors[middle] / estimates[middle])
    figures = {"measured": round(observed.order, 3), "claimed": claimed, "error_by_estimate": size}
    if abs(observed.order - claimed) > ABOVE:
        return failed(f"its error estimate should be of order {claimed}, but has order {observed.order:.2f}", **figures)
    if size > 1.0:
        return failed(f"in a step of {STEPS[middle]:.2g} s its error is {size:.2g} times its estimate", **figures)
    return passed(**figures).within({"error_by_estimate": 1.0})


def _slopes(
    equations: EquationsOfMotion, a: np.ndarray, c: np.ndarray, t: float, y: np.ndarray, step: float
) -> np.ndarray:
    """Return the slopes (stages, 2 n) of the stages of an explicit tableau."""
    slopes = np.zeros((len(c), len(y)))
    for i in range(len(c)):
        q, v = np.split(y + step * a[i, :i] @ slopes[:i], 2)
        slopes[i] = np.concatenate([v, equations.accelerations(t + c[i] * step, q, v)[0]])
    return slopes


CHECKS = (dense_output, error_estimate)
