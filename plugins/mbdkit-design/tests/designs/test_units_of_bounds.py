"""Bounds and limits of designs may have units."""

from __future__ import annotations

import pytest

from mbdkit import SpecError
from mbdkit_design.design_loading import load_design_spec


def test_bounds_of_designs_have_units() -> None:
    base = {"mbdkit": 1, "model": {"name": "single-pendulum"}, "integrator": {"name": "rk4"},
            "time": {"end": 1, "step": 0.1}}  # fmt: skip
    design = {"mbdkit_design": 1, "base": base, "minimize": "max(abs(joints.J1.force))"}
    limit = {"torque": {"value": "max(abs(joints.J1.force))", "max": "2 kN"}}
    spec = load_design_spec(design | {"variables": {"model.length": {"bounds": ["20 cm", 1]}}, "subject_to": limit})
    assert (spec.variables["model.length"].bounds, spec.subject_to["torque"].max) == ((0.2, 1.0), 2000.0)
    with pytest.raises(SpecError, match="has the unit rad, but this is a number in m"):
        load_design_spec(design | {"variables": {"model.length": {"bounds": ["20 deg", "1 rad"]}}})
