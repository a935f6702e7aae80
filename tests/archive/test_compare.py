"""Two runs are the same to the bit, or the difference is told array by array."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit.archive.compare import Comparison, compare
from mbdkit.archive.fingerprint import seal
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import Ending
from mbdkit.base.errors import ArchiveError

from .making import PROVENANCE, SPEC, STATS, largest, make, names, rows, steps, writer


def changed(path: str, change: object, **options: object) -> Run:
    """Return a run in memory in which the rows at `path` are changed."""
    into = writer(None, **options)  # type: ignore[arg-type]
    made = rows(11, names())
    into.append({**made, path: change(made[path])})  # type: ignore[operator]
    into.append_numbered("steps", steps(10))
    return Run(into.finish(Ending("complete", "", STATS, largest(11, names()))))


def compared(other: Run) -> Comparison:
    with Run(make(None)) as run, other:
        return compare(run, other)


def test_same_data_in_file_and_memory(archive: Path) -> None:
    result = compared(load(archive))
    assert result.same_data
    assert result.same_spec
    assert result.largest == 0.0
    assert result.versions == {}
    assert str(result) == "the data are the same to the bit"


def test_difference_is_relative_to_the_largest_of_the_array() -> None:
    def change(values: np.ndarray) -> np.ndarray:
        new = values.copy()
        new[3] += 1e-6
        return new

    result = compared(changed("energy/total", change))
    assert not result.same_data
    assert result.same_spec
    scale = rows(11, names())["energy/total"].max()
    assert result.differences["energy/total"] == pytest.approx(1e-6 / scale, rel=1e-6)
    assert [path for path, value in result.differences.items() if value] == ["energy/total"]
    assert result.largest == result.differences["energy/total"]
    assert "energy/total" in str(result)
    assert "energy/work" not in str(result)


def test_what_is_zero_in_one_run_is_compared_with_the_other() -> None:
    assert compared(changed("energy/work", np.zeros_like)).differences["energy/work"] == 1.0


def test_value_that_is_not_finite_in_one_run_differs_without_bound() -> None:
    def change(values: np.ndarray) -> np.ndarray:
        return np.where(np.arange(11) == 4, np.nan, values)

    assert compared(changed("energy/total", change)).largest == np.inf


def test_other_shapes_and_names_differ_without_bound() -> None:
    result = compared(Run(make(None, count=12)))
    assert result.differences["energy/total"] == np.inf
    assert result.differences["trajectory/body"] == 0.0
    result = compared(Run(make(None, quantities=frozenset())))
    assert result.differences["energy/total"] == np.inf
    named = names()
    other = replace(named, bodies=["rod1", "rod3"])
    assert compared(Run(make(None, named=other))).differences["trajectory/body"] == np.inf


def test_specs_and_versions_that_differ_are_told() -> None:
    other = make(
        None, spec={**SPEC, "title": "x"}, provenance={**PROVENANCE, "numpy": "1.26", "scipy": "1.11", "command": "y"}
    )
    result = compared(Run(other))
    assert result.same_data
    assert not result.same_spec
    assert result.versions == {"numpy": ("2.4.6", "1.26"), "scipy": ("", "1.11")}
    told = ["the specs differ", '  title: none and "x"', "numpy: 2.4.6 and 1.26", "scipy: none and 1.11"]
    assert str(result).splitlines()[1:] == told


def test_keys_and_main_numbers_that_differ_are_told() -> None:
    """A rod that hangs at rest weighs ``m g``, with the standard gravity of the guide."""
    model = {"name": "single-pendulum", "mass": 1.0, "angle": -np.pi / 2}
    spec = {"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.01}}
    result = compare(mbdkit.run(spec), mbdkit.run({**spec, "model": {**model, "mass": 2.0}}))
    assert result.settings == {"model.mass": ("1.0", "2.0")}
    assert result.answers == {"largest force in J1": ("9.81 N", "19.62 N")}
    assert str(result).splitlines()[-3:] == [
        "the specs differ", "  model.mass: 1.0 and 2.0", "largest force in J1: 9.81 N and 19.62 N",
    ]  # fmt: skip


def test_names_and_values_do_not_add_lines() -> None:
    forged = "1\nthe data are the same to the bit"
    other = make(None, provenance={**PROVENANCE, "numpy": forged, forged: "x"})
    other["energy"][forged] = [1.0]
    seal(other)
    told = str(compared(Run(other))).splitlines()
    assert any(line.startswith("the data differ") for line in told)
    assert "the data are the same to the bit" not in told


def test_crashed_runs_are_never_the_same(tmp_path: Path) -> None:
    into = writer(tmp_path / "run.h5")
    into._write_more()
    assert into._target is not None
    into._target.close()
    with load(tmp_path / "run.h5.part") as one, load(tmp_path / "run.h5.part") as two:
        assert not compare(one, two).same_data


@pytest.mark.parametrize(
    ("path", "what"), [("trajectory/position", "trajectory/position has changed"), ("", "its attributes have changed")]
)
def test_archives_that_were_changed_are_not_compared(archive: Path, path: str, what: str) -> None:
    with h5py.File(archive, "r+") as file:
        if path:
            file[path][3, 0, 0] += 1.0
        else:
            file["stats"].attrs["steps"] = np.int64(11)
    with pytest.raises(ArchiveError, match=what):
        compared(load(archive))
