"""Studies whose stores are compared."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py

BASE: dict[str, Any] = {
    "mbdkit": 1, "model": {"name": "double-pendulum", "angles": [0.1, 0.2]}, "integrator": {"name": "rk4"},
    "time": {"end": 0.3, "step": 0.01}, "limits": {"max_steps": 60},
}  # fmt: skip


#: Methods of every kind, among them an adaptive one; steps of 0.003 s and 0.004 s end early at 60 steps.
METHODS = [
    {"name": "rk4"}, {"name": "gauss", "stages": 2}, {"name": "dopri5", "adaptive": True},
    {"name": "radau-iia", "stages": 2}, {"name": "scipy-dop853"},
]  # fmt: skip


GRID: dict[str, Any] = {
    "mbdkit_study": 1, "base": BASE, "store": "all", "block": 4,
    "axes": [{"integrator": METHODS}, {"time.step": [0.01, 0.004, 0.003]}],
}  # fmt: skip


def index_hash(folder: Path) -> str:
    """The hash of all of the index but the timings."""
    with h5py.File(folder / "index.h5") as file:
        return str(file.attrs["data_sha256"])
