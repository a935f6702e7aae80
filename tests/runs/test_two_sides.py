"""Instants with two sides: rows, measures, gradients and simulations hold the limit from before, `after` is the other.

Expected values are the closed forms of `tests.benchmarks.two_sides`.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import SpecError
from tests.benchmarks.two_sides import KINDS, METHODS, drawn, faults
from tests.slow_cases import slow

TIGHT = {"adaptive": True, "rtol": 1e-10, "atol": 1e-12}
BODY = {"mass": 1.0, "inertia": 1.0}


def spec_of(model: dict[str, Any], **sections: Any) -> dict[str, Any]:
    """Return the spec of a run of one body without gravity."""
    model = {"name": "mechanism", "gravity": [0, 0], "bodies": {"b": BODY}, **model}
    integrator, time = {"name": "dop853", **TIGHT}, {"end": 1.0}
    return {"mbdkit": 1, "model": model, "integrator": integrator, "time": time, **sections}


@pytest.mark.parametrize(
    ("kind", "method"),
    [
        pytest.param(kind, method, id=f"{build.__name__} {METHODS[method]['name']}")
        for (kind, build), method in itertools.product(enumerate(KINDS), (0, 1, 3, 7))
        if "contact" not in build.__name__
    ],
)
def test_rows_and_values_at_an_instant_hold_the_side_that_the_page_says(kind: int, method: int) -> None:
    assert not [*faults(kind, method, 0)]


@slow
def test_drawn_automata_hold_the_side_that_the_page_says() -> None:
    assert not [*itertools.chain(*drawn(2 * len(KINDS) * len(METHODS)))]


@pytest.mark.parametrize(
    "integrator", [{"name": "rk4"}, {"name": "gauss", "stages": 2}, {"name": "dop853", **TIGHT}], ids=str
)
@pytest.mark.parametrize("c", [0.3, 0.567, 1.9, 1.234])
def test_an_event_does_not_happen_again_when_a_jump_lets_another_one_follow(
    integrator: dict[str, Any], c: float
) -> None:
    """A sets z; that lets B set n. Once, however `t - c` is rounded."""
    states = {"z": {"rate": "0", "initial": 1.0}, "n": {"rate": "0"}}
    events = {
        "A": {"when": f"t - {c}", "direction": "rising", "set": {"z": "-states.z"}},
        "B": {"when": "states.z", "set": {"n": "states.n + 1"}},
    }
    time = {"end": 2.0} | ({} if "adaptive" in integrator else {"step": 0.1 if "stages" in integrator else 0.05})
    run = mbdkit.run(spec_of({"states": states}, events=events, integrator=integrator, time=time))
    assert [run.status, len(run.events.time), run.states["n"].value[-1]] == ["complete", 2, 1.0]


@pytest.mark.parametrize("pause", [0.5, 0.37])
@pytest.mark.parametrize("output", [{}, {"interval": 0.1}], ids=str)
def test_a_stepped_run_that_an_event_stops_at_the_change_of_an_input_repeats_to_the_bit(
    pause: float, output: dict[str, Any]
) -> None:
    model = {"inputs": {"u": {}}, "forces": {"F": {"type": "force", "body": "b", "value": ["inputs.u", 0]}}}
    events = {"A": {"when": "inputs.u - 1", "action": "stop"}}
    simulation = mbdkit.open(spec_of(model, output=output, events=events))
    simulation.advance_to(pause)
    simulation.set_input("u", 2.0)
    while not simulation.ended:
        simulation.advance(0.1)
    run = simulation.finish()
    assert run.time[-1] == pytest.approx(pause, abs=1e-12)
    assert run["b"].acceleration[-1, 0] == 0.0
    assert mbdkit.run(run.spec).data_sha256 == run.data_sha256


def test_the_run_up_to_an_event_ends_before_it_whether_a_program_or_the_spec_ends_it() -> None:
    events = {"A": {"when": "t - 0.5", "set": {"y": "states.y - 0.2"}}}
    spec = spec_of({"states": {"y": {"rate": "1"}}}, events=events, output={"interval": 0.1})
    simulation = mbdkit.open(spec)
    simulation.advance_to(0.5)
    assert simulation.read(["states.y"])[0] == pytest.approx(0.5, abs=1e-11)
    state = simulation.state()
    stepped = simulation.finish()
    assert stepped.states["y"].value[-1] == pytest.approx(0.5, abs=1e-11)
    assert mbdkit.run(stepped.spec).data_sha256 == stepped.data_sha256
    again = mbdkit.open(spec)
    again.restore(state)  # the state that the event sets is part of it
    again.advance_to(0.7)
    assert again.read(["states.y"])[0] == pytest.approx(0.5, abs=1e-11)


def test_values_after_a_jump_have_error_bars() -> None:
    events = {"A": {"when": "states.y - 0.437", "direction": "rising", "set": {"y": "0.1*exp(states.y)"}}}
    measures = {"y": {"value": "after(states.y, events.A.time)", "unit": "1"}}
    run = mbdkit.run(spec_of({"states": {"y": {"rate": "1"}}}, events=events, measures=measures, check=True))
    assert run.measures["y"] == pytest.approx(0.1 * math.exp(0.437), abs=1e-11)
    assert run.measure_errors["y"] < 1e-9
    assert run.verdict == "good"


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        ("after(b.x, 1.0)", "no value after the end of the run"),
        ("after(b.x, final(t))", "no value after the end of the run"),
        ("after(energy.work, 0.5)", "known at recorded times only"),
        ("after(b.x, t)", "the second argument of 'after' is one time"),
        ("after(b.x, 2.0)", "the run goes from 0 s to 1 s"),
    ],
)
def test_values_that_no_run_has_are_refused(expression: str, message: str) -> None:
    with pytest.raises(SpecError, match=message):
        mbdkit.run(spec_of({}, measures={"m": expression}))


def test_there_is_no_value_after_an_event_that_ends_the_run() -> None:
    measures = {"m": "after(b.x, events.S.time)"}
    run = mbdkit.run(spec_of({}, events={"S": {"when": "t - 0.5", "action": "stop"}}, measures=measures))
    assert np.isnan(run.measures["m"])
