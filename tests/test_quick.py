"""The list of quick tests has some of every room of the core and of every part; slow tests of the list exist."""

from __future__ import annotations

from pathlib import Path

from tests.first_party import PARTS, ROOT
from tests.fixtures import QUICK, SLOW
from tests.imports import imported_names


def files(listed: str) -> list[Path]:
    path = ROOT / listed.partition("::")[0]
    return [path] if path.is_file() else sorted(path.rglob("test_*.py"))


def test_what_is_listed_exists() -> None:
    assert not [listed for listed in QUICK if not files(listed)]


def test_slow_tests_exist() -> None:
    places = [name.split("::") for name in SLOW]
    assert not [where for where in places if f"def {where[1]}(" not in (ROOT / where[0]).read_text("utf-8")]


def test_every_room_is_imported_and_every_part_has_tests() -> None:
    rooms = {path.parent.name for path in (ROOT / "mbdkit").glob("*/__init__.py")}
    imported = {
        name.split(".")[1] for listed in QUICK for file in files(listed) for name in imported_names(file) if "." in name
    }
    assert rooms <= imported
    folders = {listed.split("/")[1].replace("-", "_") for listed in QUICK if listed.startswith("plugins/")}
    assert folders == set(PARTS)
