"""Error estimates and gradients of measures of random chains, beside an independent code; 200 of them by
`python -m tests.benchmarks.measure_errors`.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.witness.chain_measures import cases_of


@pytest.mark.slow
def test_errors_and_gradients_of_measures_of_random_chains_are_true() -> None:
    cases = [case for seed in (0,) for case in cases_of(seed)]
    known = [one for one in cases if one.is_known]
    assert len(known) >= 0.9 * len(cases)
    assert np.mean([one.is_inside for one in known]) >= 0.9, [one for one in known if not one.is_inside]
    assert all(one.is_right for one in cases), [one for one in cases if not one.is_right]
