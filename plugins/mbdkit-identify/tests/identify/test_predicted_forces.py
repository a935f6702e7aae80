"""Bars of joint forces that an identified rig predicts contain the true forces, also with friction at its bound."""

from __future__ import annotations

import numpy as np
import pytest

from .predicted_forces import coverages


@pytest.mark.parametrize(
    ("case", "repeats", "least"),
    [
        ("plain", 2, 0.6),  # the quick form shows that bars exist and are of the right size
        ("bound", 1, 0.5),
        pytest.param("plain", 200, 0.90, marks=pytest.mark.slow),  # 0.95, with three standard errors of 200 repeats
        pytest.param("bound", 200, 0.90, marks=pytest.mark.slow),
        pytest.param("curved", 200, 0.90, marks=pytest.mark.slow),
    ],
)
def test_bars_contain_the_true_joint_forces(case: str, repeats: int, least: float) -> None:
    found = coverages(case, repeats)
    assert np.mean(np.isfinite(found)) > 0.8
    assert np.nanmean(found) >= least
