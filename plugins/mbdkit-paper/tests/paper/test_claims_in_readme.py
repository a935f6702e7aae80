"""What README and guide say of the source paper is what the study says."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import mbdkit
from mbdkit.guide.pages import find_page
from mbdkit_paper.paper.published_results import magnitudes
from mbdkit_paper.paper.source_paper import BIBTEX, TITLE
from mbdkit_report import Answer
from mbdkit_studies.results.judge import judge
from mbdkit_studies.spec.study_loading import load_study_spec
from tests.benchmarks.paper_page import BEGIN, END, IN_SHORT, OF_A_MACHINE, full_entry
from tests.first_party import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")


def flat(text: str) -> str:
    """Return text on one line, without the marks of quotations."""
    return " ".join(text.replace("\n> ", "\n").split())


def test_the_citation_has_the_title() -> None:
    assert TITLE in flat(README)
    assert TITLE in flat(BIBTEX)


def test_its_claims_are_those_of_the_page_on_the_paper() -> None:
    # one command writes both, from the verdict of the study
    page = flat(find_page("paper").text)
    _, _, rest = README.partition(BEGIN)
    claims = [flat(claim) for claim in rest.partition(END)[0].split("\n- ")[1:]]
    assert len(claims) == len(IN_SHORT)
    for claim in claims:
        statement, found = claim.split(" Found: ")
        assert re.search(re.escape(statement) + " Published: .*?" + re.escape(f"Found: {found}"), page), claim


def paper_study(families: tuple[str, ...], folder: Path, workers: int) -> mbdkit.Study:
    """Run some families of the packaged study."""
    spec = json.loads(load_study_spec("paper").canonical_json())
    spec["families"] = {name: family for name, family in spec["families"].items() if name in families}
    return mbdkit.study(spec, out=folder, workers=workers)


def test_the_page_on_the_paper_agrees_with_the_study_on_the_published_misalignments(tmp_path: Path) -> None:
    claim, _ = magnitudes(paper_study(("published",), tmp_path / "paper", workers=1))
    assert claim.answer is Answer.YES
    assert full_entry(claim) in find_page("paper").text


@pytest.mark.slow
def test_the_page_on_the_paper_agrees_with_the_study(tmp_path: Path) -> None:
    # otherwise run: mbdkit study paper -o FOLDER, and python -m tests.benchmarks.paper_page FOLDER
    told = ("published", "one-metre", "joints", "knee", "steps", "precision", "long", "coordinates")
    verdict = judge(paper_study(told, tmp_path / "paper", workers=2))
    assert TITLE in verdict.notes[0]
    decided = [claim for claim in verdict.claims if claim.answer is not Answer.OPEN and claim.name not in OF_A_MACHINE]
    assert len(decided) >= 8
    for claim in decided:
        assert full_entry(claim) in find_page("paper").text
