"""Crates for catalogues: what RO-Crate and its profile ask for is there, and nothing of the machine or the user.

`roc-validator` accepts such crates at its severities REQUIRED and RECOMMENDED (version 0.13.0); it needs the network.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import tempfile
from pathlib import Path
from typing import Any

import h5py
import pytest

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.base.errors import ResourceError, SpecError
from mbdkit_report.crate import METADATA, write_crate

META = {"description": "A rod swings.", "creator": "Ada Lovelace <https://orcid.org/0000-0001>", "license": "CC0-1.0"}
SPEC = {"mbdkit": 1, "title": "A swing", "model": {"name": "single-pendulum"}, "integrator": {"name": "rk4"}}
SPEC |= {"time": {"end": 0.1, "step": 0.01}}


def crate_of(folder: Path, **further: Any) -> tuple[Path, dict[str, dict[str, Any]]]:
    """Return a crate of one run, and its entities by their identifiers."""
    mbdkit.run(SPEC | further, archive=folder / "swing.h5").close()
    write_crate([folder / "swing.h5"], folder / "crate")
    graph = json.loads((folder / "crate" / METADATA).read_text(encoding="utf-8"))["@graph"]
    return folder / "crate", {entity["@id"]: entity for entity in graph}


def test_a_crate_says_who_made_what_from_what_by_which_software(tmp_path: Path) -> None:
    folder, entities = crate_of(tmp_path, meta=META)
    assert check(folder) == []
    root, descriptor = entities["./"], entities[METADATA]
    assert descriptor["conformsTo"] == {"@id": "https://w3id.org/ro/crate/1.1"}
    assert root["conformsTo"] == {"@id": "https://w3id.org/ro/wfrun/process/0.5"}
    assert (root["name"], root["description"]) == ("A swing", "A rod swings.")
    assert root["author"] == {"@id": "https://orcid.org/0000-0001"}
    assert entities["https://orcid.org/0000-0001"]["name"] == "Ada Lovelace"
    assert root["license"] == {"@id": "https://spdx.org/licenses/CC0-1.0"}
    action = entities[root["mentions"]["@id"]]
    assert action["@type"] == "CreateAction"
    assert {"@id": "swing.h5"} in action["result"]
    assert entities[action["instrument"]["@id"]]["softwareVersion"] == mbdkit.__version__
    files = {path.name for path in folder.iterdir()} - {METADATA}
    assert files == {entity["@id"] for entity in root["hasPart"]}
    with mbdkit.load(tmp_path / "swing.h5") as before, mbdkit.load(folder / "swing.h5") as after:
        assert entities["swing.h5"]["identifier"] == before.data_sha256 == after.data_sha256
    referenced = [one["@id"] for one in _references([*entities.values()]) if not one["@id"].startswith("https://w3id")]
    assert set(referenced) <= entities.keys()


def test_a_damaged_archive_is_refused_because_its_copy_would_have_hashes_of_its_own(tmp_path: Path) -> None:
    mbdkit.run(SPEC, archive=tmp_path / "swing.h5").close()
    with h5py.File(tmp_path / "swing.h5", "r+") as file:
        file["trajectory/position"][5, 0, 0] = 99.0
    with pytest.raises(SpecError, match=r"damaged: .*trajectory/position has changed"):
        write_crate([tmp_path / "swing.h5"], tmp_path / "crate")
    assert not (tmp_path / "crate").exists()


def _references(value: Any) -> list[dict[str, str]]:
    if isinstance(value, dict) and value.keys() == {"@id"}:
        return [value]
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [one for item in inner for one in _references(item)]


def test_a_crate_has_nothing_of_the_machine_or_the_user_unasked(tmp_path: Path) -> None:
    folder, entities = crate_of(tmp_path)
    with mbdkit.load(tmp_path / "swing.h5") as run:
        known = [str(run.provenance[name]) for name in ("platform", "processor", "command")]
    assert platform.platform() in known
    content = b"".join(path.read_bytes() for path in folder.iterdir())
    for text in filter(None, (*known, str(tmp_path))):
        assert text.encode() not in content
    assert entities["./"]["author"] == {"@id": "#unnamed"}


def test_a_crate_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mbdkit.run(SPEC, archive=tmp_path / "swing.h5").close()

    def refuse(*arguments: Any, **options: Any) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), f"{tmp_path}/.crate-xyz")

    monkeypatch.setattr(tempfile, "TemporaryDirectory", refuse)
    with pytest.raises(ResourceError, match=f"^{tmp_path}/crate: .* cannot be written: {os.strerror(errno.EROFS)}$"):
        write_crate([tmp_path / "swing.h5"], tmp_path / "crate")


def test_metadata_nested_too_deeply_are_damage(tmp_path: Path) -> None:
    (tmp_path / METADATA).write_text("[" * 100_000)
    (problem,) = check(tmp_path)
    assert problem.startswith(f"{METADATA} is damaged")


@pytest.mark.parametrize("name", ["swing.h5", "swing-spec.json"])
def test_a_changed_or_missing_file_of_a_crate_is_a_problem(name: str, tmp_path: Path) -> None:
    folder, _ = crate_of(tmp_path)
    content = bytearray((folder / name).read_bytes())
    content[-1] ^= 1
    (folder / name).write_bytes(content)
    assert check(folder) == [f"{name}: it has changed since the crate was written"]
    (folder / name).unlink()
    assert check(folder) == [f"{name}: there is no such file in the folder"]


def test_a_crate_that_exists_is_not_replaced(tmp_path: Path) -> None:
    crate_of(tmp_path)
    with pytest.raises(SpecError, match="folder"):
        write_crate([tmp_path / "swing.h5"], tmp_path / "crate")
