"""The verdict on the treatments of contact: its closed forms, and its claims on synthetic runs."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_paper.contact import verdict as of
from mbdkit_paper.contact.verdict import CLOSED, FINEST, Touched
from mbdkit_report import Answer
from mbdkit_studies.spec.study_loading import load_study_spec
from tests.margins import assert_within

RIGID = [
    Touched(case, method, step, error * step if method == "time-stepping" else 1e-12, 0.0, 0.0, 100.0, 1.0, "")
    for case in (*CLOSED, "rocking")
    for method, error in ((FINEST, 0.0), ("time-stepping", 0.5))
    for step in (0.02, 0.01)
]
SOFT = [Touched(case, f"k{i}", 0.0, 10.0**-i, 10.0**-i, 1.0, 1.0, 1.0, "") for case in CLOSED for i in (1, 2, 3)]


def test_closed_forms_have_the_published_values() -> None:
    # the figures of the tests of rigid contacts, derived there
    assert of.ball(np.array([0.451523640985731, 1.36])) == pytest.approx([0.1, 0.1], abs=1e-12)
    assert of.ball(np.array([0.451523640985731 * 2]))[0] == pytest.approx(0.1, abs=1e-12)  # its second impact
    assert CLOSED["incline"][1](np.array([0.268322655232618, 1.0])) == pytest.approx(
        [0.268322655232618, -0.362398577094839], abs=1e-12
    )
    assert CLOSED["belt"][1](np.array([5.0, 8.902605407814523])) == pytest.approx([1.0, 0.0], abs=1e-12)


def test_claims_follow_the_runs() -> None:
    assert of._exact(RIGID).answer is Answer.YES
    assert of._first_order(RIGID).answer is Answer.YES
    assert of._closed(RIGID).answer is Answer.YES
    assert of._softer(SOFT).answer is Answer.YES
    assert of._exact([replace(one, error=1e-6) for one in RIGID]).answer is Answer.NO
    assert of._first_order([replace(one, error=10.0 * one.step) for one in RIGID]).answer is Answer.NO
    assert of._closed([replace(one, penetration=1e-3) for one in RIGID]).answer is Answer.NO
    assert of._softer([replace(one, penetration=1e-3) for one in SOFT]).answer is not Answer.YES
    assert of._exact([replace(one, error=math.nan, state="failed") for one in RIGID]).answer is Answer.OPEN


@pytest.mark.parametrize(("passed", "answer"), [((1.32, 1.33), Answer.YES), ((1.32, 1.33, 1.34), Answer.NO)])
def test_painleves_rod_is_refused_above_four_thirds(passed: tuple[float, ...], answer: Answer) -> None:
    points: list[Any] = [
        SimpleNamespace(family="painleve", axes={"mu": mu}, status="complete" if mu in passed else "failed")
        for mu in (1.32, 1.33, 1.34, 1.35)
    ]
    assert of._painleve(SimpleNamespace(points=points)).answer is answer  # type: ignore[arg-type]


def test_a_block_sticks_and_slips_by_time_stepping() -> None:
    # with static friction while it sticks: without it, the block would rest at another place
    case = load_study_spec("contact").families["belt"].overrides
    setup = {"integrator": {"name": "moreau-jean"}, "contact": {"treatment": "time-stepping"}}
    found = mbdkit.run({"mbdkit": 1, "model": case["model"], "time": {"end": 10.0, "step": 0.05}} | setup)
    coordinate, closed = CLOSED["belt"]
    assert_within(coordinate(found) - closed(found.time), 0.6 * 0.05)
