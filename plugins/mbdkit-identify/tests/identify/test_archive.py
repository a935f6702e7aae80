"""Files with results of identifications: what is written is read, also by other programs, and nothing is damaged."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from tests.identify.hand_made import COVARIANCE, result

import mbdkit
from mbdkit import ArchiveError, SpecError
from mbdkit_identify.archive import load_identification, problems, write_identification
from mbdkit_identify.identification import Doubt, Identification
from tests.identified import write_identified


def equal(first: object, second: object) -> bool:
    """Return whether two values, which may contain arrays and nan, are equal."""
    if isinstance(first, np.ndarray | float):
        return bool(np.array_equal(first, second, equal_nan=True))  # type: ignore[arg-type]
    if isinstance(first, dict):
        return isinstance(second, dict) and [*first] == [*second] and equal([*first.values()], [*second.values()])
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(equal, first, second))  # type: ignore[arg-type]
    if hasattr(first, "__dataclass_fields__"):
        return all(equal(getattr(first, one.name), getattr(second, one.name)) for one in fields(first))  # type: ignore[arg-type]
    return first == second


PLAIN = {"next_experiment": None, "profiles": {}, "doubts": (), "notes": (), "combinations": (), "residuals": ()}


@pytest.mark.parametrize(
    "given",
    [
        pytest.param(result(), id="everything"),
        pytest.param(result(**PLAIN), id="only estimates"),
        pytest.param(result(doubts=(Doubt("", "no statistic"),)), id="a doubt without a statistic"),
    ],
)
def test_what_is_written_is_read(given: Identification, tmp_path: Path) -> None:
    path = write_identification(given, tmp_path / "fit.h5")
    assert equal(load_identification(path), given)
    assert problems(path) == []


def test_other_specs_take_the_estimates(tmp_path: Path) -> None:
    from mbdkit.archive.identified_parameters import read_identified

    names, values, covariance, reasons = read_identified(write_identification(result(), tmp_path / "fit.h5"))
    assert names == ["stiffness", "damping", "mass"]
    assert values.tolist() == [12.0, 0.02, 2.0]  # the mean of damping, whose estimate is at its bound
    np.testing.assert_array_equal(covariance, COVARIANCE)
    assert reasons == ["", "", "the data do not determine it"]


def test_xarray_sees_axes_and_units(tmp_path: Path) -> None:
    path = write_identification(result(), tmp_path / "fit.h5")
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        assert tree.attrs["format"] == "mbdkit-identification"
        assert [tree.attrs[name] for name in ("title", "description", "Conventions")] == [
            "A leg", "Result of an identification", "mbdkit-identification-1.0",
        ]  # fmt: skip
        matrix = tree["parameters"].ds["covariance"]
        assert matrix.sel(parameter="stiffness", other="damping") == -0.001
        assert tree["parameters"].ds["unit"].values.tolist() == ["N m/rad", "N m s/rad", "kg"]
        measured = tree["residuals/0"].ds["measured"]
        assert (measured.dims, measured.attrs["units"], measured["time"].attrs["units"]) == (("time",), "rad", "s")
        widths = tree["next_experiment"].ds["half_width"]
        assert widths.sel(candidate="swing: further", estimate="stiffness") == 0.2


def test_a_file_is_replaced_only_if_it_may_be_and_when_the_new_one_is_complete(tmp_path: Path) -> None:
    path = write_identification(result(), tmp_path / "fit.h5")
    before = path.read_bytes()
    with pytest.raises(SpecError, match="exists already"):
        write_identification(result(), path)
    with pytest.raises(AttributeError):
        write_identification(replace(result(), residuals=(None,)), path, overwrite=True)  # type: ignore[arg-type]
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == ["fit.h5"]
    write_identification(result(verdict="good"), path, overwrite=True)
    assert load_identification(path).verdict == "good"
    with pytest.raises(SpecError, match=r"ends in \.h5"):
        write_identification(result(), tmp_path / "fit.txt")


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-2000])


def remove(name: str, path: Path) -> None:
    with h5py.File(path, "a") as file:
        del file[name]


def change(name: str, value: object, path: Path) -> None:
    with h5py.File(path, "a") as file:
        file.attrs[name] = value


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (truncate, "truncated"),
        (lambda path: path.write_text("a text"), "not an HDF5 file, so not a result of an identification"),
        (lambda path: remove("parameters/value", path), "this file is damaged"),
        (lambda path: remove("parameters", path), "this file is damaged"),
        (lambda path: change("spec", "[1, 2", path), "this file is damaged"),
        (lambda path: change("base", "[]", path), "this file is damaged"),
        (lambda path: change("evaluations", "many", path), "this file is damaged"),
        (lambda path: change("format_version", 2, path), "has the format version 2; this mbdkit reads 1"),
        (lambda path: change("format", "netcdf", path), "not the result of an identification"),
    ],
)
def test_damaged_and_foreign_files_are_refused_in_one_sentence(damage, sentence: str, tmp_path: Path) -> None:
    path = write_identification(result(), tmp_path / "fit.h5")
    damage(path)
    with pytest.raises((SpecError, ArchiveError), match=sentence) as caught:
        load_identification(path)
    assert len(str(caught.value).splitlines()) == 1


def test_a_file_with_another_word_for_its_verdict_is_refused(tmp_path: Path) -> None:
    path = write_identification(result(verdict="excellent"), tmp_path / "fit.h5")  # sealed again by who changed it
    with pytest.raises(ArchiveError, match="this file is damaged"):
        load_identification(path)


def test_missing_and_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=r"no result of an identification of this name"):
        load_identification(tmp_path / "fit.h5")
    bare = write_identified(tmp_path / "bare.h5", {"mass": 1.0}, [[1.0]])
    with pytest.raises(ArchiveError, match="damaged"):
        load_identification(bare)
    mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01}).save(tmp_path / "run.h5")
    with pytest.raises(SpecError, match="this is an HDF5 file, but not the result of an identification"):
        load_identification(tmp_path / "run.h5")
    assert problems(tmp_path / "run.h5") is None


@pytest.mark.parametrize("place", ["parameters/value", "verdict", "parameters/value@unit"])
def test_a_changed_file_is_refused_by_all_that_read_it(tmp_path: Path, place: str) -> None:
    from mbdkit.archive.identified_parameters import read_identified

    path = write_identification(result(), tmp_path / "fit.h5")
    with h5py.File(path, "a") as file:
        name, _, attribute = place.partition("@")
        if attribute:
            file[name].attrs["units"] = "kg"
        elif name in file:
            file[name][0] = 13.0
        else:
            file.attrs[name] = "good"
    for read in (load_identification, read_identified):
        with pytest.raises(ArchiveError, match="changed since"):
            read(path)
    assert "changed since" in problems(path)[0]
