"""Measured motion of a leg that hangs at its hip, and the criteria that its inverse dynamics does not meet."""

from __future__ import annotations

from typing import Any

import numpy as np

import mbdkit

T = np.arange(0.0, 2.0, 0.01)
NOISE = 1e-3 * np.random.default_rng(8).standard_normal((4, len(T)))
ANGLES = {
    "hip_flexion": 0.3 * np.sin(3 * T) + NOISE[0],
    "knee_flexion": 0.6 - 0.5 * np.cos(4 * T) + NOISE[1],
    "ankle_dorsiflexion": 0.2 * np.sin(5 * T) + NOISE[2],
}
SMOOTH = {"name": "butterworth", "cutoff": 6.0}


def leg(columns: dict[str, Any] | None = None, **sections: Any) -> mbdkit.Run:
    """Return the inverse dynamics of a leg that hangs at its hip, with other columns in place of some."""
    motion = {"data": {"time": T, **ANGLES, **(columns or {})}, "smooth": SMOOTH} | sections.pop("motion", {})
    return mbdkit.inverse({"mbdkit": 1, "model": {"name": "leg"}, "motion": motion, **sections})


def stance(**changes: Any) -> dict[str, Any]:
    """Return the load of a plate below the foot, for the first second."""
    pose = leg(motion={"errors": "none"})
    up = 600 * np.maximum(0.0, np.sin(np.pi * T))
    data = {"time": T, "fx": 0.1 * up, "fy": up, "x": pose["foot"].position[:, 0], "y": pose["foot"].position[:, 1]}
    load = {"body": "foot", "data": data | changes, "force": ["fx", "fy"], "point": ["x", "y"]}
    return {"ground": load}


def told(run: mbdkit.Run) -> set[str]:
    """Return the criteria that a run does not meet."""
    return {reason.partition(":")[0] for reason in run.verdict_reasons}


def not_of_ends(run: mbdkit.Run) -> list[str]:
    """Return the reasons for a verdict without those about largest values near the ends of the record.

    Without a load, the torque of the ankle is largest at the start, where its value is uncertain.
    """
    return [reason for reason in run.verdict_reasons if not reason.startswith("ends: ")]
