"""What `archive info` tells."""

from __future__ import annotations

import json
from pathlib import Path

from mbdkit.archive.info import describe, text
from mbdkit.quantities.registered_kinds import array_at

from .making import PROVENANCE, STATS, make, names, writer


def test_description_is_json_and_complete(archive: Path) -> None:
    told = json.loads(json.dumps(describe(archive), allow_nan=False))
    assert told["bytes"] == archive.stat().st_size
    assert (told["rows"], told["start"], told["end"]) == (11, 0.0, 0.1)
    assert told["bodies"] == ["rod1", "rod2"]
    assert told["misalignment_max"] == {"J1": 1.0, "J2": 1.001}
    assert told["provenance"] == PROVENANCE
    assert {name: told["stats"][name] for name in STATS} == STATS
    for path, array in told["arrays"].items():
        assert array["dims"] == list(array_at(path).dims)
        assert array["units"] == array_at(path).units
    assert told["arrays"]["joints/reaction_force"]["shape"] == [11, 2, 2]


def test_description_of_what_a_crashed_run_left(tmp_path: Path) -> None:
    into = writer(tmp_path / "run.h5", quantities=frozenset())
    into._write_more()
    assert into._target is not None
    into._target.close()
    told = describe(tmp_path / "run.h5.part")
    assert (told["status"], told["rows"], told["end"]) == ("running", 0, None)
    assert json.dumps(told, allow_nan=False)
    assert "status            running" in text(told)


def test_text_of_a_description_fits_its_names(tmp_path: Path) -> None:
    make(tmp_path / "run.h5", named=names(100, 100))
    written = text(describe(tmp_path / "run.h5"))
    assert "rod32, ... (100 in all)" in written
    assert "joints/reaction_force              (time 11, joint 100, axis 2)  N" in written
    assert max(map(len, written.splitlines())) < 800
