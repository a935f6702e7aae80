"""What parts and example plugins import from the core: names for plugins, and a list of all others."""

from __future__ import annotations

import pytest

from tests.first_party import ROOT
from tests.private_names import LIST, listing, private_imports

EXAMPLES = sorted(project.parent for project in (ROOT / "plugins").glob("*/pyproject.toml"))


def test_the_list_of_private_names_is_what_the_parts_import() -> None:
    hint = "`python -m tests.private_names` writes the list; a name is better added to mbdkit.plugin"
    assert LIST.read_text(encoding="utf-8").splitlines() == listing().splitlines(), hint


@pytest.mark.parametrize("folder", EXAMPLES, ids=lambda folder: folder.name)
def test_an_example_plugin_imports_only_public_names(folder) -> None:
    assert [found for file in (folder / "src").rglob("*.py") for found in private_imports(file)] == []
