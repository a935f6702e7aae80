"""Joint centres, plane, lengths, plates and loads of persons whose joints are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.inverse_dynamics.c3d_files import Convention, c3d_bytes
from tests.inverse_dynamics.force_plates import plate
from tests.persons.walkers import FUNCTIONAL, data_of, loaded, person_spec, recorded, skeleton_of

import mbdkit
from mbdkit_biomech.inverse_dynamics.spec.inverse_loading import load_inverse_spec
from mbdkit_biomech.persons.joint_centers import IN_STEP, LANDMARKS, REGRESSION
from mbdkit_biomech.persons.landmarks import Side, landmark
from mbdkit_biomech.persons.rigid_clusters import Artefact, MarkerCluster, poses_of
from tests.benchmarks.person_markers import SHANK, THIGH, Walker, columns_of, in_laboratory, table_text

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
    for _ in range(32):
        markers = walker.markers(random)
        for joint in FUNCTIONAL:
            walker.move_in_step(markers, joint, tuple(IN_STEP * random.standard_normal(2)))
        person = skeleton_of(walker, markers, HEADING, **FUNCTIONAL)
        at = person.segments.reference
        for joint, (a, b) in person.segments.joints.items():
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
    assert np.all(np.abs(np.mean(lengths, axis=0)) < 1)
    assert np.all(np.std(lengths, axis=0) < 1.4)


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
    for joint, one in person.centers.items():  # exact in the plane, but for the shift by skin in step with the joint
        alone = REGRESSION if joint.startswith("hip") else LANDMARKS
        both = 1 / np.sqrt(1 / alone**2 + 1 / IN_STEP**2)
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


def trc_text(time: np.ndarray, markers: dict[str, np.ndarray]) -> str:
    """Return markers (T, 3) in metres as the text of a .trc file in millimetres."""
    count = len(markers)
    lines = ["PathFileType\t4\t(X/Y/Z)\tstatic.trc", "NumFrames\tNumMarkers\tUnits", f"{len(time)}\t{count}\tmm"]
    lines.append("Frame#\tTime\t" + "\t\t\t".join(markers))
    lines.append("\t\t" + "\t".join(f"{axis}{k}" for k in range(1, count + 1) for axis in "XYZ"))
    for row, at in enumerate(time):
        values = [1000 * value for own in markers.values() for value in own[row]]
        lines.append("\t".join([str(row + 1), f"{at:.5f}", *(f"{value:.2f}" for value in values)]))
    return "\n".join(lines) + "\n"


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
        assert abs(np.mean(tilt)) < 1
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
        np.testing.assert_allclose(found.joints[joint].reaction_force, force, rtol=0, atol=0.01 * np.max(np.abs(force)))
    for name in ("knee_flexion", "ankle_dorsiflexion"):
        moment = true.actuators[name].value  # the mean angle of the trunk is its zero, so that hips differ
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
        assert np.max(np.abs(np.mean(error, axis=0))) < 2 * max(person.centers[joint].deviation)
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
