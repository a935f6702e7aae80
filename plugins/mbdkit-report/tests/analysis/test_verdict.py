"""Answers with a margin, and conversion of verdicts to plain values."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from mbdkit_report import Answer, Axis, Claim, Column, Figure, Line, Range, Table, Verdict, exceeds, together

YES, NO, PARTLY, OPEN = Answer.YES, Answer.NO, Answer.PARTLY, Answer.OPEN


@pytest.mark.parametrize(
    ("value", "answer"),
    [(0.5, YES), (2e-3, YES), (5e-4, NO), (3.0, NO), (1.0, OPEN), (1.02, OPEN), (9.9e-4, OPEN), (math.nan, OPEN)],
)
def test_a_range_leaves_open_what_lies_on_its_border(value: float, answer: Answer) -> None:
    assert Range(1e-3, 1.0, "mm").holds(value) is answer


def test_one_value_exceeds_another_only_beyond_the_margin() -> None:
    assert [exceeds(a, 1.0) for a in (2.0, 1.01, 0.5, math.nan)] == [YES, OPEN, NO, OPEN]


@pytest.mark.parametrize(
    ("answers", "answer"),
    [
        ([YES, YES], YES),
        ([NO, NO], NO),
        ([YES, NO], PARTLY),
        ([YES, NO, OPEN], PARTLY),
        ([YES, OPEN], OPEN),
        ([], OPEN),
        ([YES, PARTLY], PARTLY),
    ],
)
def test_answers_together(answers: list[Answer], answer: Answer) -> None:
    assert together(answers) is answer


def test_a_verdict_is_json() -> None:
    table = Table("t", "Table", (Column("a"), Column("b", "m")), (("x", math.nan), (1, None)))
    figure = Figure("f", "Figure", "", Axis("t", "s"), Axis("x", "m", True), (Line("l", np.arange(2), np.zeros(2)),))
    claim = Claim("c", "It holds.", "1", "2", Answer.NO, "It does not.")
    verdict = Verdict("v", "Verdict", "So it is.", (claim,), (table,), (figure,))
    plain = json.loads(json.dumps(verdict.to_dict(), allow_nan=False))
    assert plain["tables"][0]["rows"] == [["x", None], [1, None]]
    assert plain["figures"][0]["lines"][0]["x"] == [0, 1]
    assert plain["claims"][0]["answer"] == "no"
    assert verdict.claim("c") is claim
    with pytest.raises(KeyError, match=r"there is no 'd'; there are c"):
        verdict.claim("d")


def test_a_table_whose_rows_do_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="2 columns, but a row of 1 cells"):
        Table("t", "Table", (Column("a"), Column("b")), ((1,),))
