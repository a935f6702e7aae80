"""Verdicts as plain text: on the terminal, in JSON and in Markdown."""

from __future__ import annotations

import json
import re

from mbdkit_report import Answer, Claim, Column, Table, Verdict, json_values, report, terminal_text
from mbdkit_report.pages.verdict_text import headlines

SHOWN = Table(
    "shown", "What it is for", (Column("method"), Column("drift", "m")), (("RK4", 1.23456e-5), ("a | b", None)),
    "A note.", headline=True,
)  # fmt: skip
OTHER = Table("other", "All runs", (Column("run"),), ((1,),))
CLAIM = Claim("held", "Joints hold.", "below 1e-12", "2e-5 m", Answer.NO, "They do not.")


def verdict(*tables: Table) -> Verdict:
    return Verdict("any", "Any", "They do not.", (CLAIM,), tables)


def test_the_terminal_gets_headline_tables_and_claims_alone() -> None:
    assert headlines(verdict(OTHER, SHOWN)) == (SHOWN,)
    assert terminal_text(verdict(OTHER, SHOWN)).splitlines() == [
        "What it is for", "  method  drift [m]", "  RK4     1.235e-05", "  a | b", "A note.",
        "no     Joints hold. Found: 2e-5 m.",
    ]  # fmt: skip
    assert terminal_text(verdict(OTHER)) == ""
    assert json_values(verdict(OTHER)) == {}
    values = json.loads(json.dumps(json_values(verdict(OTHER, SHOWN))))
    assert [table["name"] for table in values["tables"]] == ["shown"]
    assert values["claims"][0]["answer"] == "no"


def test_a_study_is_reported_in_markdown_with_every_cell_in_its_column(study_folder, tmp_path) -> None:
    target = report(study_folder, tmp_path / "page.md")
    text = target.read_text(encoding="utf-8")
    assert text.startswith("# ")
    assert "## All runs" in text
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table[-7:]}) == 1
    assert list(tmp_path.iterdir()) == [target]
