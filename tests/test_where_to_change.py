"""The maps of the code, or `mbdkit plugins where`, lead to the files that thirty earlier changes needed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from mbdkit.cli import app
from mbdkit.registry.manager import registry
from mbdkit.spec.yaml_reader import read_data
from tests.first_party import MAPS, PACKAGES, ROOT

pytestmark = pytest.mark.end_to_end  # of the sources alone

QUESTIONS = read_data((Path(__file__).parent / "where_to_change.yaml").read_text(encoding="utf-8"))

MOST_IN_ROW = 12
"""A folder or a pattern of file names in a map leads to a file only if it stands for at most this many files."""


@cache
def python_files(folder: Path) -> tuple[str, ...]:
    """Return the paths of all modules below a folder, which count from it."""
    return tuple(path.relative_to(folder).as_posix() for path in folder.rglob("*.py"))


def of_map(text: str, folder: Path) -> set[Path]:
    """Return the files that the tables of a map name, by paths that count from a folder."""
    named = set()
    cells = [cell for line in text.splitlines() if line.startswith("| ") for cell in line.split("|")[2:]]
    for name in (name for cell in cells for name in re.findall(r"`([\w/*.-]+(?:\.py|/))`", cell)):
        found = [folder / path for path in python_files(folder) if fnmatch(path, _pattern(name))]
        if len(found) <= MOST_IN_ROW:
            named |= set(found)
    return named


def _pattern(name: str) -> str:
    return f"{name}*" if name.endswith("/") else name


@cache
def of_maps() -> frozenset[Path]:
    return frozenset().union(
        *(of_map(path.read_text(encoding="utf-8"), PACKAGES[name]) for name in PACKAGES for path in MAPS[name])
    )


@cache
def where(name: str) -> dict[str, Any]:
    """Return what `mbdkit plugins where` prints."""
    found: dict[str, Any] = json.loads(CliRunner().invoke(app, ["plugins", "where", name, "--json"]).stdout)
    return found


def of_items(question: str) -> set[Path]:
    """Return the files that `mbdkit plugins where` prints for the names that a question contains."""
    names = {item.name for item in registry().items}
    found = [where(name) for name in names if re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", question)]
    return {Path(place["file"]).resolve() for one in found for item in one["items"] for place in item["places"]}


def unreached(question: dict[str, Any], maps: Iterable[Path]) -> list[str]:
    """Return the files of the answer to a question that neither maps nor the items in the question name."""
    known = {path.resolve() for path in maps} | of_items(question["question"])
    return [name for name in question["files"] if (ROOT / name).resolve() not in known]


def test_thirty_different_questions_have_answers() -> None:
    assert len({one["question"] for one in QUESTIONS}) == len({one["commit"] for one in QUESTIONS}) == 30
    assert all(1 <= len(one["files"]) <= 3 for one in QUESTIONS)
    files = [name for one in QUESTIONS for name in one["files"]]
    assert not [name for name in files if not (ROOT / name).is_file()]


@pytest.mark.parametrize("question", QUESTIONS, ids=lambda one: Path(one["files"][0]).stem)
def test_a_question_does_not_name_its_answer(question: dict[str, Any]) -> None:
    stems = {Path(name).stem for name in question["files"]}
    words = re.sub(r"[\W_]+", " ", question["question"].lower())
    assert not [stem for stem in stems if f" {stem.replace('_', ' ')} " in f" {words} "]


@pytest.mark.parametrize("question", QUESTIONS, ids=lambda one: Path(one["files"][0]).stem)
def test_maps_or_items_lead_to_every_file_of_an_answer(question: dict[str, Any]) -> None:
    assert not unreached(question, of_maps())


def test_most_answers_are_not_found_without_the_maps() -> None:
    assert sum(bool(unreached(one, ())) for one in QUESTIONS) > 25


def test_a_folder_of_many_files_leads_to_none() -> None:
    core = PACKAGES["mbdkit"]
    assert not of_map("| any | `runs/` |", core)
    assert of_map("| any | `runs/row_*.py` |", core) == {core / "runs" / "row_criteria.py"}
