"""The map of the code names files that exist, and every room."""

from __future__ import annotations

import re
from pathlib import Path

import mbdkit

ROOT = Path(mbdkit.__file__).parent
MAP = (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_file_of_the_map_exists() -> None:
    rows = [line.split("|")[2] for line in MAP.splitlines() if line.startswith("| ") and "`" in line]
    named = [name for row in rows for name in re.findall(r"`([a-z_0-9/]+(?:\.py|/))`", row)]
    assert len(named) > 40
    missing = [name for name in named if not (ROOT / name).exists()]
    assert not missing
    in_prose = re.findall(r"`((?:engine|stepping|archive|models)/[a-z_0-9/]+\.py)`", MAP)
    assert all((ROOT / name).is_file() for name in in_prose)


def test_the_map_names_every_room() -> None:
    rooms = {path.name for path in ROOT.iterdir() if (path / "__init__.py").is_file()}
    assert not {room for room in rooms if not re.search(rf"\b{room}\b", MAP)}


def test_no_two_files_share_a_name() -> None:
    # a packaged study is a folder with a file `verdict.py`; the room analysis has the class Verdict
    names = [path.name for path in ROOT.rglob("*.py") if path.name not in ("__init__.py", "__main__.py", "verdict.py")]
    assert sorted(names) == sorted(set(names))
