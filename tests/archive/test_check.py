"""The checker finds nothing in a good archive, and everything that was done to a bad one."""

from __future__ import annotations

import contextlib
import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray

from mbdkit.archive.archive_check import check
from mbdkit.archive.fingerprint import seal, spec_sha256
from mbdkit.archive.info import describe
from mbdkit.archive.layout import CORRECTIONS
from mbdkit.archive.reader import load
from mbdkit.base.errors import MbdkitError
from tests.integrators.running import DOUBLE
from tests.integrators.step_methods import RungeKutta, run_with
from tests.slow_cases import slow

from .making import SPEC, make, names


@pytest.mark.parametrize("sizes", [(11, 2, 2, 4), (0, 2, 2, 4), (1, 1, 0, 0), (11, 3, 2, 5)])
def test_good_archive_has_no_problem(tmp_path: Path, sizes: tuple[int, int, int, int]) -> None:
    make(tmp_path / "run.h5", count=sizes[0], named=names(*sizes[1:]))
    assert check(tmp_path / "run.h5") == []


@pytest.mark.parametrize("kind", ["projection", *slow("baumgarte")])
def test_the_archive_of_a_stabilized_run_has_no_problem_and_opens_in_xarray(tmp_path: Path, kind: str) -> None:
    with run_with(RungeKutta(), DOUBLE, {"end": 0.1, "step": 0.01}, stabilization=kind).check() as run:
        run.save(tmp_path / "run.h5")
    assert check(tmp_path / "run.h5") == []
    with load(tmp_path / "run.h5") as run, xarray.open_datatree(tmp_path / "run.h5", engine="h5netcdf") as tree:
        for path in CORRECTIONS[kind]:
            name = path.removeprefix("steps/")
            assert getattr(run.steps, name).max() > 0
            np.testing.assert_array_equal(tree["steps"][name], getattr(run.steps, name))
            np.testing.assert_array_equal(run.to_xarray()["steps"][name], getattr(run.steps, name))
        told = describe(tmp_path / "run.h5")
        assert (told["formulation"], told["stabilization"]["name"]) == ("index-1", kind)
        assert told["corrections"] != ""


def detach(file: h5py.File) -> None:
    file["energy/total"].dims[0].detach_scale(file["energy/time"])


def reattach(file: h5py.File) -> None:
    detach(file)
    file["energy/total"].dims[0].attach_scale(file["joints/time"])


def retype(file: h5py.File) -> None:
    values = file["energy/work"][:]
    attributes = {name: file["energy/work"].attrs[name] for name in ("units", "long_name")}
    del file["energy/work"]
    file["energy/work"] = values.astype("f4")
    file["energy/work"].attrs.update(attributes)
    file["energy/work"].dims[0].attach_scale(file["energy/time"])


def shorten(file: h5py.File) -> None:
    values = file["energy/work"][:-1]
    del file["energy/work"]
    file["energy/work"] = values
    file["energy/work"].attrs.update({"units": "J", "long_name": "work of applied loads and drivers since the start"})
    file["energy/work"].dims[0].attach_scale(file["energy/time"])


def flatten(file: h5py.File) -> None:
    del file["joints/misalignment"]
    file["joints/misalignment"] = np.zeros(22)


def put(path: str, at: object, value: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file[path][at] = value

    return change


def attribute(path: str, name: str, value: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if value is None:
            del file[path].attrs[name]
        else:
            file[path].attrs[name] = value

    return change


def drop(path: str) -> Callable[[h5py.File], None]:
    return lambda file: file.__delitem__(path)


def step(value: object) -> Callable[[h5py.File], None]:
    text = json.dumps({**SPEC, "time": {"end": 1.0, "step": value}})

    def change(file: h5py.File) -> None:
        file.attrs.update(spec=text, spec_sha256=spec_sha256(text))
        seal(file)

    return change


FORGED = "x\nother.h5: sound"

DAMAGE: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "missing array": (drop("energy/work"), "energy/work is missing"),
    "missing scale": (drop("joints/joint"), "joints/joint is missing"),
    "missing group": (drop("energy"), "energy/kinetic is missing"),
    "missing trajectory": (drop("trajectory"), "trajectory/position is missing"),
    "missing statistics": (drop("stats"), "the group stats is missing"),
    "unknown array": (lambda file: file.__setitem__("energy/heat", [1.0]), "energy/heat is not part of the layout"),
    "array with two lines": (lambda file: file.__setitem__(FORGED, [1.0]), r"x\nother.h5: sound is not part of the"),
    "soft link": (lambda file: file.__setitem__(FORGED, h5py.SoftLink("/energy")), r"x\nother.h5: sound is a"),
    "hard link": (lambda file: file.__setitem__(FORGED, file["energy"]), r"x\nother.h5: sound is a hard link"),
    "version with two lines": (attribute("/", "format_version", FORGED), r"version x\nother.h5: sound, this"),
    "step of 400 digits": (step(10**399), "it has an integer of 400 digits"),
    "infinite step": (step(float("inf")), "time.step is not a finite number"),
    "other type": (retype, "energy/work has the type <f4, not <f8"),
    "other shape": (shorten, "axis 0 of energy/work has the length 10, its scale energy/time 11"),
    "fewer axes": (flatten, "joints/misalignment has 1 axes, not 2"),
    "detached scale": (detach, "axis 0 of energy/total is not attached to its scale energy/time"),
    "another group's scale": (reattach, "axis 0 of energy/total is not attached to its scale energy/time"),
    "other units": (attribute("energy/work", "units", "kJ"), "units of energy/work is 'kJ', not 'J'"),
    "no units": (attribute("energy/work", "units", None), "units of energy/work is '', not 'J'"),
    "no long name": (attribute("energy/work", "long_name", None), "long_name of energy/work is ''"),
    "no row units": (attribute("trajectory/position", "row_units", None), "row_units of trajectory/position is ''"),
    "changed value": (put("energy/work", 3, 0.123), "energy/work has changed since it was written"),
    "changed count": (put("steps/rejected", 3, 5), "steps/rejected has changed since it was written"),
    "changed name": (put("trajectory/body", 0, "rod9"), "trajectory/body has changed since it was written"),
    "name twice": (put("trajectory/body", 0, "rod2"), "trajectory/body has a name twice"),
    "other axis names": (put("joints/axis", 0, "z"), "joints/axis is not x, y"),
    "not a number": (put("energy/work", 3, np.nan), "energy/work has 1 values that are not finite"),
    "infinity": (put("joints/reaction_force", 3, np.inf), "joints/reaction_force has 4 values"),
    "time stands still": (put("trajectory/time", 3, 0.02), "trajectory/time does not increase"),
    "times differ": (put("joints/time", 3, 0.031), "joints/time differs from trajectory/time"),
    "intervals differ": (put("steps/time", 3, 0.041), "steps/time differs from trajectory/time"),
    "intervals miscounted": (put("steps/interval", 0, 0), "steps/interval does not count from 1"),
    "clock runs back": (put("trajectory/elapsed_s", 3, 0.0), "trajectory/elapsed_s decreases"),
    "changed spec": (attribute("/", "spec", json.dumps({**SPEC, "title": "x"})), "spec_sha256 does not match"),
    "spec of another kind": (attribute("/", "spec", "model: x"), "the attribute spec does not contain a spec in JSON"),
    "no spec": (attribute("/", "spec", None), "the attribute spec is missing"),
    "no hash": (attribute("/", "data_sha256", None), "the attribute data_sha256 is missing"),
    "no hash of attributes": (attribute("/", "attributes_sha256", None), "its attributes have changed"),
    "attribute of another kind": (attribute("/", "run_id", 5), "the attribute run_id is not a string"),
    "unknown status": (attribute("/", "status", "done"), "status is 'done', not one of"),
    "still running": (attribute("/", "status", "running"), "the run did not end"),
    "reason without failure": (attribute("/", "status_reason", "singular: x"), "a complete run has the status_reason"),
    "failure without reason": (attribute("/", "status", "failed"), "status_reason of a failed run should be a code"),
    "date of another kind": (attribute("/", "created_utc", "today"), "created_utc is 'today'"),
    "counter missing": (attribute("stats", "steps", None), "steps of stats is missing"),
    "counter no integer": (attribute("stats", "steps", 3.5), "steps of stats is not an integer"),
    "time no number": (attribute("stats", "wall_s", "long"), "wall_s of stats is not a time in s"),
    "no misalignment_max": (attribute("joints", "misalignment_max", None), "does not hold a number for each of 2"),
    "short misalignment_max": (attribute("joints", "misalignment_max", [1.0]), "does not hold a number for each of 2"),
    "small misalignment_max": (attribute("joints", "misalignment_max", [0.0, 0.0]), "is less than the maximum"),
    "two misalignment_max": (attribute("joints", "misalignment_max", [3.0, 3.0]), "and of joints/misalignment differ"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_is_found(archive: Path, damage: str) -> None:
    change, words = DAMAGE[damage]
    with h5py.File(archive, "r+") as file:
        change(file)
    problems = check(archive)
    assert any(words in problem for problem in problems), problems
    assert all("\n" not in problem for problem in problems)


def test_a_failed_run_holds_no_values_either_that_are_not_finite(tmp_path: Path) -> None:
    make(tmp_path / "run.h5", status="failed", reason="not-finite: the state at t = 0.03 s")
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file["energy/work"][-1] = np.nan
        seal(file)
    assert check(tmp_path / "run.h5") == ["energy/work has 1 values that are not finite"]


@pytest.mark.slow
def test_flipped_bytes_anywhere_are_never_a_traceback(archive: Path) -> None:
    content = archive.read_bytes()
    draw = random.Random(5)
    found = 0
    for _ in range(120):
        flipped = bytearray(content)
        flipped[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
        archive.write_bytes(flipped)
        found += bool(check(archive))
        with contextlib.suppress(MbdkitError), load(archive) as run:
            run.summary()
            run.to_xarray()
            describe(archive)
    assert found > 40  # the rest fell on unused space, timings, statistics and provenance


@pytest.mark.parametrize(
    "change",
    [
        attribute("provenance", "platform", "Linuy"),
        attribute("provenance", "platform", None),
        attribute("stats", "steps", np.int64(11)),
        attribute("stats", "wall_s", 0.003),
        attribute("/", "run_id", "run-2"),
        attribute("/", "verdict_reasons", ["fine"]),
        put("trajectory/elapsed_s", 10, 1.0),
    ],
)
def test_what_the_hash_of_the_data_leaves_out_has_a_hash_as_well(archive: Path, change: Any) -> None:
    with h5py.File(archive, "r+") as file:
        change(file)
    (problem,) = check(archive)
    assert "its attributes have changed since" in problem or "trajectory/elapsed_s has changed since" in problem


def test_what_load_cannot_read_is_not_sound(archive: Path) -> None:
    with h5py.File(archive, "r+") as file:
        file["provenance"].attrs["platform"] = np.zeros(3)
        seal(file)
    (problem,) = check(archive)
    assert "platform of provenance is neither a string nor a number" in problem
