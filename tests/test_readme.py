"""The README says the truth: its code runs as printed, and what it says of the source paper is what the study says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mbdkit.cli import app
from mbdkit.guide.pages import find_page, pages
from tests.first_party import PACKAGES
from tests.printed_code import fenced_blocks, run_blocks

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
TITLE = re.findall(r"\*(A Comparative Analysis .*?)\*", " ".join(README.split()))[0]
"""Title of the source paper."""

SHELL = "python3 -m venv"
"""Beginning of the blocks that a shell runs, not this process; continuous integration does."""


def flat(text: str) -> str:
    """Return text on one line, without the marks of quotations."""
    return " ".join(text.replace("\n> ", "\n").split())


def test_it_has_fits_on_two_screens() -> None:
    assert len(README.splitlines()) <= 150


@pytest.mark.filterwarnings("ignore:FigureCanvasAgg is non-interactive")
def test_its_examples_run_as_printed(in_tmp_path: Path) -> None:
    judged = run_blocks([block for block in fenced_blocks(README) if not block.code.startswith(SHELL)], in_tmp_path)
    assert [reason for one in judged if one.level in ("doubtful", "bad") for reason in one.reasons] == []
    assert {"knee-forces.png", "crank.h5", "crank-report.html", "longer.h5"} <= {p.name for p in in_tmp_path.iterdir()}


@pytest.mark.parametrize("title", ["Run", "Test"])
def test_a_section_begins_with_its_one_command(title: str) -> None:
    (section,) = re.findall(rf"^## {title}\n(.*?)(?=^## |\Z)", README, flags=re.MULTILINE | re.DOTALL)
    first = fenced_blocks(section)[0]
    assert first.language == "sh"
    assert first.code.startswith(SHELL)
    assert len(first.code.splitlines()) <= 3
    assert all(line.endswith("&&") for line in first.code.splitlines()[:-1])


def test_its_table_and_the_guide_have_the_same_groups() -> None:
    _, *sections = re.split(r"^\| \*\*(.+?)\*\* \|  \|$", README.partition("\n## Test")[0], flags=re.MULTILINE)
    linked = {
        name: set(re.findall(r"/guide/([\w-]+)\.md\)", text))
        for name, text in zip(sections[::2], sections[1::2], strict=True)
    }
    shown: dict[str, set[str]] = {}
    for page in pages().values():
        shown.setdefault(page.group, set()).add(page.topic)
    assert list(linked) == list(shown)
    assert linked == shown


def test_it_links_every_page_of_the_guide() -> None:
    pages = {path.name for folder in PACKAGES.values() for path in (folder / "guide").glob("*.md")}
    assert pages == set(re.findall(r"\((?:mbdkit|plugins/mbdkit-\w+/src/mbdkit_\w+)/guide/([\w-]+\.md)\)", README))


def test_the_source_paper_is_cited_by_its_title() -> None:
    shown = CliRunner().invoke(app, ["plugins", "show", "paper"], prog_name="mbdkit").stdout
    for text in (README, find_page("paper").text, (ROOT / "CITATION.cff").read_text(encoding="utf-8"), shown):
        assert TITLE in flat(text)
