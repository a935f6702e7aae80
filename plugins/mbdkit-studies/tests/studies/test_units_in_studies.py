"""Values of axes and samples may have units."""

from __future__ import annotations

import math
from typing import Any

import pytest

from mbdkit import SpecError
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.spec.study_loading import load_study_spec


def test_studies_have_values_with_units() -> None:
    base = {"model": {"name": "single-pendulum"}, "integrator": {"name": "rk4"}, "time": {"end": 1, "step": 0.1}}
    study = {"mbdkit_study": 1, "base": base}

    def points(**given: Any) -> PlannedPoints:
        return PlannedPoints(load_study_spec(study | given))

    spaced = points(axes=[{"model.angle": {"linspace": ["0 deg", "60 deg", 3]}}, {"model.length": ["50 cm", 1]}])
    assert [list(point.axes.values()) for point in spaced[2:4]] == [[pytest.approx(math.pi / 6), 0.5],
                                                                      [pytest.approx(math.pi / 6), 1]]  # fmt: skip
    drawn = points(sample={"n": 4, "variables": {"model.mass": {"uniform": ["10 g", "20 g"]}}})
    assert all(0.01 < float(point.axes["model.mass"]) < 0.02 for point in drawn)
    with pytest.raises(SpecError, match=r"axes\[0\]\.\"model\.angle\"\[1\].*unit m, but this is a number in rad"):
        points(axes=[{"model.angle": [0.1, "20 mm"]}])
    with pytest.raises(SpecError, match="unit s, but this is a number in kg"):
        points(sample={"n": 4, "variables": {"model.mass": {"uniform": ["10 s", "20 s"]}}})
    with pytest.raises(SpecError, match="`mean` and `std` should have units of the same kind, or none"):
        points(sample={"n": 4, "variables": {"model.mass": {"normal": ["10 g", 1]}}})
