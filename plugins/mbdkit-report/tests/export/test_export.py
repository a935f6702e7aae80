"""Exported files, read by pandas, SciPy, pyarrow and OpenSim; data frames."""

from __future__ import annotations

import csv
import importlib.util
import json
import os
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from scipy.io import loadmat

import mbdkit
from mbdkit.archive.named_columns import NotRecordedError
from mbdkit.base.errors import MbdkitError, ResourceError, SpecError
from mbdkit.registry.target import Target
from mbdkit_report import table_formats
from mbdkit_report.export import export
from mbdkit_report.group_table import group_names, group_table
from tests.synthetic_runs import make_run as make_run

# A rod hangs on a pin and on a spring, has a name that spreadsheets would take for a formula, and passes its lowest
# position several times.
SPEC: dict[str, Any] = {
    "mbdkit": 1,
    "model": {
        "name": "mechanism", "bodies": {"=rod": {"mass": 1.0, "inertia": 0.1, "position": [0.5, 0.0]}},
        "joints": {"pin A": {"type": "revolute", "bodies": ["ground", "=rod"], "points": [[0, 0], [-0.5, 0]]}},
        "forces": {
            "damper": {"type": "torsion-spring", "bodies": ["ground", "=rod"], "stiffness": 0.0, "damping": 0.01},
        },
        "markers": {"tip": {"body": "=rod", "point": [0.5, 0.0]}},
    },
    "integrator": {"name": "gauss", "stages": 2}, "time": {"end": 2.0, "step": 0.01},
    "events": {"low": {"when": 'bodies["=rod"].angle + pi/2'}},
}  # fmt: skip


@pytest.fixture(scope="module")
def run() -> Iterator[mbdkit.Run]:
    with mbdkit.run(SPEC) as made:
        assert len(made.events) >= 2
        yield made


def columns(run: mbdkit.Run, group: str) -> dict[str, np.ndarray]:
    """Values of a group by name, with the time, taken from the histories rather than from the table."""
    joint, rod, tip = run.joints["pin A"], run["=rod"], run.markers["tip"]
    known = {
        "trajectory": {"=rod.x": rod.position[:, 0], "=rod.angle": rod.angle, "=rod.ay": rod.acceleration[:, 1]},
        "joints": {
            "pin A.misalignment": joint.misalignment, "pin A.force_y": joint.reaction_force[:, 1],
            "pin A.force_second_x": joint.reaction_force_second[:, 0], "pin A.torque": joint.reaction_torque,
            "pin A.angle": joint.angle,
        },
        "forces": {"damper.value": run.forces["damper"].value},
        "markers": {"tip.y": tip.position[:, 1], "tip.vx": tip.velocity[:, 0]},
        "energy": {"kinetic": run.energy.kinetic, "balance": run.energy.balance},
    }  # fmt: skip
    return {"time": run.time, **known[group]}


GROUPS = ("trajectory", "joints", "forces", "markers", "energy")


@pytest.mark.parametrize("group", GROUPS)
def test_a_data_frame_has_the_values_of_the_histories_by_name(run, group):
    frame = run.to_frame(group)
    known = columns(run, group)
    np.testing.assert_array_equal(frame.index, known.pop("time"))
    assert frame.index.name == "time"
    for name, values in known.items():
        np.testing.assert_array_equal(frame[name], values)


def test_a_data_frame_has_the_units_of_its_columns(run):
    units = run.to_frame("trajectory").attrs["units"]
    assert (units["time"], units["=rod.x"], units["=rod.angular_velocity"]) == ("s", "m", "rad/s")
    units = run.to_frame("joints").attrs["units"]
    assert (units["pin A.angle"], units["pin A.torque"]) == ("rad", "N m")
    assert run.to_frame("forces").attrs["units"]["damper.value"] == "N m"


def test_events_and_intervals_are_tables_as_well(run):
    events = run.to_frame("events")
    assert events["name"].tolist() == ["low"] * len(run.events)
    np.testing.assert_allclose(events["=rod.angle"], -np.pi / 2, atol=1e-9)
    assert run.to_frame("steps")["steps"].sum() == run.stats["steps"]


def test_an_unknown_group_is_answered_with_the_nearest(run):
    with pytest.raises(MbdkitError, match=r"no group 'joint' \(did you mean 'joints'\?\)"):
        run.to_frame("joint")


def test_a_group_that_the_run_lacks_is_explained(run):
    with pytest.raises(NotRecordedError, match="check: true"):
        run.to_frame("accuracy")
    with mbdkit.run("pendulum", output={"quantities": ["energy"]}) as less:
        with pytest.raises(NotRecordedError, match=r"output\.quantities"):
            less.to_frame("joints")
        with pytest.raises(NotRecordedError, match=r"output\.quantities"):
            less.to_frame("forces")
    with mbdkit.run("pendulum") as bare, pytest.raises(MbdkitError, match="mechanism of this run has no forces"):
        bare.to_frame("forces")


def test_csv_is_read_by_pandas_with_all_digits(run, tmp_path):
    export(run, tmp_path / "out", "csv")
    for group in GROUPS:
        frame = pandas.read_csv(tmp_path / "out" / f"{group}.csv", float_precision="round_trip")
        units = run.to_frame(group).attrs["units"]
        for name, values in columns(run, group).items():
            heading = f"{name} [{units[name]}]"
            read = frame[f"'{heading}" if name.startswith("=") else heading]
            np.testing.assert_array_equal(read, values)


def test_no_cell_of_a_csv_file_is_a_formula(run, tmp_path):
    for file in export(run, tmp_path, "csv"):
        with file.open(newline="", encoding="utf-8") as lines:
            for row in csv.reader(lines):
                assert not [cell for cell in row if cell[:1] in "=+@" and cell]


def test_matlab_files_are_read_by_scipy_with_valid_names(run, tmp_path):
    export(run, tmp_path, "mat")
    for group in GROUPS:
        data = loadmat(tmp_path / f"{group}.mat", simplify_cells=True)
        names = {name: variable for variable, name in data["names"].items()}
        for name, values in columns(run, group).items():
            assert names[name].isidentifier()
            assert names[name].isascii()
            assert len(names[name]) <= 63
            np.testing.assert_array_equal(data[names[name]], values)
        assert data["units"]["time"] == "s"
    assert loadmat(tmp_path / "joints.mat", simplify_cells=True)["names"]["pin_A_force_x"] == "pin A.force_x"
    assert loadmat(tmp_path / "events.mat", simplify_cells=True)["name"][0] == "low"


def test_names_that_matlab_would_confuse_stay_apart(make_run, tmp_path):
    names = ["a b", "a_b", "a-b", "振", "l" * 80, "l" * 80 + "2"]
    run = make_run(rods=6, joints=names)
    export(run, tmp_path, "mat")
    data = loadmat(tmp_path / "joints.mat", simplify_cells=True)
    assert len(data["names"]) == 1 + len(run.to_frame("joints").columns)
    assert {name.rpartition(".")[0] for name in data["names"].values()} == {"", *names}


def plain_sto(path: Path) -> tuple[dict[str, str], list[str], np.ndarray]:
    """Header, labels and rows of a storage file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    end = lines.index("endheader")
    header = dict(line.split("=") for line in lines[1:end])
    return header, lines[end + 1].split("\t"), np.array([line.split("\t") for line in lines[end + 2 :]], dtype=float)


def test_storage_files_have_header_labels_and_all_values(run, tmp_path):
    files = export(run, tmp_path, "sto")
    assert "events.sto" not in [file.name for file in files]
    for group in GROUPS:
        header, labels, values = plain_sto(tmp_path / f"{group}.sto")
        assert labels[0] == "time"
        assert (int(header["nRows"]), int(header["nColumns"])) == values.shape
        assert header["inDegrees"] == "no"
        for name, known in columns(run, group).items():
            np.testing.assert_array_equal(values[:, labels.index(name.replace(" ", "_"))], known)


@pytest.mark.skipif(not importlib.util.find_spec("opensim"), reason="the package opensim is not installed")
def test_storage_files_are_read_by_opensim(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where OpenSim writes its log
    import opensim

    export(run, tmp_path, "sto")
    for group in GROUPS:
        table = opensim.TimeSeriesTable(str(tmp_path / f"{group}.sto"))
        assert table.getTableMetaDataString("inDegrees") == "no"
        np.testing.assert_array_equal(table.getIndependentColumn(), run.time)
        for name, values in columns(run, group).items():
            if name != "time":
                column = table.getDependentColumn(name.replace(" ", "_")).to_numpy()
                np.testing.assert_array_equal(column, values)


@pytest.mark.skipif(not importlib.util.find_spec("pyarrow"), reason="the package pyarrow is not installed")
def test_parquet_is_read_by_pyarrow_with_units(run, tmp_path):
    from pyarrow import parquet

    export(run, tmp_path, "parquet")
    for group in GROUPS:
        table = parquet.read_table(tmp_path / f"{group}.parquet")
        for name, values in columns(run, group).items():
            np.testing.assert_array_equal(table[name].to_numpy(), values)
    assert parquet.read_schema(tmp_path / "joints.parquet").field("pin A.torque").metadata[b"units"] == b"N m"
    assert parquet.read_table(tmp_path / "events.parquet")["name"].to_pylist() == ["low"] * len(run.events)


def test_without_pyarrow_parquet_names_the_package(run, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(MbdkitError, match="pip install pyarrow"):
        export(run, tmp_path / "new", "parquet")
    assert list(tmp_path.iterdir()) == []


def test_json_is_strict_and_has_null_for_numbers_that_are_not_finite(make_run, tmp_path):
    def spoil(data):
        data["energy/total"][-2:] = [np.nan, np.inf]

    run = make_run(change=spoil, status="failed", reason="not-finite: the state is not finite")
    export(run, tmp_path, "json")

    def refuse(constant):
        raise AssertionError(constant)

    data = json.loads((tmp_path / "energy.json").read_text(), parse_constant=refuse)
    names = [column["name"] for column in data["columns"]]
    total = [row[names.index("total")] for row in data["rows"]]
    assert total[-2:] == [None, None]
    np.testing.assert_array_equal(total[:-2], run.energy.total[:-2])
    assert {"name": "total", "units": "J", "description": "kinetic + potential energy"} in data["columns"]


def test_long_tables_are_written_in_blocks(run, tmp_path, monkeypatch):
    export(run, tmp_path / "whole", "csv")
    monkeypatch.setattr("mbdkit_report.group_table.BLOCK_VALUES", 100)
    assert len(list(group_table(run, "joints").blocks())) > 20
    export(run, tmp_path / "blocks", "csv")
    for file in (tmp_path / "whole").iterdir():
        assert (tmp_path / "blocks" / file.name).read_bytes() == file.read_bytes()


def test_existing_files_are_kept_unless_overwriting(run, tmp_path):
    (tmp_path / "energy.csv").write_text("mine")
    with pytest.raises(SpecError, match="exists already"):
        export(run, tmp_path, "csv")
    assert [path.name for path in tmp_path.iterdir()] == ["energy.csv"]
    assert (tmp_path / "energy.csv").read_text() == "mine"
    files = export(run, tmp_path, "csv", overwrite=True)
    assert {path.stem for path in files} == set(group_names(run))
    assert (tmp_path / "energy.csv").read_text() != "mine"


def test_an_export_that_fails_in_the_middle_leaves_nothing(run, tmp_path, monkeypatch):
    def fail(table, path):
        path.write_text("half")
        if table.group == "energy":
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(table_formats, "write_csv", fail)
    monkeypatch.setattr(Target, "__call__", lambda target: pkgutil.resolve_name(target.where))
    with pytest.raises(ResourceError, match="No space left"):
        export(run, tmp_path / "out", "csv")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("is_new", [True, False])
def test_a_disk_that_is_full_at_the_second_file_leaves_no_table(is_new, run, tmp_path, monkeypatch):
    sizes, sync = iter(range(1000)), os.fsync

    def synced(file):
        if next(sizes):
            raise OSError(28, "No space left on device")
        sync(file)

    if not is_new:
        (tmp_path / "out").mkdir()
    monkeypatch.setattr(os, "fsync", synced)
    with pytest.raises(ResourceError, match="No space left"):
        export(run, tmp_path / "out", "csv")
    assert (tmp_path / "out").exists() is not is_new
    assert list(tmp_path.glob("out/*")) == []


def test_a_run_without_rows_is_refused(make_run, tmp_path):
    with pytest.raises(SpecError, match="no rows"):
        export(make_run(rows=0, status="failed", reason="singular: at the start"), tmp_path / "out", "csv")


def test_a_run_of_one_row_is_exported(make_run, tmp_path):
    run = make_run(rows=1, status="failed", reason="singular: at the start")
    for to in ("csv", "json", "mat", "sto"):
        assert {file.stem for file in export(run, tmp_path, to)} >= {"trajectory", "joints"}
