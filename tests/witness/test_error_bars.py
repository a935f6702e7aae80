"""Estimated errors against true ones, on mechanisms with known motions.

`python -m tests.benchmarks.error_bars` prints the table of all cases.
"""

from __future__ import annotations

import numpy as np
import pytest

from .error_bars import FACTORS, FIXED, NEVER, TOLERANCES, Case, Truth, run_case, share_inside
from .known_motions import Known, known_motions

PROBLEMS = known_motions()
FEW = ("slider-crank",)


def assert_trusted(cases: list[Case]) -> None:
    """Assert the limits within which an estimate may be wrong, and that no wrong reaction counts as known."""
    assert share_inside(cases) >= 0.95
    for case in cases:
        assert np.all(case.ratios <= NEVER), case
        assert not (case.good and case.worst_true_share > 0.05), case


@pytest.mark.parametrize("known", [known for known in PROBLEMS if known.name in FEW], ids=lambda known: known.name)
def test_estimated_errors_of_a_run_are_within_a_factor_of_the_true_ones(known: Known) -> None:
    # expected: closed forms, or minimal coordinates by DOP853 at rtol 1e-13
    truth = Truth(known)
    cases = [run_case(truth, method, 2.0) for method in FIXED] + [run_case(truth, "dop853", 1e-5)]
    assert_trusted(cases)


@pytest.mark.slow
def test_estimated_errors_of_all_cases_are_within_a_factor_of_the_true_ones() -> None:
    # expected: closed forms, or minimal coordinates by DOP853 at rtol 1e-13
    every: list[Case] = []
    for known in PROBLEMS:
        truth = Truth(known)
        every += [run_case(truth, method, factor) for method in FIXED for factor in FACTORS]
        every += [run_case(truth, "dop853", tolerance) for tolerance in TOLERANCES]
    assert_trusted(every)
    # most errors are known, so that the limits above are not met by silence
    assert np.mean([np.nan_to_num(case.known_until) >= case.end for case in every]) > 0.8
