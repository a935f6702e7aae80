"""The example `walking-muscles`: loads of the joints and activations in the ranges that were measured."""

from __future__ import annotations

import numpy as np
import pytest

import mbdkit
from mbdkit_biomech.inverse_dynamics.spec.inverse_loading import load_inverse_spec
from tests.benchmarks.walking_data import PHASES, STRIDE


@pytest.fixture(scope="module")
def walked():
    spec = load_inverse_spec("walking-muscles", ["motion.errors=none"])
    with mbdkit.inverse(spec) as run:
        yield run


def test_the_knee_carries_what_instrumented_knees_measure_in_walking(walked):
    # Instrumented knees carry 2.6 body weights at their peak on average (I. Kutzner et al., Journal of Biomechanics
    # 43:2164-2173, 2010, level walking), 1,920 N here; models with muscles give 3 to 4.5 for adults without prostheses.
    peak = walked.measures["knee_force"]
    assert 2000 < peak < 3400
    without = np.max(np.linalg.norm(walked.array("muscles/reaction_force_without")[:, 1], axis=1))
    assert walked.joint_names[1] == "knee"
    assert without < 900


def test_muscles_alone_produce_the_moments_and_leave_the_residuals_of_the_free_trunk(walked):
    assert np.max(walked.array("muscles/certificate")) < 1e-12
    assert all(not name.startswith("reserve.") for name in walked.actuators)
    for coordinate in ("hip_flexion", "knee_flexion", "ankle_dorsiflexion"):
        moment = sum(walked.moment_arms(name, coordinate) * one.force for name, one in walked.muscles.items())
        np.testing.assert_allclose(moment, walked.actuators[coordinate].value, rtol=0, atol=1e-9)
    with mbdkit.inverse(load_inverse_spec("walking", ["motion.errors=none"])) as bare:
        for name, actuator in bare.actuators.items():
            np.testing.assert_allclose(walked.actuators[name].value, actuator.value, rtol=0, atol=1e-10)
        without = walked.array("muscles/reaction_force_without")
        np.testing.assert_allclose(without, bare.array("joints/reaction_force"), rtol=0, atol=1e-9)


def test_moments_are_arms_times_forces_over_a_knee_that_is_a_closed_loop(walked):
    settings = ["motion.errors=none", "model.name=leg-four-bar", "recruitment.reserves=1.0"]
    spec = load_inverse_spec("walking-muscles", settings, measures={})
    with mbdkit.inverse(spec) as run:
        for coordinate in ("hip_flexion", "knee_flexion", "ankle_dorsiflexion"):
            moment = sum(run.moment_arms(name, coordinate) * one.force for name, one in run.muscles.items())
            whole = moment + run.actuators[f"reserve.{coordinate}"].value
            np.testing.assert_allclose(whole, run.actuators[coordinate].value, rtol=0, atol=1e-9)
        peaks = [np.max(np.linalg.norm(run.joints[name].reaction_force, axis=1)) for name in ("ankle", "hip")]
    for name, peak in zip(("ankle", "hip"), peaks, strict=True):  # another knee changes these little
        assert peak == pytest.approx(walked.measures[f"{name}_force"], rel=0.02)


def test_calf_muscles_are_active_in_late_stance_and_the_quadriceps_after_heel_strike(walked):
    # Winter (1991), figures 5.5 and 5.9: peaks of the electromyogram at 40 to 50 % and 5 to 15 % of the stride
    phase = np.mod(np.asarray(walked.time) / STRIDE + PHASES[0], 1.0)
    for name, low, high in (("soleus", 0.35, 0.60), ("gastrocnemius", 0.30, 0.60), ("vasti", 0.0, 0.2)):
        peak = phase[int(np.argmax(walked.muscles[name].activation))]
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
def test_moment_arms_at_the_knee_are_those_of_the_model_that_the_muscles_come_from(walked, muscle, arms):
    # OpenSim 4.6: moment arms of Gait10dof18musc at 10, 20, 30, 45 and 60 degrees of knee flexion [mm], hip at 0. Here,
    # the thigh is 8 % longer, and the hip bends.
    flexion = np.degrees(walked.bodies["thigh"].angle - walked.bodies["shank"].angle)
    own = 1e3 * walked.moment_arms(muscle, "knee_flexion")
    for angle, arm in zip((10, 20, 30, 45, 60), arms, strict=True):
        np.testing.assert_allclose(own[np.abs(flexion - angle) < 2], arm, rtol=0.13)
