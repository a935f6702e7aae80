"""Assembly that turns bodies by far is told, also if none of their points moves."""

from __future__ import annotations

import math
from typing import Any

import pytest

import mbdkit

BODY = {"mass": 1.0, "inertia": 0.01}


def warnings_of(bodies: dict[str, Any], joints: dict[str, Any], forces: dict[str, Any] | None = None) -> list[str]:
    model = {"name": "mechanism", "gravity": [0, 0], "bodies": bodies, "joints": joints, "forces": forces or {}}
    integrator = {"name": "gauss", "stages": 2}
    run = mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": 0.01, "step": 0.005}})
    return [str(warning) for warning in run.warnings if "assembly" in str(warning)]


@pytest.mark.parametrize(("offset", "is_told"), [(50.0, True), (-1.5, False)])
def test_bodies_that_turn_about_their_centres_are_told(offset, is_told):
    """The least change of two angles that satisfies b - 3 a = offset is (-3, 1) offset / 10."""
    bodies = {"a": {**BODY, "position": [0, 0]}, "b": {**BODY, "position": [1, 0]}}
    pin = {"type": "revolute", "bodies": ["ground", "a"], "at": [0, 0]}
    coupling = {"type": "coupling", "bodies": ["a", "b"], "equation": f"second - 3*first - {offset}"}
    joints = {"A": pin, "B": {**pin, "bodies": ["ground", "b"], "at": [1, 0]}, "K": coupling}
    found = warnings_of(bodies, joints)
    assert bool(found) is is_told
    if is_told:
        assert f"turns a by {0.3 * offset:.3g} rad" in found[0]


@pytest.mark.parametrize(("motion", "is_told"), [("3.5 - 2*pi", True), ("3.5", False)])
def test_a_body_that_a_wrapped_motion_turns_by_a_full_turn_is_told(motion, is_told):
    bodies = {"b": {**BODY, "position": [0, 0], "angle": 3.5}}
    pin = {"type": "revolute", "bodies": ["ground", "b"], "at": [0, 0]}
    driver = {"type": "driver", "bodies": ["ground", "b"], "coordinate": "angle", "motion": motion}
    spring = {"type": "torsion-spring", "bodies": ["ground", "b"], "stiffness": 2.0, "free_angle": 3.5}
    found = warnings_of(bodies, {"A": pin, "M": driver}, {"S": spring})
    assert bool(found) is is_told
    if is_told:
        assert f"turns b by {2 * math.pi:.3g} rad" in found[0]
        assert "whole turns" in found[0]
