"""The examples `walking` and `walking-two-legs`: their tables fit Winter's, and their moments are published ones."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from tests.inverse_dynamics.running import reference, table_of

import mbdkit
from mbdkit import Run
from mbdkit.spec.loading import example_files, read_source
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from tests.benchmarks.walking_both_legs import LEFT, residuals
from tests.benchmarks.walking_data import (
    ANGLES,
    CONTACT,
    FLAT,
    GRAVITY,
    GRID,
    HARMONICS,
    MISPRINTS,
    PERSON,
    PERSON_MASS,
    PHASES,
    SPEED,
    STRIDE,
    fitted,
    series_in,
)
from tests.margins import assert_within

TEXT = example_files("walking")["walking.csv"]
GAIT = series_in(TEXT)


def winter() -> Any:
    """Return Winter's table; skip the test if it is absent."""
    return table_of(reference("winter_normal_gait.csv").read_text("utf-8"))


def test_the_rows_of_the_table_are_the_series_in_its_comments() -> None:
    rows = table_of(TEXT)
    np.testing.assert_allclose(rows["time"], STRIDE * (PHASES - PHASES[0]), atol=1e-6)
    for name, own in GAIT.series.items():
        unit = np.radians(1.0) if name.endswith(("tilt", "flexion", "dorsiflexion")) else 1.0
        atol = (0.006 if name.startswith("force") else 2e-5) + 1e-5 * np.sum(np.abs(own))
        # margin: digits of the table
        np.testing.assert_allclose(unit * rows[name], GAIT.at(name, PHASES), rtol=0, atol=atol)
    in_air = np.mod(PHASES - CONTACT[0], 1.0) > CONTACT[1] - CONTACT[0] - 1e-9
    assert np.all(np.isnan(rows["pressure_x"]) == in_air)


def test_the_series_fit_the_table_of_winter_as_well_as_the_comments_say() -> None:
    source = winter()
    again = fitted(source)
    for name, own in GAIT.series.items():
        np.testing.assert_allclose(own, again.series[name], rtol=1e-4, atol=1e-5 * np.max(np.abs(own)))
    phase = source["gait_percent"] / 100
    error = {name: np.radians(source[f"{name.partition('_')[0]}_deg"]) - GAIT.at(name, phase) for name in HARMONICS}
    rms = {name: np.degrees(np.sqrt(np.mean(one**2))) for name, one in error.items()}
    # margin: digits of the comments
    assert rms == pytest.approx({"hip_flexion": 0.07, "knee_flexion": 0.25, "ankle_dorsiflexion": 0.11}, abs=0.006)
    for axis in "xy":
        column = source[f"grf_{axis}_N_per_kg"]
        left = column - GAIT.at(f"force_{axis}", phase) / PERSON_MASS
        assert np.sqrt(np.mean(left[:-1] ** 2)) < 0.012 * np.ptp(column)


def test_the_foot_rests_while_it_is_flat_and_the_body_walks_on() -> None:
    # expected: what Winter's table does not have, the speed of 1.325 m/s and a foot on the ground
    ankle = GAIT.hip(FLAT) + GAIT.below_hip(FLAT)[1]
    assert np.ptp(ankle.real) < 0.01 < 0.02 * SPEED * STRIDE
    foot = np.exp(1j * GAIT.angles(FLAT)[2])
    for end in (PERSON.heel, PERSON.toe):
        assert_within((ankle + end * foot).imag, 0.04)  # margin: how far the source is from this model
    stride = GAIT.hip(np.array([1.2])) - GAIT.hip(np.array([0.2]))
    assert stride[0] == pytest.approx(SPEED * STRIDE, abs=1e-12)


def test_the_moments_are_those_of_winter() -> None:
    source = winter()
    with mbdkit.inverse("walking", motion={**read_source("walking").data["motion"], "errors": "none"}) as run:
        cycles = mbdkit.workload(run, cycles=[0.3 * STRIDE, 1.3 * STRIDE]).cycles
    # published: extension and plantarflexion
    right = ~np.isin(source["gait_percent"], MISPRINTS)
    stance, swing = right & (source["gait_percent"] <= 62), right & (source["gait_percent"] > 62)
    # expected: in swing, plain inverse dynamics of the table differs from the published moments by 0.014 (ankle), 0.06
    # (knee) and 0.18 N m/kg (hip); the ankle in stance agrees because its moment gave the centre of pressure
    bounds = {"hip": (0.2, 0.25, 0.94), "knee": (0.09, 0.1, 0.94), "ankle": (0.02, 0.03, 0.999)}
    names = {"hip": "hip_flexion", "knee": "knee_flexion", "ankle": "ankle_dorsiflexion"}
    for joint, (on_ground, in_air, correlation) in bounds.items():
        found = -cycles[names[joint]].mean[::2] / PERSON_MASS
        published = source[f"{joint}_moment"]
        error = found - published
        assert np.sqrt(np.mean(error[stance] ** 2)) < on_ground
        assert np.sqrt(np.mean(error[swing] ** 2)) < in_air
        assert np.corrcoef(found[right], published[right])[0, 1] > correlation


OF_TWO_LEGS = example_files("walking-two-legs")["walking-two-legs.csv"]
HALF = 50
"""Rows of half a stride."""


@pytest.fixture(scope="module")
def walked() -> Iterator[Run]:
    with mbdkit.inverse(load_inverse_spec("walking-two-legs", ["motion.errors=none"])) as run:
        yield run


def test_the_table_has_the_series_of_its_comments_and_the_left_leg_half_a_stride_later() -> None:
    gait, rows = series_in(OF_TWO_LEGS), table_of(OF_TWO_LEGS)
    np.testing.assert_allclose(rows["time"], STRIDE * (PHASES - PHASES[0]), atol=1e-6)
    for name, own in gait.series.items():
        unit = np.radians(1.0) if name in ANGLES else 1.0
        atol = (0.006 if name.startswith("force") else 1e-7) + 1e-5 * np.sum(np.abs(own))
        # margin: digits of the table
        np.testing.assert_allclose(unit * rows[name], gait.at(name, PHASES), rtol=0, atol=atol)
    for name in LEFT:
        later = rows[name][HALF:] - (SPEED * STRIDE / 2 if name == "pressure_x" else 0.0)
        np.testing.assert_allclose(rows[f"{name}_left"][:-HALF], later, rtol=0, atol=1e-5)


def test_the_mean_ground_force_is_the_weight_and_moves_the_whole_body_by_newtons_law() -> None:
    gait, rows = series_in(OF_TWO_LEGS), table_of(OF_TWO_LEGS)
    assert 2 * np.mean(gait.force(GRID)) == pytest.approx(1j * PERSON_MASS * GRAVITY, abs=1e-2)
    stride = slice(30, 130)
    arm = np.asarray(rows["pressure_x"] - rows["hip_x"])[stride]
    for own, largest in zip(residuals(gait, PHASES[stride], arm), (2.0, 10.0, 5.0), strict=True):
        assert np.max(np.abs(own)) < largest  # N and N m; the series end with the harmonic 20 of the stride


def test_residuals_are_small_and_each_leg_has_the_moments_that_it_has_by_itself() -> None:
    data = read_source("walking-two-legs").data
    motion = {**data["motion"], "smooth": "none", "errors": "none"}
    columns = {name: one for name, one in motion["columns"].items() if not name.endswith("_left")}
    model = {"name": "leg", "root": "trunk"}
    one = {"motion": {**motion, "columns": columns}, "loads": {"ground": data["loads"]["ground"]}, "model": model}
    two = {"motion": motion, "model": {**model, "legs": 2}}
    given = {"recruitment": None, "measures": {}, "accept": ["residuals"]}
    runs = [mbdkit.inverse(load_inverse_spec("walking-two-legs", **given, **own)) for own in (two, one)]
    for name, largest in (("hip_x", 2.0), ("hip_y", 10.0), ("trunk_tilt", 5.0)):
        assert np.max(np.abs(runs[0].actuators[name].value)) < largest
    for name in ("hip_flexion", "knee_flexion", "ankle_dorsiflexion"):
        values = [run.actuators[name].value for run in runs]
        np.testing.assert_allclose(values[0], values[1], rtol=0, atol=1e-9)


def test_knees_carry_what_instrumented_knees_measure_in_walking(walked: Run) -> None:
    # I. Kutzner et al. (2010): 2.6 body weights at the peak on average, 1,920 N here; see test_walking_muscles
    names = list(walked.joint_names)
    without = np.max(np.linalg.norm(walked.array("muscles/reaction_force_without"), axis=2), axis=0)
    for side in ("", "_left"):
        assert 2000 < walked.measures[f"knee_force{side}"] < 3400
        assert without[names.index(f"knee{side}")] < 900
    assert_within(walked.array("muscles/certificate"), 1e-12)


def test_a_leg_without_muscles_is_named(walked: Run) -> None:
    assert not any("no muscle acts on" in warning for warning in walked.warnings)
    given = ("model.symmetric_muscles=false", "motion.errors=none", "measures={}")
    with mbdkit.inverse(load_inverse_spec("walking-two-legs", given)) as run:
        said = "no muscle acts on hip_flexion_left, knee_flexion_left and ankle_dorsiflexion_left"
        assert any(said in warning and "symmetric_muscles" in warning for warning in run.warnings)


@pytest.fixture(scope="module")
def walked_with_muscles():
    spec = load_inverse_spec("walking-muscles", ["motion.errors=none"])
    with mbdkit.inverse(spec) as run:
        yield run


def test_the_knee_carries_what_instrumented_knees_measure_in_walking(walked_with_muscles):
    # Instrumented knees carry 2.6 body weights at their peak on average (I. Kutzner et al., Journal of Biomechanics
    # 43:2164-2173, 2010, level walking), 1,920 N here; models with muscles give 3 to 4.5 for adults without prostheses.
    peak = walked_with_muscles.measures["knee_force"]
    assert 2000 < peak < 3400
    without = np.max(np.linalg.norm(walked_with_muscles.array("muscles/reaction_force_without")[:, 1], axis=1))
    assert walked_with_muscles.joint_names[1] == "knee"
    assert without < 900


def test_muscles_alone_produce_the_moments_and_leave_the_residuals_of_the_free_trunk(walked_with_muscles):
    assert_within(walked_with_muscles.array("muscles/certificate"), 1e-12)
    assert all(not name.startswith("reserve.") for name in walked_with_muscles.actuators)
    for coordinate in ("hip_flexion", "knee_flexion", "ankle_dorsiflexion"):
        moment = sum(
            walked_with_muscles.moment_arms(name, coordinate) * one.force
            for name, one in walked_with_muscles.muscles.items()
        )
        np.testing.assert_allclose(moment, walked_with_muscles.actuators[coordinate].value, rtol=0, atol=1e-9)
    with mbdkit.inverse(load_inverse_spec("walking", ["motion.errors=none"])) as bare:
        for name, actuator in bare.actuators.items():
            np.testing.assert_allclose(walked_with_muscles.actuators[name].value, actuator.value, rtol=0, atol=1e-10)
        without = walked_with_muscles.array("muscles/reaction_force_without")
        np.testing.assert_allclose(without, bare.array("joints/reaction_force"), rtol=0, atol=1e-9)


def test_moments_are_arms_times_forces_over_a_knee_that_is_a_closed_loop(walked_with_muscles):
    settings = ["motion.errors=none", "model.name=leg-four-bar", "recruitment.reserves=1.0"]
    spec = load_inverse_spec("walking-muscles", settings, measures={})
    with mbdkit.inverse(spec) as run:
        for coordinate in ("hip_flexion", "knee_flexion", "ankle_dorsiflexion"):
            moment = sum(run.moment_arms(name, coordinate) * one.force for name, one in run.muscles.items())
            whole = moment + run.actuators[f"reserve.{coordinate}"].value
            np.testing.assert_allclose(whole, run.actuators[coordinate].value, rtol=0, atol=1e-9)
        peaks = [np.max(np.linalg.norm(run.joints[name].reaction_force, axis=1)) for name in ("ankle", "hip")]
    for name, peak in zip(("ankle", "hip"), peaks, strict=True):  # another knee changes these little
        assert peak == pytest.approx(walked_with_muscles.measures[f"{name}_force"], rel=0.02)


def test_calf_muscles_are_active_in_late_stance_and_the_quadriceps_after_heel_strike(walked_with_muscles):
    # Winter (1991), figures 5.5 and 5.9: peaks of the electromyogram at 40 to 50 % and 5 to 15 % of the stride
    phase = np.mod(np.asarray(walked_with_muscles.time) / STRIDE + PHASES[0], 1.0)
    for name, low, high in (("soleus", 0.35, 0.60), ("gastrocnemius", 0.30, 0.60), ("vasti", 0.0, 0.2)):
        peak = phase[int(np.argmax(walked_with_muscles.muscles[name].activation))]
        assert low <= peak <= high, name


@pytest.mark.parametrize(
    ("muscle", "arms"),
    [
        ("vasti", [-44.9, -45.8, -44.7, -41.5, -37.3]),
        ("rectus_femoris", [-48.4, -50.4, -49.6, -45.4, -39.8]),
        ("hamstrings", [31.5, 34.0, 34.8, 33.9, 30.6]),
        ("biceps_femoris_short_head", [26.4, 30.5, 32.1, 33.8, 33.1]),
    ],
)
def test_moment_arms_at_the_knee_are_those_of_the_model_that_the_muscles_come_from(walked_with_muscles, muscle, arms):
    # OpenSim 4.6: moment arms of Gait10dof18musc at 10, 20, 30, 45 and 60 degrees of knee flexion [mm], hip at 0. Here,
    # the thigh is 8 % longer, and the hip bends.
    flexion = np.degrees(walked_with_muscles.bodies["thigh"].angle - walked_with_muscles.bodies["shank"].angle)
    own = 1e3 * walked_with_muscles.moment_arms(muscle, "knee_flexion")
    for angle, arm in zip((10, 20, 30, 45, 60), arms, strict=True):
        # margin: how far the source is from this model
        np.testing.assert_allclose(own[np.abs(flexion - angle) < 2], arm, rtol=0.13)
