"""A run that is stopped between steps and continued equals an uninterrupted run bit for bit."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.methods.step_methods import Step, StepMethod, StepState
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, failed, passed, skipped
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, drive
from mbdkit_testing.trial_models import DRIVEN_PENDULUM

if TYPE_CHECKING:
    from mbdkit.integrators.interface import Stepper

STEPS, END = 60, 0.6


@check("restart.stretches")
def stretches(integrator: IntegratorUnderTest) -> Result:
    """An uninterrupted run, one in single steps, and one with dense output in every step are bitwise identical."""
    if integrator.claims.adaptive:
        raise Skip("it has no fixed steps")
    whole = integrator.moved(integrator.workspace(DRIVEN_PENDULUM), END, STEPS)
    for looked_into in (False, True):
        stepper = integrator.stepper(integrator.workspace(DRIVEN_PENDULUM), END, STEPS, every=STEPS, single=True)

        def look(stepper: Stepper = stepper, looked_into: bool = looked_into) -> None:
            if looked_into and stepper.last_step is not None:
                stepper.within(0.3)

        if not all(np.array_equal(*ends) for ends in zip(drive(stepper, look), whole, strict=True)):
            how = "with dense output in every step" if looked_into else "in single steps"
            return failed(f"a run {how} gives different results")
    return passed(steps=STEPS)


@check("restart.state")
def state(integrator: IntegratorUnderTest) -> Result:
    """If a new object of a method with `step` continues from a pickled state, its results are bitwise the same."""
    if not isinstance(integrator.method(), StepMethod):
        return skipped("it is not a class with `step`")
    if not integrator.claims.restartable:
        return skipped("it does not claim to be restartable")
    whole = _moved(integrator, restart=False)
    try:
        parts = _moved(integrator, restart=True)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        return failed(f"it claims to be restartable, but its state cannot be stored: {error}")
    same = np.array_equal(whole.q, parts.q) and np.array_equal(whole.v, parts.v)
    if not same:
        change = float(max(np.max(np.abs(whole.q - parts.q)), np.max(np.abs(whole.v - parts.v))))
        return failed("its state does not contain everything that the next step needs", change=change)
    return passed(steps=STEPS)


def _moved(integrator: IntegratorUnderTest, *, restart: bool) -> StepState:
    equations, method = EquationsOfMotion(integrator.workspace(DRIVEN_PENDULUM)), integrator.method()
    state, h = StepState(equations.q0.copy(), equations.v0.copy()), END / STEPS
    for k in range(STEPS):
        if restart and k in (1, STEPS // 2):
            equations, method = EquationsOfMotion(integrator.workspace(DRIVEN_PENDULUM)), integrator.method()
            state = pickle.loads(pickle.dumps(state))
        assert isinstance(method, StepMethod)
        if not k:
            state = replace(state, memory=method.begin(equations, 0.0, state, "start"))
        after = method.step(equations, k * h, state, h)
        state = after.state if isinstance(after, Step) else after
    return state


CHECKS = (stretches, state)
