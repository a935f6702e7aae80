"""Archives hold the mechanism that was run: they are read and drawn without its model, and without opening a file.

Expected drawings are those of the mechanism that the model itself builds.
"""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import pytest

import mbdkit
from mbdkit.archive.fingerprint import seal
from mbdkit.archive.stored_mechanism import mechanism_json, read_mechanism
from mbdkit.mechanism.mechanism import Mechanism
from tests.archive.stored import SHORT, stored, swing


def test_bodies_have_the_order_of_the_archive() -> None:
    m = Mechanism()
    m.body("first", mass=1.0)
    m.beam("arm", a=(0, 0), b=(1, 0), elements=2, A=1e-4, I=1e-9, E=1e9, nu=0.3, density=1e3)
    m.body("last", mass=1.0)
    read = read_mechanism(mechanism_json(m), list(m.bodies))
    assert read.mechanism is not None
    assert list(read.mechanism.bodies) == ["first", "arm.0", "arm.1", "arm.2", "last"]


def test_unknown_bodies_leave_only_points() -> None:
    data = json.loads(mechanism_json(swing()))
    data["bodies"]["rod"]["color"] = "red"
    read = stored(data)
    assert read.mechanism is None
    assert read.not_drawn == "this version of mbdkit does not know all of its bodies, so only points are drawn"


@pytest.mark.parametrize("text", ["", "[]", "3", "[" * 100_000, '{"bodies": 3}', '{"gravity": "x"}', '{"assembly": 1}'])
def test_a_damaged_mechanism_is_an_error_about_the_archive(tmp_path: Path, text: str) -> None:
    with mbdkit.run(swing(), archive=tmp_path / "a.h5", **SHORT):
        pass
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file.attrs["mechanism"] = text
        seal(file)
    with mbdkit.load(tmp_path / "a.h5") as run, pytest.raises(mbdkit.ArchiveError, match=r"a\.h5"):
        assert run.mechanism


def test_a_run_in_memory_and_its_copy_have_the_mechanism(tmp_path: Path) -> None:
    with mbdkit.run(swing(), **SHORT) as run:
        run.save(tmp_path / "a.h5")
        with mbdkit.load(tmp_path / "a.h5") as copy:
            assert copy.mechanism.to_spec() == run.mechanism.to_spec() == swing().to_spec()
            assert copy.files == ()
