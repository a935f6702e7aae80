"""Files that this part generates are fresh."""

from __future__ import annotations

from mbdkit.guide.pages import find_page
from mbdkit.registry.manager import registry
from mbdkit_testing import history_columns, layout_document, spec_page
from tests.archive.making import DOCUMENT


def test_declarations_of_columns_are_fresh() -> None:
    text = history_columns.TARGET.read_text(encoding="utf-8")
    assert history_columns.declarations() == text, "run: python -m mbdkit_testing.history_columns"


def test_document_is_fresh() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    assert layout_document.renewed(text) == text, "run: python -m mbdkit_testing.layout_document schemas/archive.md"


def test_the_reference_of_specs_is_fresh() -> None:
    fresh = spec_page.page(registry().only("mbdkit"))
    assert find_page("spec").text == fresh, "stale: python -m mbdkit_testing.spec_page mbdkit/guide/spec.md"
