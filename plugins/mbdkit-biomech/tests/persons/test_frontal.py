"""Moments of the ground's force about the forward axes of knees, and the compartments that carry them."""

from dataclasses import replace

import numpy as np
import pytest
from tests.persons.walkers import data_of, loaded, person_spec

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from tests.benchmarks.drawn_frontal import FrontalPlane, errors_of_all
from tests.benchmarks.drawn_persons import Wider, drawn_columns, spec_of_columns
from tests.benchmarks.person_markers import HIP, Walker, columns_of, in_laboratory

INWARD, SIDEWAYS = 0.04, 0.05
"""Distance of the points of application inward from the knees [m], and inward force as a share of the vertical one."""
HEADING = 2.0
MIDPOINTS = {"knee": {"midpoint": ["RKNE", "RKNM"]}, "knee_left": {"midpoint": ["LKNE", "LKNM"]}}


def walking():
    """Return a person with exact markers whose feet push inward of the knees, and its data."""
    walker = Walker.of_example(2)
    columns = columns_of(walker, walker.markers(), HEADING)
    for number, ((foot, *_), (force, point)) in enumerate(zip(walker.contacts(), walker.plates(), strict=True), 1):
        side = 1.0 if foot == "foot" else -1.0
        force[:, 2], point[:, 2] = -side * SIDEWAYS * force[:, 1], side * (HIP[2] - INWARD)
        columns[f"plate{number}.force"] = in_laboratory(force, HEADING)
        columns[f"plate{number}.point"] = in_laboratory(point, HEADING)
    return walker, data_of(walker, columns)


def test_moments_about_the_forward_axis_follow_from_plates_and_landmarks():
    walker, data = walking()
    person = loaded(data, motion={"centers": MIDPOINTS, "smooth": {"name": "butterworth", "cutoff": 10}}).person
    for leg in ("", "_left"):
        knee, force = person.knees[f"knee{leg}"], walker.loads[f"foot{leg}"][0][:, 1]
        exact = force * (INWARD + SIDEWAYS * walker.joints[f"knee{leg}"][:, 1])
        inside = force > 200.0
        assert knee.deviation == pytest.approx(0.007)
        np.testing.assert_allclose(knee.moment[inside], exact[inside], rtol=0.0, atol=0.05 * np.max(exact))


@pytest.mark.parametrize(("numbers", "landmark"), [((0, 1), "KNE"), ((2, 3, 4), "KNM")])
def test_moments_by_a_landmark_on_one_side_are_within_their_deviation_for_drawn_persons(numbers, landmark):
    # the moment is a cross product in a stick model of three dimensions, which sways and turns the leg
    errors = []
    for number in numbers:
        random = np.random.default_rng([93, number])
        plane = replace(FrontalPlane.drawn(random), landmarks=(landmark,))
        knee = load_inverse_spec(spec_of_columns(plane.columns(drawn_columns(Wider(random, 1.0))))).person.knees["knee"]
        stands = knee.load > 300.0
        assert knee.deviation == pytest.approx(0.01)
        errors.append(np.mean((knee.moment - plane.moment)[stands] / knee.load[stands]) / knee.deviation)
        assert 15.0 < np.max(plane.moment) < 90.0  # 29 N m for 65 kg in the walk of the page `validation`
    assert np.max(np.abs(errors)) < 2.5
    assert np.sqrt(np.mean(np.square(errors))) < 1.5


def test_the_patella_shows_where_a_knee_is_and_without_a_landmark_there_is_no_bound():
    walker, data = walking()
    for side, leg in (("R", ""), ("L", "_left")):
        data = {name: values for name, values in data.items() if not name.startswith((f"{side}KNE", f"{side}KNM"))}
        front = in_laboratory(walker.joints[f"knee{leg}"] + np.array([0.05, 0.0, 0.0]), HEADING)
        data |= {f"{side}Patella.{axis}": own for axis, own in zip("xyz", front.T, strict=True)}
    person = loaded(data, motion={"smooth": {"name": "butterworth", "cutoff": 10}}).person
    for leg in ("", "_left"):
        knee, force = person.knees[f"knee{leg}"], walker.loads[f"foot{leg}"][0][:, 1]
        exact = force * (INWARD + SIDEWAYS * walker.joints[f"knee{leg}"][:, 1])
        np.testing.assert_allclose(knee.moment[force > 200], exact[force > 200], rtol=0.0, atol=0.1 * np.max(exact))
    person = loaded({name: values for name, values in data.items() if "Patella" not in name}).person
    assert not person.knees
    assert any("use markers on the patella" in str(one) for one in person.findings)


@pytest.mark.slow
def test_bars_with_the_frontal_bound_cover_drawn_persons_with_a_landmark_and_errors_do_not_grow():
    rows = [errors_of_all(np.random.default_rng([93, number]), 100) for number in (0, 1, 2, 3)]
    rms, inside = {}, {}
    for key in rows[0]:
        error, lower, upper, share = np.moveaxis(np.concatenate([one[key] for one in rows]), 1, 0)
        stance, middle = (share >= 0) & (share < 1), (share >= 0.2) & (share < 0.6)
        inside[key] = np.mean((np.abs(error) <= np.where(error > 0, upper, lower))[stance])
        rms[key] = np.sqrt(np.mean(error[middle] ** 2))
    assert rms["a landmark outside, with the bound"] < 1.05 * rms["a landmark outside, no bound"]
    assert inside["a landmark outside, with the bound"] > max(0.85, inside["a landmark outside, no bound"] - 0.05)


def test_forces_beside_the_feet_are_doubtful():
    walker, data = walking()
    assert not any(
        "of the ankle on average" in str(one) for one in loaded(motion={"centers": MIDPOINTS}).person.findings
    )
    findings = [str(one) for one in loaded(data).person.findings if one.criterion == "plates" and one.level]
    for foot, way in (("foot", "left"), ("foot_left", "right")):
        force, ankle = walker.loads[foot][0][:, 1], walker.joints[foot.replace("foot", "ankle")][:, 1]
        lever = 1000 * np.sum(force * (INWARD + SIDEWAYS * ankle)) / np.sum(force)
        (said,) = (one for one in findings if f"force on {foot} acts" in one)
        assert f"to the {way} of the ankle" in said
        assert float(said.split(" acts ")[1].split(" mm")[0]) == pytest.approx(lever, abs=3.0)


def test_compartments_hardly_pull():
    _, data = walking()
    model = {"name": "leg", "legs": 2, "root": "trunk", "symmetric_muscles": True, "muscles": "walking-two-legs"}
    measures = {"medial": "max(knees.knee.medial_force)", "pressed": "max(knees.knee.patellofemoral_force)"}
    given = {"motion": {"centers": MIDPOINTS}, "model": model, "recruitment": {"reserves": 1.0}}
    given |= {"measures": measures, "uncertainty": "none"}
    with (
        mbdkit.inverse(person_spec(data, **given)) as run,
        mbdkit.inverse(person_spec(data, frontal="none", **given)) as alone,
    ):
        knee, force, angle = run.knees["knee"], run.joints["knee"].reaction_force, run["shank"].angle
        along = np.sin(angle) * force[:, 0] - np.cos(angle) * force[:, 1]
        np.testing.assert_allclose(knee.medial_force + knee.lateral_force, along, atol=1e-9)
        without = np.sin(angle) * (other := alone.joints["knee"].reaction_force)[:, 0] - np.cos(angle) * other[:, 1]
        half = 0.5 * (knee.medial_force - knee.lateral_force)
        pulled = 0.5 * without - np.abs(half)  # force of the compartment that opens, without the bound
        least = np.minimum(knee.medial_force, knee.lateral_force)
        assert np.min(pulled) < -150.0
        assert np.min(least) > 0.4 * np.min(pulled)
        np.testing.assert_allclose(least[pulled > 0], pulled[pulled > 0], atol=1e-6)
        assert np.all(np.isnan(alone.knees["knee"].medial_force))
        assert run.measures["medial"] == pytest.approx(np.max(knee.medial_force), rel=1e-3)
        assert run.measures["pressed"] == pytest.approx(np.max(knee.patellofemoral_force), rel=1e-3)


def test_measures_of_compartments_need_no_patella():
    _, data = walking()
    model = {"name": "leg", "legs": 2, "root": "trunk", "symmetric_muscles": True, "muscles": "walking-muscles"}
    sections = {"model": model, "recruitment": {"reserves": 1.0}, "measures": {"a": "max(knees.knee.lateral_force)"}}
    with mbdkit.inverse(person_spec(data, motion={"centers": MIDPOINTS}, uncertainty="none", **sections)) as run:
        assert run.measures["a"] == pytest.approx(np.max(run.knees["knee"].lateral_force), rel=1e-3)
        assert np.all(np.isnan(run.knees["knee"].patellofemoral_force))


def test_compartments_need_a_person():
    motion = {"data": {"time": [0.0, 0.1], "a": [0.0, 0.1]}, "columns": {"J1.angle": "a"}}
    spec = {"mbdkit": 1, "model": {"name": "single-pendulum"}, "motion": motion, "frontal": {"width": 0.05}}
    with pytest.raises(SpecError) as error:
        mbdkit.inverse(spec)
    assert error.value.key == "frontal"


@pytest.mark.parametrize(
    ("frontal", "sections", "message"),
    [
        ({"width": 46}, {}, "should be at most 0.1, not 46"),
        ({"width": 0.05}, {}, "needs the section `recruitment`"),
        ({"width": 0.05}, {"recruitment": {}, "model": {"muscles": "walking-two-legs"}, "loads": {}}, "plates"),
    ],
)
def test_compartments_without_effect_are_refused(frontal, sections, message):
    _, data = walking()
    model = {"name": "leg", "legs": 2, "root": "trunk", **sections.pop("model", {})}
    if "loads" in sections:
        data = {name: values for name, values in data.items() if not name.startswith("plate")}
    with pytest.raises(SpecError, match=message) as error:
        mbdkit.inverse(person_spec(data, frontal=frontal, model=model, **sections))
    assert error.value.key.startswith("frontal")
