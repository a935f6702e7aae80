"""Error bars of tensions and joint forces by samples of properties of the muscles."""

import numpy as np
import pytest
from tests.muscles.forearm import forearm

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.results import measure_samples
from mbdkit_biomech.inverse_dynamics.spec.inverse_loading import load_inverse_spec

FORCE = 1.5 * 9.81 * 0.15 / 0.04


def held(deviations: dict, **more: object) -> dict:
    """Return a forearm at rest, held by one muscle, with noise that does not matter."""
    spec = forearm(recruitment={"capacity": "isometric", "deviations": deviations} | more)
    motion = spec["motion"]
    motion["columns"] = {"elbow.angle": {"column": "a", "deviation": 1e-12}}
    motion["smooth"] = {"name": "butterworth", "cutoff": 2}
    return spec


def test_a_single_muscle_has_its_tension_whatever_its_properties():
    with mbdkit.inverse(held({"max_force": 0.2})) as run:
        np.testing.assert_allclose(run.muscles["biceps"].force, FORCE, rtol=1e-9)
        assert np.max(run.muscles["biceps"].force_error) < 1e-6 * FORCE
        assert "100 samples of 1 scalar of 1 source" in run.accuracy.method


def test_the_error_of_a_shared_tension_follows_from_the_deviation_of_the_muscle():
    # expected: F = M / 0.04 (1 - s) with s = 1 / (1 + (0.04 C / 2)^2); to first order, the deviation of C by a share d
    # changes F by 2 s (1 - s) M / 0.04 d. Bounds of 400 samples scatter by 3.5 %.
    deviation, optimal = 0.02, 20.0
    share = 1 / (1 + (0.04 * 600 / optimal) ** 2)
    slope = 2 * share * (1 - share) * FORCE
    deviations = {"max_force": deviation, "samples": 400}
    with mbdkit.inverse(held(deviations, reserves={"elbow": optimal})) as run:
        error = run.muscles["biceps"].force_error
        np.testing.assert_allclose(error, 1.96 * slope * deviation, rtol=0.12)
        np.testing.assert_allclose(run.accuracy.reaction_error[:, 0], error, rtol=0.02)


def test_measures_have_samples_of_muscles_too(monkeypatch):
    monkeypatch.setattr(measure_samples, "SAMPLES", 2)
    spec = held({"max_force": 0.02, "samples": 40}, reserves={"elbow": 20.0})
    spec["measures"] = {"pull": {"value": "mean(muscles.biceps.force)", "unit": "N"}}
    spec["motion"]["smooth"] = "quintic"
    found = measure_samples.sampled_measures(load_inverse_spec(spec, ()), ["pull"])
    assert found is not None
    assert len(found.uncertain) == measure_samples.UNCERTAIN_SAMPLES
    share = 1 / (1 + (0.04 * 600 / 20.0) ** 2)
    assert np.std(found.uncertain) == pytest.approx(2 * share * (1 - share) * FORCE * 0.02, rel=0.3)


@pytest.mark.parametrize(
    ("deviations", "key", "message"),
    [
        ({}, "recruitment.deviations", "at least one of `max_force`, `optimal_length` and `tendon_length` has to be"),
        ({"max_force": -0.1}, "recruitment.deviations.max_force", "at least 0"),
        ({"max_forces": 0.1}, "recruitment.deviations.max_forces", "unknown key"),
        ({"max_force": 0.1, "samples": 3}, "recruitment.deviations.samples", "at least 20"),
    ],
)
def test_wrong_deviations_get_one_sentence_with_their_key(deviations, key, message):
    with pytest.raises(SpecError) as error:
        mbdkit.inverse(held(deviations))
    assert error.value.key == key
    assert message in str(error.value)
