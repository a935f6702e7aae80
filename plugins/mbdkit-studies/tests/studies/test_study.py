"""The study as Python and other programs see it, the file of its index, and runs that are not to be trusted."""

from __future__ import annotations

import logging
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit.archive.fingerprint import seal
from mbdkit.base.errors import ArchiveError, MbdkitError, SpecError
from mbdkit_studies.report.study_summary import summary
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.store import study_index
from mbdkit_studies.store.study_index import Index, Row
from mbdkit_studies.study import Study
from tests.tiny_disk import tiny_disk


def test_a_study_is_opened_from_its_folder_alone(finished):
    study = mbdkit.load_study(finished.folder)
    assert isinstance(study, Study)
    assert study.computed == 0
    assert study.spec.sha256() == finished.spec.sha256()
    assert list(study.points) == list(finished.points)
    assert study.families == {"": "Two methods, two steps"}
    assert study.axes() == {"integrator": ["rk4", "Gauss 2"], "time.step": [0.02, 0.01]}


@pytest.mark.parametrize("what", ["nothing", "no index"])
def test_a_folder_without_a_study_is_refused(what, copied, tmp_path):
    folder = tmp_path / "missing"
    if what == "no index":
        folder = copied
        (folder / "index.h5").unlink()
    with pytest.raises(SpecError):
        mbdkit.load_study(folder)


def test_a_point_knows_its_place_its_spec_and_its_run(finished):
    point = finished.points[3]
    assert point.number == 4
    assert point.label == "Gauss 2; time.step 0.01"
    assert point.spec.run_id() == point.run_id
    with finished.run(point) as run, finished.reference(point) as reference:
        assert run.run_id == point.run_id
        assert reference.run_id == point.reference_id == finished.references[0].run_id
        assert point.values["misalignment_max"] == run.misalignment_max
        assert point.values["energy_balance_max"] == abs(run.energy.balance).max()
        assert point.values["steps"] == run.stats["steps"] == 50
        apart = run.array("trajectory/position")[-1] - reference.array("trajectory/position")[-1]
        assert point.values["end_error"] == pytest.approx(np.hypot(apart[:, 0], apart[:, 1]).max(), rel=1e-12)
        assert point.values["end_angle_error"] == pytest.approx(abs(apart[:, 2]).max(), rel=1e-12)
    assert finished.references[0].spec.integrator.stages == 4
    assert [run.run_id for _, run in finished.runs()] == [point.run_id for point in finished.points]


def test_errors_fall_with_the_fourth_power_of_the_step_for_methods_of_order_four(finished):
    for coarse, fine in (finished.points[:2], finished.points[2:]):
        for measure in ("end_error", "trajectory_error", "end_angle_error", "trajectory_angle_error"):
            ratio = coarse.values[measure] / fine.values[measure]
            assert np.log2(ratio) == pytest.approx(4.0, abs=0.3)  # margin: order, from errors of mbdkit alone


def test_a_frame_has_one_row_a_run(finished):
    frame = finished.to_frame()
    assert list(frame.columns[:4]) == ["number", "family", "integrator", "time.step"]
    assert list(frame["integrator"]) == ["rk4", "rk4", "Gauss 2", "Gauss 2"]
    assert list(frame["time.step"]) == [0.02, 0.01, 0.02, 0.01]
    assert list(frame["status"]) == ["complete"] * 4
    assert frame["misalignment_max"].max() == max(point.values["misalignment_max"] for point in finished.points)


def test_an_array_has_one_dimension_an_axis_and_units(finished):
    grid = finished.to_xarray()
    assert grid["end_error"].dims == ("integrator", "time.step")
    chosen = grid["end_error"].sel({"integrator": "Gauss 2", "time.step": 0.01})
    assert float(chosen) == finished.points[3].values["end_error"]
    assert grid["end_error"].units == "m"
    assert str(grid["status"].values[0, 0]) == "complete"


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_a_package_that_is_not_installed_is_named(package, finished, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    method = {"pandas": finished.to_frame, "xarray": finished.to_xarray}[package]
    with pytest.raises(MbdkitError, match=f"pip install {package}"):
        method()


def test_an_unknown_family_is_named(finished):
    with pytest.raises(MbdkitError, match="no family 'fig4'"):
        finished.family("fig4")


def test_netcdf_tools_open_the_index(finished):
    import netCDF4
    import xarray

    path = finished.folder / "index.h5"
    with xarray.open_dataset(path, engine="h5netcdf", group="runs") as runs:
        assert runs["time.step"].dims == ("run",)
        assert list(runs["integrator"].values) == ["rk4", "rk4", "Gauss 2", "Gauss 2"]
        assert runs["end_error"].units == "m"
    with netCDF4.Dataset(path) as file:
        assert list(file["runs"]["run_id"][:]) == [point.run_id for point in finished.points]
        assert len(file["references"].dimensions["reference"]) == 1


def test_measures_may_be_chosen(tmp_path):
    study = mbdkit.study(
        {
            "mbdkit_study": 1, "base": "pendulum",
            "overrides": {"time": {"end": 0.1, "step": 0.01}, "output.quantities": ["joints"]},
            "axes": [{"model.length": [1.0]}], "measures": ["misalignment_max", "energy_balance_max"],
        },
        out=tmp_path / "out",
    )  # fmt: skip
    values = study.points[0].values
    assert values["misalignment_max"] >= 0
    assert np.isnan(values["energy_balance_max"])  # not recorded
    assert "end_error" not in values
    assert "energy_scale" not in values


def test_a_base_reads_the_file_of_its_input(tmp_path: Path) -> None:
    # a force of 1 N for 1 s moves a mass m by 1/(2 m)
    (tmp_path / "force.csv").write_text("time,F\n0,0.001\n1,0.001\n")
    (tmp_path / "base.yaml").write_text("""
mbdkit: 1
parameters: {m: 1.0}
model:
  name: mechanism
  gravity: [0, 0]
  bodies: {b: {mass: m, inertia: 0.1*m, position: [0, 0]}}
  joints: {s: {type: prismatic, bodies: [ground, b], at: [0, 0], axis: [1, 0]}}
  inputs: {F: {unit: N, hold: linear}}
  forces: {l: {type: force, body: b, value: [inputs.F, 0]}}
inputs: {F: {file: force.csv, unit: kN}}
integrator: {name: rk4}
time: {end: 1.0, step: 0.1}
""")
    (tmp_path / "study.yaml").write_text(
        "mbdkit_study: 1\nbase: base.yaml\naxes: [{parameters.m: [1, 2]}]\nmeasures: {x: final(b.x)}\n"
    )
    study = mbdkit.study(tmp_path / "study.yaml", out=tmp_path / "out")
    assert [point.values["x"] for point in study.points] == pytest.approx([0.5, 0.25])
    study = mbdkit.ensemble(tmp_path / "base.yaml", {"parameters.m": [1.0, 4.0]}, measures={"x": "final(b.x)"})
    assert [point.values["x"] for point in study.points] == pytest.approx([0.5, 0.125])


def test_another_run_under_the_name_of_a_run_is_refused(copied, tmp_path):
    study = mbdkit.load_study(copied)
    first, second = study.points[0], study.points[1]
    first.path.write_bytes(second.path.read_bytes())
    with pytest.raises(SpecError, match="another run in place of run 1") as refused:
        study.run(first)
    assert refused.value.file == str(first.path)
    study.references[0].path.write_bytes(second.path.read_bytes())
    with pytest.raises(SpecError, match="in place of the reference run"):
        study.reference(second)


def test_every_number_of_a_study_with_a_reference_is_computed_again(finished):
    for point in finished.points:
        finished.remake(point)
    errors = dict(finished.points[1].values, trajectory_error=1e-9)
    falsified = replace(finished.points[1], values=errors)
    with pytest.raises(MbdkitError, match="the index has other values of trajectory_error"):
        finished.remake(falsified)


def test_a_study_is_logged_below_the_logger_mbdkit(tmp_path, caplog):
    # expected: a program that asks mbdkit for messages, as the guide shows, gets those of studies too
    spec = {"mbdkit_study": 1, "base": "pendulum", "axes": [{"time.step": [0.01]}], "overrides": {"time.end": 0.05}}
    with caplog.at_level(logging.INFO, logger="mbdkit"):
        mbdkit.study(spec, out=tmp_path / "study")
    told = [record.getMessage() for record in caplog.records if record.name.startswith("mbdkit.studies.")]
    assert [words in text for words, text in zip(("begins", "ends"), told, strict=True)] == [True, True], told


RUN = {"integrator": {"name": "gauss", "stages": 3}, "time": {"end": 2.0, "step": 0.05}}
STUDY = {
    "mbdkit_study": 1, "title": "two methods", "base": {"mbdkit": 1, "model": {"name": "double-pendulum"}, **RUN},
    "axes": [{"integrator": [{"name": "gauss", "stages": 3}, {"name": "rk-gill"}]}],
}  # fmt: skip


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Study:
    return mbdkit.study(STUDY, out=tmp_path_factory.mktemp("study") / "two")


def test_the_table_of_a_study_has_the_verdict_of_each_run(study: mbdkit.Study) -> None:
    frame = study.to_frame()
    assert list(frame["status"]) == ["complete", "complete"]
    assert list(frame["verdict"]) == ["unknown", "bad"]
    assert frame["verdict_reasons"][0] == ""
    assert frame["verdict_reasons"][1].startswith("Joint 'J2' is misaligned by up to ")
    assert [point.verdict for point in study.points] == ["unknown", "bad"]
    with h5py.File(study.folder / "index.h5") as file:
        assert list(file["runs/verdict"].asstr()[:]) == ["unknown", "bad"]


SPEC = load_study_spec({"mbdkit_study": 1, "base": "pendulum", "axes": [{"time.step": [0.01]}]})


def index(count: int) -> Index:
    return Index.of_rows([Row(f"run{number}", "missing") for number in range(count)], [], {})


def test_a_changed_value_is_found(tmp_path: Path) -> None:
    path = tmp_path / "index.h5"
    study_index.write(path, SPEC, index(3))
    assert len(study_index.read(path)) == 3
    with h5py.File(path, "r+") as file:
        file["runs/status"][1] = "complete"
    with pytest.raises(ArchiveError, match="runs/status has changed since it was written"):
        study_index.read(path)


def test_columns_of_different_lengths_are_damage(tmp_path: Path) -> None:
    path = tmp_path / "index.h5"
    study_index.write(path, SPEC, index(3))
    with h5py.File(path, "r+") as file:
        known = {name: file["runs/status"].attrs[name] for name in ("name", "role", "place", "units", "long_name")}
        del file["runs/status"]
        file["runs"].create_dataset("status", data=["complete"], dtype=h5py.string_dtype()).attrs.update(known)
        seal(file)
    with pytest.raises(ArchiveError, match="this file is damaged"):
        study_index.read(path)


def test_a_full_disk_leaves_the_previous_index(tmp_path: Path) -> None:
    with tiny_disk(tmp_path / "disk", 300) as disk:
        path = disk / "index.h5"
        study_index.write(path, SPEC, index(1))
        with pytest.raises(MbdkitError, match="No space left"):
            study_index.write(path, SPEC, index(5000))
        assert len(study_index.read(path)) == 1
        assert [file.name for file in disk.iterdir()] == ["index.h5"]


def test_reasons_do_not_add_lines() -> None:
    spec = SimpleNamespace(title="", defined_measures=tuple, has_table=False, verdict="", tolerances={})
    study: Any = SimpleNamespace(points=(), references=(), failures=(), spec=spec, computed=0, folder="out")
    study.unfinished, study.statuses, study.verdicts = ("x\nall is well",), list, list
    study.columns = lambda: dict.fromkeys(("status", "status_reason", "verdict", "verdict_reasons"), ())
    assert summary(study).splitlines()[-1] == "unfinished 1 time: x\\nall is well"
