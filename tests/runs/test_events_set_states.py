"""Events that set first-order states, against closed forms: integrate and fire, and a bouncing ball."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import SpecError
from tests.margins import assert_within
from tests.runs.resuming.killed_runs import killed
from tests.runs.rotor import END, FIRES, INERTIA, exact, rotor, spec_of
from tests.slow_cases import slow

RK4, GAUSS = {"name": "rk4"}, {"name": "gauss", "stages": 2}


def errors(integrator: dict[str, Any], step: float | None, **more: Any) -> tuple[float, float]:
    """Return the largest error of the times of the events, and that of charge and angular velocity at the end."""
    run = mbdkit.run(spec_of(integrator, step, **more)).check()
    times = run.events.of_name("fires").time
    assert len(times) == 7
    at_end = run.states["charge"].value[-1], run["rotor"].angular_velocity[-1]
    return float(np.abs(times - math.log(2) * np.arange(1, 8)).max()), float(np.abs(np.subtract(at_end, exact())).max())


@pytest.mark.parametrize(
    ("integrator", "more", "order"),
    [
        (RK4, {}, 4),
        (RK4, {"stabilization": "projection"}, 4),
        (GAUSS, {}, 4),
        ({"name": "radau-iia", "stages": 2}, {"formulation": "index-2"}, 3),
    ],
)
def test_methods_keep_their_order_across_events_that_set_states(
    integrator: dict[str, Any], more: dict[str, Any], order: int
) -> None:
    coarse, fine = (np.array(errors(integrator, step, **more)) for step in (0.08, 0.04))
    np.testing.assert_allclose(np.log2(coarse / fine), order, atol=0.3)


@pytest.mark.parametrize(
    "integrator",
    [
        {"name": "dop853", "adaptive": True, "rtol": 1e-10, "atol": 1e-10},
        {"name": "radau-iia", "adaptive": True, "rtol": 1e-10, "atol": 1e-10},
        {"name": "scipy-dop853", "rtol": 1e-11, "atol": 1e-11},
    ],
    ids=str,
)
def test_adaptive_methods_reach_their_tolerance(integrator: dict[str, Any]) -> None:
    assert_within(max(errors(integrator, None)), 1e-9)


@pytest.mark.parametrize("integrator", [RK4, GAUSS, {"name": "scipy-dop853"}], ids=str)
def test_a_ball_that_bounces_ever_faster_stops_the_run_at_its_limit(integrator: dict[str, Any]) -> None:
    """The ball is two states; its bounces follow in a geometric series, and steps contain many of them."""
    states = {"height": {"initial": 1.0, "rate": "states.speed"}, "speed": {"rate": "-9.81"}}
    bounce = {"when": "states.height", "direction": "falling", "set": {"speed": "-0.5*states.speed", "height": 0}}
    step = {} if "scipy" in integrator["name"] else {"step": 0.02}
    run = mbdkit.run(
        {"mbdkit": 1, "model": rotor(**states), "integrator": integrator, "time": {"end": 2.0, **step},
         "events": {"bounce": bounce}}
    )  # fmt: skip
    fall = math.sqrt(2 / 9.81)
    wanted = fall + 2 * fall * (1 - 0.5 ** np.arange(30))
    np.testing.assert_allclose(run.events.of_name("bounce").time[:30], wanted, atol=1e-11)
    assert run.status == "failed"
    assert run.status_reason.startswith("zeno: event 'bounce' sets states again")
    assert run.time[-1] == pytest.approx(3 * fall, abs=1e-11)


def test_an_event_whose_expression_does_not_change_fires_once_and_others_see_what_it_sets() -> None:
    states = {"a": {"initial": 1.0, "rate": "0"}, "b": {"initial": 0.5, "rate": "0"}}
    events = {
        "swap": {"when": "t - 0.3", "set": {"a": "states.b", "b": "states.a"}},  # values are those before
        "fell": {"when": "states.a - 0.7"},
        "doubles": {"when": "states.a - 0.6", "direction": "falling", "set": {"b": "2*states.b + t"}},
    }
    spec = {"mbdkit": 1, "model": rotor(**states), "integrator": RK4, "time": {"end": 1.0, "step": 0.1}}
    run = mbdkit.run(spec | {"events": events}).check()
    assert sorted(one.name for one in run.events) == ["doubles", "fell", "swap"]
    assert [one.time for one in run.events] == pytest.approx([0.3] * 3, abs=1e-12)
    assert run.states["a"].value[-1] == 0.5
    assert run.states["b"].value[-1] == pytest.approx(2.3, abs=1e-12)
    assert run["rotor"].angular_velocity[-1] == pytest.approx((0.3 + 0.7 * 0.5) / INERTIA, abs=1e-12)


RAMP = {"y": {"rate": "1", "initial": 0.2}, "n": {"rate": "0"}}
RESET = {"when": "states.y - 1", "direction": "rising", "set": {"y": -0.1}}
ON_RAMP = pytest.mark.parametrize(
    ("integrator", "step"),
    [
        (RK4, 0.2),
        (RK4, 5.0),
        (GAUSS, 0.07),
        ({"name": "dop853", "adaptive": True}, None),
        ({"name": "scipy-lsoda"}, None),
    ],
    ids=str,
)


def on_ramp(integrator: dict[str, Any], step: float | None, **events: Any) -> mbdkit.Run:
    """Run y' = 1 from 0.2 for 5 s; y is set to -0.1 when it reaches 1, at 0.8 s, 1.9 s, 3 s and 4.1 s."""
    return mbdkit.run(spec_of(integrator, step, model=rotor(**RAMP), events={"reset": RESET, **events}))


@ON_RAMP
def test_a_change_of_sign_by_states_that_are_set_is_a_crossing(integrator: dict[str, Any], step: float | None) -> None:
    run = on_ramp(integrator, step, zero={"when": "states.y"}, same={"when": "(states.y - 1)**3"}).check()
    times = np.array([0.8, 0.9, 1.9, 2.0, 3.0, 3.1, 4.1, 4.2])
    np.testing.assert_allclose(run.events.of_name("zero").time, times, atol=1e-9)
    assert run.events.of_name("zero").direction.tolist() == [-1, 1] * 4
    np.testing.assert_allclose(run.events.of_name("same").time, np.repeat(times[::2], 2), atol=1e-9)
    assert run.events.of_name("same").direction.tolist() == [1, -1] * 4
    assert run.time[-1] == END


@ON_RAMP
@pytest.mark.parametrize("when", ["states.y + 0.05", "1 - states.y"])
def test_a_stop_at_the_time_at_which_states_are_set_stops(
    integrator: dict[str, Any], step: float | None, when: str
) -> None:
    run = on_ramp(integrator, step, end={"when": when, "action": "stop"}).check()
    assert run.time[-1] == pytest.approx(0.8, abs=1e-9)
    assert [event.name for event in run.events] == ["reset", "end"]


@ON_RAMP
def test_chains_of_events_that_set_states_end_or_are_refused_by_name(
    integrator: dict[str, Any], step: float | None
) -> None:
    count = {"when": "states.y - 0.5", "direction": "falling", "set": {"n": "states.n + 1"}}
    run = on_ramp(integrator, step, count=count, third={"when": "states.n - 2.5"}).check()
    assert run.states["n"].value[-1] == 4.0
    assert run.events.of_name("third").time == pytest.approx([3.0], abs=1e-9)
    same = {"when": "states.y - 1", "direction": "falling", "set": {"n": "states.n + 1"}}
    assert on_ramp(integrator, step, same=same).check().states["n"].value[-1] == 4.0
    endless = {"when": "states.y - 0.5", "direction": "falling", "set": {"y": 2}}
    run = on_ramp(integrator, step, endless=endless)
    assert run.status_reason.startswith("zeno: event 'reset' sets states again")
    assert run.time[-1] == pytest.approx(0.8, abs=1e-9)


@ON_RAMP
def test_events_that_set_states_at_the_same_time_all_use_the_values_before(
    integrator: dict[str, Any], step: float | None
) -> None:
    both = {"when": "(states.y - 1)**3", "direction": "rising", "set": {"n": "states.n + states.y"}}
    run = on_ramp(integrator, step, both=both).check()
    assert run.states["n"].value[-1] == pytest.approx(4.0, abs=1e-9)


JUMPING = {
    "name": "mechanism",
    "gravity": [0, 0],
    "bodies": {"a": {"mass": 1.0, "inertia": 1.0}},
    "joints": {
        "rail": {"type": "prismatic", "bodies": ["ground", "a"], "points": [[0, 0], [0, 0]], "axis": [1, 0]},
        "motor": {"type": "driver", "bodies": ["ground", "a"], "coordinate": "x",
                  "motion": {"table": [[0, 1, 1.5, 3], [0, 1, 0, 3]], "interpolation": "linear"}},
    },
    "controllers": {"c": {"period": 0.4, "outputs": {"u": "sin(4*t)"}}},
}  # fmt: skip


@pytest.mark.parametrize(
    ("integrator", "step"),
    [
        (RK4, 0.25),
        (RK4, 3.0),
        (GAUSS, 0.1),
        ({"name": "dop853", "adaptive": True}, None),
        ({"name": "scipy-dop853"}, None),
    ],
    ids=str,
)
def test_a_change_of_sign_at_an_impulse_or_a_sample_is_a_crossing(
    integrator: dict[str, Any], step: float | None
) -> None:
    events = {"back": {"when": "a.vx"}, "held": {"when": "controllers.c.u - 0.1"}}
    given = {"time": {"end": 3.0} | ({} if step is None else {"step": step}), "impacts": "allow", "events": events}
    run = mbdkit.run({"mbdkit": 1, "model": JUMPING, "integrator": integrator, **given}).check()
    np.testing.assert_allclose(run.events.of_name("back").time, [1.0, 1.5], atol=1e-12)
    # expected: sin(4 t) at 0, 0.4, 0.8, ... is 0, 1, -0.06, -1, 0.12, 0.99, -0.17, -1
    np.testing.assert_allclose(run.events.of_name("held").time, [0.4, 0.8, 1.6, 2.4], atol=1e-12)
    end = {"end": {"when": "controllers.c.u + 0.1", "direction": "falling", "action": "stop"}}
    stopped = mbdkit.run({"mbdkit": 1, "model": JUMPING, "integrator": integrator, **given, "events": end}).check()
    assert stopped.time[-1] == pytest.approx(1.2, abs=1e-12)


@pytest.mark.parametrize(("integrator", "step"), [(RK4, 0.02), *slow((GAUSS, 0.02))])
def test_error_bars_contain_the_errors(integrator: dict[str, Any], step: float) -> None:
    run = mbdkit.run(spec_of(integrator, step, check=True)).check()
    assert run.accuracy is not None
    assert run.accuracy.known_until == run.time[-1]
    error, bar = abs(run["rotor"].angular_velocity[-1] - exact()[1]), run.accuracy.velocity_error[-1, 0, 2]
    assert error <= bar <= 20 * error


def test_a_killed_run_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    model = rotor(charge={"rate": "40 - 20*states.charge"})  # it fires once in 3.5 steps
    spec = spec_of(RK4, 0.01, model=model, measures={"all": "integral(states.charge)"})
    spec["time"] = {"end": 4.0, "step": 0.01}
    whole = mbdkit.run(spec)
    assert len(whole.events) > 100
    part = tmp_path / "run.h5.part"
    assert killed(spec, part, checkpoints=10, delay=0.0)
    resumed = mbdkit.resume(part).check()
    assert resumed.provenance["resumed"] == 1
    assert resumed.data_sha256 == whole.data_sha256
    assert dict(resumed.measures) == dict(whole.measures)


def test_a_method_is_not_chosen() -> None:
    spec = spec_of(RK4) | {"accuracy": 1e-6}
    del spec["integrator"]
    with pytest.raises(SpecError, match="`accuracy` is not available for runs in which events set states"):
        mbdkit.run(spec)


def test_a_value_that_is_not_finite_stops_the_run() -> None:
    events = {"fires": FIRES["fires"] | {"set": {"charge": "1/(states.charge - states.charge)"}}}
    run = mbdkit.run(spec_of(RK4, 0.01, events=events))
    assert run.status_reason.startswith("not-finite: the value of 'charge' that event 'fires' sets is not finite")


def test_measures_of_states_end_with_the_event_that_stops_the_run() -> None:
    model = rotor(charge={"rate": "2*t"})
    end = {"end": {"when": "t - 0.55", "action": "stop"}}
    measures = {"largest": "max(states.charge)", "sum": "integral(states.charge)"}
    spec = {"mbdkit": 1, "model": model, "integrator": RK4, "time": {"end": 1.0, "step": 0.1}, "events": end}
    values = mbdkit.run(spec | {"measures": measures}).measures
    assert values["largest"] == pytest.approx(0.55**2, abs=1e-13)
    assert values["sum"] == pytest.approx(0.55**3 / 3, abs=1e-13)


def test_new_values_of_states_may_contain_named_parameters(tmp_path: Path) -> None:
    def spec(k: float, text: str = "0.1*k + half*states.charge - k*rotor.angle") -> dict[str, Any]:
        fires = FIRES["fires"] | {"set": {"charge": text}}
        time = {"end": 1.0, "step": 0.04}
        return spec_of(RK4, parameters={"k": k, "half": "k/2"}, events={"fires": fires}, time=time)

    run = mbdkit.run(spec(0.3))
    same = mbdkit.run(spec(0.3, "0.1*0.3 + 0.15*states.charge - 0.3*rotor.angle"))
    np.testing.assert_array_equal(run.states["charge"].value, same.states["charge"].value)
    prepared = mbdkit.prepare(mbdkit.load_spec(spec(0.2)))
    hashes = {k: mbdkit.run(mbdkit.load_spec(spec(0.5), [f"parameters.k={k}"])).data_sha256 for k in (0.3, 0.2, 0.4)}
    assert len({*hashes.values()}) == 3
    assert hashes[0.3] == run.data_sha256
    assert [prepared.run({"k": k}).data_sha256 for k in hashes] == [*hashes.values()]
    assert [mbdkit.run(spec(k)).data_sha256 for k in hashes] == [*hashes.values()]
    run.save(tmp_path / "run.h5")
    with mbdkit.load(tmp_path / "run.h5") as stored:
        assert mbdkit.run(stored.spec).data_sha256 == run.data_sha256


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("2*gian", r"unknown name 'gian' \(did you mean 'gain'\?\)"),
        ("2*q", "unknown name 'q'; known: t, pi, gain and functions"),
        ("gain - states.charg", "no state 'charg'"),
        ("gain*rotor", "'rotor' is a body, not a number"),
        ("gain charge", r"write \* between factors"),
    ],
)
def test_a_wrong_new_value_is_refused_at_its_key(text: str, words: str) -> None:
    spec = spec_of(RK4, 0.04, parameters={"gain": 1.0}, events={"fires": FIRES["fires"] | {"set": {"charge": text}}})
    with pytest.raises(SpecError, match=words) as caught:
        mbdkit.load_spec(spec)
    assert caught.value.key == "events.fires.set.charge"
