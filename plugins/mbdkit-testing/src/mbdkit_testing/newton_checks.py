"""Check that the iteration of a step does not stop so early that results become less accurate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbdkit.methods.kinds import ImplicitRungeKutta, Method
from mbdkit.methods.step_methods import StepMethod
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, at_most, failed, skipped
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, drive, require_complete
from mbdkit_testing.order_checks import NEAR_ROUNDING
from mbdkit_testing.trial_models import FORCED_PENDULUM

SAME = 0.01  #: Largest change of the result by further iterations, as a share of the error of the result.
SIZES, FEW = (0.02, 0.1, 0.004), 5  #: Sizes of steps [s], and their number, that show whether a method iterates.


@check("newton.tolerance")
def tolerance(integrator: IntegratorUnderTest) -> Result:
    """Iterating to round-off changes the result by less than a hundredth of the error of the result."""
    if integrator.claims.adaptive:
        raise Skip("it is adaptive")
    own, has_option = integrator.method(), "tolerance" in integrator.plugin.options.model_fields
    works = list[Mapping[str, Any]]()
    for size in SIZES:
        with integrator.run(FORCED_PENDULUM, {"end": FEW * size, "step": size}) as run:
            require_complete(run)
            works.append(run.stats)
    if not works[0]["newton_iterations"] and not has_option:
        least, *_, most = sorted(one["rhs_evaluations"] for one in works)
        if least < most and isinstance(own, StepMethod):
            cause = "the number of evaluations in a step varies, so that it iterates, but it counts no iterations"
            return failed(f"{cause}, and has no option `tolerance`", least=least, largest=most)
        raise Skip("it does not iterate")
    steps = 50
    if own.traits.tableau is not None:  # explicit methods are skipped above
        exact: Method = ImplicitRungeKutta(own.traits.tableau)
    elif has_option:
        exact = integrator.method(tolerance=1e-13)
    else:
        return skipped("it is not given by a tableau and has no option `tolerance`")

    def end(method: Method, steps: int) -> np.ndarray:
        workspace = integrator.workspace(FORCED_PENDULUM)
        return np.concatenate(drive(integrator.stepper(workspace, 1.0, steps, method=method)))

    result, iterated = end(own, steps), end(exact, steps)
    change, error = float(np.max(np.abs(result - iterated))), float(np.max(np.abs(iterated - end(exact, 2 * steps))))
    cause = "its iteration stops early: iterating to rounding changes the result"
    return at_most({"change": SAME * error + NEAR_ROUNDING}, cause, change=change, error=error)


CHECKS = (tolerance,)
