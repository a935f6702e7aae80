"""Strength of the muscles of persons, beside published figures."""

import numpy as np
import pytest
from tests.persons.walkers import loaded, person_spec

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.models._segments import BodySegments
from mbdkit_biomech.persons.person_sections import Subject
from mbdkit_biomech.persons.scaled_model import moves_knee
from mbdkit_biomech.persons.strength import UNKNOWN_AGE, strength_of

MODEL = BodySegments(75.0, 1.8)
MUSCLES = {"name": "leg", "legs": 2, "root": "trunk", "muscles": "walking-two-legs"}
SIZE = {"mass": 75.0, "height": 1.8}


def test_strength_declines_from_the_fifth_decade_by_12_to_15_percent_a_decade():
    young, old, older = (strength_of(Subject(**SIZE, age=age), MODEL) for age in (25, 65, 75))
    assert young == 1.0
    assert 0.85 <= older / old <= 0.88  # Hurley 1995
    assert older == pytest.approx(0.61, abs=0.05)  # Young 1985: men in their seventies, quadriceps


def test_forces_are_in_proportion_to_volumes_over_lengths():
    # Handsfield 2014: 47 m h + 1285 cm^3; 60 kg and 1.6 m have 0.760 of the volume of 75 kg and 1.8 m
    factor = strength_of(Subject(mass=60.0, height=1.6, age=25), MODEL)
    assert factor == pytest.approx(5797.0 / 7630.0 * 1.8 / 1.6, rel=1e-12)


def test_an_unknown_age_stands_for_adults_of_20_to_80_years():
    ages = 20.0 + 60.0 * (np.arange(6000) + 0.5) / 6000
    logs = np.log([strength_of(Subject(**SIZE, age=float(age)), MODEL) for age in ages])
    np.testing.assert_allclose(UNKNOWN_AGE, (np.mean(logs), np.std(logs)), atol=2e-3)
    assert strength_of(Subject(**SIZE), MODEL) == pytest.approx(np.exp(np.mean(logs)), rel=2e-3)


@pytest.mark.parametrize("symmetric", [True, False])
def test_only_muscles_of_the_replaced_knee_are_weaker(symmetric):
    subject = {**SIZE, "age": 30, "sex": "male"}
    model = MUSCLES | {"symmetric_muscles": symmetric}
    plain = loaded(subject=subject, model=model, recruitment={}).mechanism().muscles
    given = (
        loaded(subject=subject | {"replacement": {"right": "knee"}}, model=model, recruitment={}).mechanism().muscles
    )
    assert list(plain) == list(given)
    weaker = {name for name in plain if given[name].max_force < plain[name].max_force}
    assert weaker == {"hamstrings", "biceps_femoris_short_head", "rectus_femoris", "vasti"}
    for name in weaker:  # Silva 2003: 30.7 and 32.2 % after two years
        assert 0.678 <= given[name].max_force / plain[name].max_force <= 0.693
    assert not any(moves_knee(muscle, "") for name, muscle in plain.items() if name.startswith(("soleus", "gastroc")))


def test_strength_after_a_replacement_is_a_source_of_the_bars():
    subject = {**SIZE, "age": 70, "sex": "female", "replacement": {"right": "knee"}}
    model = MUSCLES | {"symmetric_muscles": True}
    spec = person_spec(subject=subject, model=model, recruitment={"reserves": 1.0}, uncertainty={"samples": 20})
    spec["motion"]["errors"] = {"samples": 20}
    with mbdkit.inverse(spec) as run:
        assert "strength after replacement of knee" in str(run.contributions("knee"))
        assert "70 years, female, right knee replaced" in run.summary()


def test_without_sex_segments_are_the_mean_of_both_tables():
    masses = {
        sex: loaded(subject=SIZE | ({"sex": sex} if sex else {})).person.masses for sex in ("female", "male", None)
    }
    for name in ("thigh", "shank", "foot"):
        assert masses[None][name] == pytest.approx((masses["female"][name] + masses["male"][name]) / 2, rel=1e-9)


@pytest.mark.parametrize(
    ("given", "key"), [({"age": 8}, "subject.age"), ({"replacement": {"right": "hip"}}, "subject.replacement.right")]
)
def test_wrong_words_about_a_subject_are_refused(given, key):
    with pytest.raises(SpecError) as error:
        mbdkit.inverse(person_spec(subject=SIZE | given))
    assert error.value.key == key
