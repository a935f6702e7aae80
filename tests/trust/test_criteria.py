"""Each criterion alone decides the level it should, and says so with its limit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mbdkit.trust.criteria import LEVELS, BranchSuspicion, EstimatedErrors, Evidence, judge
from mbdkit.trust.energy_record import EnergyRecord

JOINTS = {"misalignment": 1e-9, "joint": "A", "angle_misalignment": 1e-12, "angle_joint": "motor"}
ENERGY = {"kinetic": 10.0, "energy": 50.0, "balance": 1e-6, "energy_jump": 1e-7, "energy_jump_time": 1.0}
SOUND = Evidence(end=5.0, size=2.0, **JOINTS, **ENERGY)
KNOWN = EstimatedErrors(position=1e-6, reaction=1e-4, known_until=5.0)


def test_a_run_without_an_estimate_of_its_error_is_unknown_at_best() -> None:
    assert judge(SOUND).level == "unknown"
    assert judge(SOUND).reasons == ()


def test_good_is_earned_by_an_estimate_over_the_whole_run() -> None:
    assert judge(SOUND, KNOWN).level == "good"
    short = judge(SOUND, replace(KNOWN, known_until=4.2))
    assert short.level == "doubtful"
    assert "only until t = 4.2 s" in short.reasons[0]


@pytest.mark.parametrize(
    ("error", "level"), [(0.005, "good"), (0.05, "doubtful"), (0.3, "bad"), (math.nan, "bad"), (math.inf, "bad")]
)
@pytest.mark.parametrize("what", ["position", "reaction"])
def test_an_estimate_is_judged_by_its_size(what: str, error: float, level: str) -> None:
    assert judge(SOUND, replace(KNOWN, **{what: error})).level == level


STOPPED = "interrupted: stopped by the user at t = 5 s of 9 s."
CASES = {
    # size 2 m: limits 0.2 mm and 2 mm; kinetic energy 10 J: 10 mJ, 0.5 J and 0.5 J in one step
    "joint opens": ({"misalignment": 3e-4}, "doubtful", "Joint 'A' is misaligned by up to 0.0003 m, 0.00015 of"),
    "joint apart": ({"misalignment": 3e-3}, "bad", "doubtful above 0.0001, bad above 0.001"),
    "joint at infinity": ({"misalignment": math.inf}, "bad", "misaligned by up to inf m"),
    "angle off": ({"angle_misalignment": 2e-4}, "doubtful", "The angle of joint 'motor' is misaligned by up to"),
    "angle far off": ({"angle_misalignment": 0.1}, "bad", "0.1 rad"),
    "energy off": ({"balance": 0.02}, "doubtful", "violated by up to 0.02 J, 0.002 of the largest kinetic energy"),
    "energy from nowhere": ({"balance": 1.0}, "bad", "bad above 0.05"),
    "energy not a number": ({"balance": math.nan}, "bad", "violated by up to nan J"),
    "energy jumps": ({"energy_jump": 0.6}, "bad", "changes by 0.6 J in one step at t = 1 s"),
    "failed": ({"status": "failed", "status_reason": "singular: it binds."}, "bad", "stopped at t = 5 s, before its"),
    "interrupted": (
        {"status": "interrupted", "status_reason": STOPPED},
        "doubtful",
        "stopped by the user at t = 5 s of 9",
    ),
    "warned": ({"warnings": ("the motion has a corner",)}, "doubtful", "the motion has a corner"),
    "branch left": ({"branch": (BranchSuspicion(2.0, 1.0, 0.02),)}, "bad", "`stabilization: projection`"),
}


@pytest.mark.parametrize("case", CASES)
def test_each_criterion_alone_decides(case: str) -> None:
    change, level, words = CASES[case]
    verdict = judge(replace(SOUND, **change))
    assert verdict.level == level
    (reason,) = verdict.reasons
    assert words in reason
    assert judge(replace(SOUND, **change), KNOWN).level == level


@pytest.mark.parametrize(
    "change",
    [
        {"branch": (BranchSuspicion(2.0, 0.2, 0.02), BranchSuspicion(3.0, 0.5, 0.2))},
        {"energy_jump": 0.4, "balance": 1e-3},
        {"kinetic": 1e-30, "balance": 1e-13, "energy_jump": 1e-13},
    ],
    ids=["gentle turns", "below the limits", "at rest but for rounding"],
)
def test_what_is_no_reason(change: dict[str, object]) -> None:
    assert judge(replace(SOUND, **change)).reasons == ()


def test_energy_errors_of_a_mechanism_at_rest_are_bad_above_rounding() -> None:
    assert judge(replace(SOUND, kinetic=0.0, balance=1e-6)).level == "bad"


def test_warnings_which_may_be_the_cause_of_others_come_first_and_then_the_worst_reason() -> None:
    verdict = judge(replace(SOUND, misalignment=3e-4, balance=1.0, warnings=("a corner",)))
    assert verdict.level == "bad"
    assert [reason.split()[0] for reason in verdict.reasons] == ["a", "The", "Joint"]
    assert LEVELS[-1] == "bad"


def test_the_largest_energies_are_kept_across_calls() -> None:
    record = EnergyRecord()
    none = np.zeros((1, 2))
    record.add(np.array([1.0, 3.0]), none, np.array([0.0, 0.5]))
    record.add(np.array([1.0, 2.0]), none - 7.0, np.array([-0.5, 3.5]))
    assert (record.kinetic, record.energy, record.balance) == (3.0, 7.0, 3.5)
    record.add(np.array([2.0]), none[:, :1] + np.nan, np.array([np.nan]))
    assert np.isnan(record.energy)
    assert np.isnan(record.balance)
