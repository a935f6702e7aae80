"""Bars of joint forces that an identified rig predicts contain the true forces, also with friction at its bound."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbdkit
from tests.margins import assert_within

from .predicted_forces import coverages, prediction


def test_bars_of_joint_forces_are_those_of_the_covariance(tmp_path: Path) -> None:
    found = prediction("plain", 0, tmp_path)
    known = {name: value for name, value in found.spec["parameters"].items() if name != "from"}
    best = known | {name: found.fit[name].value for name in found.fit.parameters}

    def force(name: str, change: float) -> np.ndarray:
        run = mbdkit.run(found.spec, parameters=best | {name: best[name] * (1.0 + change)}, check=False)
        return run.joints["pin"].reaction_force

    slopes = [(force(name, 1e-3) - force(name, -1e-3)) / (2e-3 * best[name]) for name in found.fit.parameters]
    variance = np.einsum("atk,ab,btk->t", slopes, found.fit.covariance, slopes)
    some = slice(len(variance) // 4, None)  # at the start, the parameters matter little
    # the bars follow from samples of the posterior, which is curved by 2 %
    assert_within(found.bar[some] / (1.96 * np.sqrt(variance[some])) - 1.0, 0.06)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["plain", "bound", "curved"])
def test_bars_contain_the_true_joint_forces(case: str) -> None:
    found = coverages(case, 200)
    assert np.mean(np.isfinite(found)) > 0.8
    assert np.nanmean(found) >= 0.90  # 0.95, with three standard errors of 200 repeats
