"""Whether a run that stops between steps and goes on is the run that never stopped, bit for bit."""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.methods.step_method import StepMethod, StepState
from mbdkit.testing.check import Skip, check
from mbdkit.testing.integrator_under_test import IntegratorSubject, drive
from mbdkit.testing.outcome import Finding, failed, passed, skipped
from mbdkit.testing.trial_models import DRIVEN_PENDULUM

if TYPE_CHECKING:
    from mbdkit.stepping.interface import Stepper

STEPS, END = 60, 0.6


@check("restart.stretches")
def stretches(subject: IntegratorSubject) -> Finding:
    """A run gives the same bits in one piece, step by step, and with every step looked into, as events ask for it."""
    if subject.claims.adaptive:
        raise Skip("it does not go in fixed steps")
    whole = subject.moved(subject.workspace(DRIVEN_PENDULUM), END, STEPS)
    for looked_into in (False, True):
        stepper = subject.stepper(subject.workspace(DRIVEN_PENDULUM), END, STEPS, every=STEPS, single=True)

        def look(stepper: Stepper = stepper, looked_into: bool = looked_into) -> None:
            if looked_into and stepper.last_step is not None:
                stepper.within(0.3)

        if not all(np.array_equal(*ends) for ends in zip(drive(stepper, look), whole, strict=True)):
            how = "looked into within its steps" if looked_into else "stopped between steps and gone on from there"
            return failed(f"{how}, it moves differently")
    return passed(steps=STEPS)


@check("restart.state")
def state(subject: IntegratorSubject) -> Finding:
    """A method with `step` resumes from a pickled state in another object with the same bits."""
    if not isinstance(subject.method(), StepMethod):
        return skipped("its state is the framework's")
    whole, parts = (_moved(subject, restart) for restart in (False, True))
    same = np.array_equal(whole.q, parts.q) and np.array_equal(whole.v, parts.v)
    if not same:
        change = float(max(np.max(np.abs(whole.q - parts.q)), np.max(np.abs(whole.v - parts.v))))
        return failed("its state does not hold all that the next step needs", change=change)
    return passed(steps=STEPS)


def _moved(subject: IntegratorSubject, restart: bool) -> StepState:
    equations, method = EquationsOfMotion(subject.workspace(DRIVEN_PENDULUM)), subject.method()
    state, h = StepState(equations.q0.copy(), equations.v0.copy()), END / STEPS
    for k in range(STEPS):
        if restart and k in (1, STEPS // 2):
            equations, method = EquationsOfMotion(subject.workspace(DRIVEN_PENDULUM)), subject.method()
            state = pickle.loads(pickle.dumps(state))
        assert isinstance(method, StepMethod)
        state = method.step(equations, k * h, state, h)
    return state


CHECKS = (stretches, state)
