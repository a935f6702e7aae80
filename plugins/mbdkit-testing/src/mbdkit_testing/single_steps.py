"""Single steps of several sizes from the start of a test problem or after others, and their reference states."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from mbdkit.base.errors import StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Moment, Timetable
from mbdkit.integrators.start import start_method
from mbdkit.methods.step_methods import Step, StepMethod, StepState
from mbdkit.runs.preparation import build, make_method
from mbdkit.spec.loading import load_spec
from mbdkit_testing.check import Skip
from mbdkit_testing.integrator_under_test import IntegratorUnderTest
from mbdkit_testing.trial_models import FORCED_PENDULUM, LAGGING_PENDULUM, Model

STEPS = tuple(0.4 / 1.4**k for k in range(14))  #: Sizes of the single steps from the start [s].
SHARES = (0.3, 0.5, 0.8, 1.0)  #: Shares of a step at which reference states are known.
FLOOR = 1e-15  #: Errors of this size count as rounding.
#: Number of steps of one size before the one that shows what a method with memory does after its start.
#:
#: The errors of a start of low order have then left the memory, or have been damped.
HISTORY = 12
#: Sizes of steps with history, as a share of `STEPS`, so that the motion before them is short and hardly depends on the
#: size; and the error of their reference states.
LATER_SHARE, LATER_FLOOR = 1 / 16, 1e-13
#: Tolerance of methods that choose their steps themselves, and reject the sizes above with their own.
LOOSE = 0.1
REFERENCE = {"name": "mbdkit:gauss", "stages": 6}


@dataclass(frozen=True)
class SingleStep:
    """A step from the start of the test problem, or after others.

    Parameters
    ----------
    size
        Size of the step [s].
    begin, made
        The state before the step, and the step.
    inside
        The states in `SHARES` before the last, as dense output gave them when the step was taken; none if there is no
        dense output.
    exact
        The reference states in `SHARES`.
    """

    size: float
    begin: StepState
    made: Step
    inside: tuple[Moment, ...]
    exact: tuple[Moment, ...]


def model_for(integrator: IntegratorUnderTest) -> Model:
    """Return the test problem, which has a first-order state if the method claims to integrate such states."""
    return LAGGING_PENDULUM if integrator.claims.states else FORCED_PENDULUM


def equations_for(integrator: IntegratorUnderTest, model: Model) -> tuple[EquationsOfMotion, StepState]:
    """Return the equations of a model and its initial state."""
    equations = EquationsOfMotion(integrator.workspace(model))
    return equations, StepState(equations.q0, equations.v0, z=equations.z0)


def step_method(integrator: IntegratorUnderTest, **changes: float) -> StepMethod:
    """Return a new method, some options of which may be changed; raises Skip if it is not a class with `step`."""
    method = integrator.method(**changes)
    if not isinstance(method, StepMethod):
        raise Skip("it is not a class with `step`")
    return method


def step_of(method: StepMethod, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
    """Take one step."""
    result = method.step(equations, t, state, h)
    return result if isinstance(result, Step) else Step(result)


def single_steps(integrator: IntegratorUnderTest) -> tuple[SingleStep, ...]:
    """Return steps of the sizes in `STEPS`, without those that cannot be taken; raises Skip if there are none."""
    return integrator.cached("single steps", lambda: _taken(integrator))


def _taken(integrator: IntegratorUnderTest) -> tuple[SingleStep, ...]:
    model = model_for(integrator)
    exact = dict(zip(STEPS, reference_states(with_state=model is LAGGING_PENDULUM), strict=True))
    return tuple(
        SingleStep(size, begin, made, looked_into(made), exact[size])
        for size, begin, made in steps_on(integrator, model)
    )


def steps_on(integrator: IntegratorUnderTest, model: Model) -> Iterator[tuple[float, StepState, Step]]:
    """Yield the size [s], the begin and the step of steps of the sizes in `STEPS` from the start of a model.

    Raises Skip if none can be taken.
    """
    taken, why = 0, ""
    for changes in ({}, integrator.tolerances(LOOSE)):
        method, (equations, start) = step_method(integrator, **changes), equations_for(integrator, model)
        for size in STEPS:
            begin = replace(start, memory=method.begin(equations, equations.t0, start, "start"))
            try:
                result = step_of(method, equations, equations.t0, begin, size)
            except StepError as error:
                why = str(error).rstrip(".")
                continue
            if result.accepted and result.time is None and result.event is None:
                taken += 1
                yield size, begin, result
            elif not result.accepted:
                why = f"its own control rejects them, down to the smallest of {size:.2g} s"
            else:
                why = "they end earlier than asked"
        if taken:
            return
    raise Skip(f"no single step from the start could be taken: {why}")


def has_memory(integrator: IntegratorUnderTest) -> bool:
    """Return whether the first step of a method in Python passes memory on, as that of a multistep method does."""
    return any(step.made.state.memory is not None for step in single_steps(integrator))


def later_steps(integrator: IntegratorUnderTest) -> tuple[SingleStep, ...]:
    """Return steps that follow `HISTORY` others of their size, without those that cannot be taken.

    Their reference states are those of the motion through the begin of the step.
    """
    result = (_later_steps(integrator, changes) for changes in ({}, integrator.tolerances(LOOSE)))
    return next((steps for steps in result if steps), ())


def _later_steps(integrator: IntegratorUnderTest, changes: dict[str, float]) -> tuple[SingleStep, ...]:
    method, (equations, start) = step_method(integrator, **changes), equations_for(integrator, model_for(integrator))
    cuts, found = (equations.n, 2 * equations.n), list[SingleStep]()
    for size in (LATER_SHARE * size for size in STEPS):
        # all steps begin near one time, because the coefficient of their error depends on it
        first = HISTORY * (LATER_SHARE * STEPS[0] - size)
        q, v, z = np.split(moved(equations, equations.t0, (start.q, start.v, start.z), first), cuts)
        state = replace(start, q=q, v=v, z=z)
        state = replace(state, memory=method.begin(equations, equations.t0 + first, state, "start"))
        for number in range(HISTORY + 1):
            t, begin = equations.t0 + first + number * size, state
            try:
                result = step_of(method, equations, t, begin, size)
            except StepError:
                break
            if not result.accepted or result.time is not None or result.event is not None:
                break
            state = result.state
        else:
            ends = (moved(equations, t, (begin.q, begin.v, begin.z), share * size) for share in SHARES)
            q, v, z = zip(*(np.split(end, cuts) for end in ends), strict=True)
            exact = tuple(zip(q, v, z, strict=True))
            found.append(SingleStep(size, begin, result, looked_into(result), exact))
    return tuple(found)


def looked_into(made: Step) -> tuple[Moment, ...]:
    """Return the states (q, v, z) inside a step by its dense output; none if there is no dense output."""
    dense: Callable[[float], tuple[np.ndarray, ...]] | None = made.dense
    if dense is None:
        return ()
    q, v, z = zip(*(tuple(map(np.array, dense(share)[:3])) for share in SHARES[:-1]), strict=True)
    return tuple(zip(q, v, z, strict=True))


def moved(equations: EquationsOfMotion, t: float, begin: Moment, h: float) -> np.ndarray:
    """Return (q, v, z) in one vector after the time `h` [s] from a state, by tight adaptive steps."""
    cuts = equations.n, 2 * equations.n

    def rates(time: float, y: np.ndarray) -> np.ndarray:
        q, v, z = np.split(y, cuts)
        a, _, rate = equations.derivatives(time, q, v, z)
        return np.concatenate([v, a, rate])

    run = solve_ivp(rates, (t, t + h), np.concatenate(begin), method="DOP853", rtol=1e-12, atol=1e-14)
    return np.asarray(run.y[:, -1])


@cache
def reference_states(*, with_state: bool) -> tuple[tuple[Moment, ...], ...]:
    """Return (q, v, z), without the ground, in `SHARES` of each step in `STEPS`, by Gauss collocation of order 12."""
    model = LAGGING_PENDULUM if with_state else FORCED_PENDULUM
    spec = load_spec({"mbdkit": 1, "model": model, "integrator": REFERENCE, "time": {"end": 1.0, "step": 0.5}})
    workspace: Workspace = build(spec)[0]
    times = np.array([[workspace.t0 + share * step for share in SHARES] for step in STEPS])
    stops = sorted(set(times.ravel().tolist()))
    table = Timetable(
        workspace.t0, stops[-1], step=0.1, steps=4, every=10**9, single=True,
        stops=tuple(stops[:-1]), stop_margins=(1e-15,) * (len(stops) - 1),
    )  # fmt: skip
    stepper, result = start_method(make_method(spec), workspace, table), dict[float, Moment]()
    n = len(workspace.q0) - 3
    while not stepper.finished:
        stepper.advance()
        step = stepper.last_step
        assert step is not None
        near = min(stops, key=lambda stop, end=step.t1: abs(stop - end))  # type: ignore[misc]
        result[near] = step.q1[:n].copy(), step.v1[:n].copy(), step.z1.copy()
    return tuple(tuple(result[time] for time in row) for row in times.tolist())
