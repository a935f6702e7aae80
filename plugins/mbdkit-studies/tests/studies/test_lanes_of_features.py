"""Runs in lanes have the bits and the warnings of single runs, whatever the mechanisms have."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import RunSpec
from mbdkit.engine.kernels.angles import FAR
from mbdkit.spec import load_spec
from mbdkit_studies.compute.batch import simulate_batch
from mbdkit_studies.lanes.lane_runs import why_alone
from tests.engine.drawn_angles import drawn
from tests.laws.thrown_mass import thrown
from tests.runs import leg_with_states
from tests.runs.coincident_ends import passing
from tests.runs.oscillator import TEXTS, oscillator
from tests.runs.slow_pin import pin


def test_lanes_have_the_bits_of_numbers() -> None:
    # near and far angles side by side in one vector as well
    angles = [*np.concatenate([drawn(scale, 8) for scale in (1e-6, 10.0, 1e3, FAR)]).tolist(), 1e7, 0.3, -2e9, 1.0]
    time = {"end": 0.02, "step": 0.01}
    specs = [load_spec("pendulum", (f"model.angle={x!r}",), integrator={"name": "rk4"}, time=time) for x in angles]
    for spec, together in zip(specs, simulate_batch(specs), strict=True):
        assert together.data_sha256 == mbdkit.run(spec).data_sha256


def test_lanes_tell_the_same_as_single_runs() -> None:
    specs = [
        thrown(speed=speed, output={"every": 1}, integrator={"name": "rk4"}) for speed in (2.5, 2.9, 3.0, 3.4, 3.8)
    ]
    alone = [mbdkit.run(spec) for spec in specs]
    together = list(simulate_batch([load_spec(spec) for spec in specs]))
    assert [list(one.warnings) for one in together] == [list(one.warnings) for one in alone]
    assert not why_alone(load_spec(specs[0]))
    assert why_alone(load_spec(thrown(output={"every": 2}))).startswith("the ranges of their force laws are watched")
    assert [one.judgement.level for one in together] == ["unknown", "unknown", "doubtful", "doubtful", "doubtful"]


@pytest.mark.parametrize(
    "specs",
    [
        [pin(transition) | {"integrator": {"name": "rk4"}} for transition in (0.01, 0.02)],
        [passing(free_length) for free_length in (0.1, 0.0)],
    ],
    ids=["slow friction", "ends that meet"],
)
def test_warnings_in_lanes_are_those_of_single_runs(specs: list[dict[str, Any]]) -> None:
    alone = [tuple(mbdkit.run(spec).warnings) for spec in specs]
    assert any(alone)
    assert not why_alone(load_spec(specs[0]))
    assert [run.warnings for run in simulate_batch([load_spec(spec) for spec in specs])] == alone


def test_extrema_are_found_in_lanes_and_integrals_are_not() -> None:
    spec = oscillator({"name": "rk4"}, 0.05, measures=TEXTS)
    alone = mbdkit.run(spec).integrals
    extrema = RunSpec(**spec | {"measures": {name: TEXTS[name] for name in ("peak", "lowest", "kinked", "moment")}})
    assert why_alone(extrema) == ""
    (in_lane,) = simulate_batch([extrema])
    assert in_lane.integrals == {text: alone[text] for text in in_lane.integrals}
    assert len(in_lane.integrals) == 4
    assert "integrals" in why_alone(RunSpec(**spec))


def test_runs_of_a_batch_that_differ_in_states_or_controllers_only_are_not_mixed_up() -> None:
    """Mechanisms that are equal except for these must not share what was compiled."""
    models: list[dict[str, Any]] = []
    for initial, rate in ((0.1, "leg.angle"), (0.5, "leg.angle"), (0.5, "2*leg.angle")):
        model = leg_with_states.leg()
        model["states"]["i"] |= {"initial": initial, "rate": rate}
        models.append(model)
    for gain, period in ((6, 0.02), (9, 0.02), (9, 0.04)):
        model = leg_with_states.rotor(0.0).to_spec()
        model["controllers"]["pid"] |= {"period": period, "outputs": {"u": f"-{gain}*rotor.angle"}}
        models.append(model)
    specs = [load_spec(leg_with_states.spec_of({"name": "rk4"}, model=model)) for model in models]
    alone = [mbdkit.run(spec).data_sha256 for spec in specs]
    assert [run.data_sha256 for run in simulate_batch(specs)] == alone
    assert len(set(alone)) == len(alone)
