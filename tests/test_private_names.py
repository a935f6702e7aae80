"""Parts use the doors that strangers use; the names that have no door become fewer."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.first_party import ROOT
from tests.private_names import BUDGET, counts, inner_imports, private_names, public_names

EXAMPLES = sorted(project.parent for project in (ROOT / "plugins").glob("*/pyproject.toml"))


def test_parts_import_public_names_from_their_doors() -> None:
    public = public_names()
    wrong = [
        f"{part}: {name} of {module} is in {public[module, name][0]}"
        for part, modules in private_names().items()
        for module, names in modules.items()
        for name in names
        if (module, name) in public
    ]
    assert not wrong


def test_each_part_imports_as_many_private_names_as_its_budget_says() -> None:
    budget = dict(line.split() for line in BUDGET.read_text(encoding="utf-8").splitlines())
    hint = "add no private name (`python -m tests.private_names` lists them); where there are fewer, lower the budget"
    assert {part: str(count) for part, count in counts().items()} == budget, hint


def test_each_name_is_behind_one_door() -> None:
    """Users need some of the names that authors of plugins need, which are in `mbdkit` too."""
    doors = {place: [face for face in faces if face != "mbdkit"] for place, faces in public_names().items()}
    assert {place: faces for place, faces in doors.items() if len(faces) > 1} == {}


@pytest.mark.parametrize("folder", EXAMPLES, ids=lambda folder: folder.name)
def test_an_example_plugin_imports_only_public_names(folder: Path) -> None:
    assert [found for file in (folder / "src").rglob("*.py") for found in inner_imports(file)] == []
