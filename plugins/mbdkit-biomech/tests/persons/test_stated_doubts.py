"""Timing of muscles, number of samples, largest values, contradictions and contacts without plates: closed forms and
persons who are known.
"""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2
from tests.muscles.forearm import forearm
from tests.persons.walkers import data_of, loaded, person_spec, recorded, trc_text

import mbdkit
from mbdkit import SpecError
from mbdkit.plugin import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem, compute
from mbdkit_biomech.inverse_dynamics.criteria.data_verdict import ranked_doubts
from mbdkit_biomech.inverse_dynamics.criteria.load_point_criterion import unmeasured_frames
from mbdkit_biomech.inverse_dynamics.criteria.model_criteria import misfit_doubts
from mbdkit_biomech.inverse_dynamics.signals.chi_square import quantile_of_many
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from mbdkit_biomech.persons.landmarks import MarkerFile
from mbdkit_biomech.persons.plate_contacts import plate_numbers
from mbdkit_biomech.uncertainty.changed_problem import Changer
from mbdkit_biomech.uncertainty.uncertain_result import UncertainResult
from tests.benchmarks.person_markers import Walker, columns_of
from tests.margins import assert_within

ARM, AT, LOAD, DELAY, GAIN = 0.04, 0.3, 20.0, 0.02, 0.05
TIME = [0.0, 0.25, 0.5, 0.75, 1.0]


def held(uncertainty: object, *loads: list[float]) -> dict[str, Any]:
    """Return a horizontal forearm at rest that one muscle holds, with downward loads at the hand at `TIME`."""
    spec = forearm(uncertainty=uncertainty, recruitment={"capacity": "isometric"})
    spec["motion"]["columns"] = {"elbow.angle": {"column": "a", "deviation": 1e-12}}
    spec["motion"]["smooth"] = {"name": "butterworth", "cutoff": 2}
    spec["loads"] = {
        f"hand{number}": {
            "body": "forearm",
            "data": {"time": TIME, "down": [-one for one in own]},
            "force": [0.0, "down"],
            "point": [AT, 0.0],
            "kind": "other",
        }
        for number, own in enumerate(loads)
    }
    return spec


def test_muscles_that_act_late_or_early_change_forces_by_their_rate() -> None:
    rate = LOAD * AT / ARM  # of the tension [N/s]: the load at the hand grows by 20 N in 1 s
    spec = held({"muscle_delay": DELAY}, [LOAD * (1 + at) for at in TIME])
    result = compute(InverseProblem.of(load_inverse_spec(spec)))
    late = Changer(result).at({("muscle_delay",): DELAY}).forces()
    assert result.recruited is not None
    assert late.recruited is not None
    inside = (result.motion.time > 0.1) & (result.motion.time < 0.9)
    change = (late.recruited.force - result.recruited.force)[inside, 0]
    np.testing.assert_allclose(change, -rate * DELAY, rtol=1e-6)
    np.testing.assert_array_equal(late.recruited.actuators[..., 0], result.recruited.actuators[..., 0])
    with mbdkit.inverse(spec) as run:
        bar = run.muscles["biceps"].force_error[inside]
        np.testing.assert_allclose(bar, 1.96 * rate * DELAY, rtol=0.12)  # 500 samples scatter by 5 %


def test_the_largest_of_two_equal_peaks_is_too_large_by_the_mean_of_the_larger_of_two_errors() -> None:
    # Both peaks have independent errors with the deviation s. The mean of the larger one of two normal numbers is
    # 1 / sqrt(pi); the sum over sources of second order gives 1 / sqrt(3). The frames beside a peak have 0.8 of it.
    peaks = [[0.0, LOAD, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, LOAD, 0.0]]
    with mbdkit.inverse(held({"plate_gain": GAIN}, *peaks)) as run:
        excess = run.accuracy.parts["reaction_peak_bias"][0]
        of_load = 0.8 * LOAD * (AT / ARM - 1.0)
        # margin: the sum over sources is an approximation
        assert excess == pytest.approx(GAIN * of_load / np.sqrt(np.pi), rel=0.03)
        assert "less its expected excess" in run.summary()
    with mbdkit.inverse(held({"plate_gain": GAIN}, [LOAD] * 5)) as run:  # one error for all times
        assert_within(run.accuracy.parts["reaction_peak_bias"][0], 0.1 * GAIN * of_load)


@pytest.mark.parametrize(("samples", "is_named"), [(20, True), (500, False)])
def test_too_few_samples_are_named_with_the_scatter_of_the_bars(samples: int, is_named: bool) -> None:
    stated = {"plate_gain": GAIN, "masses": 0.3, "lengths": 0.02, "muscle_points": 0.001, "samples": samples}
    with mbdkit.inverse(held(stated, [LOAD] * 5)) as run:
        assert any(f"uncertainty.samples: {samples} samples leave" in text for text in run.warnings) == is_named


def test_the_number_of_samples_that_would_do_follows_from_the_scatter() -> None:
    # expected: standard errors fall with the root of the number, 500 (0.12 / 0.1)^2 = 720, in hundreds
    scattered = SimpleNamespace(scatter=np.array([0.04, 0.12]), samples=500, failed=0)
    (told,) = UncertainResult.remarks.fget(scattered)
    assert told.endswith("uncertain by up to 12.0% (standard error); it falls to 10% with about 800")


@pytest.mark.parametrize("freedoms", [2, 5, 11, 40])
def test_quantiles_of_many_degrees_of_freedom_are_those_of_scipy(freedoms: int) -> None:
    # margin: error of the formula for quantiles
    assert quantile_of_many(freedoms) == pytest.approx(chi2.ppf(0.95, freedoms), rel=0.013)


def computed(data: Any = None, **sections: Any) -> Inverse:
    return compute(InverseProblem.of(loaded(data, **sections)))


def test_landmarks_that_contradict_the_motion_are_named() -> None:
    assert not [*misfit_doubts(computed(), None)]
    data = recorded(heading=0.0)
    for name in ("RKNE", "RKNM", "LKNE", "LKNM"):
        data[f"{name}.x"] = data[f"{name}.x"] + 0.05
    (finding,) = misfit_doubts(computed(data), None)
    assert finding.criterion == "misfit"
    assert "centre of knee" in finding.sentence


def test_frames_in_which_a_foot_stands_beside_the_plates_are_found_and_not_judged() -> None:
    loads = {"ground": {"body": "foot", "plates": [2, 4, 6]}, "ground_left": {"body": "foot_left", "plates": [1, 5]}}
    result = computed(loads=loads)
    (found,) = unmeasured_frames(result).values()
    time = result.motion.time
    assert np.all(found[(time > 1.0) & (time < 1.55)])  # the stance on plate 3 lasts from 0.91 to 1.62 s
    assert not np.any(found[(time > 0.6) & (time < 0.85)])
    assert not np.any(found[(time > 1.75) & (time < 2.0)])
    declared = unmeasured_frames(computed(loads=loads, unmeasured=["foot_left"]))["foot_left"]
    assert np.all(declared[(time > 0.6) & (time < 1.9)])
    with mbdkit.inverse(person_spec(loads=loads)) as run:
        assert any(text.startswith("residuals: the force of the ground is not measured") for text in run.warnings)
        (told,) = (text for text in run.warnings if "contradict Newton's second law" in text)
        size = re.search(r"The residual force is up to ([\d.]+) N", told)
        assert size is not None
        assert float(size[1]) < 100  # as with all plates, by heel strikes; 700 N are not measured
    with pytest.raises(SpecError, match=r"unmeasured: should list bodies of the model .* not 'hand'"):
        computed(unmeasured=["hand"])


def test_the_doubt_that_changes_the_largest_force_most_comes_first() -> None:
    result = computed()
    remark = Finding("centers", None, "a remark")
    found = ranked_doubts(
        result, None, [remark, Finding("plane", "doubtful", "unknown"), Finding("residuals", "doubtful", "known.")]
    )
    assert found[0].sentence.startswith("known (about ")
    assert "N of the largest force, of " in found[0].sentence
    assert [one.sentence for one in found[1:]] == ["a remark", "unknown"]


def on_treadmill(walker: Walker, speed: float) -> dict[str, np.ndarray]:
    columns = columns_of(walker, walker.markers())
    for name, values in columns.items():
        if not name.endswith(("force", "torque")):
            columns[name] = values - np.outer(speed * walker.time, [1.0, 0.0, 0.0])
    return data_of(walker, columns)


@pytest.mark.parametrize(("stated", "way"), [(0.0, "backward"), (2.0, "forward")])
def test_a_belt_whose_speed_is_not_stated_is_no_offset_of_the_plates(tmp_path: Path, stated: float, way: str) -> None:
    walker = Walker.of_example(2)
    standing = {name: np.repeat(points[:1], 10, axis=0) for name, points in walker.markers().items()}
    (tmp_path / "standing.trc").write_text(trc_text(walker.time[:10], standing))
    motion = {"static": str(tmp_path / "standing.trc"), "belt": stated}
    person = loaded(on_treadmill(walker, 1.3), motion=motion).person
    assert person is not None
    assert person.plates.offset is None
    doubt = next(one for one in person.findings if one.criterion == "plates" and one.level == "doubtful")
    found = re.search(r"move (\w+) with about \S+ m/s .* state `motion.belt: (\S+)`", doubt.sentence)
    assert found
    assert found[1] == way
    assert float(found[2]) == pytest.approx(1.3, abs=0.05)  # margin: seeded noise


def test_feet_rest_on_the_belt_of_a_treadmill() -> None:
    walker, speed = Walker.of_example(2), 1.3
    data = on_treadmill(walker, speed)
    with pytest.raises(SpecError, match="rests flat on the ground in"):
        _ = loaded(data).person
    person = loaded(data, motion={"belt": speed}).person
    ground = loaded(data_of(walker, columns_of(walker, walker.markers()))).person
    assert person is not None
    assert ground is not None
    for body in ("foot", "foot_left"):
        np.testing.assert_allclose(
            person.columns[f"bodies.{body}.angle"], ground.columns[f"bodies.{body}.angle"], atol=1e-6
        )
    # margin: seeded noise
    assert_within(person.plates.offset.late, 2 * person.plates.offset.deviation)  # none was added


def test_a_joint_whose_centre_the_markers_do_not_determine_is_named_with_the_landmarks_that_lack() -> None:
    data = {name: own[20:32] for name, own in recorded().items() if name[:4] != "RANM"}
    with pytest.raises(SpecError, match="centre of the joint 'ankle': they lack the medial side of it, and the motion"):
        loaded(data)


def test_columns_that_only_begin_like_those_of_plates_are_no_plates() -> None:
    headings = ["plate2.force.x", "plateA.force.x", "plate.force.x", "plate3.point.x"]
    file = MarkerFile(SimpleNamespace(headings=headings), np.zeros(1))  # type: ignore[arg-type]
    assert plate_numbers(file) == [2]
