"""Adaptive methods from rest where derivatives of the motion vanish by symmetry, so that error estimates may vanish."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

import mbdkit

METHODS: list[dict[str, Any]] = [
    {"name": "dopri5", "adaptive": True},
    {"name": "dop853", "adaptive": True},
    {"name": "radau-iia", "adaptive": True, "stages": 3},
    {"name": "scipy-dop853"},
    {"name": "scipy-lsoda"},
]
STARTS = {"horizontal": 0.0, "at a turning point": -1.1, "almost in equilibrium": -np.pi / 2 + 1e-3}
END = 1.5


def angle(start: float) -> float:
    """Return the angle of a rod of 1 m at the end: phi'' = -(3 g / 2 L) sin(phi) from rest, phi = angle + pi/2."""
    modulus = np.sin((start + np.pi / 2) / 2)
    sn = ellipj(ellipk(modulus**2) - np.sqrt(1.5 * 9.81) * END, modulus**2)[0]
    return float(2 * np.arcsin(modulus * sn) - np.pi / 2)


@pytest.mark.parametrize("start", STARTS.values(), ids=STARTS)
@pytest.mark.parametrize("method", METHODS, ids=lambda one: f"{one['name']}-{one.get('stages', '')}")
def test_an_adaptive_method_is_right_from_a_symmetric_start(method: dict[str, Any], start: float) -> None:
    for tolerance in (1e-4, 1e-7):
        integrator = method | {"rtol": tolerance, "atol": tolerance}
        model = {"name": "single-pendulum", "angle": start}
        run = mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": {"end": END}})
        assert run["rod1"].angle[-1] == pytest.approx(angle(start), abs=20 * tolerance)


@pytest.mark.parametrize("start", STARTS.values(), ids=STARTS)
def test_a_requested_accuracy_is_reached_from_a_symmetric_start(start: float) -> None:
    model = {"name": "single-pendulum", "angle": start}
    run = mbdkit.run({"mbdkit": 1, "model": model, "accuracy": 1e-6, "time": {"end": END}})
    assert run.verdict == "good"
    assert run["rod1"].angle[-1] == pytest.approx(angle(start), abs=1e-6)
