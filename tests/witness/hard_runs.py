"""Runs of difficult mechanisms with each method."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.archive.layout import every_array
from tests.slow_cases import slow

METHODS: dict[str, tuple[dict[str, Any], float | None, float]] = {
    "rk4": ({"name": "rk4"}, 2e-4, 1e-9),
    "rk-gill": ({"name": "rk-gill"}, 2e-4, 1e-9),
    "gauss-1": ({"name": "gauss", "stages": 1}, 1e-3, 1e-4),
    "gauss-2": ({"name": "gauss", "stages": 2}, 2e-3, 1e-8),
    "gauss-3": ({"name": "gauss", "stages": 3}, 5e-3, 1e-9),
    "radau-iia-2": ({"name": "radau-iia", "stages": 2}, 1e-3, 1e-6),
    "radau-iia-3": ({"name": "radau-iia", "stages": 3}, 5e-3, 1e-7),
    "radau-iia-5": ({"name": "radau-iia", "stages": 5}, 1e-2, 1e-9),
    "scipy-dop853": ({"name": "scipy-dop853", "rtol": 1e-11, "atol": 1e-12}, None, 1e-8),
    "scipy-radau": ({"name": "scipy-radau", "rtol": 1e-8, "atol": 1e-10}, None, 1e-5),
    "scipy-lsoda": ({"name": "scipy-lsoda", "rtol": 1e-10, "atol": 1e-12}, None, 1e-6),
}
"""Integrator, step [s], and largest error of the angles after one second [rad]."""


EXPLICIT = ("rk4", "rk-gill")


every_method = pytest.mark.parametrize(
    "method", ["rk4", "gauss-3", "radau-iia-3", "scipy-dop853", *slow("gauss-2", "scipy-radau", "scipy-lsoda")]
)


def run(model: dict[str, Any], method: str, end: float = 1.0, step: float | None = None, **sections: Any) -> mbdkit.Run:
    """Run a model and check that all recorded values are finite."""
    integrator, usual, _ = METHODS[method]
    time: dict[str, Any] = {"end": end}
    if usual is not None:
        time["step"] = step or usual
    result: mbdkit.Run = mbdkit.run({"mbdkit": 1, "model": model, "integrator": integrator, "time": time, **sections})
    for array in every_array():
        if array.dims[0] == "time" and result.records(array.path):
            assert np.isfinite(result.array(array.path)).all(), array.path
    return result
