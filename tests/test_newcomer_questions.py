"""Newcomers find answers: the table has questions in their words, the page of each, and words of the answer."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from mbdkit.guide.pages import pages, search

with Path(__file__).with_name("newcomer_questions.tsv").open(encoding="utf-8") as file:
    QUESTIONS = list(csv.DictReader(file, delimiter="\t"))


@pytest.mark.parametrize("row", QUESTIONS, ids=lambda row: row["question"])
def test_the_page_answers_the_question_and_is_among_the_first_three(row: dict[str, str]) -> None:
    text = pages()[row["page"]].text.lower()
    assert [word for word in row["answer"].lower().split("; ") if word not in text] == []
    assert row["page"] in list(dict.fromkeys(hit.topic for hit in search(row["question"])))[:3]


def test_every_page_answers_a_question() -> None:
    """Reference pages and the history of changes are read by other ways."""
    assert pages().keys() - {row["page"] for row in QUESTIONS} == {"spec", "changes", "elements", "kernels", "device"}
