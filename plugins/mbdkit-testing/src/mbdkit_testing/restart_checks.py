"""What one step passes to the next: stored states continue bit for bit, and memory that no longer holds is dropped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.base.text import counted
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.integrators.interface import Stepper, Stretch, joined
from mbdkit.methods.step_methods import ExternalMethod, StepMethod, StepState, Why
from mbdkit.runs.stored_python_steps import MemoryNotStoredError, copy_state
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, failed, passed
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, drive
from mbdkit_testing.single_steps import equations_for, model_for, step_method, step_of
from mbdkit_testing.trial_models import DRIVEN_PENDULUM, LAGGING_PENDULUM

STEPS, END = 60, 0.6
STORED_AFTER = (1, 7, 25)  #: Numbers of steps after which the state is stored.
#: Columns of rows that have to be the same.
COLUMNS = ("time", "q", "v", "z", "work", "dissipated", "multipliers")
#: Number of steps before a discontinuity, and sizes of these steps [s], in two attempts.
PAST, LARGE, SMALL = 6, 0.02, 0.0025
#: Difference that counts as rounding, and the factor by which a larger one must fall from `LARGE` to `SMALL`.
#:
#: It falls by 8 where the memory is wrong, and by 64 or more where it is not.
SAME, FALLS = 1e-9, 16.0


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
    """A run that a new object of the method continues from a checkpoint is bitwise the same, also with projection."""
    if not integrator.claims.restartable:
        raise Skip("it does not claim to be restartable")
    method = integrator.method()
    if not isinstance(method, StepMethod | ExternalMethod):
        raise Skip("its steps are those of the framework, which stores their state itself")
    if isinstance(method, ExternalMethod) and method.traits.why_no_checkpoint:
        return failed(f"it claims to be restartable, but {method.traits.why_no_checkpoint}")
    for stabilization in ("none", "projection"):
        if stabilization in integrator.claims.stabilizations and (wrong := _continued(integrator, stabilization)):
            return wrong
    return passed(steps=STEPS)


def _continued(integrator: IntegratorUnderTest, stabilization: str) -> Result | None:
    """Return a failure if a run that is continued from a checkpoint differs."""
    whole = _rows(_host(integrator, stabilization), STEPS)
    for number in STORED_AFTER:
        first, later = _host(integrator, stabilization), _host(integrator, stabilization)
        before = _rows(first, number)
        if first.finished:
            break
        try:
            copy_state(first, later)
        except MemoryNotStoredError as error:
            return failed(f"it claims to be restartable, but its state cannot be stored: {error}")
        parts = joined([before, _rows(later, STEPS - number)])
        for name in COLUMNS:
            one, other = getattr(parts, name), getattr(whole, name)
            if one is not None and not np.array_equal(one, other):
                cause = "its state does not contain everything that the next step needs"
                run = "a run" if stabilization == "none" else f"with {stabilization} a run"
                return failed(f"{cause}: {run} that continues after {counted(number, 'step')} has another {name}")
    return None


def _host(integrator: IntegratorUnderTest, stabilization: str) -> StepHost:
    model = LAGGING_PENDULUM if integrator.claims.states else DRIVEN_PENDULUM
    workspace = integrator.workspace(model, stabilization=stabilization)
    stepper = integrator.stepper(workspace, END, STEPS, every=1, single=True)
    assert isinstance(stepper, StepHost)
    return stepper


def _rows(host: StepHost, steps: int) -> Stretch:
    """Return the rows of the next steps, as many as there are up to `steps`."""
    rows = list[Stretch]()
    while len(rows) < steps and not host.finished:
        rows.append(host.advance())
        if host.failure is not None:
            raise Skip(f"the steps could not be taken: {host.failure.sentence}".rstrip("."))
    return joined(rows)


@check("restart.discontinuities")
def discontinuities(integrator: IntegratorUnderTest) -> Result:
    """After a jump of a load, of velocities or of first-order states, a step uses no memory of the steps before."""
    method, model = step_method(integrator), model_for(integrator)
    jumps: tuple[Why, ...] = ("stop", "impact", "event") if integrator.claims.states else ("stop", "impact")
    equations, start = equations_for(integrator, model)
    loaded = {**model, "forces": model["forces"] | {"jump": {"type": "torque", "body": "rod2", "value": "6"}}}
    after_stop = equations_for(integrator, loaded)[0]
    after = (_state_after(method, equations, equations.t0, start, "start", LARGE, count) for count in (1, PAST))
    if all(state.memory is None for state in after):
        raise Skip("it has no memory")
    largest = 0.0
    for why in jumps:
        now = after_stop if why == "stop" else equations
        differences = list[float]()
        for h in (LARGE, SMALL):
            t, state = equations.t0 + PAST * h, _state_after(method, equations, equations.t0, start, "start", h, PAST)
            if why == "impact":  # velocities that the joints allow; their jump does not vanish with the step
                state = replace(state, v=now.project_velocities(t, state.q, state.v + 3.0))
            if why == "event":
                state = replace(state, z=state.z + 1.0)
            state = replace(state, low=(0.0, 0.0), multipliers=None)
            fresh = replace(state, memory=None)
            end, other = (_state_after(method, now, t, *begin, h, 1) for begin in ((state, why), (fresh, "start")))
            changes = (np.abs(end.q - other.q), np.abs(end.v - other.v), np.abs(end.z - other.z))
            differences.append(float(np.max(np.concatenate(changes))))
        if not differences[1] <= max(SAME, differences[0] / FALLS):
            what = {"stop": "a load has jumped", "impact": "the velocities have jumped", "event": "an event"}[why]
            return failed(f"after {what}, a step uses the memory of the steps before", difference=differences[1])
        largest = max(largest, differences[1])
    return passed(difference=largest)


def _state_after(
    method: StepMethod, equations: EquationsOfMotion, t: float, start: StepState, why: Why, h: float, steps: int
) -> StepState:
    """Return the state after steps of the size `h` [s] that begin anew; raises Skip if they cannot be taken."""
    state = replace(start, memory=method.begin(equations, t, start, why))
    try:
        for k in range(steps):
            state = step_of(method, equations, t + k * h, state, h).state
    except StepError as error:
        raise Skip(f"the steps could not be taken: {error}") from None
    return state


CHECKS = (stretches, state, discontinuities)
