"""Checks of final states: of free fall, after a shorter last step, and from starts at which derivatives vanish."""

from __future__ import annotations

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, failed, passed
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, require_complete
from mbdkit_testing.order_checks import ENDS, HIGH, NEAR_ROUNDING, PROBLEMS, error_at_tolerance, reference
from mbdkit_testing.trial_models import COASTING_BODY, FORCED_PENDULUM, RESTING

#: Largest error of free fall [m, rad, m/s] with fixed and with adaptive steps, and number of steps before the last.
#:
#: The first error counts as rounding; the second is larger, because adaptive methods may begin with order 1.
FALL, FALL_ADAPTIVE, FALL_STEPS = 1e-10, 1e-3, 100
LAST_STEPS = (0.97, 0.6, 0.3, 0.04, 1e-3, 1e-6)  #: Sizes of a shorter last step, relative to the other steps.
#: Number of steps before the shorter last one, and largest factor by which the last step may increase the error.
LAST_COUNT, LAST_TIMES = 24, 10.0
#: Tolerances of adaptive methods in runs from rest, and largest error as a multiple of the tolerance.
RESTING_TOLERANCES, RESTING_TIMES = (1e-4, 1e-7), 1e3
#: Errors above this limit [m, rad, m/s, rad/s] show no order. They would hide an error that does not decrease, such as
#: 0.4 without friction in the joint.
LARGE = 0.3
#: Factors by which the number of steps is multiplied; those after the first three are used only until the order is
#: visible, and the last three only for orders below 2.
FINER = (1, 2, 4, 8, 16, 32, 64, 128)
#: For methods with fixed steps: smallest number of steps, and number of starts at rest that are tried.
#:
#: Methods of high order begin with half this number of steps. Only some of the starts are tried, because methods with
#: fixed steps have no error estimate that could vanish by accident.
FIRST_RESTING, STARTS_OF_FIXED = 24, 3


@check("state.free-fall")
def free_fall(integrator: IntegratorUnderTest) -> Result:
    """The final velocity and angle of a body in free fall are exact, after one step, equal steps and a shorter last
    step; its position is exact unless the claimed order is below 2.
    """
    worst, limit = 0.0, FALL_ADAPTIVE if integrator.claims.adaptive else FALL
    for count in (1, FALL_STEPS, *(FALL_STEPS + share for share in LAST_STEPS)):
        end = 2.0 if integrator.claims.adaptive else count * 0.02
        time = {"end": end} if integrator.claims.adaptive else {"end": end, "step": 0.02}
        with integrator.run(COASTING_BODY, time, output={"every": 10**9}) as run:
            require_complete(run, "the run of a free body")
            body = run["mass"]
            gravity = np.array([0.0, -9.81])
            defects = [body.velocity[-1] - (np.array([30.0, -7.0]) + gravity * end), body.angle[-1] - 9.0 * end]
            if integrator.claims.order is None or integrator.claims.order >= 2:
                exact = np.array([0.4, -0.2]) + np.array([30.0, -7.0]) * end + gravity * end**2 / 2
                defects.append(body.position[-1] - exact)
            else:  # the force acts along y only
                defects.append(body.position[-1, 0] - 0.4 - 30.0 * end)
        defect = float(max(np.max(np.abs(defect)) for defect in defects))
        worst = max(worst, defect)
        if not defect <= limit:
            where = f" at the end of a last step of {count - FALL_STEPS:g} times the others"
            if integrator.claims.adaptive:
                where = ""
            elif count <= FALL_STEPS:
                where = " after the first step" if count == 1 else f" after {count} equal steps"
            return failed(f"the motion of a free body in free fall is wrong{where}", defect=defect)
        if integrator.claims.adaptive:
            break
    return passed(defect=worst).within({"defect": limit})


@check("state.last-step")
def last_step(integrator: IntegratorUnderTest) -> Result:
    """A shorter last step does not make the final state worse."""
    (state, _, floor), end, order = reference("forced-pendulum"), ENDS["forced-pendulum"], integrator.order

    def error(step: float) -> float:
        return float(np.max(np.abs(integrator.final_state(FORCED_PENDULUM, end, step) - state)))

    usual = max(error(end / number) for number in (LAST_COUNT, LAST_COUNT + 1))
    if not np.isfinite(usual):
        raise Skip("the runs did not complete")
    limit, worst = max(LAST_TIMES * usual, 100 * floor, NEAR_ROUNDING), 0.0
    for share in LAST_STEPS:
        worst = max(worst, error(end / (LAST_COUNT + share)))
        if not worst <= limit:
            cause = f"a last step of {share:g} times the others gives an error of {worst:.2g}, otherwise {usual:.2g}"
            return failed(cause, order=order)
    return passed(error=worst).within({"error": limit})


@check("state.resting-starts")
def resting_starts(integrator: IntegratorUnderTest) -> Result:
    """From starts at rest at which derivatives of the motion vanish, the errors of the method decrease with the claimed
    order or, for an adaptive method, with the tolerance.
    """
    count = len(RESTING) if integrator.claims.adaptive else STARTS_OF_FIXED
    worst = max(
        _finest_error(integrator, f"resting: {name}", f"from rest with {name}") for name in list(RESTING)[:count]
    )
    return passed(starts=count, finest_error=worst)


@check("state.joint-friction")
def joint_friction(integrator: IntegratorUnderTest) -> Result:
    """With friction in a joint, which depends on its reaction, the errors of the method decrease with the claimed order
    or, for an adaptive method, with the tolerance.
    """
    return passed(finest_error=_finest_error(integrator, "joint-friction", "with friction in a joint"))


def _finest_error(integrator: IntegratorUnderTest, problem: str, where: str) -> float:
    """Return the error of the last run of a problem, after runs in ever smaller steps or at smaller tolerances.

    Raises MbdkitError, with `where`, if the errors do not decrease as they should.
    """
    state, _, floor = reference(problem)
    small = max(100 * floor, NEAR_ROUNDING)
    if integrator.claims.adaptive:
        if "rtol" not in integrator.plugin.options.model_fields:
            raise Skip("it has no option `rtol`")
        for rtol in RESTING_TOLERANCES:
            error = error_at_tolerance(integrator, problem, rtol, state)
            if not error <= max(RESTING_TIMES * rtol, small):
                raise MbdkitError(f"{where}, its error is {error:.2g} at a tolerance of {rtol:g}")
        return error
    first = FIRST_RESTING if integrator.order < HIGH else FIRST_RESTING // 2
    model, end, errors = PROBLEMS[problem], ENDS[problem], list[float]()
    for finer in FINER[: None if integrator.order < 2 else -3]:
        final = integrator.final_state(model, end, end / (first * finer))
        errors.append(float(np.max(np.abs(final - state))))
        if len(errors) < 3:
            continue
        orders = -np.diff(np.log2(np.maximum(errors, 1e-300)))[-3:]
        # an error that changes its sign may vanish at one step size, so that its order there says nothing
        is_shown = np.mean(orders) >= 0.85 * integrator.order and orders[-1] <= integrator.order + 1.0
        if errors[-1] <= small or (is_shown and errors[-1] <= LARGE):
            return errors[-1]
    raise MbdkitError(f"{where}, it has the order {orders[-1]:.2f} at an error of {errors[-1]:.2g}")


CHECKS = (free_fall, last_step, resting_starts, joint_friction)
