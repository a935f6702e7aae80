"""Steps with error, dense output, own control, memory, states of elements and events, and libraries with own loops."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import EquationsOfMotion, Step, StepState, Tolerances
from mbdkit.archive.checkpoint import Checkpoint
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.engine.stabilization import Stabilization
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.integrators.interface import Stretch, Timetable, joined
from mbdkit.runs.simulation import simulate
from mbdkit.runs.stored_python_steps import MemoryNotStoredError, restore_stepper, stored_stepper
from mbdkit.spec import load_spec
from mbdkit.spec.run_spec import spec_type
from tests.benchmarks.bits_examples import with_treatment
from tests.integrators.python_methods import Pair, Rk45, run_with
from tests.margins import assert_within
from tests.runs.resuming.checkpoints import checkpoint_of
from tests.runs.rotor import exact as exact_end
from tests.runs.rotor import spec_of

from .running import DOUBLE, driven_chain
from .step_methods import RungeKutta, offering


def example(name: str, method: Any, **changes: Any) -> tuple[mbdkit.Run, mbdkit.Run]:
    """Return runs of an example with a method, and with dop853 and tight tolerances."""
    data = load_spec(name).model_dump(exclude_none=True, by_alias=True)
    data = {key: part for key, part in data.items() if key not in ("mbdkit", "integrator", "time", "output")} | changes
    exact = mbdkit.run({"mbdkit": 1, "integrator": TIGHT, **data}).check()
    return run_with(method, **data).check(), exact


TIGHT = {"name": "dop853", "adaptive": True, "rtol": 1e-12, "atol": 1e-13}
METHODS = pytest.mark.parametrize("method", [Pair(1e-7), Rk45()], ids=["step", "library"])


@METHODS
def test_controlled_steps_with_impulses_of_drivers_and_rows_at_an_interval(method: Any) -> None:
    # expected: dop853 with tight tolerances
    mine, exact = example("crank-press", method, time={"end": 0.6}, output={"interval": 0.05})
    np.testing.assert_array_equal(mine.time, exact.time)
    for name, body in exact.bodies.items():
        np.testing.assert_allclose(mine.bodies[name].position, body.position, rtol=0, atol=2e-5)
    np.testing.assert_allclose(mine.energy.work, exact.energy.work, rtol=0, atol=1e-3 * np.abs(exact.energy.work).max())


@METHODS
def test_projected_steps_keep_their_size_and_joints_closed_also_at_events(method: Any) -> None:
    # expected: the steps of a run without projection, and joints closed up to rounding errors
    model, time = driven_chain(), {"end": 0.5}
    time |= {"step": 1e-3}
    first_turn = {"turns": {"when": "r2.angular_velocity", "action": "stop"}}
    free, projected, stopped = (
        run_with(method, model, time, stabilization=kind, events=events).check()
        for kind, events in (("none", {}), ("projection", {}), ("projection", first_turn))
    )
    assert free.misalignment_max > 1e-9
    assert abs(len(projected.time) - len(free.time)) <= 0.05 * len(free.time)
    assert stopped.time[-1] < time["end"]
    for run in (projected, stopped):
        assert_within(max(run.misalignment_max, float(run.array("joints/velocity_misalignment").max())), 1e-12)
    for name, body in free.bodies.items():
        np.testing.assert_allclose(projected[name].position[-1], body.position[-1], rtol=0, atol=1e-5)


@METHODS
@pytest.mark.parametrize("name", ["series-elastic-knee", "delayed-balance"])
def test_states_of_motors_and_sampled_controllers_are_integrated(method: Any, name: str) -> None:
    # expected: dop853 with tight tolerances
    mine, exact = example(name, method, time={"end": 0.2}, output={"interval": 0.05})
    size = max(float(np.abs(body.position).max()) for body in exact.bodies.values())
    for body in exact.bodies:
        np.testing.assert_allclose(mine.bodies[body].position, exact.bodies[body].position, rtol=0, atol=1e-5 * size)
    assert_within(mine.energy.balance, 1e-4 * np.abs(exact.energy.total).max())


@pytest.mark.parametrize("stabilization", ["none", "projection"])
@METHODS
def test_events_that_set_states_end_steps(method: Any, stabilization: str) -> None:
    # expected: the closed form of a charge that is taken seven times
    spec = spec_of({}, None)
    sections = {"events": spec["events"], "stabilization": stabilization}
    mine = run_with(method, spec["model"], spec["time"], **sections).check()
    times = mine.events.of_name("fires").time
    np.testing.assert_allclose(times, np.log(2) * np.arange(1, 8), rtol=0, atol=1e-5)
    at_end = mine.states["charge"].value[-1], mine["rotor"].angular_velocity[-1]
    np.testing.assert_allclose(at_end, exact_end(), rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("method", "name", "end"),
    [(Pair(None), "limit-stop", 0.3), (Pair(1e-8), "bouncing-ball", 0.8)],
    ids=["fixed", "controlled"],
)
def test_methods_that_evaluate_accelerations_meet_rigid_contacts(method: Any, name: str, end: float) -> None:
    # expected: dop853 in fixed steps, with the same laws of contact and impact
    given = with_treatment(name, "event-driven")
    data = {key: part for key, part in given.items() if key not in ("mbdkit", "integrator", "time", "output")}
    time = {"end": end, "step": 5e-3}
    exact = mbdkit.run({"mbdkit": 1, "integrator": {"name": "dop853"}, "time": time, **data})
    mine = run_with(method, **data, time=time).check()
    for body in exact.bodies:
        last = exact.bodies[body].position[-1]
        np.testing.assert_allclose(mine.bodies[body].position[-1], last, rtol=0, atol=1e-5)
    np.testing.assert_allclose(mine.impacts.time, exact.impacts.time, rtol=0, atol=1e-6)


def test_errors_follow_the_tolerance_and_steps_are_rejected() -> None:
    # expected: a tight run; the error of a method of order 3 on a driven chain is proportional to the tolerance
    time, exact = (
        {"end": 0.5},
        mbdkit.run(driven_chain(), integrator=TIGHT, time={"end": 0.5}),
    )
    errors, rejected = [], 0
    for rtol in (1e-4, 1e-6, 1e-8):
        mine = run_with(Pair(rtol), driven_chain(), time).check()
        last = [(mine.bodies[name].position[-1], body.position[-1]) for name, body in exact.bodies.items()]
        errors.append(max(float(np.abs(ours - best).max()) for ours, best in last))
        rejected += mine.stats["rejected"]
        assert mine.array("steps/rejected").sum() == mine.stats["rejected"]
    assert rejected > 0
    assert errors[1] < 0.1 * errors[0]
    assert errors[2] < 0.1 * errors[1]


def test_fixed_steps_record_rows_at_an_interval_by_dense_output() -> None:
    # expected: steps that end at these times
    through = run_with(Pair(None), DOUBLE, {"steps": 100, "step": 0.01}, output={"interval": 0.025}).check()
    ends = run_with(Pair(None), DOUBLE, {"steps": 200, "step": 0.005}, output={"every": 5}).check()
    np.testing.assert_allclose(through.time, ends.time, rtol=0, atol=1e-15)
    np.testing.assert_allclose(through["rod2"].position, ends["rod2"].position, rtol=0, atol=1e-5)
    assert through.array("steps/steps").sum() == 100


def test_a_rejected_fixed_step_is_divided_and_its_rows_stay_on_the_grid() -> None:
    class Careful(RungeKutta):
        """Takes no step above 3 ms."""

        def step(self, equations: Any, t: float, state: StepState, h: float) -> Step:
            return Step(super().step(equations, t, state, h), accepted=h <= 0.003, next_step=0.0025)

    mine = run_with(Careful(), DOUBLE, {"steps": 20, "step": 0.01}).check()
    fine = run_with(RungeKutta(), DOUBLE, {"steps": 80, "step": 0.0025}, output={"every": 4}).check()
    np.testing.assert_allclose(mine.time, fine.time, rtol=0, atol=1e-15)
    np.testing.assert_allclose(mine["rod2"].position, fine["rod2"].position, rtol=0, atol=1e-12)
    assert mine.stats["steps"] == 80
    assert mine.stats["rejected"] == mine.array("steps/rejected").sum() > 0


def test_a_method_may_control_its_steps_itself() -> None:
    class Doubling(RungeKutta):
        """Doubles its step, and takes none above 3 ms: it then asks for half of it."""

        tolerances = Tolerances(1e-6, 1e-6)

        def step(self, equations: Any, t: float, state: StepState, h: float) -> Step:
            is_short = h <= 0.003
            return Step(super().step(equations, t, state, h), next_step=2 * h if is_short else h / 2, accepted=is_short)

    mine = run_with(Doubling(), DOUBLE, {"end": 0.011, "step": 0.001}).check()
    np.testing.assert_allclose(mine.array("steps/size")[1:], [0.002, 0.002, 0.003, 0.003], rtol=1e-9)
    assert mine.array("steps/rejected").sum() == mine.stats["rejected"] > 0


@pytest.mark.parametrize("tolerances", [None, Tolerances(1e-6, 1e-6)], ids=["fixed", "controlled"])
def test_a_step_that_ends_early_is_divided_at_an_event(tolerances: Tolerances | None) -> None:
    # expected: the motion at the time of the event
    class Hesitant(RungeKutta):
        """Takes only half of each step that it is asked for."""

        def step(self, equations: Any, t: float, state: StepState, h: float) -> Step:
            size = min(h, max(h / 2, 1e-4))
            return Step(super().step(equations, t, state, size), time=t + size, next_step=0.004)

    method = Hesitant()
    method.tolerances = tolerances
    events = {"enough": {"when": "t - 0.0437", "action": "stop"}}
    mine = run_with(method, DOUBLE, {"end": 0.1, "step": 0.004}, events=events).check()
    exact = mbdkit.run(
        {"mbdkit": 1, "model": DOUBLE, "integrator": TIGHT, "time": {"end": 0.0437}, "output": {"every": 10**6}}
    )  # fmt: skip
    assert mine.time[-1] == pytest.approx(0.0437, abs=1e-12)
    np.testing.assert_allclose(mine["rod2"].position[-1], exact["rod2"].position[-1], rtol=0, atol=1e-8)


def test_a_rejected_step_must_be_followed_by_a_smaller_one() -> None:
    class Stubborn(RungeKutta):
        def step(self, equations: Any, t: float, state: StepState, h: float) -> Step:
            return Step(super().step(equations, t, state, h), accepted=False, next_step=h)

    mine = run_with(Stubborn(), DOUBLE, {"steps": 2, "step": 0.01})
    assert "Stubborn rejects a step of 0.01 s and asks for one of 0.01 s, no smaller one" in mine.status_reason


def test_begin_is_told_why() -> None:
    told = []

    class Told(Pair):
        def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: str) -> Any:
            told.append((round(t, 9), why))
            return super().begin(equations, t, state, why)

    run_with(Told(1e-6), driven_chain(), {"end": 0.1}).check()
    assert told == [(0.0, "start")]
    told.clear()
    run_with(Told(None), DOUBLE, {"steps": 2, "step": 0.01}, stabilization="projection").check()
    assert told == [(0.0, "start"), (0.01, "projection"), (0.02, "projection")]
    told.clear()
    spec = spec_of({}, None)
    run_with(Told(1e-6), spec["model"], {"end": 1.0}, events=spec["events"]).check()
    assert told == [(0.0, "start"), (pytest.approx(np.log(2), abs=2e-6), "event")]


def advanced(host: StepHost) -> list[Stretch]:
    stretches: list[Stretch] = []
    while not host.finished and host.failure is None:
        stretches.append(host.advance())
    assert host.failure is None
    return stretches


class Counted:
    """Memory that is an object, and says how it is stored."""

    def __init__(self, steps: int):
        self.steps = steps

    def stored(self) -> Any:
        return {"steps": self.steps}

    def restored(self, data: Any) -> Counted:
        return Counted(data["steps"])


class Counting(RungeKutta):
    """Steps depend on the number of steps before."""

    def begin(self, equations: Any, t: float, state: StepState, why: str) -> Any:
        return Counted(0)

    def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
        new = super().step(equations, t, state, h * (1 + 1e-9 * state.memory.steps))
        return StepState(new.q, new.v, memory=Counted(state.memory.steps + 1), low=new.low, z=new.z)


class Nameless(Counting):
    """Its memory cannot be stored."""

    def begin(self, equations: Any, t: float, state: StepState, why: str) -> Any:
        return None

    def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
        new = RungeKutta.step(self, equations, t, state, h)
        return StepState(new.q, new.v, memory=(1.0, object()))


@pytest.mark.parametrize(
    ("name", "when"),
    [
        ("series-elastic-knee", "third"),
        ("double-pendulum", "third"),
        ("double-pendulum", "stop"),
        ("double-pendulum", "projection"),
    ],
    ids=["states", "plain", "at a stop", "projected"],
)
@pytest.mark.parametrize(
    "method", [Pair(1e-6), Pair(None), Rk45(), Counting()], ids=["pair", "fixed", "library", "object"]
)
def test_a_stored_state_continues_to_the_same_bits(method: Any, name: str, when: str) -> None:
    spec = load_spec(name)
    rows = {"steps": 200} if method.tolerances is None else {"interval": 0.01}
    stops = {"stops": (0.05, 0.1), "stop_margins": (1e-14, 1e-14)}
    table = Timetable(0.0, 0.2, single=True, step=1e-3, **rows, **stops)
    workspace = workspace_at_start(spec.mechanism())[0]
    workspace.stabilization = Stabilization("projection" if when == "projection" else "none")
    fresh = [StepHost(method, replace(workspace), table) for _ in range(3)]
    whole = joined(advanced(fresh[0]))
    first = [fresh[1].advance()]
    while fresh[1].now.why != "stop" if when == "stop" else fresh[1].counters.steps < 3:
        first.append(fresh[1].advance())
    stored = Checkpoint.decoded(checkpoint_of(stored_stepper(fresh[1])).encoded())
    assert stored is not None
    restore_stepper(fresh[2], stored.state)
    resumed = joined([*first, *advanced(fresh[2])])
    for column in ("time", "q", "v", "z", "work", "dissipated", "intervals"):
        np.testing.assert_array_equal(getattr(resumed, column), getattr(whole, column))
    assert fresh[2].counters == fresh[0].counters


def test_memory_that_cannot_be_stored_is_named() -> None:
    host = StepHost(
        Nameless(), workspace_at_start(load_spec("double-pendulum").mechanism())[0], Timetable(0.0, 0.1, 0.01, 10)
    )
    host.advance()
    with pytest.raises(MemoryNotStoredError, match=r"the memory of the method, a tuple, cannot be stored: .* a object"):
        stored_stepper(host)


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (lambda new, n: Step(new, error=np.zeros(3)), r"step returned an invalid `error`"),
        (lambda new, n: Step(new, next_step=-1.0), r"next_step = -1.0, which is not a positive number"),
        (lambda new, n: Step(new, time=5.0), r"time = 5.0, which is not .* at most its end, 0.01\."),
        (lambda new, n: Step(new, time=0.0), r"time = 0.0, which is not later than the start of the step, 0.0,"),
        (lambda new, n: Step("no"), r"returned a Step whose state is a str"),  # type: ignore[arg-type]
        (lambda new, n: StepState(new.q, new.v, z=np.zeros(1)), r"invalid `z`"),
    ],
)
def test_what_a_step_returns_is_checked(made: Any, expected: str) -> None:
    class Wrong(RungeKutta):
        def step(self, equations: Any, t: float, state: StepState, h: float) -> Any:
            return made(super().step(equations, t, state, h), equations.n)

    mine = run_with(Wrong(), DOUBLE, {"steps": 2, "step": 0.01})
    assert mine.status_reason.startswith("plugin-error: integrator acme:mine raised")
    assert re.search(expected, mine.status_reason)


def test_states_that_are_not_claimed_are_refused_before_the_run() -> None:
    data = load_spec("series-elastic-knee").model_dump(exclude_none=True, by_alias=True)
    data |= {"integrator": {"name": "mine"}, "time": {"steps": 2, "step": 1e-3}}
    with pytest.raises(mbdkit.SpecError, match=r"does not integrate first-order states .* does not claim `states`"):
        simulate(spec_type(offering(RungeKutta()))(**data))
