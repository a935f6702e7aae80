"""The verdict on long runs without drift, and on synthetic runs with drift."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from mbdkit_paper.no_drift.verdict import verdict as judge_no_drift
from mbdkit_paper.wording import UNDECIDED
from mbdkit_report import Answer


def study(*runs: tuple[float, float, str]) -> Any:
    """Return a study of runs of a mechanism of 2 m, by position and velocity misalignment and status."""
    points = [
        SimpleNamespace(
            family="rod",
            axes={"method": f"method {number}"},
            status=status,
            values={
                "misalignment_max": position, "velocity_misalignment_every_step": velocity, "mechanism_size": 2.0,
                "steps": 1e5, "wall_s": 1.0, "projections": 1e5,
            },
        )
        for number, (position, velocity, status) in enumerate(runs, start=1)
    ]  # fmt: skip
    return SimpleNamespace(points=points, spec=SimpleNamespace(title="Long runs", added=()))


@pytest.mark.parametrize(
    ("position", "velocity", "answers"),
    [
        (1.5e-12, 1e-14, ("yes", "yes")),  # 0.75e-12 of 2 m
        (3e-12, 1e-14, ("no", "yes")),
        (1e-15, 1e-3, ("yes", "no")),
        (2e-12, 1e-14, ("open", "yes")),
    ],
)
def test_misalignments_are_held_to_the_mechanisms_size(
    position: float, velocity: float, answers: tuple[str, str]
) -> None:
    verdict = judge_no_drift(study((1e-15, 1e-15, "complete"), (position, velocity, "complete")))
    assert tuple(str(claim.answer) for claim in verdict.claims) == answers
    assert verdict.table("no-drift").rows[1][3] == pytest.approx(position / 2, rel=0.05)


def test_a_run_that_failed_leaves_it_open_and_is_named() -> None:
    verdict = judge_no_drift(study((1e-15, 1e-15, "complete"), (1e-15, 1e-15, "failed")))
    assert [claim.answer for claim in verdict.claims] == [Answer.OPEN] * 2
    assert verdict.claim("positions").sentence == UNDECIDED
    assert "unknown for rod, method 2" in verdict.claim("positions").computed
    assert verdict.table("no-drift").rows[1][2:] == ("failed",) * 5


def test_one_run_that_drifts_is_told_though_another_failed() -> None:
    verdict = judge_no_drift(study((1e-9, 1e-15, "complete"), (math.nan, math.nan, "left-out")))
    assert verdict.claim("positions").answer is Answer.NO
    assert "Exceptions: rod, method 1." in verdict.claim("positions").sentence
