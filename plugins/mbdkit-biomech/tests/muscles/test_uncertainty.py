"""Uncertain properties of loads, segments and muscles: closed forms for a forearm at rest, and exact samples."""

import numpy as np
import pytest
from tests.muscles.forearm import forearm

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem, compute
from mbdkit_biomech.inverse_dynamics.results import measure_samples
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from mbdkit_biomech.uncertainty.changed_problem import Changer
from mbdkit_biomech.uncertainty.sources import change_of, sources_of
from mbdkit_biomech.uncertainty.uncertain_result import drawn, uncertain_result

WEIGHT, ARM, HEIGHT, LOAD, AT = 1.5 * 9.81, 0.04, 0.3, 20.0, 0.3
TENSION = (WEIGHT * 0.15 + LOAD * AT) / ARM
STATED = {"masses": 0.01, "lengths": 0.02, "plate_gain": 0.03, "pressure": 0.004, "muscle_points": 0.0005}
WITHOUT_EFFECT = {"inertias": 0.2, "angles": 0.001, "max_force": 0.1, "exponent": [2, 3], "minimum": [0.01, 0.05]}


def held(uncertainty: object, **more: object) -> dict:
    """Return a horizontal forearm at rest that one muscle holds, with a load of 20 N at the hand, without noise."""
    spec = forearm(uncertainty=uncertainty, **more)
    spec["motion"]["columns"] = {"elbow.angle": {"column": "a", "deviation": 1e-12}}
    spec["motion"]["smooth"] = {"name": "butterworth", "cutoff": 2}
    data = {"time": [0.0, 1.0], "down": [-LOAD, -LOAD], "x": [AT, AT]}
    spec["loads"] = {"hand": {"body": "forearm", "data": data, "force": [0.0, "down"], "point": ["x", 0.0]}}
    return spec


def test_sources_have_the_shares_of_closed_forms():
    # The elbow carries (F dx / h, weight + load - F) with the tension F, whose line has the length h and the arm r.
    squares = {
        "mass of the forearm": (WEIGHT - WEIGHT * 0.15 / ARM) ** 2 * STATED["masses"] ** 2,
        "lengths of the forearm": ((LOAD * AT / ARM) ** 2 + (TENSION * ARM / HEIGHT) ** 2) * STATED["lengths"] ** 2,
        "gain of hand": (LOAD - LOAD * AT / ARM) ** 2 * STATED["plate_gain"] ** 2,
        "pressure point of hand": (LOAD / ARM) ** 2 * STATED["pressure"] ** 2,
        "points of biceps": ((TENSION / ARM) ** 2 + 2 * (TENSION / HEIGHT) ** 2) * STATED["muscle_points"] ** 2,
    }
    whole = sum(squares.values())
    with mbdkit.inverse(held(STATED | WITHOUT_EFFECT)) as run:
        found = run.contributions("elbow", at=0.5)
        for name, square in squares.items():
            assert found.shares[name] == pytest.approx(square / whole, rel=0.01), name
        for name in ("inertia of the forearm", "zero of elbow.angle", "strength of biceps", "exponent of recruitment"):
            assert found.shares[name] == pytest.approx(0.0, abs=1e-3), name
        assert sum(found.shares.values()) == pytest.approx(1.0, abs=1e-12)
        assert found.shares["interactions"] == pytest.approx(0.0, abs=0.01)
        assert found.error == pytest.approx(1.96 * np.sqrt(whole), rel=0.1)  # 500 samples scatter by 4 %
        parts = run.accuracy.parts
        people, muscles = parts["reaction_error_person"], parts["reaction_error_muscles"]
        np.testing.assert_allclose(
            muscles**2 / (people**2 + muscles**2), squares["points of biceps"] / whole, rtol=0.02
        )
        assert "gain of hand" in str(found)
        assert "sources of error" in run.summary()


@pytest.mark.slow
def test_bars_cover_exact_samples_where_recruitment_has_corners():
    # The smallest activation exceeds the optimal one in half of the samples; the bars come from other samples, in which
    # all but recruitment is linear.
    stated = {"max_force": 0.3, "masses": 0.2, "muscle_points": 0.003, "exponent": [2, 3], "minimum": [0.2, 0.6]}
    recruitment = {"capacity": "isometric", "reserves": {"elbow": 8.0}, "minimum": 0.2}
    spec = load_inverse_spec(held(stated, recruitment=recruitment))
    result = compute(InverseProblem.of(spec))
    sources, changer = sources_of(result.problem), Changer(result)
    bars = uncertain_result(result, np.random.default_rng(0))
    covered, sizes = [], []
    for values in drawn(sources, 400, np.random.default_rng(1)):
        change = changer.at(change_of(sources, values)).forces().recruited.force[5, 0] - result.recruited.force[5, 0]
        covered.append(abs(change) <= np.sqrt(bars.squares[5][5, 0]))
        sizes.append(abs(change))
    assert 0.93 <= np.mean(covered) <= 0.97
    assert np.sqrt(bars.squares[5][5, 0]) <= 1.1 * np.quantile(sizes, 0.95)


def test_samples_without_solution_are_counted():
    with mbdkit.inverse(held({"max_force": 0.3}, recruitment={"capacity": "isometric"})) as run:
        told = " ".join(run.warnings)
        assert "samples of the uncertain muscles, some frames have no result" in told
        assert ": muscles are too weak in " in told
        assert np.all(np.isfinite(run.accuracy.reaction_error))


@pytest.mark.parametrize(
    ("uncertainty", "key", "message"),
    [
        ({"masses": -0.1}, "uncertainty.masses", "at least 0"),
        ({"mass": 0.1}, "uncertainty.mass", "unknown key"),
        ({"centers": 0.01}, "uncertainty.centers", "needs `subject`"),
        ({"exponent": [3, 2]}, "uncertainty.exponent", "lowest, highest"),
        ({"minimum": [0.0, 1.5]}, "uncertainty.minimum[1]", "less than 1"),
        ({"samples": 3}, "uncertainty.samples", "at least 20"),
    ],
)
def test_wrong_uncertainty_gets_one_sentence_with_its_key(uncertainty, key, message):
    with pytest.raises(SpecError) as error:
        mbdkit.inverse(held(uncertainty))
    assert error.value.key == key
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"recruitment": None, "uncertainty": {"max_force": 0.1}}, "uncertainty.max_force"),
        ({"loads": {}, "uncertainty": {"pressure": 0.01}}, "uncertainty.pressure"),
        ({"loads": {}, "uncertainty": {"plate_gain": 0.01}}, "uncertainty.plate_gain"),
    ],
)
def test_uncertainty_of_what_is_missing_is_refused(change, key):
    spec = held({"masses": 0.1}) | change
    with pytest.raises(SpecError) as error:
        mbdkit.inverse({name: one for name, one in spec.items() if one is not None})
    assert error.value.key == key


def test_uncertainty_without_error_bars_has_no_effect():
    spec = held({"masses": 0.1})
    spec["motion"]["errors"] = "none"
    with mbdkit.inverse(spec) as run:
        assert run.accuracy is None


FORCE = 1.5 * 9.81 * 0.15 / 0.04


def held_by_one(uncertainty: dict, **more: object) -> dict:
    """Return a forearm at rest, held by one muscle, with noise that does not matter."""
    spec = forearm(recruitment={"capacity": "isometric"} | more) | {"uncertainty": uncertainty}
    motion = spec["motion"]
    motion["columns"] = {"elbow.angle": {"column": "a", "deviation": 1e-12}}
    motion["smooth"] = {"name": "butterworth", "cutoff": 2}
    return spec


def test_a_single_muscle_has_its_tension_whatever_its_properties():
    with mbdkit.inverse(held_by_one({"max_force": 0.2})) as run:
        np.testing.assert_allclose(run.muscles["biceps"].force, FORCE, rtol=1e-9)
        assert np.max(run.muscles["biceps"].force_error) < 1e-6 * FORCE
        assert "500 samples of 2 scalars of 2 sources" in run.accuracy.method


def test_the_error_of_a_shared_tension_follows_from_the_deviation_of_the_muscle():
    # expected: F = M / 0.04 (1 - s) with s = 1 / (1 + (0.04 C / 2)^2); to first order, the deviation of C by a share d
    # changes F by 2 s (1 - s) M / 0.04 d; C has a factor of its own and one of all muscles, each with the deviation d.
    # Bounds of 400 samples scatter by 3.5 %.
    deviation, optimal = 0.02, 20.0
    share = 1 / (1 + (0.04 * 600 / optimal) ** 2)
    slope = 2 * share * (1 - share) * FORCE
    uncertainty = {"max_force": deviation, "samples": 400}
    with mbdkit.inverse(held_by_one(uncertainty, reserves={"elbow": optimal})) as run:
        error = run.muscles["biceps"].force_error
        np.testing.assert_allclose(error, 1.96 * slope * np.sqrt(2) * deviation, rtol=0.12)
        np.testing.assert_allclose(run.accuracy.reaction_error[:, 0], error, rtol=0.02)


def test_measures_have_samples_of_muscles_too(monkeypatch):
    monkeypatch.setattr(measure_samples, "SAMPLES", 2)
    spec = held_by_one({"max_force": 0.02, "samples": 40}, reserves={"elbow": 20.0})
    spec["measures"] = {"pull": {"value": "mean(muscles.biceps.force)", "unit": "N"}}
    spec["motion"]["smooth"] = "quintic"
    found = measure_samples.sampled_measures(load_inverse_spec(spec, ()), ["pull"])
    assert found is not None
    assert len(found.uncertain) == measure_samples.UNCERTAIN_SAMPLES
    share = 1 / (1 + (0.04 * 600 / 20.0) ** 2)
    assert np.std(found.uncertain) == pytest.approx(2 * share * (1 - share) * FORCE * np.sqrt(2) * 0.02, rel=0.3)
