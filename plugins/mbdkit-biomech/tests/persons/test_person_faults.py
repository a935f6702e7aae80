"""Faults in the data and the spec of a person: each is refused with one sentence, reported, or without effect."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.persons.walkers import FUNCTIONAL, SUBJECT, data_of, loaded, person_spec, recorded

import mbdkit
from mbdkit import SpecError
from mbdkit_biomech.commands import repeated_inverse
from mbdkit_biomech.persons.person import Person
from tests.benchmarks.person_markers import CLUSTERS, Array, Walker, columns_of, in_laboratory, table_text

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
    "thigh and shank that turn together": (lambda d: {one: own[:12] for one, own in d.items()},
        {"motion": {"centers": {"ankle": "functional"}}},
        r"motion.centers.ankle: is functional, but the two segments turn together: .* changes by \d+ deg"),
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
    "a leg with markers that are too low": (lambda d: moved(d, "RKN", (0.0, 0.0, -0.06)), {}, "centers",
        "landmarks and motion determine centres of knee that differ"),
    "a leg that is too short": (lambda d: moved(d, "RKN", (0.0, 0.0, -0.06)),
        {"motion": {"centers": {"knee": "static"}}}, "lengths", "long differ by more than"),
}  # fmt: skip


def person_of(data: Data, **sections: Any) -> Person:
    person = loaded(data, **sections).person
    assert person is not None
    return person


@pytest.mark.parametrize("fault", FOUND)
def test_faults_that_are_doubtful(fault: str) -> None:
    change, sections, criterion, sentence = FOUND[fault]
    findings = person_of(change(recorded(heading=2.0)), **sections).findings
    assert {one.criterion for one in findings if one.level} == {criterion}
    assert re.search(sentence, next(str(one) for one in findings if one.level))


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
