"""Specs of small runs, for attacks that need one."""

from __future__ import annotations

from typing import Any


def pendulum(end: float = 0.2, step: float = 0.01) -> dict[str, Any]:
    """Return the spec of a pendulum."""
    return {
        "mbdkit": 1,
        "model": {"name": "single-pendulum"},
        "integrator": {"name": "rk4"},
        "time": {"end": end, "step": step},
    }
