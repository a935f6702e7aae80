"""Joint centres, plane, lengths, plates and loads of persons whose joints are known, and faults of their data."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.inverse_dynamics.c3d_files import Convention, c3d_bytes
from tests.inverse_dynamics.force_plates import plate
from tests.persons.walkers import FUNCTIONAL, SUBJECT, data_of, loaded, person_spec, recorded, skeleton_of, trc_text

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.commands import repeated_inverse
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from mbdkit_biomech.persons.calibration import angle_of
from mbdkit_biomech.persons.joint_centers import LANDMARKS, REGRESSION
from mbdkit_biomech.persons.landmarks import Side, landmark
from mbdkit_biomech.persons.person import Person
from mbdkit_biomech.persons.rigid_clusters import Artefact, MarkerCluster, poses_of
from tests.benchmarks.person_markers import CLUSTERS, SHANK, THIGH, Array, Walker, columns_of, in_laboratory, table_text
from tests.margins import assert_within

HEADING = 2.0


def test_errors_of_a_point_of_a_segment_have_the_covariance_of_fitzpatrick() -> None:
    random, skin, point = np.random.default_rng(0), 0.005, np.array([0.0, -0.3, 0.05])
    cluster = MarkerCluster.of("thigh", tuple("abcd"), 0.08 * random.standard_normal((1, 4, 3)))
    poses = poses_of(cluster.template, cluster.template + skin * random.standard_normal((4000, 4, 3)))
    found = np.cov((poses.point(point) - point).T)
    np.testing.assert_allclose(found, skin**2 * cluster.covariance(point), rtol=0, atol=0.08 * np.trace(found))
    artefact = Artefact.of(poses)
    assert artefact.deviation == pytest.approx(skin, rel=0.02)
    assert np.max(artefact.correlation[1:], initial=0.0) < 0.1  # independent in each frame


@pytest.mark.slow
def test_centres_and_lengths_lie_within_their_stated_covariances() -> None:
    walker, random = Walker.of_example(2), np.random.default_rng(3)
    truth = {name: in_laboratory(points, HEADING) for name, points in walker.joints.items()}
    squares: dict[str, list[float]] = {}
    lengths = []
    for number in range(32):  # the shank in step with the ankle would shift the knee too
        markers, kind = walker.markers(random), ("knee", "ankle")[number % 2]
        for joint in (kind, f"{kind}_left"):
            walker.move_in_step(markers, joint, random)
        person = skeleton_of(walker, markers, HEADING, **FUNCTIONAL)
        at = person.segments.reference
        for joint, (a, b) in person.segments.joints.items():
            if not joint.startswith((kind, "hip")):
                continue
            center, poses = person.centers[joint], tuple(person.segments.motion.poses[body] for body in (a, b))
            parts = [
                weight * own.rotation[at] @ (point - np.mean(own.inside(truth[joint]), axis=0))
                for weight, own, point in zip(center.fit.weights, poses, (center.proximal, center.distal), strict=True)
            ]
            error = person.plane.coordinates(parts[0] + parts[1])[:2]
            squares.setdefault(joint.removesuffix("_left"), []).append(
                float(error @ np.linalg.solve(center.covariance[:2, :2], error))
            )
        lengths.append([(person.lengths[name].value - true) / person.lengths[name].deviation
                        for name, true in (("thigh", THIGH), ("shank", SHANK))])  # fmt: skip
    for joint in ("knee", "ankle"):  # chi-square with 2 degrees of freedom: mean 2, 5.99 in 95 % of the cases
        assert 1.2 < np.mean(squares[joint]) < 2.8
        assert np.mean(np.array(squares[joint]) < 5.99) > 0.88
    assert np.mean(squares["hip"]) < 2  # the landmarks of the pelvis are those of the regression
    assert_within(np.mean(lengths, axis=0), 1)
    assert np.all(np.std(lengths, axis=0) < 1.4)


class Single:
    """Numbers of which all but one are 0."""

    def __init__(self, place: int):
        self.place = place

    def standard_normal(self, size: int) -> Array:
        """Return the next numbers."""
        self.place -= size
        return np.eye(size)[self.place + size] if 0 <= self.place + size < size else np.zeros(size)


@pytest.mark.parametrize("joint", ["knee", "ankle"])
def test_skin_that_moves_in_step_with_a_joint_shifts_its_centre_as_stated(joint: str) -> None:
    walker = Walker.of_example(4)
    exact = skeleton_of(walker, walker.markers(), HEADING, **FUNCTIONAL)
    hip, knee, ankle = (walker.joints[name] for name in ("hip", "knee", "ankle"))
    flexion = np.degrees(np.ptp(np.unwrap(angle_of(hip - knee) - angle_of(knee - ankle))))
    assert np.degrees(exact.centers["knee"].turn) == pytest.approx(flexion, abs=1)  # whatever the first frame
    shifts = []
    for place in range(6):  # along two axes and about the third one, of both segments
        markers = walker.markers()
        walker.move_in_step(markers, joint, Single(place))
        person, at = skeleton_of(walker, markers, HEADING, **FUNCTIONAL), exact.segments.reference
        shifts.append((person.points[joint] - exact.points[joint])[at, :2])
    size = np.sqrt(np.sum(np.square(shifts), axis=0))  # those of turns about other axes are small
    np.testing.assert_allclose(size, exact.centers[joint].deviation, rtol=0.15)


@pytest.mark.parametrize(("heading", "up"), [(0.0, "z"), (np.pi, "z"), (2.0, "z"), (0.0, "y")])
def test_the_plane_is_found_for_every_heading(heading: float, up: str) -> None:
    person = loaded(recorded(heading=heading, up=up)).person
    assert person is not None
    forward = in_laboratory(np.array([1.0, 0.0, 0.0]), heading, up)
    assert np.degrees(np.arccos(person.plane.axes[0] @ forward)) < 2
    assert np.linalg.det(person.plane.axes) == pytest.approx(1.0)
    assert person.plane.residual < 0.01
    assert [one.body for one in person.plates.contacts] == ["foot_left", "foot"] * 3
    assert not [one for one in person.findings if one.level]


def test_landmarks_by_name_midpoints_and_regression_find_exact_centres_without_artefacts() -> None:
    walker = Walker.of_example(2)
    spec = loaded(data_of(walker, columns_of(walker, walker.markers(), HEADING)))
    person, midpoint = spec.person, {"midpoint": ["RKNE", "RKNM"]}
    assert person is not None
    assert [one.method for one in person.centers.values()] == ["combined"] * 6
    functional = skeleton_of(walker, walker.markers(), HEADING, **dict.fromkeys(person.centers, "functional")).centers
    for joint, one in person.centers.items():
        alone = REGRESSION if joint.startswith("hip") else LANDMARKS
        both = 1 / np.sqrt(1 / alone**2 + 1 / np.square(functional[joint].deviation))
        np.testing.assert_allclose(one.deviation, both, rtol=0.1)
    other = loaded(
        data_of(walker, columns_of(walker, walker.markers(), HEADING)), motion={"centers": {"knee": midpoint}}
    )
    for one in (person, other.person):  # tolerances are small shares of the stated deviations, 5 mm
        assert one.lengths["thigh"].value == pytest.approx(THIGH, abs=1e-5)
        assert one.lengths["shank"].value == pytest.approx(SHANK, abs=1e-5)
        names = ("hip", "knee", "ankle")
        shift = one.columns["markers.hip.x"][0] - walker.hip[0, 0]  # the plane has another origin than the walkway
        for name in names:
            found = np.column_stack([one.columns[f"markers.{name}.{axis}"] for axis in "xy"])
            np.testing.assert_allclose(found - [shift, 0.0], walker.joints[name][:, :2], rtol=0, atol=1e-4)
    assert other.person.centers["knee"].method == "midpoint"


def test_a_static_trial_gives_upright_angles_and_landmarks_to_several_motions(tmp_path: Path) -> None:
    walker, standing = Walker.of_example(2), Walker.of_example(2)
    upright = {body: np.zeros(len(standing.time)) for body in standing.angles}
    still = np.tile([0.0, THIGH + SHANK + 0.0702], (len(standing.time), 1))
    standing = Walker(standing.time, upright, still, standing.loads)
    random = np.random.default_rng(1)
    facing = {name: in_laboratory(points, 0.4) for name, points in standing.markers().items()}
    (tmp_path / "static.trc").write_text(trc_text(standing.time, facing))
    walked = {name: own for name, own in walker.markers(random).items() if name[1:] not in ("KNE", "KNM", "ANK", "ANM")}
    for name, heading in (("first", 2.0), ("second", -1.0)):
        (tmp_path / f"{name}.csv").write_text(table_text(walker.time, columns_of(walker, walked, heading)))
        motion = {"data": None, "file": str(tmp_path / f"{name}.csv"), "static": str(tmp_path / "static.trc")}
        person = loaded({}, motion=motion).person
        assert person is not None
        assert [one.method for one in person.centers.values()] == ["combined"] * 6
        assert person.lengths["thigh"].value == pytest.approx(THIGH, abs=0.004)
        tilt = np.degrees(person.columns["bodies.trunk.angle"] - walker.angles["trunk"])
        assert_within(np.mean(tilt), 1)
        assert np.degrees(np.std(person.columns["bodies.foot.angle"] - walker.angles["foot"])) < 2


def test_loads_of_a_person_are_those_of_the_known_motion_of_the_same_model(tmp_path: Path) -> None:
    pytest.importorskip("ezc3d", reason="ezc3d is not installed: pip install mbdkit[c3d]")
    walker = Walker.of_example(2)
    markers = {name: 1000 * in_laboratory(own, np.pi) for name, own in walker.markers().items()}
    plates = []
    for force, point in walker.plates():
        at = 1000 * np.nan_to_num(in_laboratory(point, np.pi))
        middle = np.mean(at[force[:, 1] > 0], axis=0)
        at[force[:, 1] <= 0] = middle
        plates.append(plate(2, in_laboratory(force, np.pi), at, 0 * force, middle))
    rate = 1.0 / float(walker.time[1] - walker.time[0])
    (tmp_path / "walk.c3d").write_bytes(c3d_bytes(markers, rate, Convention(), plates))
    loads = {"right": {"body": "foot", "plates": [2, 4, 6]}, "left": {"body": "foot_left", "plates": [1, 3, 5]}}
    motion = {"data": None, "file": str(tmp_path / "walk.c3d"), "plane": {"forward": "-x", "up": "z"}}
    spec = loaded({}, motion=motion, loads=loads)
    found = mbdkit.inverse(spec, archive=tmp_path / "person.h5")
    model = {"name": "leg", "legs": 2, "root": "trunk", "body_mass": 75, "height": 1.8, "table": "de-leva-male"}
    model |= {"thigh_length": THIGH, "shank_length": SHANK}
    columns = {"hip_x": walker.hip[:, 0], "hip_y": walker.hip[:, 1], "trunk_tilt": walker.angles["trunk"]}
    for leg in ("", "_left"):
        chain = [walker.angles[name] for name in ("trunk", f"thigh{leg}", f"shank{leg}", f"foot{leg}")]
        names = (f"hip_flexion{leg}", f"knee_flexion{leg}", f"ankle_dorsiflexion{leg}")
        for name, sign, above, below in zip(names, (1, -1, 1), chain, chain[1:], strict=False):
            columns[name] = sign * (below - above)
    true_loads = {}
    for name, foot in (("right", "foot"), ("left", "foot_left")):
        force, point = walker.filtered(8.0)[foot]
        data = {"time": walker.time, "fx": force[:, 0], "fy": force[:, 1], "px": point[:, 0], "py": point[:, 1]}
        true_loads[name] = {"body": foot, "force": ["fx", "fy"], "point": ["px", "py"], "data": data}
    data = {"time": walker.time, **columns}
    smooth = {"name": "butterworth", "cutoff": 8}
    true = mbdkit.inverse({"mbdkit": 1, "model": model, "motion": {"data": data, "smooth": smooth, "errors": "none"},
                           "loads": true_loads})  # fmt: skip
    for joint in ("hip", "knee", "ankle_left"):
        force = true.joints[joint].reaction_force
        # margin: error of the smoothed markers
        np.testing.assert_allclose(found.joints[joint].reaction_force, force, rtol=0, atol=0.01 * np.max(np.abs(force)))
    for name in ("knee_flexion", "ankle_dorsiflexion"):
        moment = true.actuators[name].value  # the mean angle of the trunk is its zero, so that hips differ
        # margin: error of the smoothed markers
        np.testing.assert_allclose(found.actuators[name].value, moment, rtol=0, atol=0.02 * np.max(np.abs(moment)))
    again = mbdkit.inverse(spec)
    assert again.data_sha256 == found.data_sha256
    assert found.spec["subject"] == person_spec({})["subject"]


def test_masses_lengths_and_muscles_are_those_of_the_person() -> None:
    path = [{"body": "thigh", "point": [0.03, -0.1]}, {"body": "shank", "point": ["0.04 + 0*knee_flexion", 0.1]}]
    muscle = {"max_force": 1000, "optimal_length": 0.1, "tendon_length": 0.3, "path": path}
    model = {"name": "leg", "legs": 2, "root": "trunk", "muscles": {"vasti": muscle}, "symmetric_muscles": True}
    walker = Walker.of_example(2, size=0.9)
    data = data_of(walker, columns_of(walker, walker.markers(), HEADING))
    spec = loaded(data, model=model, subject={"mass": 50, "height": 1.62, "sex": "female"})
    person, own = spec.person, spec.mechanism()
    assert person is not None
    thigh, shank = (person.lengths[name].value for name in ("thigh", "shank"))
    assert (thigh, shank) == pytest.approx((0.9 * THIGH, 0.9 * SHANK), abs=2e-3)  # the regression does not scale
    assert own.bodies["thigh"].mass == pytest.approx(0.1478 * 50) == pytest.approx(person.masses["thigh"])  # de Leva
    assert sum(body.mass or 0.0 for body in own.bodies.values()) == pytest.approx(50)
    scaled, factors = own.muscles["vasti_left"], (thigh / THIGH, shank / SHANK)
    below = -0.1 - 0.433 * THIGH, 0.1 - 0.433 * SHANK  # below hip and knee
    before = np.hypot(0.03 - 0.04, below[0] - (below[1] - THIGH))
    after = np.hypot(0.03 * factors[0] - 0.04 * factors[1], below[0] * factors[0] - (below[1] * factors[1] - thigh))
    assert scaled.optimal_length / 0.1 == pytest.approx(after / before, abs=1e-9)
    assert scaled.tendon_length / 0.3 == pytest.approx(after / before, abs=1e-9)
    point = scaled.path[0].point
    assert point is not None
    assert float(point[1]) - 0.3612 * thigh == pytest.approx(below[0] * factors[0])  # the same place below the hip


def test_the_packaged_example_finds_the_centres_of_the_person_who_made_its_table() -> None:
    walker, person = Walker.of_example(2, slice(24, 230)), load_inverse_spec("person-walking").person
    assert [one.method for one in person.centers.values()] == ["combined", "functional", "combined"] * 2
    for joint in ("knee", "ankle"):
        found = np.column_stack([person.columns[f"markers.{joint}.{axis}"] for axis in "xy"])
        error = found - walker.joints[joint][:, :2]
        assert_within(np.mean(error, axis=0), 2 * max(person.centers[joint].deviation))  # margin: seeded noise
    assert not [one for one in person.findings if one.level]


@pytest.mark.parametrize(
    ("kind", "side", "names"),
    [
        ("asis", "r", ["RASI", "R.ASIS", "Subject:RASIS", "RAsis", "R_IAS", "r asis"]),
        ("psis", "l", ["LPSI", "L.PSIS", "LPsis", "PSIS_Left", "L_IPS"]),
        ("sacrum", None, ["V.Sacral", "SACR", "Sacral", "VSAC"]),
        ("knee.lateral", "r", ["RKNE", "R.Knee.Lat", "R.Knee.Lateral", "RLatKnee", "RLFE", "RLatEpicondyle", "R_FLE"]),
        ("knee.medial", "l", ["LKNM", "L.Knee.Med", "L.Knee.Medial", "LMedKnee", "LMFE", "LMKNE", "L_FME"]),
        ("ankle.lateral", "l", ["LANK", "L.Ankle.Lat", "L_Ankle_Lateral", "LLatMalleolus", "LLMAL", "L_FAL"]),
        ("ankle.medial", "r", ["RANM", "R.Ankle.Med", "RMedMal", "RMMAL", "Right.Medial.Ankle", "R_TAM"]),
    ],
)
def test_names_of_landmarks_in_published_marker_sets(kind: str, side: Side | None, names: list[str]) -> None:
    others = [
        "RTHI", "LTIB", "R.Thigh.Lateral", "RMedial", "RMED", "RShankLateral", "RMidfootMedial", "LToeLateral", "C7",
    ]  # fmt: skip
    for name in names:
        assert landmark([*others, name], kind, side) == name
        assert landmark([name], kind, "r" if side == "l" else "l") is None
    assert landmark(others, kind, side) is None


Data = dict[str, Array]
AXES = "xyz"


def of_markers(data: Data, names: list[str]) -> list[str]:
    """Return the headings of markers."""
    return [f"{name}.{axis}" for name in names for axis in AXES]


def exchanged(data: Data, names: dict[str, str]) -> Data:
    """Return data with markers under other names."""
    return {f"{names.get(one[:-2], one[:-2])}{one[-2:]}" if one != "time" else one: own for one, own in data.items()}


def other_side(names: list[str]) -> dict[str, str]:
    return {name: {"R": "L", "L": "R"}[name[0]] + name[1:] for name in names}


def scaled(data: Data, factor: float, beginning: str = "") -> Data:
    return {
        one: own * (factor if one != "time" and ".force" not in one and one.startswith(beginning) else 1.0)
        for one, own in data.items()
    }


def moved(data: Data, beginning: str, by: tuple[float, float, float]) -> Data:
    shift = {f".{axis}": value for axis, value in zip(AXES, by, strict=True)}
    return {one: own + (shift[one[-2:]] if one.startswith(beginning) else 0.0) for one, own in data.items()}


def late(data: Data, frames: int) -> Data:
    return {one: np.roll(own, frames) if one.startswith("plate") else own for one, own in data.items()}


def without(data: Data, names: list[str]) -> Data:
    return {one: own for one, own in data.items() if one[:-2] not in names}


def at_rest(data: Data) -> Data:
    return {one: own if one == "time" else np.full_like(own, own[0]) for one, own in data.items()}


def sliding(data: Data) -> Data:
    """Return data in which the markers of both thighs slide down and up within the skin by up to 6 cm."""
    slide = 0.06 * np.sin(2 * np.pi * data["time"] / 0.57)
    own = {f"{name}.z" for leg in ("", "_left") for name in CLUSTERS[f"thigh{leg}"]}
    return {one: x + (slide if one in own else 0.0) for one, x in data.items()}


MARKERS = [name for names in CLUSTERS.values() for name in names]
EVERY = [name[0] + one for name in ("R", "L") for one in ("KNE", "KNM", "ANK", "ANM")] + MARKERS
LEGS = [name for name in EVERY if not name.endswith("SI")]
FEET = [*CLUSTERS["foot"], *CLUSTERS["foot_left"]]
REFUSED: dict[str, tuple[Callable[[Data], Data], dict[str, Any], str]] = {
    "a marker that is missing": (lambda d: without(d, ["RTHF"]), {},
        r"motion.clusters.thigh: the data has no marker 'RTHF' \(did you mean 'RTHU'\?\)"),
    "landmarks of the pelvis that are missing": (lambda d: exchanged(d, {"RASI": "P1", "LPSI": "P2"}),
        {"motion": {"clusters": CLUSTERS | {"trunk": ["P1", "LASI", "RPSI", "P2"]},
                    "centers": {"hip": "hip-regression"}}},
        r"motion.centers.hip: needs markers of the right and left anterior superior iliac spines"),
    "a medial marker that is missing": (lambda d: without(d, ["RKNM"]), {"motion": {"centers": {"knee": "static"}}},
        r"motion.centers.knee: needs a marker on the medial and on the lateral side .*R.Knee.Medial"),
    "both sides exchanged": (lambda d: exchanged(d, other_side(LEGS)), {},
        r"motion.clusters.thigh: sides are exchanged: the markers of thigh, shank and foot"),
    "feet exchanged": (lambda d: exchanged(d, other_side(FEET)), {}, r"sides are exchanged: the markers of foot"),
    "millimetres taken for metres": (lambda d: scaled(d, 1000.0), {},
        r"motion.file: the markers of the trunk are .* check the unit of length"),
    "metres taken for millimetres": (lambda d: scaled(d, 0.001), {}, r"lie on a line"),
    "a stated direction that is opposite": (lambda d: recorded(heading=0.0),
        {"motion": {"plane": {"forward": "-x", "up": "z"}}}, r"plane.forward: is opposite to the direction in which"),
    "a stated axis up that is horizontal": (lambda d: d, {"motion": {"plane": {"forward": "x", "up": "y"}}},
        r"motion.plane.up: is y, but the trunk is above the feet along z"),
    "plates in another frame": (lambda d: moved(d, "plate2.point", (1.5, 0.0, 0.0)), {},
        r"loads.ground.*plates: the force of plate 2 .* acts 1.* m from the nearest foot"),
    "plates in millimetres": (lambda d: scaled(d, 1000.0, "plate"), {}, r"m from the nearest foot"),
    "a plate that does not exist": (lambda d: d, {"loads": {"ground": {"body": "foot", "plates": [9]}}},
        r"loads.ground.plates: the data has no plate 9: it has plates 1, 2, 3, 4, 5 and 6"),
    "a plate under the other foot": (lambda d: d, {"loads": {"ground": {"body": "foot", "plates": [1]}}},
        r"'foot' stands on none of the plates 1; 'foot_left' stands on plate 1"),
    "a person who does not move": (at_rest, {},
        r"motion.plane: cannot be found, because the segments do not move"),
    "a plate with a gap": (lambda d: d | {"plate1.force.z": np.where(d["time"] == d["time"][3], np.nan, 1.0)}, {},
        r"row 4: force or torque of plate 1 is missing"),
    "a marker that is too far away": (lambda d: scaled(d, 1e6, "RTHF"), {}, r"'RTHF' .* more than 10000 m"),
    "two markers of a cluster": (lambda d: d, {"motion": {"clusters": CLUSTERS | {"shank": ["RSHU", "RSHL"]}}},
        r"motion.clusters.shank: has 2 markers, but a pose needs three"),
    "a record that is too short": (lambda d: {one: own[:6] for one, own in d.items()}, {}, r"has 6 rows"),
    "a segment without a cluster": (lambda d: d, {"motion": {"clusters": {"trunk": CLUSTERS["trunk"]}}},
        r"motion.clusters.thigh: is missing"),
    "a cluster of no segment": (lambda d: d, {"motion": {"clusters": CLUSTERS | {"shin": ["RSHU"]}}},
        r"motion.clusters.shin: is no segment"),
    "markers that slide with the skin": (sliding, {"motion": {"centers": FUNCTIONAL}},
        r"motion.centers.knee: is functional, but no point of one segment stays at a point of the other"),
    "shank and foot that turn together": (lambda d: {one: own[20:32] for one, own in d.items()},
        {"motion": {"centers": {"ankle": "functional"}}},
        r"motion.centers.ankle: is functional, but the motion does not determine the centre: .* changes by \d+ deg"),
    "a gap that may not be bridged": (lambda d: {one: np.where(np.arange(len(own)) == 40, np.nan, own)
                                                 if one[:-2] in ("RTHU", "RTHF") else own for one, own in d.items()},
        {}, r"row 41: column 'markers.hip.x': the value is missing"),
    "another model": (lambda d: d, {"model": {"name": "leg", "legs": 2}}, r"model.root: should be `trunk`"),
    "no person": (lambda d: d, {"subject": None}, r"motion.clusters: needs `subject`"),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_faults_that_are_refused(fault: str) -> None:
    change, sections, message = REFUSED[fault]
    data = change(recorded(heading=2.0))
    with pytest.raises(SpecError, match=message) as error:
        mbdkit.inverse(person_spec(data, **sections))
    assert "\n" not in error.value.message


FOUND: dict[str, tuple[Callable[[Data], Data], dict[str, Any], str, str]] = {
    "the height of a second person": (lambda d: d, {"subject": SUBJECT | {"height": 1.5}}, "lengths",
        "of the body height of 1.5 m"),
    "plates that are late": (lambda d: late(d, 3), {}, "plates", "the plates are 69 ms late"),
    "a plane that is stated wrongly": (lambda d: recorded(heading=0.35),
        {"motion": {"plane": {"forward": "x", "up": "z"}}}, "plane", "the stated plane is 20 deg off"),
    "a plate that is not named": (lambda d: d, {"loads": {"a": {"body": "foot", "plates": [1, 2]}}}, "plates",
        "foot_left stands on plate 1 .* but no load of it names it"),
    # the centre by the motion is known within 17 to 52 mm, because skin moves in step with joints
    "a leg with markers that are too low": (lambda d: moved(d, "RKN", (0.0, 0.0, -0.1)), {}, "centers",
        "landmarks and motion determine centres of knee that differ"),
    "a leg that is too short": (lambda d: moved(d, "RKN", (0.0, 0.0, -0.06)),
        {"motion": {"centers": {"knee": "static"}}}, "lengths", "long differ by more than"),
    "landmarks of the other knee": (lambda d: d, {"motion": {"centers": {"knee": {"midpoint": ["LKNE", "LKNM"]}}}},
        "centers", "knee is .* mm to the (left|right) of knee_left on average"),
}  # fmt: skip


def person_of(data: Data, **sections: Any) -> Person:
    person = loaded(data, **sections).person
    assert person is not None
    return person


@pytest.mark.parametrize("fault", FOUND)
def test_faults_that_are_doubtful(fault: str) -> None:
    change, sections, criterion, sentence = FOUND[fault]
    findings = person_of(change(recorded(heading=2.0)), **sections).findings
    assert {one.criterion for one in findings if one.level} <= {criterion, "lengths"}  # wrong centres change lengths
    assert re.search(sentence, next(str(one) for one in findings if one.level))


@pytest.mark.parametrize("fault", ["none", "another person", "exchanged markers"])
def test_a_static_trial_of_other_markers_is_doubtful(tmp_path: Path, fault: str) -> None:
    walker, size = Walker.of_example(2), 1.12 if fault == "another person" else 1.0
    standing = {name: size * np.repeat(points[:1], 10, axis=0) for name, points in walker.markers().items()}
    if fault == "exchanged markers":
        standing["RTHU"], standing["LTHU"] = standing["LTHU"], standing["RTHU"]
    (tmp_path / "static.trc").write_text(trc_text(walker.time[:10], standing))
    findings = person_of(recorded(heading=2.0), motion={"static": str(tmp_path / "static.trc")}).findings
    sentences = [one.sentence for one in findings if one.criterion == "centers" and "another shape" in one.sentence]
    assert len(sentences) == (fault != "none")


def test_a_static_trial_of_another_person_is_the_cause_of_a_centre_that_is_not_known(tmp_path: Path) -> None:
    walker, random = Walker.of_example(2), np.random.default_rng(3)
    standing = {
        name: np.repeat(own[:1] + 0.06 * random.standard_normal(3), 10, 0) for name, own in walker.markers().items()
    }
    (tmp_path / "static.trc").write_text(trc_text(walker.time[:10], standing))
    motion = {"static": str(tmp_path / "static.trc"), "centers": FUNCTIONAL}
    with pytest.raises(SpecError, match=r"another shape in `motion.static` .*: is it a trial of this person") as error:
        person_of(recorded(heading=2.0), motion=motion)
    assert error.value.key == "motion.static"
    assert "not at all" not in str(error.value)


def test_what_has_no_effect() -> None:
    walker = Walker.of_example(2)
    columns = columns_of(walker, walker.markers(np.random.default_rng(0)), 2.0)
    expected = person_of(data_of(walker, columns))
    opposite = {name: -own if name.endswith("force") else own for name, own in columns.items()}
    other_way = columns_of(walker, walker.markers(np.random.default_rng(0)), 2.0 + np.pi)
    unseen = {name: np.where((np.arange(len(own)) == 40)[:, None], 0.0, own) if name == "RTHF" else own
              for name, own in columns.items()}  # fmt: skip
    of_subject = {name if name.startswith("plate") else f"Subject:{name}": own for name, own in columns.items()}
    for changed in (opposite, other_way, unseen, of_subject):
        person = person_of(data_of(walker, changed), motion={"gaps": {"longest": 0.1}})
        for name, load in expected.plates.loads.items():
            np.testing.assert_allclose(person.plates.loads[name].force, load.force, rtol=0, atol=2.0)
        for name, length in expected.lengths.items():
            assert person.lengths[name].value == pytest.approx(length.value, abs=2e-3)
        for name, values in expected.columns.items():
            if name.endswith(("y", "angle")):
                np.testing.assert_allclose(person.columns[name][41:], values[41:], rtol=0, atol=5e-3)


def test_a_single_leg_has_the_plates_of_its_foot_alone() -> None:
    own = {body: names for body, names in CLUSTERS.items() if not body.endswith("_left")}
    right = person_of(recorded(), legs=1, motion={"clusters": own})
    assert [one.plate for one in right.plates.contacts] == [2, 4, 6]
    left = {"trunk": CLUSTERS["trunk"]} | {body[:-5]: n for body, n in CLUSTERS.items() if body.endswith("_left")}
    other = person_of(recorded(), legs=1, motion={"clusters": left})
    assert [one.plate for one in other.plates.contacts] == [1, 3, 5]
    assert not [one for one in (*right.findings, *other.findings) if one.level]


def test_archives_of_persons_need_no_file_and_repeats_read_only_files_beside_them(tmp_path: Path) -> None:
    walker = Walker.of_example(2)
    markers = {name: in_laboratory(own, 2.0) for name, own in walker.markers(np.random.default_rng(0)).items()}
    text = table_text(walker.time, markers)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "spec").mkdir()
    for file in (tmp_path / "elsewhere" / "walk.csv", tmp_path / "spec" / "walk.csv"):
        file.write_text(text)
        spec = person_spec({}, motion={"data": None, "file": file.name}, accept=["residuals"])
        spec["motion"]["file"] = str(file) if file.parent.name == "elsewhere" else file.name
        path = tmp_path / "spec" / "walk.yaml"
        path.write_text(json.dumps(spec))
        archive = tmp_path / "spec" / f"{file.parent.name}.h5"
        with mbdkit.inverse(path, archive=archive) as run:
            assert "hip combined" in run.summary()
            assert json.loads(run.provenance["person"])["centers"]["hip"]["method"] == "combined"
            if file.parent.name == "elsewhere":
                with pytest.raises(SpecError, match="not in the folder of the archive"):
                    repeated_inverse(run, archive, None, overwrite=False, progress=None)
            else:
                again = repeated_inverse(run, archive, None, overwrite=False, progress=None)
                assert again.data_sha256 == run.data_sha256
    (tmp_path / "spec" / "walk.csv").unlink()
    with mbdkit.load(tmp_path / "spec" / "spec.h5") as run:
        assert "thigh" in run.mechanism.bodies
        assert mbdkit.workload(run)["knee"].load.peak > 0
