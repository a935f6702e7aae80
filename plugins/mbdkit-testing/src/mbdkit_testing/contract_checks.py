"""Requirements on every integrator: options, unchanged inputs, repeatable results, exact end time."""

from __future__ import annotations

import copy
import pickle
from typing import Any, cast

import numpy as np
from pydantic import ValidationError

from mbdkit.base.errors import MbdkitError, PluginError, SpecError
from mbdkit.base.text import counted, listed
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.methods.kinds import Method
from mbdkit.methods.step_methods import Step, StepMethod, StepState, Why
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, at_most, failed, passed, skipped, warned
from mbdkit_testing.integrator_under_test import IntegratorUnderTest, drive, final_state, require_complete
from mbdkit_testing.item_checks import digest_in_new_process
from mbdkit_testing.options_under_test import options_result, results_of_variants, validated
from mbdkit_testing.trial_models import (
    DRIVEN_PENDULUM,
    FORCED_PENDULUM,
    FOUR_BAR,
    LAG_AT_1,
    WITH_STATE,
    forced_pendulum,
)

STEPS = 23
START_TIMES = 0.0, 3.0, 1000.0, -8.0  #: Start times for which runs should give the same results [s].
#: Largest change of the final state that counts as rounding if only the start time changes.
#:
#: The first is for fixed steps, the second for adaptive methods, whose step sizes depend on rounding.
SAME, SAME_ADAPTIVE = 1e-9, 1e-4
#: Largest error of a first-order state of an adaptive method with its default tolerances.
STATE_ADAPTIVE = 1e-5


@check("contract.options")
def options(integrator: IntegratorUnderTest) -> Result:
    """The integrator's options round-trip through JSON, reject unknown keys, and have descriptions."""
    try:
        integrator.spec(FORCED_PENDULUM, {"end": 1.0, "step": 0.1}, options={"no-such-option": 1})
    except (ValidationError, ValueError):
        return options_result(integrator.plugin.options, integrator.options)
    return failed("a spec with an unknown option is accepted")


@check("contract.method")
def method(integrator: IntegratorUnderTest) -> Result:
    """The integrator creates a method, its claims are consistent, and it names references."""
    made: object = integrator.method()
    claims = integrator.claims
    if not isinstance(made, Method):
        return failed(f"it created a {type(made).__name__}, which is not a method")
    if claims.order is None and not claims.adaptive:
        return failed("it claims neither an order nor adaptive steps")
    if claims.adaptive != (made.traits.tolerances is not None):
        return failed(f"it claims adaptive = {claims.adaptive}, but its method is a {type(made).__name__}")
    if not claims.formulations:
        return failed("it claims no formulation")
    if claims.multiplier_order is not None and made.traits.own_multipliers == "never":
        return failed("it claims an order of multipliers, but has no multipliers of its own")
    if not integrator.plugin.references:
        return warned("it has no references")
    return passed(references=len(integrator.plugin.references))


@check("contract.inputs")
def inputs(integrator: IntegratorUnderTest) -> Result:
    """The method does not modify its options, the start of the run, states passed to it, or states that it returned."""
    given = validated(integrator.plugin.options, integrator.options)
    before = given.model_dump_json()
    made = cast(Method, integrator.plugin.create(given))
    workspace = integrator.workspace(FORCED_PENDULUM)
    start = workspace.q0.copy(), workspace.v0.copy()
    watched = _Watched(made) if isinstance(made, StepMethod) else made
    try:
        drive(integrator.stepper(workspace, 0.5, STEPS, method=watched))
    except Exception:
        if not (isinstance(watched, _Watched) and watched.changed):
            raise
    if given.model_dump_json() != before:
        return failed("it modified its options")
    if not (np.array_equal(workspace.q0, start[0]) and np.array_equal(workspace.v0, start[1])):
        return failed("it modified the start of the run")
    if isinstance(watched, _Watched) and watched.changed:
        return failed(f"its step modified {listed(sorted(watched.changed), 'and')} of the state passed to it")
    if isinstance(watched, _Watched) and watched.reused:
        return failed(
            f"its next step overwrites {listed(sorted(watched.reused), 'and')} in an array that an earlier step "
            f"returned; it should return new arrays"
        )
    return passed()


_PARTS = ("q", "v", "z", "multipliers", "memory")


class _Watched(StepMethod):
    """A wrapper of a method that records which parts of states are modified by a step.

    It compares the state passed to the step, and the state that the previous step returned. The arrays passed to the
    method are writable, so that all modifications are detected.
    """

    def __init__(self, method: StepMethod):
        self.method = method
        self.changed: set[str] = set()
        self.reused: set[str] = set()
        self.returned: tuple[StepState, StepState] | None = None
        self.carries_multipliers = method.carries_multipliers  # type: ignore[misc]
        self.hint, self.tolerances, self.error_order = method.hint, method.tolerances, method.error_order

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: Why) -> Any:
        return self.method.begin(equations, t, state, why)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState | Step:
        before, state = copy.deepcopy(state), copy.deepcopy(state)
        try:
            after = self.method.step(equations, t, state, h)
        finally:
            self.changed |= {name for name in _PARTS if not _same(before, state, name)}
        if self.returned is not None:
            self.reused |= {name for name in _PARTS if not _same(*self.returned, name)}
        end = after.state if isinstance(after, Step) else after
        self.returned = end, copy.deepcopy(end)
        return after


def _same(before: StepState, after: StepState, name: str) -> bool:
    return _bytes(getattr(before, name)) == _bytes(getattr(after, name))


def _bytes(value: object) -> bytes:
    return value.tobytes() if isinstance(value, np.ndarray) else pickle.dumps(value)


@check("contract.repeatable")
def repeatable(integrator: IntegratorUnderTest) -> Result:
    """Two runs are identical bit for bit, also after another model, in a new process, and by the same method object."""
    time = {"end": 0.7, "step": 0.7 / STEPS}
    for other in (FOUR_BAR, FORCED_PENDULUM):
        integrator.run(other, time).close()
    with integrator.run(DRIVEN_PENDULUM, time) as first, integrator.run(DRIVEN_PENDULUM, time) as second:
        if first.data_sha256 != second.data_sha256:
            return failed("two runs of the same spec differ")
        alone = digest_in_new_process(integrator.spec(DRIVEN_PENDULUM, time))
        if alone not in ("", first.data_sha256):
            return failed("a run after others differs from one in a new process: it keeps data between runs")
    made = integrator.method()
    ends = [drive(integrator.stepper(integrator.workspace(DRIVEN_PENDULUM), 0.7, STEPS, method=made)) for _ in range(2)]
    if not all(np.array_equal(x, y) for x, y in zip(*ends, strict=True)):
        return failed("a method object gives different results when it is used again: it keeps data of the last run")
    return passed()


@check("contract.picklable")
def picklable(integrator: IntegratorUnderTest) -> Result:
    """Options and method can be pickled, for studies."""
    things = {"options": validated(integrator.plugin.options, integrator.options), "method": integrator.method()}
    for what, thing in things.items():
        try:
            pickle.loads(pickle.dumps(thing))
        except Exception as error:
            return failed(f"its {what} cannot be pickled: {error}")
    return passed()


@check("contract.end-time")
def end_time(integrator: IntegratorUnderTest) -> Result:
    """A run ends exactly at its end time, whether or not the step divides it, and counts each step once."""
    for end, step in ((1.0, 0.3), (0.7, 0.1), (1.0, 1.0 / 3.0), (0.5, 2.0)):
        with integrator.run(FORCED_PENDULUM, {"start": 0.25, "end": 0.25 + end, "step": step}) as run:
            if run.status != "complete":
                if integrator.claims.adaptive or step <= 0.1:
                    return failed(f"a run of {end:g} s did not complete: {run.status_reason}")
                continue  # steps of this size may fail
            last = float(run.time[-1])
            expected = int(np.ceil(end / step - 1e-9))
            if last != 0.25 + end:
                return failed(f"a run to {0.25 + end!r} s ended at {last!r} s")
            if not integrator.claims.adaptive and run.stats["steps"] != expected:
                return failed(f"{end:g} s in steps of {step:g} s took {run.stats['steps']} steps, not {expected}")
            if np.any(np.diff(run.time) <= 0):
                return failed("recorded times do not increase")
    return passed()


@check("contract.start-time")
def start_time(integrator: IntegratorUnderTest) -> Result:
    """Runs of a model whose forces begin at the start of the run are the same for any start time."""
    ends, largest = [], 0.0
    for start in START_TIMES:
        time = {"start": start, "end": start + 1.0} | ({} if integrator.claims.adaptive else {"step": 0.01})
        with integrator.run(forced_pendulum(start), time, output={"every": 10**9}) as run:
            require_complete(run, f"a run from t = {start:g} s", MbdkitError)
            ends.append(final_state(run))
        change = float(np.max(np.abs(ends[-1] - ends[0])))
        largest = max(largest, change)
        limit = SAME_ADAPTIVE if integrator.claims.adaptive else SAME
        if change > limit:
            return failed(f"a run from t = {start:g} s ends in another state than one from t = 0", change=change)
    return passed(change=largest).within({"change": limit})


@check("contract.formulations")
def formulations(integrator: IntegratorUnderTest) -> Result:
    """A run completes on every formulation that it claims."""
    others = [name for name in integrator.claims.formulations if name != integrator.formulation]
    if not others:
        return skipped(f"it claims only {integrator.formulation}, which the other checks use")
    for name in others:
        with integrator.run(FORCED_PENDULUM, {"end": 0.2, "step": 0.01}, formulation=name) as run:
            require_complete(run, f"on {name} a run", MbdkitError)
    return passed(formulations=counted(len(others) + 1, "formulation"))


@check("contract.states")
def states(integrator: IntegratorUnderTest) -> Result:
    """If the method claims to integrate first-order states, they converge to their closed form with the step or the
    tolerance.
    """
    if not integrator.claims.states:
        raise Skip("it does not claim to integrate first-order states")
    errors = list[float]()
    for steps in (20, 80):
        time = {"end": 1.0} if integrator.claims.adaptive else {"end": 1.0, "step": 1.0 / steps}
        try:
            run = integrator.run(WITH_STATE, time)
        except (SpecError, PluginError) as error:
            return failed(f"it claims to integrate first-order states, but {error}".rstrip("."))
        with run:
            require_complete(run, "with a first-order state a run", MbdkitError)
            errors.append(abs(float(run.array("states/value")[-1, 0]) - LAG_AT_1))
    limit = STATE_ADAPTIVE if integrator.claims.adaptive else max(errors[0] / 2, SAME)
    return at_most({"fine": limit}, "its first-order states do not converge", coarse=errors[0], fine=errors[1])


@check("contract.other-options")
def other_options(integrator: IntegratorUnderTest) -> Result:
    """With other values of each option within its bounds, the integrator creates a method that fits its claims, and a
    run of 0.1 s does not end with an error in the plugin. The other checks use the given values of the options only.
    """

    def method_and_run(name: str, chosen: dict[str, Any]) -> Result:
        other = IntegratorUnderTest(integrator.item, chosen, integrator.installed)
        try:
            if (result := method.function(other)).outcome != "fail":
                time = {"end": 0.1} if other.claims.adaptive else {"end": 0.1, "step": 0.01}
                other.run(FORCED_PENDULUM, time).close()
        except PluginError as error:
            return failed(str(error).rstrip("."))
        return result

    return results_of_variants(integrator.item, integrator.options, method_and_run)


CHECKS = (options, other_options, method, inputs, repeatable, picklable, end_time, start_time, formulations, states)
