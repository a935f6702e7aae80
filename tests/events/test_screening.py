"""Steps without events are taken many at once: with the same bits as one by one, and none with a crossing is passed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.events import screening, watch
from mbdkit.events.crossing import crossings
from mbdkit.events.sampling import INSIDE, refined
from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.integrators.loop.steps_ahead import StepsAhead
from mbdkit.runs.preparation import RunSetup
from mbdkit.spec import load_spec
from tests.slow_cases import slow_but

PLACES = (0.0, *INSIDE, 1.0)


def test_no_step_with_a_crossing_counts_as_clear() -> None:
    """Polynomials of degree 1 to 7, with roots in the step, near it, and in pairs that almost touch."""
    rng = np.random.default_rng(0)
    clear = 0
    for _ in range(4000):
        roots = rng.uniform(-1.0, 2.0, rng.integers(1, 5)).tolist()
        middle, half = rng.uniform(-0.2, 1.2), 10.0 ** rng.uniform(-6.0, 0.0)
        roots += [[], [middle - half, middle + half], [middle + 1j * half, middle - 1j * half]][rng.integers(3)]
        power = np.real(np.poly(roots))

        def scalar(x: float, power: np.ndarray = power) -> float:
            return float(np.polyval(power, x))

        values = np.array([[scalar(x) for x in PLACES]])
        if not screening._is_clear(values * np.sign(values[0, 0]), 0.0)[0]:
            continue
        clear += 1
        samples = refined([(x, [x]) for x in PLACES], lambda x: [x], lambda known: scalar(known[0]), (), (), 0.0)
        assert [x for x, _ in samples] == list(PLACES)
        assert crossings(0, samples, scalar, scalar, 1e-13)[0] == []
    assert clear > 400


def test_steps_with_other_signs_than_before_and_steps_on_zero() -> None:
    values = np.array([[1.0] * 5, [0.0] * 5, [2.0] * 5])
    assert screening._is_clear(values, 0.0).tolist() == [True, True, True]
    assert screening._is_clear(-values, 0.0).tolist() == [False, True, False]
    assert not screening._is_clear(np.array([[1.0, 1.0, np.nan, 1.0, 1.0]]), 0.0)[0]
    assert not screening._is_clear(np.array([[1e300, 1.0, 1e300, 1.0, 1e300]]), 0.0)[0]


DOUBLE = {"mbdkit": 1, "model": {"name": "double-pendulum", "angles": [-1.0, -0.4]}}
CHARGE = {
    "name": "mechanism",
    "bodies": {"rotor": {"mass": 1.0, "inertia": 0.5, "position": [0.3, 0.0]}},
    "joints": {
        "pin": {"type": "revolute", "bodies": ["ground", "rotor"], "at": [0, 0]},
    },
    "forces": {"motor": {"type": "torque", "body": "rotor", "value": "states.charge + max(0, 1 - 4*t)"}},
    "states": {"charge": {"rate": "2 - states.charge"}},
}
FIRES = {"when": "states.charge - 1", "direction": "rising", "set": {"charge": 0}}
EVENTS = {
    "bent": "J2.angle - 0.2",
    "fast": "abs(rod1.angular_velocity) - 1",
    "turned": "sin(9*t) - 0.3*cos(rod1.angle)",
    "pulled": "J1.force - 20",
}
MEASURES = {"largest": "max(abs(joints.J1.force))", "mean": "mean(abs(bodies.rod2.y))"}
METHODS: list[dict[str, Any]] = [
    {"integrator": {"name": "rk4"}, "time": {"end": 2.0, "step": 0.005}, "output": {"every": 7}},
    {"integrator": {"name": "dopri5", "adaptive": True, "rtol": 1e-8}, "time": {"end": 2.0}},
    {"integrator": {"name": "dopri5"}, "time": {"end": 1.5, "step": 0.5}, "output": {"interval": 1e-4}},
    {"integrator": {"name": "gauss", "stages": 3}, "time": {"end": 2.0, "step": 0.01}, "output": {"interval": 0.03}},
    {"integrator": {"name": "radau-iia", "adaptive": True, "rtol": 1e-7}, "time": {"end": 2.0}},
    {"stabilization": "projection", "integrator": {"name": "dop853"}, "time": {"end": 2.0, "step": 0.02}},
]


def cases() -> list[dict[str, Any]]:
    """Return specs of runs with events and measures."""
    events = {name: {"when": when} for name, when in EVENTS.items()}
    runs = [DOUBLE | method | {"events": events, "measures": MEASURES} for method in METHODS]
    runs.append(
        DOUBLE | METHODS[1] | {"events": {"end": {"when": "t - 1.234", "action": "stop"}}, "measures": MEASURES}
    )
    undefined = {"event": {"when": "atan(1/(t - 1.1))"}}
    runs.append(DOUBLE | {"integrator": {"name": "rk4"}, "time": {"end": 2.0, "step": 0.1}, "events": undefined})
    charged = {"mbdkit": 1, "model": CHARGE, "events": {"fires": FIRES, "turns": {"when": "rotor.angle - 1"}}}
    return [*runs, *(charged | METHODS[number] | {"output": {"every": 2}} for number in (1, 3))]


@pytest.mark.parametrize("spec", slow_but(cases(), *cases()[::3]), ids=lambda spec: spec["integrator"]["name"])
def test_many_steps_at_once_yield_the_same_bits_as_one_by_one(
    spec: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    several = mbdkit.run(spec)
    monkeypatch.setattr(StepsAhead, "of", lambda *_: None)
    single = mbdkit.run(spec)
    assert several.data_sha256 == single.data_sha256
    assert (several.status, several.status_reason) == (single.status, single.status_reason)
    assert several.stats["steps"] == single.stats["steps"]
    assert several.stats["rejected"] == single.stats["rejected"]


def stepper_of(spec: dict[str, Any]) -> CompiledStepper:
    """Return the stepper of a run, started to take steps one by one."""
    loaded = load_spec(spec)
    setup = RunSetup.of(loaded)
    stepper = setup.stepper(setup.timetable(nodes=True, ends=True))
    assert isinstance(stepper, CompiledStepper)
    return stepper


LONG = [method for method in METHODS if method["time"]["end"] == 2.0]
"""Methods that take more than five steps."""


@pytest.mark.parametrize("method", LONG, ids=lambda one: one["integrator"]["name"])
def test_steps_that_are_taken_back_leave_no_trace(method: dict[str, Any]) -> None:
    spec = DOUBLE | method | {"output": {"every": 2}}
    alone, several = stepper_of(spec), stepper_of(spec)
    ahead = StepsAhead(several, INSIDE)
    rows, known = [], []
    for keep in (0, 2):
        states = ahead.take(5)
        assert len(states.time) > 1 + 2 * 4  # more steps than are kept
        rows.append(ahead.keep(keep))
    for _ in range(2):
        known.append(alone.advance())
        assert alone.last_step is not None
        inside = [alone.inside(theta) for theta in INSIDE]
        first = 4 * (len(known) - 1)
        np.testing.assert_allclose(states.q[first + 1 : first + 4], [q for q, _, _ in inside], rtol=1e-12, atol=1e-14)
        np.testing.assert_array_equal(states.q[first + 4], alone.last_step.q1)
    np.testing.assert_array_equal(np.concatenate([x.q for x in rows]), np.concatenate([x.q for x in known]))
    for _ in range(3):  # the following steps are the same as well
        alone.advance()
        several.advance()
        np.testing.assert_array_equal(alone.run_state.q, several.run_state.q)
    first, second = alone.taken_nodes(), several.taken_nodes()
    np.testing.assert_array_equal(first.q, second.q)
    assert alone.counters.accepted == several.counters.accepted


def test_the_number_of_steps_at_once_grows_without_events_and_shrinks_with_them() -> None:
    pace = watch.Lookahead()
    wanted = []
    for clear in (8, 16, 10, 0, 0, 1):
        wanted.append((pace.steps, pace.single))
        pace.single = 0
        pace.took(clear, pace.steps)
    assert wanted == [(8, 0), (16, 0), (32, 0), (10, 1), (1, 2), (1, 4)]
