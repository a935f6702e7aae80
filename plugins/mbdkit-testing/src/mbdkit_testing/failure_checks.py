"""A method fails with a status code, with the motion up to the failure, and without delay."""

from __future__ import annotations

import signal
import threading
from dataclasses import replace

import numpy as np
from pydantic import ValidationError

from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError, PluginError, SpecError, StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.methods.step_methods import StepMethod, StepState
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, failed, passed, skipped
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, require_complete
from mbdkit_testing.trial_models import CANNOT_MEET, FORCED_PENDULUM, NO_NUMBER, OUT_OF_REACH, SWINGING

NOT_OF_METHODS = ("event", "plugin-error")  #: Codes with which a method does not end a run by itself.


def _fault(run: Run) -> str:
    """Return what is wrong with the way in which a run ended; empty if nothing is wrong."""
    code = run.status_reason.partition(":")[0]
    if run.status == "failed" and code in NOT_OF_METHODS:
        return f"it ended with {run.status_reason.rstrip('.')}"
    for name in ("trajectory/position", "trajectory/velocity"):
        if not np.all(np.isfinite(run.array(name))):
            return "it recorded numbers that are not finite"
    return ""


@check("failure.not-a-number")
def not_a_number(integrator: IntegratorUnderTest) -> Result:
    """A run with a torque that becomes NaN fails with a status code, and keeps the motion before the failure."""
    _refuse_to_step(integrator)
    with integrator.run(NO_NUMBER, {"end": 1.0, "step": 0.01}) as run:
        if run.status == "complete":
            return failed("it completed a run with a torque that is not a number")
        if fault := _fault(run):
            return failed(fault)
        if len(run.time) < 2:
            return failed("the motion before the failure was not kept")
        if (reached := float(run.time[-1])) > 0.52:
            return failed(f"it continued to {reached:g} s, although the torque is undefined after 0.5 s")
        return passed(reason=run.status_reason.partition(":")[0], reached_s=reached)


def _refuse_to_step(integrator: IntegratorUnderTest) -> None:
    """Call `step` of a method at a state with undefined accelerations; raise MbdkitError if it returns."""
    method = integrator.method()
    if not isinstance(method, StepMethod):
        return
    equations = EquationsOfMotion(integrator.workspace(NO_NUMBER))
    try:
        start = StepState(equations.q0, equations.v0)
        method.step(equations, 0.6, replace(start, memory=method.begin(equations, 0.6, start, "start")), 0.01)
    except StepError:
        return
    raise MbdkitError(
        "its step returns a state although the accelerations are undefined; it should raise mbdkit.StepError"
    )


@check("failure.singular")
def singular(integrator: IntegratorUnderTest) -> Result:
    """A run with a driver that pulls two rods beyond their reach records only finite values, and if it fails, it ends
    with a status code.
    """
    with integrator.run(OUT_OF_REACH, {"end": 1.5, "step": 0.01}, limits={"max_steps": 20000}) as run:
        if fault := _fault(run):
            return failed(fault)
        if run.status == "interrupted":
            return failed("it ended as interrupted without an interrupt")
        return passed(status=run.status, reason=run.status_reason.partition(":")[0], reached_s=float(run.time[-1]))


@check("failure.inconsistent-start")
def inconsistent_start(integrator: IntegratorUnderTest) -> Result:
    """Joints that cannot meet are an error before the first step; an inconsistent start is made consistent."""
    try:
        integrator.run(CANNOT_MEET, {"end": 1.0, "step": 0.01}).close()
    except SpecError:
        pass
    else:
        return failed("joints that cannot meet were integrated")
    bodies = {name: {**body, "velocity": [0.3, -0.2]} for name, body in SWINGING["bodies"].items()}
    with integrator.run({**SWINGING, "bodies": bodies}, {"end": 0.1, "step": 0.01}) as run:
        require_complete(run, "from an inconsistent start it", MbdkitError)
        if float(np.max(run.array("joints/velocity_misalignment")[0])) > 1e-10:
            return failed("it started from inconsistent velocities")
    return passed()


@check("failure.impossible-tolerance")
def impossible_tolerance(integrator: IntegratorUnderTest) -> Result:
    """A tolerance that cannot be met is refused, or the run records only finite values, and if it fails, it ends with a
    status code.
    """
    fields = [name for name in ("tolerance", "rtol") if name in integrator.plugin.options.model_fields]
    if not fields:
        return skipped("it has no option `tolerance` or `rtol`")
    name = fields[0]
    outcomes = []
    for value in (1e-300, 3e-14):
        try:
            run = integrator.run(
                FORCED_PENDULUM, {"end": 0.1, "step": 0.01}, options={name: value}, limits={"max_steps": 20000}
            )
        except (SpecError, ValidationError):
            outcomes.append("refused")
            continue
        except PluginError as error:
            return failed(f"with {name} = {value:g} {str(error).rstrip('.')}")
        with run:
            if fault := _fault(run):
                return failed(f"with {name} = {value:g} {fault}")
            outcomes.append(run.status)
    return passed(outcomes=", ".join(outcomes))


@check("failure.step-limit")
def step_limit(integrator: IntegratorUnderTest) -> Result:
    """A run stops after limits.max_steps and keeps all steps up to then."""
    with integrator.run(FORCED_PENDULUM, {"end": 5.0, "step": 0.01}, limits={"max_steps": 7}) as run:
        code = run.status_reason.partition(":")[0]
        if run.status != "failed" or code != "max-steps":
            return failed(
                f"after 7 steps it should fail with max-steps, but its status is {run.status} {code}".rstrip()
            )
        if len(run.time) != 8 or run.stats["steps"] != 7:
            return failed(f"after 7 steps it counted {run.stats['steps']} and kept {len(run.time) - 1}")
    return passed()


@check("failure.interrupt")
def interrupt(integrator: IntegratorUnderTest) -> Result:
    """Ctrl-C ends the run as interrupted; the motion up to the interrupt is kept."""
    if threading.current_thread() is not threading.main_thread():
        raise Skip("only the main thread receives signals")
    rung: list[float] = []

    def ring(now: float, end: float) -> None:
        if not rung:
            rung.append(now)
            signal.raise_signal(signal.SIGINT)

    time = {"end": 1e6, "step": 0.01}
    endless = {"misalignment": 1e300}  # with a method of low order, misalignment may stop a run before the interrupt
    with integrator.run(SWINGING, time, progress=ring, output={"every": 1000}, limits=endless) as run:
        if run.status != "interrupted":
            return failed(f"after Ctrl-C its status is {run.status}: {run.status_reason}")
        if fault := _fault(run):
            return failed(fault)
        if abs(float(run.time[-1]) - rung[0]) > 1e-9 * max(1.0, rung[0]):
            return failed("the last state before the interrupt was not kept")
    return passed(stopped_at_s=rung[0])


CHECKS = (not_a_number, singular, inconsistent_start, impossible_tolerance, step_limit, interrupt)
