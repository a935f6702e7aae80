"""A study says why its runs are not vectorized."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import mbdkit

BASE: dict[str, Any] = {
    "mbdkit": 1, "model": {"name": "double-pendulum", "angles": [0.1, 0.2]}, "integrator": {"name": "rk4"},
    "time": {"end": 0.05, "step": 0.01},
}  # fmt: skip


@pytest.mark.parametrize(
    ("sections", "reason"),
    [
        ({}, ""),
        ({"stabilization": "projection"}, "their stabilization is projection"),
        ({"events": {"down": {"when": "rod1.angle"}}}, "they have events"),
        ({"integrator": {"name": "radau-iia"}, "formulation": "index-3"}, "their formulation is index-3"),
        ({"integrator": {"name": "scipy-radau"}}, "mbdkit:scipy-radau cannot be vectorized with these options"),
        ({"measures": {"energy": "integral(energy.kinetic)"}}, "their measures contain integrals over time"),
        ({"check": True}, "their errors are estimated"),
    ],
)
def test_a_study_says_why_its_runs_are_not_vectorized(sections: dict[str, Any], reason: str, tmp_path: Path) -> None:
    said: list[str] = []
    mbdkit.ensemble(BASE | sections, {"model.angles.0": [0.1, 0.2]}, out=tmp_path / "study", notify=said.append)
    told = [text for text in said if "not vectorized" in text]
    wanted = f"the runs are not vectorized but computed one after another, because {reason}"
    assert told == ([wanted] if reason else [])
