"""The golden files of format 1 are read with equal numbers, also with what versions 1.1 may add; 2.0 is refused."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mbdkit as public
from mbdkit.archive.fingerprint import seal
from mbdkit.archive.headlines import answers
from mbdkit.spec.reading import read_file

from .plain import Numbers, numbers, plain
from .write import ARCHIVES

pytestmark = pytest.mark.skipif(find_spec("mbdkit_studies") is None, reason="the golden files are those of all parts")

EXPECTED: dict[str, Numbers] = json.loads((ARCHIVES / "numbers.json").read_text("utf-8"))
RUNS = [name for name, found in EXPECTED.items() if found.get("format") == "mbdkit-run"]


@pytest.fixture
def golden(tmp_path: Path) -> Callable[[str], Path]:
    """Return a function that copies a golden file or folder."""

    def copy(name: str) -> Path:
        source, target = ARCHIVES / name, tmp_path / name
        if source.is_dir():
            shutil.copytree(source, target)
        else:
            shutil.copy(source, target)
        return target

    return copy


def run_numbers(path: Path) -> Numbers:
    with public.load(path) as run:
        return plain({
            "format": "mbdkit-run", "title": run.file.attrs["title"], "status": run.status, "verdict": run.verdict,
            "kind": run.kind, "status_reason": run.status_reason, "rows": len(run.time), "end": run.time[-1],
            "measures": dict(run.measures),
            "answers": {
                one.id: [one.value, one.unit, one.bar.lower, one.bar.upper]
                for one in answers(run) if "answers" in run.file.attrs
            },
            "gradients": {name: dict(one["derivatives"]) for name, one in run.gradients.items()},
            "forces": {name: np.linalg.norm(joint.reaction_force, axis=1).max() for name, joint in run.joints.items()},
            "positions": {name: np.append(run[name].position[-1], run[name].angle[-1]) for name in run.bodies},
            "events": [event.time for event in run.events],
            "spec_sha256": run.spec_sha256, "data_sha256": run.data_sha256,
        })  # fmt: skip


def identification_numbers(path: Path) -> Numbers:
    found = public.load_identification(path)
    names = ("value", "deviation", "lower", "upper", "unit")
    columns = {name: [getattr(found.estimates[one], name) for one in found.parameters] for name in names}
    return plain({
        "format": "mbdkit-identification", "title": found.title, "verdict": found.verdict, "level": found.level,
        "cost": found.cost, "log_likelihood": found.log_likelihood, "parameter": list(found.parameters),
        **columns, "covariance": found.covariance,
        "covered": {one.quantity: one.covered for one in found.residuals},
    })  # fmt: skip


def study_numbers(folder: Path) -> Numbers:
    """Return the numbers of a study of which its readers know all but timings and the hashes of files."""
    study = public.load_study(folder)
    frame = study.to_frame()
    found: Numbers = {
        "index.h5": {"format": "mbdkit-study", "title": study.spec.title, "columns": {
            name: list(frame[name]) for name in frame.columns
            if name not in ("number", "family") and not name.endswith("_s")
        }},
    }  # fmt: skip
    if (folder / "members.h5").is_file():
        keys = EXPECTED[folder.name]["members.h5"].keys() - {"format", "title"}
        found["members.h5"] = {
            "format": "mbdkit-members",
            "title": "Values of a study",
            **{key: list(frame[key]) for key in keys},
        }
    for point in study.points:
        with study.run(point) as run:
            found[run.run_id] = {
                "positions": [np.append(run[name].position[-1], run[name].angle[-1]) for name in run.bodies],
                "hashes": [run.spec_sha256, run.data_sha256], "verdict": run.verdict, "status": run.status,
            }  # fmt: skip
    return plain(found)


def of_readers(expected: Numbers) -> Numbers:
    """Return the numbers of a study in the form of `study_numbers`."""
    index = expected["index.h5"]
    found = {name: part for name, part in expected.items() if not name.startswith("runs/")}
    columns = {name: values for name, values in index["columns"].items() if name not in ("file_sha256", "family")}
    found["index.h5"] = index | {"columns": columns}
    for name, part in expected.items():
        if part["format"] == "mbdkit-block":
            runs = part["runs"]
            for row, run_id in enumerate(runs["run_id"]):
                found[run_id] = {
                    "positions": part["positions"][row], "hashes": [runs["spec_sha256"][row], runs["data_sha256"][row]],
                    "verdict": runs["verdict"][row], "status": runs["status"][row],
                }  # fmt: skip
        elif name.startswith("runs/"):
            found[Path(name).stem] = {
                "positions": [*part["positions"].values()], "hashes": [part["spec_sha256"], part["data_sha256"]],
                "verdict": part["verdict"], "status": part["status"],
            }  # fmt: skip
    return found


def design_numbers(folder: Path) -> Numbers:
    found = public.load_design(folder)
    best = found.best
    result = {"best": best.variables, "goals": best.goals, "measures": best.measures, "verdict": found.trust.verdict}
    return plain({**{name: run_numbers(folder / name) for name in ("best.h5", "start.h5")}, "design.json": result})


def crate_numbers(folder: Path) -> Numbers:
    listed = json.loads((folder / "ro-crate-metadata.json").read_text("utf-8"))["@graph"]
    files = {one["@id"]: one["name"] for one in listed if one["@type"] == "File"}
    return {"failed.h5": run_numbers(folder / "failed.h5"), "ro-crate-metadata.json": files}


READERS = {
    **dict.fromkeys(RUNS, run_numbers), "identify.h5": identification_numbers, "design": design_numbers,
    "study": study_numbers, "sample": study_numbers, "crate": crate_numbers,
}  # fmt: skip


def differences(found: Any, expected: Any, place: str = "") -> list[str]:
    """Return where data differ, which for large tables says more than the comparison of pytest."""
    if isinstance(found, dict) and isinstance(expected, dict):
        return [
            line for key in {**found, **expected}
            for line in differences(found.get(key, "missing"), expected.get(key, "missing"), f"{place}/{key}")
        ]  # fmt: skip
    return [] if found == expected else [f"{place}: {found!r}, not {expected!r}"]


def assert_read(path: Path, *but: str) -> None:
    expected = EXPECTED[path.name]
    found = READERS[path.name](path)
    found |= {name: expected[name] for name in but}
    assert differences(found, of_readers(expected) if "index.h5" in expected else expected) == []


@pytest.mark.parametrize("name", EXPECTED)
def test_a_plain_reader_and_mbdkit_find_the_numbers(name: str) -> None:
    assert numbers(ARCHIVES / name) == EXPECTED[name]
    assert_read(ARCHIVES / name)


def of_version(version: str, path: Path) -> None:
    """Make a file or all files of a folder those of another version, with further groups, arrays and attributes."""
    for file in [path] if path.is_file() else sorted(path.rglob("*.h5")):
        with h5py.File(file, "r+") as opened:
            opened.attrs["format_version"] = version
            opened.attrs["added"] = "by a later version"
            opened.create_group("later")
            if path.is_file() and "mechanism" in opened.attrs:
                for name in ("spec", "mechanism"):
                    opened.attrs[name] = json.dumps(json.loads(opened.attrs[name]) | {"later": {"x": {"type": "new"}}})
                opened.attrs["spec_sha256"] = hashlib.sha256(opened.attrs["spec"].encode()).hexdigest()
            for group in opened.values():
                group.attrs["added"] = 1.0
                if path.is_file() and group.name in ("/trajectory", "/joints", "/parameters", "/later"):
                    group["added"] = [1.0]
                    group["added"].attrs.update({"units": "1", "long_name": "number that a later version adds"})
                    group["added"].make_scale()
            seal(opened)
    if (path / "ro-crate-metadata.json").is_file():
        metadata = path / "ro-crate-metadata.json"
        text = metadata.read_text("utf-8")
        for entity in json.loads(text)["@graph"]:
            if str(entity["@id"]).endswith(".h5"):
                digest = hashlib.sha256((path / entity["@id"]).read_bytes()).hexdigest()
                text = text.replace(entity["sha256"], digest)
        metadata.write_text(text.replace('"name": ', '"laterProperty": 1, "name": '), "utf-8")
    if (path / "design.json").is_file():
        data = json.loads((path / "design.json").read_text("utf-8"))
        data = {"mbdkit_result": int(float(version)), "later": 1, **data}
        data.pop("sha256")
        spec = read_file(path / "design.yaml").data
        data["sha256"] = hashlib.sha256(json.dumps([spec, data]).encode()).hexdigest()
        (path / "design.json").write_text(json.dumps(data), "utf-8")
        points = (path / "points.jsonl").read_text("utf-8")
        (path / "points.jsonl").write_text(points.replace('points": 1', f'points": {int(float(version))}'), "utf-8")


@pytest.mark.parametrize("name", EXPECTED)
def test_what_version_1_1_adds_is_left_out(name: str, golden: Callable[[str], Path], mbdkit: Any) -> None:
    path = golden(name)
    of_version("1.1", path)
    assert numbers(path).keys() == EXPECTED[name].keys()
    assert_read(path, *(("data_sha256", "spec_sha256") if name in RUNS else ()))  # which cover what is added
    if path.suffix or name == "crate":
        assert mbdkit("archive", "check", str(path)).exit_code == 0
    if name in RUNS:
        info = json.loads(mbdkit("archive", "info", str(path), "--json").stdout)
        assert info["archives"][0]["format_version"] == "1.1"


COMMANDS = {
    **dict.fromkeys(RUNS, ("archive check", "archive info", "report", "plot", "rerun")),
    "identify.h5": ("archive check", "report"), "crate": ("archive check",),
    "study": ("report", "archive export --to csv"), "sample": ("report",), "design": ("report",),
}  # fmt: skip


@pytest.mark.parametrize("name", EXPECTED)
def test_version_2_is_refused_by_a_sentence(name: str, golden: Callable[[str], Path], mbdkit: Any) -> None:
    path = golden(name)
    of_version("2.0", path)
    for command in COMMANDS[name]:
        done = mbdkit(*command.split(), str(path))
        assert done.exit_code == 2, command
        assert len(done.stderr.splitlines()) == 1, done.stderr
        assert "version 2" in done.stderr


@pytest.mark.parametrize(
    ("command", "name", "later"),
    [
        ("study", "study", ""),
        ("study", "sample", "runs"),
        ("study", "sample", "members.h5"),
        ("design", "design", ""),
    ],
)
def test_a_folder_with_files_of_version_2_is_not_continued(
    command: str, name: str, later: str, golden: Callable[[str], Path], mbdkit: Any
) -> None:
    folder = golden(name)
    of_version("2.0", folder / later)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    done = mbdkit(command, str(folder / f"{command}.yaml"), "-o", str(folder))
    assert done.exit_code == 2
    assert "version 2" in done.stderr
    assert {path: path.read_bytes() for path in before} == before
