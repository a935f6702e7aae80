"""Files with results of identifications, and a spring whose motion and reaction are known functions of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mbdkit.archive.fingerprint import seal

STIFFNESS, MASS = 40.0, 2.0
COVARIANCE = np.array([[0.2**2, 0.6 * 0.2 * 0.01], [0.6 * 0.2 * 0.01, 0.01**2]])
"""Covariance of stiffness and mass: deviations of 0.2 N/m and 0.01 kg, correlation 0.6."""


def write_identified(
    path: Path, values: Mapping[str, float], covariance: Sequence[Sequence[float]] | np.ndarray
) -> Path:
    """Write the result of an identification; parameters with an unknown variance are not identifiable."""
    matrix = np.array(covariance, float)
    with h5py.File(path, "w") as file:
        file.attrs["format"], file.attrs["format_version"] = "mbdkit-identification", 1
        group = file.create_group("parameters")
        group["parameter"] = np.array([*values], object)
        group["value"], group["covariance"] = np.array([*values.values()]), matrix
        group["mean"] = group["value"][:]
        group["deviation"] = np.sqrt(np.diagonal(matrix))
        group["why"] = np.array([""] * len(values), object)
        group["identifiable"] = np.isfinite(np.diagonal(matrix)).astype(int)
        seal(file)
    return path


def write_fit(folder: Path, covariance: np.ndarray = COVARIANCE) -> Path:
    """Write stiffness and mass of the spring to ``fit.h5``, with a parameter that is not used and one that is lost."""
    matrix = np.full((4, 4), np.nan)
    matrix[:3, :3] = 0.0
    matrix[np.ix_([0, 2], [0, 2])] = covariance
    matrix[1, 1] = 4.0
    values = {"stiffness": STIFFNESS, "unused": 7.0, "mass": MASS, "lost": 1.0}
    return write_identified(folder / "fit.h5", values, matrix)


def sliding(**sections: Any) -> dict[str, Any]:
    """Return the spec of a body on a horizontal rail, with a spring and a start 0.1 m from its rest at x = 1 m."""
    return {
        "mbdkit": 1,
        "parameters": {"from": "fit.h5"},
        "model": {
            "name": "mechanism",
            "gravity": [0.0, -10.0],
            "bodies": {"block": {"mass": "mass", "inertia": 1.0, "position": [1.1, 0.0]}},
            "joints": {"rail": {"type": "prismatic", "bodies": ["ground", "block"], "at": [1.1, 0], "axis": [1, 0]}},
            "forces": {
                "spring": {
                    "type": "spring-damper", "bodies": ["ground", "block"], "points": [[0, 0], [0, 0]],
                    "stiffness": "stiffness", "free_length": 1.0,
                }
            },
        },
        "integrator": {"name": "dop853"},
        "time": {"end": 3.0, "step": 0.02},
    } | sections  # fmt: skip
