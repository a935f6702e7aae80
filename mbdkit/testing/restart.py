"""Whether a run that stops between steps and goes on is the run that never stopped, bit for bit."""

from __future__ import annotations

import pickle
from typing import Any, cast

import numpy as np

from mbdkit.integrators.step_method import StepMethod, StepState
from mbdkit.integrators.step_problem import StepProblem
from mbdkit.testing.check import Skip, check
from mbdkit.testing.outcome import Finding, failed, passed, skipped
from mbdkit.testing.problems import DRIVEN_PENDULUM
from mbdkit.testing.subject import IntegratorSubject, drive

STEPS, END = 60, 0.6


@check("restart.stretches")
def stretches(subject: IntegratorSubject) -> Finding:
    """One stretch of many steps gives the same bits as many stretches of one step."""
    if subject.claims.adaptive:
        raise Skip("it does not go in fixed steps")
    ends = []
    for at_a_time in (10**6, 1, 7):
        stepper = subject.stepper(subject.problem(DRIVEN_PENDULUM), END, STEPS, every=STEPS)
        pace = cast("Any", stepper).pace

        def limit(steps: int = at_a_time, pace: object = pace) -> None:
            pace.steps = steps  # type: ignore[attr-defined]

        ends.append(drive(stepper, limit))
    for q, v in ends[1:]:
        if not (np.array_equal(q, ends[0][0]) and np.array_equal(v, ends[0][1])):
            return failed("stopped between steps and gone on from there, it moves differently")
    return passed(steps=STEPS)


@check("restart.state")
def state(subject: IntegratorSubject) -> Finding:
    """A method with `step` goes on from a pickled state in another object, and another problem, with the same bits."""
    if not isinstance(subject.method(), StepMethod):
        return skipped("its state is the framework's")
    whole, parts = (_moved(subject, restart) for restart in (False, True))
    same = np.array_equal(whole.q, parts.q) and np.array_equal(whole.v, parts.v)
    if not same:
        change = float(max(np.max(np.abs(whole.q - parts.q)), np.max(np.abs(whole.v - parts.v))))
        return failed("its state does not hold all that the next step needs", change=change)
    return passed(steps=STEPS)


def _moved(subject: IntegratorSubject, restart: bool) -> StepState:
    problem, method = StepProblem(subject.problem(DRIVEN_PENDULUM)), subject.method()
    state, h = StepState(problem.q0.copy(), problem.v0.copy()), END / STEPS
    for k in range(STEPS):
        if restart and k in (1, STEPS // 2):
            problem, method = StepProblem(subject.problem(DRIVEN_PENDULUM)), subject.method()
            state = pickle.loads(pickle.dumps(state))
        assert isinstance(method, StepMethod)
        state = method.step(problem, k * h, state, h)
    return state


CHECKS = (stretches, state)
