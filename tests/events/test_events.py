"""Events of a run: noted or stopping, in order of time, with every kind of method, and kept in the archive."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pytest
import xarray

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.base.errors import UnknownNameError
from mbdkit.runs.simulation import simulate
from mbdkit.spec import load_spec
from mbdkit.spec.run_spec import spec_type
from tests.integrators.step_methods import Remembering, RungeKutta, offering, run_with
from tests.margins import assert_within

DOUBLE = {"name": "double-pendulum", "angles": [-1.0, -0.4]}
GAUSS = {"name": "gauss", "stages": 3}
DOP853 = {"name": "scipy-dop853"}
ADAPTIVE = [{"name": name, "adaptive": True, "rtol": 1e-9} for name in ("dopri5", "dop853", "gauss", "radau-iia")]
METHODS = [GAUSS, {"name": "rk4"}, {"name": "radau-iia"}, DOP853, {"name": "scipy-radau"}, {"name": "scipy-lsoda"}]
METHODS += ADAPTIVE


def run(events: dict[str, Any], integrator: dict[str, Any] = GAUSS, **sections: Any) -> mbdkit.Run:
    """Run the double pendulum for a second, whatever its end; an event may be its expression alone."""
    named = {name: event if isinstance(event, dict) else {"when": event} for name, event in events.items()}
    time = {"end": 1.0, "step": 0.01}
    return mbdkit.run({"mbdkit": 1, "model": DOUBLE, "integrator": integrator, "time": time, **sections}, events=named)


def stop(when: str) -> dict[str, str]:
    """Return an event that ends the run."""
    return {"when": when, "action": "stop"}


every_method = pytest.mark.parametrize(
    "integrator", METHODS, ids=lambda one: one["name"] + ("-adaptive" if one.get("adaptive") else "")
)


@every_method
def test_a_run_that_an_event_stops_is_complete_and_ends_there(integrator: dict[str, Any]) -> None:
    with run({"enough": stop("t - 0.4321")}, integrator) as stopped:
        assert stopped.check().status == "complete"
        assert stopped.status_reason == "event: 'enough' crossed zero upwards at t = 0.4321 s."
        assert stopped.time[-1] == pytest.approx(0.4321, abs=1e-12)
        assert np.all(np.diff(stopped.time) > 0)
        assert stopped.steps.steps.sum() == stopped.stats["steps"]
        assert stopped.energy.balance == pytest.approx(0.0, abs=1e-5)
        with run({}, integrator) as whole:
            before = whole.time < 0.43
            position = stopped.array("trajectory/position")
            np.testing.assert_array_equal(position[: before.sum()], whole.array("trajectory/position")[before])


@every_method
def test_looking_for_events_changes_nothing_in_what_is_recorded(integrator: dict[str, Any]) -> None:
    with run({"bent": "J2.angle - 0.2", "loaded": "J1.force - 20"}, integrator) as seen, run({}, integrator) as unseen:
        assert len(seen.events) > 1
        np.testing.assert_array_equal(seen.time, unseen.time)
        for name in ("trajectory/position", "trajectory/velocity", "joints/reaction_force", "energy/total"):
            np.testing.assert_array_equal(seen.array(name), unseen.array(name))


SYMMETRIC = {"name": "projection", "symmetric": True}
STABILIZED = [(one, how) for one in (GAUSS, ADAPTIVE[1]) for how in ("baumgarte", "projection")] + [(GAUSS, SYMMETRIC)]


@pytest.mark.parametrize(("integrator", "stabilization"), STABILIZED)
def test_events_of_stabilized_runs_stop_on_the_joints_and_change_nothing_before(
    integrator: dict[str, Any], stabilization: Any
) -> None:
    bent = {"bent": "J2.angle - 0.2", "enough": stop("t - 0.4321")}
    with (
        run(bent, integrator, stabilization=stabilization) as stopped,
        run({}, integrator, stabilization=stabilization) as whole,
    ):
        assert stopped.check().time[-1] == pytest.approx(0.4321, abs=1e-12)
        if stabilization != "baumgarte":
            for level in ("position", "velocity"):
                assert_within(stopped.array(f"constraints/{level}_residual"), 1e-14)
        before = int((whole.time < 0.43).sum())
        last = len(stopped.time) - 1
        assert before > 3
        for name, first in (("trajectory/position", 0), ("steps/iterations", 1), ("steps/size", 1)):
            some, other = (x.array(name) for x in (stopped, whole))
            np.testing.assert_array_equal(some[: min(before, last) - first], other[: min(before, last) - first])


def test_events_come_in_order_of_time_within_a_step_too_and_none_after_a_stop() -> None:
    events = {"d": "t - 0.509", "b": "t - 0.503", "a": "t - 0.501", "c": stop("t - 0.507"), "e": stop("t - 0.508")}
    with run(events) as stopped:
        assert [event.name for event in stopped.events] == ["a", "b", "c"]
        assert stopped.time[-1] == pytest.approx(0.507, abs=1e-12)


def test_directions_are_those_that_are_asked_for() -> None:
    wave = "sin(2*pi*t/0.3)"
    events = {"both": wave, "up": {"when": wave, "direction": "rising"}, "down": {"when": wave, "direction": "falling"}}
    with run(events) as noted:
        assert noted.events.of_name("both").time == pytest.approx([0.15, 0.3, 0.45, 0.6, 0.75, 0.9], abs=1e-12)
        assert noted.events.of_name("up").time == pytest.approx([0.3, 0.6, 0.9], abs=1e-12)
        assert noted.events.of_name("down").direction.tolist() == [-1, -1, -1]
        assert noted.status_reason == ""
        with pytest.raises(UnknownNameError, match="'sideways'"):
            noted.events.of_name("sideways")


@pytest.mark.parametrize("integrator", [GAUSS, DOP853], ids=lambda one: one["name"])
def test_an_event_between_recorded_rows_ends_the_run_at_a_row_of_its_own(integrator: dict[str, Any]) -> None:
    with run({"enough": stop("t - 0.4321")}, integrator, output={"every": 30}) as stopped:
        assert stopped.time[-1] == pytest.approx(0.4321, abs=1e-12)
        assert stopped.steps.steps.sum() == stopped.stats["steps"]


def test_an_event_at_the_end_of_a_step_ends_the_run_there_once() -> None:
    with run({"enough": stop("t - 0.5")}, {"name": "rk4"}) as stopped:
        assert stopped.time[-2:] == pytest.approx([0.49, 0.5], abs=1e-15)
        assert stopped.stats["steps"] == stopped.steps.steps.sum() == 50


def test_zeros_at_the_start_and_at_the_end_are_no_crossings() -> None:
    with run({"start": "t", "end": "t - 1", "rest": "rod1.angular_velocity"}, {"name": "rk4"}) as noted:
        assert len(noted.events) == 0
        assert noted.events.position.shape == (0, 2, 3)


def test_a_run_that_fails_keeps_the_events_found_before() -> None:
    with run({"early": "t - 0.0501", "late": "t - 0.9"}, limits={"max_steps": 20}) as failed:
        assert failed.status == "failed"
        assert failed.status_reason.startswith("max-steps")
        assert [event.name for event in failed.events] == ["early"]


def test_a_run_that_is_interrupted_keeps_the_events_found_before() -> None:
    spec = {"mbdkit": 1, "model": DOUBLE, "integrator": GAUSS, "time": {"end": 1000.0, "step": 0.01}}
    checked = load_spec(spec, events={"wave": {"when": "sin(50*t)"}})
    with simulate(checked, progress=lambda reached, end: os.kill(os.getpid(), signal.SIGINT)) as interrupted:
        assert interrupted.status == "interrupted"
        count = int(interrupted.time[-1] * 50 / np.pi)
        np.testing.assert_allclose(interrupted.events.time, np.arange(1, count + 1) * np.pi / 50, rtol=0, atol=1e-12)


def test_what_is_noted_at_the_very_time_of_a_stop_comes_before_it() -> None:
    with run({"end": stop("t - 0.4321"), "same": "t - 0.4321"}, {"name": "rk4"}) as stopped:
        assert [event.name for event in stopped.events] == ["same", "end"]


def test_a_stop_in_the_last_step_that_is_allowed_is_a_stop() -> None:
    with run({"enough": stop("t - 0.195")}, limits={"max_steps": 20}) as stopped:
        assert stopped.status == "complete"
        assert stopped.time[-1] == pytest.approx(0.195, abs=1e-12)


def test_an_expression_without_a_value_fails_the_run_by_its_name() -> None:
    with run({"root": "sqrt(0.3 - t) - 0.01"}) as failed:
        assert failed.status == "failed"
        assert "not-finite: the expression of event 'root' has no finite value at t = 0.3" in failed.status_reason
        assert failed.time[-1] == pytest.approx(0.31, abs=1e-12)


@pytest.mark.parametrize("method", [RungeKutta(), Remembering()])
def test_a_method_in_python_is_stopped_by_its_own_step(method: Any) -> None:
    with run({"enough": stop("t - 0.4321")}, {"name": "rk4"}) as ours:
        named = {"enough": stop("t - 0.4321"), "bent": {"when": "J2.angle - 0.2"}}
        with run_with(method, DOUBLE, {"end": 1.0, "step": 0.01}, events=named) as stopped:
            assert stopped.check().time[-1] == ours.time[-1]
            assert len(stopped.events) > 1
            np.testing.assert_allclose(
                stopped.array("trajectory/position"), ours.array("trajectory/position"), rtol=0, atol=1e-13
            )
            if method.carries_multipliers:  # they count the steps
                own = stopped.array("constraints/method_multiplier")
                assert own[-2:, 0].tolist() == [43.0, 44.0]


def test_looking_into_projected_steps_of_a_method_in_python_changes_nothing_in_what_is_recorded() -> None:
    time, every_other = {"end": 0.5, "step": 0.01}, {"name": "projection", "every": 2}
    looks: dict[str, Any] = {"bent": {"when": "J2.angle - 0.2"}, "loaded": {"when": "J1.force - 20"}}
    sections: dict[str, Any] = {"stabilization": every_other, "output": {"every": 3}}
    with (
        run_with(RungeKutta(), DOUBLE, time, events=looks, **sections) as seen,
        run_with(RungeKutta(), DOUBLE, time, **sections) as unseen,
    ):
        assert len(seen.check().events) > 1
        for name in ("trajectory/position", "steps/projections", "steps/position_correction", "joints/misalignment"):
            np.testing.assert_array_equal(seen.array(name), unseen.array(name))
        assert seen.misalignment_max == unseen.misalignment_max


@pytest.mark.parametrize(("when", "due"), [(0.4250, False), (0.4350, True)])
def test_a_step_that_is_cut_short_is_projected_where_it_is_due(when: float, due: bool) -> None:
    # expected: the event ends step 43, or step 44, the second of which is projected
    with run_with(
        RungeKutta(),
        DOUBLE,
        {"end": 1.0, "step": 0.01},
        stabilization={"name": "projection", "every": 2},
        events={"enough": stop(f"t - {when}")},
    ) as stopped:
        assert stopped.check().steps.projections[-1] == due
        off = np.abs(stopped.array("constraints/position_residual")[-1]).max()
        assert bool(off < 1e-15) is due


def test_redundant_joints_share_their_force_as_in_the_archive() -> None:
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("A", m.ground, rod, at=(0.0, 0.0))
    m.revolute("B", m.ground, rod, at=(0.0, 0.0))
    settings: dict[str, Any] = {"integrator": GAUSS, "time": {"end": 0.5, "step": 0.01}}
    with mbdkit.run(m, **settings, events={"half": {"when": "B.force - 8"}}) as noted:
        force = np.hypot(*noted.joints["B"].reaction_force.T)
        assert force == pytest.approx(np.hypot(*noted.joints["A"].reaction_force.T), rel=1e-9)
        [event] = noted.events
        assert np.interp(event.time, noted.time, force) == pytest.approx(8.0, abs=1e-2)


def test_archive_of_a_run_with_events_is_right_and_says_when(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    named = {"bent": {"when": "J2.angle - 0.2"}, "never": {"when": "rod1.x - 9"}, "enough": stop("t - 0.4321")}
    spec = {"mbdkit": 1, "model": DOUBLE, "integrator": GAUSS, "time": {"end": 1.0, "step": 0.01}, "events": named}
    mbdkit.run(spec, archive=path).close()
    assert check(path) == []
    with mbdkit.load(path) as loaded:
        assert loaded.status == "complete"
        assert loaded.events[-1].name == "enough"
        assert loaded.events.position[-1] == pytest.approx(loaded.array("trajectory/position")[-1])
        tree = loaded.to_xarray()
        assert tree["events/position"].dims == ("event", "body", "coordinate")
        assert list(tree["events/name"].values) == list(loaded.events.names)
        assert "enough once at 0.4321 s" in loaded.summary()
        assert "never never" in loaded.summary()
        with mbdkit.run(loaded.spec) as again:
            assert again.data_sha256 == loaded.data_sha256


@pytest.mark.parametrize("interval", [0.0, 1.0])
def test_other_programs_read_the_events_whether_they_came_in_one_piece_or_in_many(
    interval: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mbdkit.archive.writer.FLUSH_INTERVAL", interval)
    monkeypatch.setattr("mbdkit.integrators.interface.STRETCH", 0.001)
    path = tmp_path / "run.h5"
    spec = {"mbdkit": 1, "model": DOUBLE, "integrator": GAUSS, "time": {"end": 1.0, "step": 0.01}}
    named = {"a long name, bent": {"when": "J2.angle - 0.2"}, "wave": {"when": "sin(50*t)"}}
    with mbdkit.run(spec, archive=path, events=named) as made:
        assert (made.file["events/time"].chunks is not None) == (interval == 0.0)
        names, times = list(made.events.names), made.events.time
        assert len(times) == 16
    assert check(path) == []
    with xarray.open_datatree(path, engine="h5netcdf") as tree:
        assert list(tree["events/name"].values) == names
        np.testing.assert_array_equal(tree["events/time"], times)
    with netCDF4.Dataset(path) as data:
        assert list(data["events/name"][:]) == names
        assert data["events/position"].dimensions == ("event", "body", "coordinate")


THROWN = {
    "name": "mechanism",
    "gravity": [0, -9.81],
    "bodies": {"a": {"mass": 1.0, "inertia": 1.0, "velocity": [1.0, 5.0]}},
}


def thrown(when: str, integrator: dict[str, Any], end: float = 2.0, **event: str) -> mbdkit.Run:
    """Run a thrown body, whose x is the time and y = 5 t - 9.81 t^2 / 2, in a few long steps."""
    sections = {"model": THROWN, "integrator": integrator, "time": {"end": end}}
    return mbdkit.run({"mbdkit": 1, **sections, "events": {"e": {"when": when, **event}}})


LONG_STEPS = [
    {"name": "dop853", "adaptive": True}, {"name": "gauss", "stages": 3, "adaptive": True}, {"name": "scipy-dop853"},
]  # fmt: skip


@pytest.mark.parametrize("integrator", LONG_STEPS, ids=lambda one: one["name"])
def test_a_dip_below_zero_is_found_in_long_steps(integrator: dict[str, Any]) -> None:
    with thrown("abs(a.x - 0.55) - 0.03", integrator, action="stop") as there:
        assert there.check().time[-1] == pytest.approx(0.52, abs=1e-9)
    with thrown("abs(a.x - 1.61803) - 1e-6", integrator) as there:
        assert there.events.time == pytest.approx([1.618029, 1.618031], abs=1e-9)
    top = 5.0**2 / (2 * 9.81)
    with thrown(f"a.y - {top - 1e-7!r}", integrator) as there:  # above for 2 sqrt(2e-7 / g)
        half = np.sqrt(2e-7 / 9.81)
        assert there.events.time == pytest.approx([5 / 9.81 - half, 5 / 9.81 + half], abs=1e-8)
    with thrown(f"a.y - {top + 1e-9!r}", integrator) as there:
        assert len(there.events.time) == 0


@pytest.mark.parametrize("integrator", LONG_STEPS, ids=lambda one: one["name"])
def test_zeros_beside_a_factor_of_another_size_and_between_close_kinks_are_found(integrator: dict[str, Any]) -> None:
    with thrown("((t - 1.3911)**2 - 1e-5)*(a.y + 3.25)**21/(a.x + 1)", integrator) as there:
        half, fallen = 1e-5**0.5, (5 + np.sqrt(25 + 2 * 9.81 * 3.25)) / 9.81
        assert there.check().events.time == pytest.approx([1.3911 - half, 1.3911 + half, fallen], abs=1e-9)
    top, peak = 5.0**2 / (2 * 9.81), 5 / 9.81
    with thrown(f"abs(a.y - {top - 1e-3!r}) - 5e-4", integrator) as there:
        inner, outer = (np.sqrt(2 * depth / 9.81) for depth in (0.5e-3, 1.5e-3))
        times = [peak - outer, peak - inner, peak + inner, peak + outer]
        assert there.check().events.time == pytest.approx(times, abs=1e-8)


def test_an_expression_whose_period_divides_the_samples_is_not_mistaken_for_zero() -> None:
    with thrown("sin(2*pi*t)", {"name": "dop853", "adaptive": True}, end=64.2) as there:
        assert len(there.events.time) == 128


@pytest.mark.parametrize(
    "integrator", [{"name": "rk4"}, *LONG_STEPS, {"name": "scipy-lsoda"}], ids=lambda one: one["name"]
)
@pytest.mark.parametrize(
    ("when", "times"),
    [("(a.x - 1.07)**3", [1.07]), ("(a.x - 1.07)**21", [1.07]), ("sin(4*a.x)**3", [np.pi / 4, np.pi / 2]),
     ("a.x*(a.x - 1.07)**5/(a.x - 0.4)", [1.07])],
)  # fmt: skip
def test_odd_multiple_zeros_are_found_and_the_run_goes_on(
    integrator: dict[str, Any], when: str, times: list[float]
) -> None:
    time = {"end": 2.0, "step": 0.1} if integrator["name"] == "rk4" else {"end": 2.0}
    spec = {"mbdkit": 1, "model": THROWN, "integrator": integrator, "time": time}
    with mbdkit.run(spec, events={"e": {"when": when}}) as there:
        assert there.check().time[-1] == 2.0
        assert there.events.time == pytest.approx(times, abs=1e-9)


@pytest.mark.parametrize("when", ["1/(t - 0.5)", "1/(t - 0.5)**2 - 1e-3", "abs(t - 0.5)/(t - 0.5)"])
def test_a_pole_at_the_end_of_a_step_does_not_end_the_run(when: str) -> None:
    with run({"pole": when}, {"name": "rk4"}) as there:
        assert there.check().time[-1] == 1.0
        jumps = [0.5] if when.startswith("abs") else []
        assert there.events.time == pytest.approx(jumps, abs=1e-10)


def test_an_exception_of_dense_output_in_the_last_step_is_not_lost() -> None:
    class Bursting(RungeKutta):
        def step(self, equations: Any, t: float, state: Any, h: float) -> Any:
            def dense(theta: float) -> Any:
                raise RuntimeError("burst")

            new = super().step(equations, t, state, h)
            return mbdkit.Step(new, dense=dense) if t > 0.7 else new

    time, output = {"end": 1.0, "step": 0.2}, {"interval": 0.3}
    registry = offering(Bursting(), dense_output=True)
    data = {"mbdkit": 1, "model": DOUBLE, "integrator": {"name": "mine"}, "time": time, "output": output}
    with simulate(spec_type(registry)(**data)) as failed:
        assert failed.status_reason.startswith("plugin-error")
