"""Errors of measures in the analysis of samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mbdkit
from mbdkit_studies.report.study_headlines import headlines
from mbdkit_studies.statistics.sensitivity import sensitivity
from tests.runs.oscillator import oscillator


def test_indices_of_errors_are_not_shown(tmp_path: Path) -> None:
    # the total energy does not depend on the phase: its values differ by their errors only
    base = oscillator({"name": "rk4"}, 0.2, check=True, parameters={"phase": 0.0, "level": 0.0})
    base["model"]["bodies"]["slider"] |= {"position": ["cos(phase)", 0], "velocity": ["-2*sin(phase)", 0]}
    variables = {"parameters.phase": {"uniform": [0.0, 3.0]}, "parameters.level": {"uniform": [0.0, 1.0]}}
    sample = {"n": 4, "method": "sobol", "design": "saltelli", "seed": 1, "variables": variables}
    measures = {"noise": "max(energy.total) - 2 + 2", "swing": {"value": "final(slider.x)*(1 + level)", "unit": "m"}}
    study = mbdkit.study(
        {"mbdkit_study": 1, "base": base, "sample": sample, "measures": measures}, out=tmp_path / "study"
    )
    found = sensitivity(study, "noise")
    assert np.all(np.isnan(found.first))
    assert np.all(np.isnan(found.total))
    assert "within their estimated errors" in str(found)
    wide = sensitivity(study, "swing")
    assert not wide.reason
    covers = (wide.indices.first_low <= 0) & (wide.indices.first_high >= 1)
    assert np.array_equal(np.isnan(wide.first), covers)
    told = dict(headlines(study))
    assert "of the standard deviation: THE SPREAD MAY BE NUMERICAL" in told["noise"]
    assert "no variable explains it: the values of noise differ by" in told["noise"]
    assert "NUMERICAL" not in told["swing"]
    assert "error of a run" in told["swing"]
