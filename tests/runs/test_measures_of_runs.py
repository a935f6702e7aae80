"""`measures` in the spec of a run: checked before it, taken at its end, kept in its archive."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.archive.measured_values import MeasuredValues
from tests.runs.oscillator import oscillator

TIME = {"end": 0.2, "step": 0.01}
MEASURES = {
    "peak_B": {"value": "max(abs(joints.B.force))", "unit": "kN"},
    "bend": {"value": "final(shank.angle)", "unit": "deg"},
}


def measured() -> mbdkit.Run:
    return mbdkit.run("knee", time=TIME, measures=MEASURES)


def test_measures_are_those_of_the_recorded_rows() -> None:
    run = measured()
    force = np.linalg.norm(run.joints["B"].reaction_force, axis=1)
    peak, bend = force.max() / 1000.0, math.degrees(run["shank"].angle[-1])
    assert run.measures == {"peak_B": pytest.approx(peak), "bend": pytest.approx(bend)}
    assert run.measures.units == {"peak_B": "kN", "bend": "deg"}
    assert f"measures      peak_B {force.max() / 1000.0:.6g} kN (max at the end of the run)\n" in run.summary()


def test_they_are_kept_in_the_archive_outside_the_hash_of_the_data(tmp_path: Path) -> None:
    run = measured()
    run.save(tmp_path / "run.h5")
    with mbdkit.load(tmp_path / "run.h5") as kept:
        assert kept.measures == run.measures
        assert kept.measures.units == run.measures.units
    assert check(tmp_path / "run.h5") == []
    plain = mbdkit.run("knee", time=TIME)
    assert plain.measures == {}
    assert plain.data_sha256 == run.data_sha256


def test_what_users_should_know_about_a_value_is_told(tmp_path: Path) -> None:
    # the dense output of the method, from which rows between steps are taken, is less accurate than its steps
    coarse = {"name": "dopri5", "adaptive": True, "rtol": 1e-3, "atol": 1e-3}
    spec = oscillator(coarse, None, measures={"right": "max(slider.x)"}, output={"interval": 0.01})
    made = mbdkit.run(spec)
    assert made["slider"].position[:, 0].max() > made.measures["right"]
    assert "has 1.00052, beyond the max of the motion between the ends of steps" in made.summary()
    assert mbdkit.run(spec | {"output": {"every": 1}}).measures.remarks == {}
    made.save(tmp_path / "run.h5")
    with mbdkit.load(tmp_path / "run.h5") as kept:
        assert kept.measures.remarks == made.measures.remarks != {}


@pytest.mark.parametrize(
    ("end", "is_at_end"),
    [
        pytest.param(0.2, True, id="before the lowest point"),
        pytest.param(0.5, False, id="after it"),
        pytest.param(1.5, False, id="back near the start"),
    ],
)
def test_a_largest_value_at_the_end_of_a_run_is_told(end: float, is_at_end: bool) -> None:
    spec: dict[str, Any] = {
        "mbdkit": 1,
        "model": {"name": "single-pendulum", "length": 1.0, "angle": math.radians(-30.0)},
        "integrator": {"name": "gauss", "stages": 3},
        "time": {"end": end, "step": 0.01},
    }
    measured = mbdkit.run(spec | {"measures": {"peak": "max(abs(joints.J1.force))"}})
    assert ("N (max at the end of the run)" in measured.summary()) == is_at_end
    assert ("N at the end of the run" in mbdkit.run(spec).summary()) == is_at_end


def test_values_that_are_not_finite_and_failures_survive_the_archive() -> None:
    kept = MeasuredValues.from_json(MeasuredValues({"a": math.nan}, {"a": "N"}, {"a": "why"}).to_json())
    assert math.isnan(kept["a"])
    assert (kept.units, kept.reasons) == ({"a": "N"}, {"a": "why"})
    for damaged in ("[]", '{"a": 1}', '{"a": {"value": "x", "unit": "N"}}', "{"):
        with pytest.raises(ValueError, match=r"measures|convert|Expecting"):
            MeasuredValues.from_json(damaged)


def test_a_study_runs_a_base_with_measures(tmp_path: Path) -> None:
    base = json.loads(mbdkit.RunSpec(**measured().spec).canonical_json())
    study = {"mbdkit_study": 1, "base": base, "axes": [{"time.step": [0.01, 0.02]}]}
    done = mbdkit.study(study, out=tmp_path / "study")
    assert [set(run.measures) for point in done.points if (run := done.run(point))] == [{"peak_B", "bend"}] * 2
