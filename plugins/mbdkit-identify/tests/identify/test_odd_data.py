"""Data without noise, dead and wrapped columns, and impossible cells are answered or refused in a sentence."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit_identify.identification import Identification, Residuals
from mbdkit_identify.misfit import useless

TIMES = np.linspace(0.0, 3.0, 61)
BASE = {
    "mbdkit": 1, "model": {"name": "single-pendulum", "length": 1.0, "angle": -1.0}, "integrator": {"name": "rk4"},
    "time": {"end": 3.0, "step": 0.05},
}  # fmt: skip


def fit(folder: Path, time: np.ndarray, angle: np.ndarray, **sections: Any) -> Identification:
    np.savetxt(folder / "a.csv", np.column_stack([time, angle]), delimiter=",", header="time,angle", comments="")
    experiment = {"file": str(folder / "a.csv"), "observed": {"rod1.angle": "angle"}}
    spec = {
        "mbdkit_identify": 1, "base": BASE, "experiments": {"a": experiment},
        "parameters": {"model.length": {"bounds": [0.5, 2.0]}},
    }  # fmt: skip
    return mbdkit.identify(spec | sections)


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_data_without_noise_are_fitted(tmp_path: Path, loss: str) -> None:
    with mbdkit.run(BASE) as run:
        found = fit(tmp_path, run.time, run["rod1"].angle, loss=loss)["model.length"]
    # the file has 18 digits, so that only rounding separates the estimate from the truth
    assert found.value == pytest.approx(1.0, abs=1e-9)
    assert found.lower <= 1.0 <= found.upper


@pytest.mark.parametrize(
    ("angle", "sentence"),
    [
        (np.where(np.arange(61) == 30, 1e308, 0.1), "values up to 1e\\+308, which no unit makes plausible"),
        (np.full(61, 1e-320), "which no unit makes plausible"),
    ],
)
def test_cells_that_no_sensor_shows_are_refused(tmp_path: Path, angle: np.ndarray, sentence: str) -> None:
    with pytest.raises(mbdkit.SpecError, match=sentence):
        fit(tmp_path, TIMES, angle)


def test_fewer_values_than_unknowns_are_refused(tmp_path: Path) -> None:
    unknowns = {"model.length": {"bounds": [0.5, 2.0]}, "model.angle": {}, "model.rate": {}}
    with pytest.raises(mbdkit.SpecError, match="3 measured values cannot determine 3 unknowns and the noise"):
        fit(tmp_path, TIMES[:3], np.cos(TIMES[:3]), parameters=unknowns)


def test_a_note_says_by_how_much_a_fast_clock_changes_the_estimate(tmp_path: Path) -> None:
    # the frequency follows from gravity over length alone, so that the length changes by twice the error of the clock
    with mbdkit.run(BASE) as run:
        time, angle = run.time, run["rod1"].angle + 1e-3 * np.random.default_rng(2).normal(size=61)
    notes = fit(tmp_path, time, angle, intervals={"method": "linear"}).notes
    assert any("a clock that is 0.1 % fast changes model.length by +0.2 %" in note for note in notes)


SWING, NOISE = 3.0 * np.cos(3.0 * TIMES), 0.02 * np.random.default_rng(1).normal(size=61)


@pytest.mark.parametrize(
    ("measured", "fitted", "sentence"),
    [
        (SWING + NOISE, SWING, ""),
        (NOISE, 0.0 * TIMES, ""),  # a body at rest
        (np.mod(SWING + NOISE, 2 * math.pi), SWING, "jumps by a whole turn at 0.55 s, as if it wraps"),
        (np.full(61, 0.1), SWING, "never changes: if its sensor is dead, leave it out"),
        (SWING + NOISE, -SWING, "no better than a constant would"),
        (SWING + NOISE + np.where(TIMES[30] == TIMES, 1e9, 0.0), SWING, "such as the one at 1.5 s"),
    ],
)
def test_signals_that_the_fit_does_not_explain_are_named(
    measured: np.ndarray, fitted: np.ndarray, sentence: str
) -> None:
    rest = measured - fitted
    signal = Residuals("a", "arm.angle", "rad", TIMES, measured, fitted, rest, 1.0, 0.0, False, rest, 1.0)
    doubts = [one.text for one in useless([signal], [2.0 * math.pi], is_robust=False)]
    assert len(doubts) == bool(sentence)
    assert all(sentence in one and one.count(". ") == 0 for one in doubts)
