"""Faults of the signals of force plates, for `drawn_faults`: glitches of a few rows, and points that are lost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from tests.benchmarks.drawn_faults import DataSet


def glitch(one: DataSet, random: np.random.Generator) -> bool | None:
    """One to five rows under load in which the force drops to zero, or in which force, point or torque have a spike."""
    if not one.loads:
        return None
    load = list(one.loads.values())[random.integers(len(one.loads))]
    data = load["data"]
    peak = np.max(np.abs(data["fy"]))
    rows = np.flatnonzero(np.abs(data["fy"]) > 0.3 * peak)
    at = int(random.choice(rows[(rows > 15) & (rows < len(data["fy"]) - 20)]))
    during, sign = slice(at, at + int(random.integers(1, 6))), random.choice([-1, 1])
    kind = ("dropout", "fx", "fy", "px", "mz")[random.integers(5)]
    if kind == "dropout":
        data["fx"][during] = data["fy"][during] = 0.0
    elif kind == "mz":
        data["mz"] = 0 * data["fy"]
        data["mz"][during] = sign * random.uniform(0.2, 1.0) * peak
        load["torque"] = "mz"
    else:
        data[kind][during] += sign * (random.uniform(0.3, 3.0) if kind == "px" else random.uniform(0.3, 2.0) * peak)
    return True


def lost_point(one: DataSet, random: np.random.Generator) -> bool | None:
    """A centre of pressure that is exactly zero under large forces, or always."""
    if not one.loads:
        return None
    data = next(iter(one.loads.values()))["data"]
    least = random.choice([0.0, 0.5, 0.8]) * np.max(np.abs(data["fy"]))
    data["px"] = np.where(np.abs(data["fy"]) > least, 0.0, data["px"])
    return True
