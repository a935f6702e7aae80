"""Runs in lanes, prepared runs and starts at once have the bits of single ones, whatever the mechanisms have."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import RunSpec
from mbdkit.base.errors import SpecError
from mbdkit.engine.kernels.angles import FAR
from mbdkit.runs.lane_runs import why_alone
from mbdkit.runs.simulation import simulate
from mbdkit.spec import load_spec
from mbdkit.spec.reading import parse_key, put
from mbdkit_studies.compute.batch import simulate_batch
from tests.engine.drawn_angles import drawn
from tests.laws.thrown_mass import thrown
from tests.margins import assert_within
from tests.runs import leg_with_states
from tests.runs.coincident_ends import passing
from tests.runs.oscillator import TEXTS, oscillator
from tests.runs.rotor_with_inputs import rotor
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


def test_tolerances_of_an_ensemble_are_those_of_the_lengths_of_each_run() -> None:
    # below 1 m, the default of atol is proportional to the characteristic length
    base = {"mbdkit": 1, "integrator": {"name": "dop853", "adaptive": True}, "time": {"end": 0.5}}
    lengths, model = [0.1, 0.2, 0.4], {"name": "double-pendulum", "lengths": [0.1, 0.1]}
    table = mbdkit.ensemble(base | {"model": model}, {"model.lengths.0": lengths}).to_frame()
    for length, digest in zip(lengths, table["data_sha256"], strict=True):
        single = mbdkit.run(base | {"model": model | {"lengths": [length, 0.1]}})
        assert single.data_sha256 == digest


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


def test_constant_inputs_are_run_in_lanes_and_tables_alone() -> None:
    specs = []
    for hold, initial in (("zero", 0.5), ("zero", 0.75), ("linear", 0.5)):
        m = rotor(hold, 9.81)
        m.inputs["torque"] = m.inputs["torque"].model_copy(update={"initial": initial})
        specs.append(load_spec(m, integrator={"name": "rk4"}, time={"end": 0.2, "step": 0.01}))
    assert not any(map(why_alone, specs))
    alone = [mbdkit.run(spec) for spec in specs]
    together = list(simulate_batch(specs))
    assert [run.data_sha256 for run in together] == [run.data_sha256 for run in alone]
    assert together[1].arrays["inputs/set/value"].tolist() == [0.75]
    with_table = load_spec(specs[0], inputs={"torque": {"table": [[-1.0], [2.0]]}})
    assert why_alone(with_table) == "their inputs are set by tables"
    assert next(iter(simulate_batch([with_table]))).data_sha256 == mbdkit.run(with_table).data_sha256


DOUBLE = {
    "mbdkit": 1, "model": {"name": "double-pendulum", "angles": [0.3, -0.2]}, "integrator": {"name": "rk4"},
    "time": {"end": 0.2, "step": 0.01},
}  # fmt: skip
CASES: list[tuple[Any, dict[str, Any], str, float]] = [
    (DOUBLE, {}, "model.angles.0", 1.2),
    (
        DOUBLE, {"measures": {"peak": "max(abs(joints.J1.force))", "mean": "mean(energy.kinetic)"}}, "model.masses.1",
        3.0,
    ),
    (DOUBLE, {"formulation": "index-3", "integrator": {"name": "radau-iia"}}, "model.lengths.0", 2.0),
    (DOUBLE, {"stabilization": "projection", "integrator": {"name": "dop853"}}, "model.lengths.0", 2.0),
    (DOUBLE, {"integrator": {"name": "dop853"}, "check": True}, "model.rates.1", -1.0),
    (DOUBLE, {"integrator": {"name": "gauss"}, "time": {"end": 0.2, "step": 0.02}}, "time.step", 0.01),
    (DOUBLE, {"integrator": {"name": "radau-iia", "adaptive": True}}, "model.lengths.0", 2.0),
    ("knee", {"time": {"end": 0.02, "step": 0.0025}}, "model.springs.support.stiffness", 900.0),
    ("jump", {"time": {"end": 0.02, "step": 0.005}}, "duration", 0.2),  # rigid contacts, events, named parameters
    ("delayed-balance", {"time": {"end": 0.1, "step": 0.002}}, "lean", 0.02),  # a sampled controller
    ("slider-crank", {"time": {"end": 0.1, "step": 0.01}}, "model.bodies.rod.mass", 3.0),  # assembled velocities
    ("limit-stop", {"time": {"end": 0.5}}, "model.bodies.thigh.angle", 0.2),  # a method of SciPy
]  # fmt: skip


def alone(spec: RunSpec, key: str, value: float) -> mbdkit.Run:
    """Run a spec with a value, without preparation."""
    data = json.loads(spec.canonical_json())
    put(data, parse_key(key) if "." in key else ("parameters", key), value)
    return simulate(load_spec(data))


@pytest.mark.parametrize(("source", "sections", "key", "value"), CASES)
def test_prepared_runs_equal_single_ones_to_the_bit(source: Any, sections: Any, key: str, value: float) -> None:
    spec = load_spec(source, **sections)
    prepared = mbdkit.prepare(spec)
    for number in (value, 0.9 * value, value):  # the second run leaves nothing behind
        made, single = prepared.run({key: number}), alone(spec, key, number)
        assert made.data_sha256 == single.data_sha256
        for one in ("run_id", "spec_json", "status_reason", "verdict", "verdict_reasons", "warnings"):
            assert getattr(made, one) == getattr(single, one), one
        np.testing.assert_equal(dict(made.measures), dict(single.measures))
        assert (made.accuracy is None) == (single.accuracy is None)


def test_a_start_with_given_values_closes_all_joints_and_is_that_of_the_spec_of_the_run() -> None:
    prepared = mbdkit.prepare("knee", time={"end": 0.02, "step": 0.0025})
    given = {"acl.angle": 0.5, "shank.angular_velocity": 2.0}
    with prepared.run(initial=given) as run:
        assert (run.bodies["acl"].angle[0], run.bodies["shank"].angular_velocity[0]) == (0.5, pytest.approx(2.0))
        assert_within(run.array("joints/misalignment")[0], 1e-14)
        assert_within(run.array("joints/velocity_misalignment")[0], 1e-13)
        assert mbdkit.run(run.run_spec).data_sha256 == run.data_sha256
    # closed form: rods of 1 m from the ground outwards; the second one keeps its angle only if nothing else is nearer
    with mbdkit.prepare(DOUBLE).run(initial={"rod1.angle": -2.0, "rod2.angle": 0.5, "rod1.angular_velocity": 3}) as run:
        tip = np.array([math.cos(-2.0) + 0.5 * math.cos(0.5), math.sin(-2.0) + 0.5 * math.sin(0.5)])
        assert run.bodies["rod2"].position[0] == pytest.approx(tip, abs=1e-12)
        assert run.bodies["rod1"].velocity[0] == pytest.approx([-1.5 * math.sin(-2.0), 1.5 * math.cos(-2.0)], abs=1e-12)


@pytest.mark.parametrize(
    ("parameters", "initial", "message"),
    [
        ({"mass": 2.0}, {}, "the spec has no parameter 'mass'; numbers of the model have dotted keys"),
        ({"model.mases.0": 2.0}, {}, "did you mean 'masses'"),
        ({"model.masses.0": -1.0}, {}, "should be greater than 0"),
        ({}, {"rod9.angle": 1.0}, "no quantity 'rod9.angle'"),
        ({}, {"rod1.angle": math.nan}, "finite number"),
        ({}, {"rod1.x": 3.0}, "cannot be assembled with these initial values: rod1.x = 3"),
        ({}, {"rod1.vx": 1.0, "rod1.angular_velocity": 0.0}, "no velocities satisfy the joints"),
    ],
)
def test_wrong_numbers_are_refused(parameters: Any, initial: Any, message: str) -> None:
    with pytest.raises(SpecError, match=message):
        mbdkit.prepare(DOUBLE).run(parameters, initial)


def test_prepared_runs_may_allow_impacts() -> None:
    changes = {"integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}, "impacts": "allow"}
    single = mbdkit.run("pendulum", **changes)
    assert mbdkit.prepare("pendulum", **changes).run({}).data_sha256 == single.data_sha256
