"""The maps of the code, in the README of the core and of each part, name files that exist, and every room."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.first_party import MAPS, PACKAGES, ROOT, modules

pytestmark = pytest.mark.end_to_end  # of the sources alone

CORE = (ROOT / "mbdkit" / "README.md").read_text(encoding="utf-8")
MOST_ROWS = 20
"""Largest number of rows of a map."""


def rows(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8").partition("| to change | open |")[2]
    return [line for line in text.splitlines() if line.startswith("| ") and "`" in line]


def files_of_map(path: Path) -> list[str]:
    return [file for row in rows(path) for file in re.findall(r"`([a-z_0-9/]+(?:\.py|/))`", row.split("|")[2])]


@pytest.mark.parametrize("name", PACKAGES)
def test_every_file_of_the_map_exists(name: str) -> None:
    named = [file for path in MAPS[name] for file in files_of_map(path)]
    assert named
    assert not [file for file in named if not (PACKAGES[name] / file).exists()]


@pytest.mark.parametrize("name", ["mbdkit_opensim", "mbdkit_robots"])
def test_every_file_of_the_map_of_an_example_of_plugins_exists(name: str) -> None:
    folder = ROOT / "plugins" / name.replace("_", "-")
    named, sources = files_of_map(folder / "README.md"), folder / "src" / name
    assert {file.name for file in sources.glob("*.py")} - set(named) == {"__init__.py"}
    assert not [file for file in named if not (sources / file).exists()]


@pytest.mark.parametrize("name", PACKAGES)
def test_the_map_is_short(name: str) -> None:
    assert max(len(rows(path)) for path in MAPS[name]) <= MOST_ROWS


def test_the_map_of_the_core_names_every_room() -> None:
    rooms = {path.name for path in (ROOT / "mbdkit").iterdir() if (path / "__init__.py").is_file()}
    assert not {room for room in rooms if not re.search(rf"\b{room}\b", CORE)}
    in_prose = re.findall(r"`((?:engine|integrators|archive|models)/[a-z_0-9/]+\.py)`", CORE)
    assert all((ROOT / "mbdkit" / name).is_file() for name in in_prose)


def test_no_two_files_of_a_package_share_a_name() -> None:
    # a packaged study is a folder with a file `verdict.py`; doors are named after the rooms behind them
    for package in PACKAGES:
        inside = (path for name, path in modules().items() if name.split(".")[0] == package)
        names = [path.name for path in inside if path.parent.name != "plugin"]
        names = [name for name in names if name not in ("__init__.py", "__main__.py", "verdict.py")]
        assert sorted(names) == sorted(set(names))
