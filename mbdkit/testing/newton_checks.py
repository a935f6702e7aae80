"""Whether the equations of a step are solved: an iteration that stops early costs accuracy, or even the order."""

from __future__ import annotations

import numpy as np

from mbdkit.methods.kinds import ImplicitRungeKutta, Method
from mbdkit.testing.check import Skip, check
from mbdkit.testing.integrator_under_test import IntegratorSubject, drive
from mbdkit.testing.order_checks import convergence
from mbdkit.testing.outcome import Finding, failed, passed, skipped
from mbdkit.testing.trial_models import FORCED_PENDULUM

NEAR_ROUNDING = 1e-11
"""Errors below this count as rounding: here the order may end."""
FINEST = 3
"""Refinements at the fine end over which the error is looked at."""
SAME = 0.01
"""Share of the error by which a further iteration may change the result."""


@check("newton.order")
def order_holds(subject: IntegratorSubject) -> Finding:
    """The order holds at the finest steps until errors come near to rounding: no iteration ends it before."""
    _require_iterations(subject)
    order, found = subject.order, convergence(subject, "forced-pendulum")
    keep = np.isfinite(found.errors) & (found.errors > 0)
    steps, errors = found.steps[keep], found.errors[keep]
    if len(steps) <= FINEST:
        raise Skip("too few runs completed")
    smallest = float(errors.min())
    slope = float(np.log(errors[-1] / errors[-1 - FINEST]) / np.log(steps[-1] / steps[-1 - FINEST]))
    if slope < order - 0.5 and errors[-1] > NEAR_ROUNDING:
        return failed(
            f"at the finest steps its error falls with order {slope:.2f} only, and is {errors[-1]:.1g} still",
            slope_at_finest=slope,
            smallest_error=smallest,
        )
    return passed(slope_at_finest=round(slope, 2), smallest_error=smallest)


@check("newton.tolerance")
def tolerance(subject: IntegratorSubject) -> Finding:
    """An iteration to rounding does not change the result by more than a hundredth of its error."""
    _require_iterations(subject)
    steps = 50
    own = subject.method()
    if isinstance(own, ImplicitRungeKutta):
        exact: Method = ImplicitRungeKutta(own.tableau)
    elif "tolerance" in subject.plugin.options.model_fields:
        exact = subject.method(tolerance=1e-13)
    else:
        return skipped("it is no tableau, and has no option `tolerance`")

    def end(method: Method, steps: int) -> np.ndarray:
        return np.concatenate(drive(subject.stepper(subject.workspace(FORCED_PENDULUM), 1.0, steps, method=method)))

    found, iterated = end(own, steps), end(exact, steps)
    change, error = float(np.max(np.abs(found - iterated))), float(np.max(np.abs(iterated - end(exact, 2 * steps))))
    if change > SAME * error + NEAR_ROUNDING:
        return failed(
            "its iteration stops early: iterated to rounding it moves differently", change=change, error=error
        )
    return passed(change=change, error=error)


def _require_iterations(subject: IntegratorSubject) -> None:
    if subject.claims.adaptive:
        raise Skip("it controls its own error")
    with subject.run(FORCED_PENDULUM, {"end": 0.1, "step": 0.02}) as run:
        if not run.stats["newton_iterations"]:
            raise Skip("it does not iterate")


CHECKS = (order_holds, tolerance)
