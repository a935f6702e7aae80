"""The uncertainty of a person: centres of joints, and error bars that contain them."""

from __future__ import annotations

import numpy as np
import pytest
from tests.persons.walkers import loaded, person_spec

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem, compression, compute, knees_of, reactions_of
from mbdkit_biomech.inverse_dynamics.criteria.model_criteria import compression_doubts
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from mbdkit_biomech.uncertainty.changed_problem import Changer
from mbdkit_biomech.uncertainty.sources import sources_of
from mbdkit_biomech.uncertainty.uncertain_result import uncertain_result
from tests.benchmarks.drawn_persons import JOINTS, Tally, add_person


@pytest.mark.parametrize("axis", ["x", "y"])
def test_an_error_of_a_knee_changes_its_moment_by_the_force_times_the_distance(axis):
    # The segments beneath are in equilibrium with the force R of the thigh on the shank: the moment about a point that
    # is moved by e changes by the cross product of e and R. The lengths are means of both legs, so that half of the
    # change of a length does not fit this leg.
    result = compute(InverseProblem.of(loaded()))
    size, changer = 0.005, Changer(result)
    moved = changer.at({("centers", "knee", axis): size})
    values, others = moved.forces().dynamics.value, result.dynamics.value
    names = [one.name for one in result.problem.actuators]
    change = (values - others)[:, names.index("knee_flexion")]
    with mbdkit.inverse(person_spec()) as run:
        x, y = run.joints["knee"].reaction_force.T
    displacement = changer.displacement("knee", {("centers", "knee", axis): size})
    expected = displacement[:, 0] * y - displacement[:, 1] * x
    inside = slice(5, -5)
    left = change[inside] - expected[inside]
    assert np.sqrt(np.mean(left**2)) < 0.15 * np.sqrt(np.mean(expected[inside] ** 2))


@pytest.mark.slow
def test_bars_of_a_person_contain_data_and_person_by_default():
    with mbdkit.inverse(person_spec(motion={"errors": {"samples": 100}}, uncertainty={"samples": 100})) as run:
        parts = run.accuracy.parts
        of_data, person, muscles = (parts[f"reaction_error_{one}"] for one in ("data", "person", "muscles"))
        np.testing.assert_allclose(of_data**2 + person**2 + muscles**2, run.accuracy.reaction_error**2, rtol=1e-9)
        np.testing.assert_allclose(np.sum(parts["contribution"], axis=0), 1.0, atol=1e-9)
        assert np.all(muscles == 0)
        found = run.contributions("knee")
        assert {"centre of the knee", "mass of the shank", "gain of ground"} <= set(found.shares)
        assert "error bars do not include muscles that the model lacks" in run.summary()
        with pytest.raises(mbdkit.MbdkitError, match="knees"):
            run.contributions("knees")


@pytest.mark.parametrize(
    ("uncertainty", "key"),
    [
        ({"centers": {"knees": 0.01}}, "uncertainty.centers.knees"),
        ({"masses": {"thighs": 0.1}}, "uncertainty.masses.thighs"),
        ({"exponent": [2, 3]}, "uncertainty.exponent"),
    ],
)
def test_wrong_uncertainty_of_a_person_is_refused(uncertainty, key):
    with pytest.raises(SpecError) as error:
        mbdkit.inverse(person_spec(uncertainty=uncertainty))
    assert error.value.key == key


@pytest.mark.parametrize(
    ("stated", "masses"), [(None, [0.1, 0.2, 0.1, 0.3]), (0.05, [0.05] * 4), ({"foot": 0.2}, [0.1, 0.2, 0.1, 0.2])]
)
def test_masses_have_a_deviation_by_segment_and_both_hips_are_wrong_alike(stated, masses):
    spec = loaded(uncertainty={"masses": stated}, motion={"errors": {"samples": 20}})
    moves = [one.moves for one in sources_of(InverseProblem.of(spec))]
    found = {place[1]: size for one in moves for place, size in one.items() if place[0] == "masses"}
    assert found == dict(zip(("trunk", "thigh", "shank", "foot"), masses, strict=True))
    joints = [{place[1] for place in one} for one in moves if next(iter(one))[0] == "centers"]
    assert joints.count({"hip", "hip_left"}) == 2  # along two directions
    assert {"knee"} in joints


def test_without_uncertainty_bars_say_that_the_person_is_missing():
    with mbdkit.inverse(person_spec(motion={"errors": {"samples": 20}}, uncertainty="none")) as run:
        assert not run.accuracy.parts
        assert "uncertainty of the person's joint centres" in run.summary()


@pytest.mark.parametrize(("above", "doubts"), [(0.05, []), (-0.25, ["compression"])])
def test_a_muscle_along_the_leg_that_pulls_the_shank_off_the_knee_is_doubtful(above, doubts):
    # A person stands on one leg. A muscle along its axis has hardly a moment arm, so that its activation is the least
    # one and its tension 0.3 * 1000 N. If its end on the thigh is below that on the shank, it pulls the shank down.
    model = {"name": "leg", "root": "trunk", "body_mass": 75, "height": 1.8}
    path = [{"body": "thigh", "point": [1e-4, above - 0.25]}, {"body": "shank", "point": [1e-4, 0.05]}]
    muscle = {"max_force": 1000, "optimal_length": 0.1, "tendon_length": 0.1, "path": path}
    still = {"time": np.linspace(0, 1, 41), "hip_x": 0, "hip_y": 0.9542, "trunk_tilt": 0}
    still |= dict.fromkeys(("hip_flexion", "knee_flexion", "ankle_dorsiflexion"), 0)
    data = {name: np.full(41, value) if np.isscalar(value) else value for name, value in still.items()}
    result = compute(
        InverseProblem.of(
            load_inverse_spec(
                {
                    "mbdkit": 1,
                    "model": model | {"muscles": {"axial": muscle}},
                    "motion": {"data": data, "errors": "none"},
                    "loads": {"ground": {"body": "foot", "force": [0, 735], "point": [0, 0]}},
                    "actuators": {"hip_flexion": {}, "knee_flexion": {}, "ankle_dorsiflexion": {}},
                    "recruitment": {"exponent": 2, "minimum": 0.3, "capacity": "isometric", "reserves": 1.0},
                }
            )
        )
    )
    found = list(compression_doubts(result))
    assert [one.criterion for one in found] == doubts
    assert all("of knee in single stance by up to 300 N" in one.sentence for one in found)


NOTHING = dict.fromkeys(
    ("centers", "masses", "inertias", "angles", "pressure", "plate_gain", "max_force", "optimal_length"), 0.0
) | dict.fromkeys(("tendon_length", "muscle_points", "muscle_delay", "extensor_arm"), 0.0)
"""Deviations of a person who is known exactly, but for recruitment."""


def test_muscles_that_act_together_only_add_to_the_compression_and_only_in_their_phases() -> None:
    model = {"name": "leg", "legs": 2, "root": "trunk", "symmetric_muscles": True, "muscles": "walking-two-legs"}
    sections = {"model": model, "recruitment": {"exponent": 2, "minimum": 0.01, "reserves": 1.0}}
    sections |= {"frontal": "none"}
    stated = NOTHING | {"exponent": [2, 2], "minimum": [0.01, 0.01], "cocontraction": [0.2, 0.0], "samples": 40}
    motion = {"errors": {"samples": 20}, "centers": {"knee": {"midpoint": ["RKNE", "RKNM"]}}}
    result = compute(InverseProblem.of(loaded(motion=motion, uncertainty=stated, **sections)))
    bars = uncertain_result(result, np.random.default_rng(0)).knees
    own = reactions_of(result)
    time, (joint, shank) = result.motion.time, knees_of(result.problem)[0]
    plain = compression(own[:, joint], result.motion.q, shank)
    contact = next(one for one in result.problem.source.person.plates.contacts if one.body == "foot")
    begin, end = result.problem.source.person.time[[contact.first, contact.end - 1]]
    share = (time - begin) / (end - begin)
    late, early = (share > 0.4) & (share < 0.8), (share > 0.0) & (share < 0.15)
    assert early.sum() > 3
    np.testing.assert_array_equal(bars.center[:, 0], plain)  # recruitment, which co-contraction does not change
    np.testing.assert_allclose(bars.high[late, 0], plain[late], rtol=0.02)  # the offset in time of plates is left
    np.testing.assert_allclose(bars.low[:, 0], plain, rtol=0.02, atol=20.0)  # one half of the persons has none
    # of the four levels of a scalar that is 0 or uniform from 0 to 0.2, the largest one is 0.15 times 2300 N or more
    assert np.all(bars.high[early, 0] - plain[early] > 100.0)


@pytest.mark.slow
def test_bars_of_a_drawn_person_contain_most_forces() -> None:
    # The benchmark `persons` counts this for many: 96 %, with a standard deviation of 14 % between them, of which 2.5
    # are allowed. One person shows that no large source is missing: bars of the noise of the data contain 10 to 30 %.
    tally = Tally()
    add_person(tally, np.random.default_rng(1), samples=40)
    covered = {name: tally.row(name)[0] for name in tally.errors}
    assert np.mean([covered[f"force of the {joint}"] for joint in JOINTS]) > 0.6
    assert covered["forces of muscles"] > 0.6
    error, lower, upper, _ = np.moveaxis(tally.knee[0], -1, 0)
    assert np.mean((-lower <= error) & (error <= upper)) > 0.6
    assert np.median(upper) > 1.1 * np.median(lower)  # co-contraction only adds
    for joint in JOINTS:
        assert np.nanmedian(tally.bars[f"force of the {joint}"]) < 1200  # N; the largest forces are 1,700 to 3,800 N
