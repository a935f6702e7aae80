"""The public doors are small and recorded; guests and plugins of others use nothing else; parts use fewer names."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path

import pytest

from tests.core_names import BUDGET, counts
from tests.first_party import PACKAGES, PARTS, ROOT, import_statements
from tests.public_door import FACES, GUESTS, entries, lines, reasons

pytestmark = pytest.mark.end_to_end  # of the sources alone

MOST_ENTRIES = 317
"""Entries on all public doors; the number may only fall until the first release."""

OUTSIDE = {project.parent.name: project.parent / "src" for project in (ROOT / "plugins").glob("*/pyproject.toml")} | {
    part: PARTS[part] for part in GUESTS
}
"""Sources of the distributions of their own, and of the parts that are written like these."""


def test_public_names_and_their_signatures_are_recorded() -> None:
    recorded = Path(__file__).with_name("public_door.txt").read_text(encoding="utf-8").splitlines()
    hint = "a promise changes: `python -m tests.public_door > tests/public_door.txt`, and say so in the commit"
    assert list(lines()) == recorded, hint


def test_the_public_doors_stay_small() -> None:
    assert len(entries()) <= MOST_ENTRIES


def test_each_public_name_is_used_by_a_guest_a_plugin_of_others_a_template_or_the_guide() -> None:
    assert [".".join(entry) for entry, users in reasons().items() if not users] == []


def test_each_name_is_behind_one_door() -> None:
    """Users need some of the names that authors of plugins need, which are in `mbdkit` too."""
    homes = [(home, name) for face, name, home in entries() if face not in ("mbdkit", "mbdkit.testing")]
    assert len(set(homes)) == len(homes)


@pytest.mark.skipif(not PARTS, reason="doors lead to all parts")
def test_pages_and_docstrings_of_doors_name_functions_that_are_on_doors() -> None:
    """A page once named `load_inverse_spec`, which only inner modules have."""
    known = {name for _, name, _ in entries()} | {"load_frame"}  # a column of measured loads
    pages = [*ROOT.glob("mbdkit/guide/*.md"), *ROOT.glob("plugins/*/src/*/guide/*.md"), ROOT / "README.md"]
    texts = {page.name: page.read_text(encoding="utf-8") for page in pages}
    for face, name, _ in entries():
        texts[f"{face}.{name}"] = getattr(importlib.import_module(face), name).__doc__ or ""
    assert len(texts) > 100
    unknown = {place: set(re.findall(r"\bload_\w+", text)) - known for place, text in texts.items()}
    assert {place: names for place, names in unknown.items() if names} == {}


@pytest.mark.parametrize("name", sorted(OUTSIDE))
def test_guests_and_plugins_of_others_import_public_names_only(name: str) -> None:
    inner = [
        f"{file.name}: {module}"
        for file in OUTSIDE[name].rglob("*.py")
        for node in import_statements(file)
        for module in ([str(node.module)] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names])
        if module.partition(".")[0] in (PACKAGES.keys() - {name}) and module not in {*FACES, "mbdkit.testing"}
    ]
    assert inner == []


def test_parts_use_as_many_names_of_the_core_as_their_budget_says() -> None:
    budget = dict(line.split() for line in BUDGET.read_text(encoding="utf-8").splitlines())
    hint = "`python -m tests.core_names --names` lists them; where there are fewer, write the file again"
    assert {name: str(count) for name, count in counts().items()} == budget, hint
