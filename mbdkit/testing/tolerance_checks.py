"""Errors of adaptive methods decrease with the tolerance."""

from __future__ import annotations

import numpy as np

from mbdkit.testing.check import Check, Skip
from mbdkit.testing.check_result import Result, failed, passed
from mbdkit.testing.integrator_under_test import IntegratorUnderTest, final_state
from mbdkit.testing.order_checks import ENDS, PROBLEMS, reference

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
OBEYS = 10.0
"""Least factor by which four decades of tolerance must reduce the error."""


def _on(problem: str) -> Check[IntegratorUnderTest]:
    def obeys(integrator: IntegratorUnderTest) -> Result:
        if not integrator.claims.adaptive:
            raise Skip("it has fixed steps")
        if "rtol" not in integrator.plugin.options.model_fields:
            raise Skip("it has no option `rtol`")
        state, _, floor = reference(problem)
        errors = []
        for rtol in TOLERANCES:
            options = {"rtol": rtol, **({"atol": rtol} if "atol" in integrator.plugin.options.model_fields else {})}
            with integrator.run(
                PROBLEMS[problem], {"end": ENDS[problem]}, options=options, output={"every": 10**9}
            ) as run:
                errors.append(float(np.max(np.abs(final_state(run) - state))))
        figures = {f"error_at_{rtol:g}": error for rtol, error in zip(TOLERANCES, errors, strict=True)}
        if not np.all(np.isfinite(errors)):
            return failed("a run did not complete", **figures)
        for coarse, fine in zip(errors, errors[2:], strict=False):
            if fine > max(coarse / OBEYS, 100 * floor):
                return failed("its error does not decrease with the tolerance", **figures)
        return passed(**figures)

    obeys.__doc__ = f"Its error on the {problem.replace('-', ' ')} decreases with the tolerance."
    return Check(f"tolerance.{problem}", obeys, slow=problem == "driven-pendulum")


CHECKS = tuple(_on(problem) for problem in PROBLEMS)
