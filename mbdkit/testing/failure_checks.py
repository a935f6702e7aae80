"""How a method fails: with a typed status, with what was computed before, and soon."""

from __future__ import annotations

import signal
import threading

import numpy as np
from pydantic import ValidationError

from mbdkit.archive.run import Run
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.errors import MbdkitError, SpecError, StepError
from mbdkit.methods.step_method import StepMethod, StepState
from mbdkit.testing.check import Skip, check
from mbdkit.testing.integrator_under_test import IntegratorSubject
from mbdkit.testing.outcome import Finding, failed, passed, skipped
from mbdkit.testing.trial_models import CANNOT_MEET, FORCED_PENDULUM, NO_NUMBER, OUT_OF_REACH, SWINGING

TYPED = ("newton-failed", "singular", "step-too-small", "not-finite", "max-steps", "wall-time")


def _fault(run: Run, *, allowed: tuple[str, ...] = TYPED) -> str:
    """Return what is wrong with how a run ended; empty where it ended as it should."""
    code = run.status_reason.partition(":")[0]
    if run.status == "failed" and code not in allowed:
        return f"it ended with {run.status_reason.rstrip('.')}"
    for name in ("trajectory/position", "trajectory/velocity"):
        if not np.all(np.isfinite(run.array(name))):
            return "it recorded numbers that are not finite"
    return ""


@check("failure.not-a-number")
def not_a_number(subject: IntegratorSubject) -> Finding:
    """A torque that becomes NaN ends the run as failed, with a typed reason and the motion before it."""
    _refuse_to_step(subject)
    with subject.run(NO_NUMBER, {"end": 1.0, "step": 0.01}) as run:
        if run.status == "complete":
            return failed("it ran to the end through a torque that is not a number")
        if fault := _fault(run):
            return failed(fault)
        if len(run.time) < 2:
            return failed("nothing that it computed before was kept")
        reached = float(run.time[-1])
        if reached > 0.52:
            return failed(f"it went on to {reached:g} s, beyond the torque's end at 0.5 s")
        return passed(reason=run.status_reason.partition(":")[0], reached_s=reached)


def _refuse_to_step(subject: IntegratorSubject) -> None:
    """Let a method with `step` step where there are no accelerations; raises `_GoesOnError` if it returns."""
    method = subject.method()
    if not isinstance(method, StepMethod):
        return
    equations = EquationsOfMotion(subject.workspace(NO_NUMBER))
    try:
        method.step(equations, 0.6, StepState(equations.q0, equations.v0), 0.01)
    except StepError:
        return
    raise _GoesOnError("it returns from a step in which there are no accelerations, as if nothing had happened")


class _GoesOnError(MbdkitError):
    """A method that hides from the framework that a step cannot be taken."""


@check("failure.singular")
def singular(subject: IntegratorSubject) -> Finding:
    """A driver that pulls two rods beyond their reach ends in a typed reason, or in finite numbers."""
    with subject.run(OUT_OF_REACH, {"end": 1.5, "step": 0.01}, limits={"wall_time": 10, "max_steps": 20000}) as run:
        if fault := _fault(run):
            return failed(fault)
        if run.status == "interrupted":
            return failed("it was interrupted by nobody")
        return passed(status=run.status, reason=run.status_reason.partition(":")[0], reached_s=float(run.time[-1]))


@check("failure.inconsistent-start")
def inconsistent_start(subject: IntegratorSubject) -> Finding:
    """Joints that cannot meet are refused before the first step, and a start that is off is made consistent."""
    try:
        subject.run(CANNOT_MEET, {"end": 1.0, "step": 0.01}).close()
    except SpecError:
        pass
    else:
        return failed("joints that cannot meet were integrated")
    bodies = {name: {**body, "velocity": [0.3, -0.2]} for name, body in SWINGING["bodies"].items()}
    with subject.run({**SWINGING, "bodies": bodies}, {"end": 0.1, "step": 0.01}) as run:
        if run.status != "complete":
            return failed(f"from a start that was off it did not complete: {run.status_reason}")
        if float(np.max(run.array("joints/velocity_misalignment")[0])) > 1e-10:
            return failed("it started from velocities that the joints do not allow")
    return passed()


@check("failure.impossible-tolerance")
def impossible_tolerance(subject: IntegratorSubject) -> Finding:
    """A tolerance that no iteration and no step can meet is refused, or ends in a typed reason or a finite result."""
    fields = [name for name in ("tolerance", "rtol") if name in subject.plugin.options.model_fields]
    if not fields:
        return skipped("it has no option `tolerance` or `rtol`")
    name = fields[0]
    outcomes = []
    for value in (1e-300, 3e-14):
        try:
            run = subject.run(
                FORCED_PENDULUM,
                {"end": 0.1, "step": 0.01},
                options={name: value},
                limits={"wall_time": 10, "max_steps": 20000},
            )
        except (SpecError, ValidationError):
            outcomes.append("refused")
            continue
        with run:
            if fault := _fault(run):
                return failed(f"with {name} = {value:g} {fault}")
            outcomes.append(run.status)
    return passed(outcomes=", ".join(outcomes))


@check("failure.step-limit")
def step_limit(subject: IntegratorSubject) -> Finding:
    """It stops after limits.max_steps and keeps every step before."""
    with subject.run(FORCED_PENDULUM, {"end": 5.0, "step": 0.01}, limits={"max_steps": 7}) as run:
        code = run.status_reason.partition(":")[0]
        if run.status != "failed" or code != "max-steps":
            return failed(f"after 7 steps it should stop for max-steps, not as {run.status} {code}".rstrip())
        if len(run.time) != 8 or run.stats["steps"] != 7:
            return failed(f"of 7 steps it counted {run.stats['steps']} and kept {len(run.time) - 1}")
    return passed()


@check("failure.interrupt")
def interrupt(subject: IntegratorSubject) -> Finding:
    """Ctrl-C ends it as interrupted, with the motion up to there."""
    if threading.current_thread() is not threading.main_thread():
        raise Skip("signals reach the main thread only")
    rung: list[float] = []

    def ring(now: float, end: float) -> None:
        if not rung:
            rung.append(now)
            signal.raise_signal(signal.SIGINT)

    time = {"end": 1e6, "step": 0.01}
    with subject.run(SWINGING, time, progress=ring, output={"every": 1000}) as run:
        if run.status != "interrupted":
            return failed(f"interrupted by Ctrl-C it ended as {run.status}: {run.status_reason}")
        if fault := _fault(run):
            return failed(fault)
        if abs(float(run.time[-1]) - rung[0]) > 1e-9 * max(1.0, rung[0]):
            return failed("the state that it had reached was not kept")
    return passed(stopped_at_s=rung[0])


CHECKS = (not_a_number, singular, inconsistent_start, impossible_tolerance, step_limit, interrupt)
