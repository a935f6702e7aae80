"""What every integrator owes whatever its method: options, untouched inputs, the same bits twice, the exact end."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
from pydantic import ValidationError

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.methods.kinds import Method, SciPySolver
from mbdkit.methods.step_method import StepMethod, StepState
from mbdkit.testing.check import check
from mbdkit.testing.integrator_under_test import IntegratorSubject, drive
from mbdkit.testing.options_under_test import validated
from mbdkit.testing.outcome import Finding, failed, passed, skipped, warned
from mbdkit.testing.trial_models import DRIVEN_PENDULUM, FORCED_PENDULUM
from mbdkit.text import counted, listed

STEPS = 23


@check("contract.options")
def options(subject: IntegratorSubject) -> Finding:
    """Its options survive the way to JSON and back, refuse unknown keys, and each says what it is."""
    model = subject.plugin.options
    chosen = validated(model, subject.options)
    again = model.model_validate_json(chosen.model_dump_json())
    if again != chosen:
        return failed(f"options {chosen!r} come back from JSON as {again!r}")
    try:
        subject.spec(FORCED_PENDULUM, {"end": 1.0, "step": 0.1}, options={"no-such-option": 1})
    except (ValidationError, ValueError):
        pass
    else:
        return failed("a spec with an option that does not exist is accepted")
    described = model.model_json_schema().get("properties", {})
    silent = [name for name, info in described.items() if not info.get("description")]
    if silent:
        return warned(f"{listed(silent, 'and')} have no description: write a docstring below each option")
    return passed(options=len(described))


@check("contract.method")
def method(subject: IntegratorSubject) -> Finding:
    """What it creates is a method, its claims are meaningful, and it names its sources."""
    made: object = subject.method()
    claims = subject.claims
    if not isinstance(made, Method):
        return failed(f"it made {type(made).__name__}, which is no method")
    if claims.order is None and not claims.adaptive:
        return failed("it claims neither an order nor that it controls its own error")
    if claims.adaptive != isinstance(made, SciPySolver):
        return failed(f"it claims adaptive = {claims.adaptive}, but is of the kind {type(made).__name__}")
    if not claims.formulations:
        return failed("it claims no formulation that it could serve")
    if claims.multiplier_order is not None and not getattr(made, "carries_multipliers", False):
        return failed("it claims an order of multipliers, but carries none")
    if not subject.plugin.references:
        return warned("it names no reference")
    return passed(references=len(subject.plugin.references))


@check("contract.inputs")
def inputs(subject: IntegratorSubject) -> Finding:
    """It changes neither its options, nor the start of the run, nor the states that it is handed."""
    given = validated(subject.plugin.options, subject.options)
    before = given.model_dump_json()
    made = subject.plugin.create(given)
    workspace = subject.workspace(FORCED_PENDULUM)
    start = workspace.q0.copy(), workspace.v0.copy()
    watched = _Watched(made) if isinstance(made, StepMethod) else made
    drive(subject.stepper(workspace, 0.5, STEPS, method=watched))
    if given.model_dump_json() != before:
        return failed("it changed its options")
    if not (np.array_equal(workspace.q0, start[0]) and np.array_equal(workspace.v0, start[1])):
        return failed("it changed the start of the run")
    if isinstance(watched, _Watched) and watched.changed:
        return failed(f"its step changed {listed(sorted(watched.changed), 'and')} of the state that it was handed")
    return passed()


class _Watched(StepMethod):
    """A method whose states are compared with themselves after each step."""

    def __init__(self, method: StepMethod):
        self.method = method
        self.changed: set[str] = set()
        self.carries_multipliers = method.carries_multipliers  # type: ignore[misc]
        self.hint = method.hint  # type: ignore[misc]

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        before = copy.deepcopy(state)
        after = self.method.step(equations, t, state, h)
        self.changed |= {name for name in ("q", "v", "multipliers", "memory") if not _same(before, state, name)}
        return after


def _same(before: StepState, after: StepState, name: str) -> bool:
    return _bytes(getattr(before, name)) == _bytes(getattr(after, name))


def _bytes(value: Any) -> bytes:
    return value.tobytes() if isinstance(value, np.ndarray) else pickle.dumps(value)


@check("contract.repeatable")
def repeatable(subject: IntegratorSubject) -> Finding:
    """Two runs give the same bits, and so does the same method object when it is used again."""
    time = {"end": 0.7, "step": 0.7 / STEPS}
    with subject.run(DRIVEN_PENDULUM, time) as first, subject.run(DRIVEN_PENDULUM, time) as second:
        if first.data_sha256 != second.data_sha256:
            return failed("two runs of the same spec differ")
    made = subject.method()
    ends = [drive(subject.stepper(subject.workspace(DRIVEN_PENDULUM), 0.7, STEPS, method=made)) for _ in range(2)]
    if not all(np.array_equal(x, y) for x, y in zip(*ends, strict=True)):
        return failed("the same method object moves differently when it is used again: it remembers its last run")
    return passed()


@check("contract.picklable")
def picklable(subject: IntegratorSubject) -> Finding:
    """Options, method, and the states of a method with `step` survive pickling, as studies and restarts need it."""
    made = subject.method()
    for what, thing in (("its options", validated(subject.plugin.options, subject.options)), ("its method", made)):
        try:
            pickle.loads(pickle.dumps(thing))
        except Exception as error:
            return failed(f"{what} cannot be pickled: {error}")
    if isinstance(made, StepMethod):
        equations = EquationsOfMotion(subject.workspace(FORCED_PENDULUM))
        state = made.step(equations, equations.t0, StepState(equations.q0, equations.v0), 0.01)
        try:
            pickle.loads(pickle.dumps(state))
        except Exception as error:
            return failed(f"its state cannot be pickled: {error}")
    return passed()


@check("contract.end-time")
def end_time(subject: IntegratorSubject) -> Finding:
    """A run ends at its end to the bit, whether or not the step divides it, with every step counted once."""
    for end, step in ((1.0, 0.3), (0.7, 0.1), (1.0, 1.0 / 3.0), (0.5, 2.0)):
        with subject.run(FORCED_PENDULUM, {"start": 0.25, "end": 0.25 + end, "step": step}) as run:
            if run.status != "complete":
                if subject.claims.adaptive or step <= 0.1:
                    return failed(f"a run of {end:g} s did not complete: {run.status_reason}")
                continue  # steps as large as these need not be possible
            last = float(run.time[-1])
            expected = int(np.ceil(end / step - 1e-9))
            if last != 0.25 + end:
                return failed(f"a run to {0.25 + end!r} s ended at {last!r} s")
            if not subject.claims.adaptive and run.stats["steps"] != expected:
                return failed(f"{end:g} s in steps of {step:g} s took {run.stats['steps']} steps, not {expected}")
            if np.any(np.diff(run.time) <= 0):
                return failed("recorded times do not increase")
    return passed()


@check("contract.formulations")
def formulations(subject: IntegratorSubject) -> Finding:
    """It serves every formulation that it claims."""
    others = [name for name in subject.claims.formulations if name != subject.formulation]
    if not others:
        return skipped(f"it claims {subject.formulation} alone, on which everything else is tried")
    for name in others:
        with subject.run(FORCED_PENDULUM, {"end": 0.2, "step": 0.01}, formulation=name) as run:
            if run.status != "complete":
                return failed(f"on {name} a run did not complete: {run.status_reason}")
    return passed(formulations=counted(len(others) + 1, "formulation"))


CHECKS = (options, method, inputs, repeatable, picklable, end_time, formulations)
