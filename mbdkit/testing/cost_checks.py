"""Cost of a step: reported, without a limit."""

from __future__ import annotations

from mbdkit.testing.check import check
from mbdkit.testing.check_result import Result, passed, skipped
from mbdkit.testing.integrator_under_test import IntegratorUnderTest
from mbdkit.testing.trial_models import COASTING


@check("cost.step")
def step(integrator: IntegratorUnderTest) -> Result:
    """Time and evaluations per step on two rods without forces; reported without a limit."""
    steps = 300
    time = {"end": 3.0} if integrator.claims.adaptive else {"steps": steps, "step": 0.01}
    best, stats = float("inf"), {}
    for _ in range(3):
        with integrator.run(COASTING, time, output={"every": 10**6}) as run:
            if run.status != "complete":
                return skipped(f"the run did not complete: {run.status_reason}".rstrip("."))
            stats = dict(run.stats)
            best = min(best, float(stats["wall_s"]))
    count = int(stats["steps"])
    return passed(
        us_per_step=round(1e6 * best / count, 2),
        rhs_per_step=round(stats["rhs_evaluations"] / count, 2),
        iterations_per_step=round(stats["newton_iterations"] / count, 2),
    )


CHECKS = (step,)
