"""Archives in memory whose motion is given in closed form, written by the archive's own writer."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from mbdkit.archive.layout import QUANTITIES, recorded_by
from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import Ending, Origin
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.quantities.names import ArchiveNames

MakeRun = Callable[..., Run]


def swinging_chain(rods: int, time: np.ndarray, length: float = 1.0) -> np.ndarray:
    """Return poses (T, n, 3) of a chain of rods that hangs from the origin, without gaps in its joints."""
    angle = -np.pi / 2 + np.cos(2.0 * time[:, None] - 2.0 * np.arange(rods) / rods)
    step = length * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    centre = np.cumsum(step, axis=1) - step / 2
    return np.concatenate([centre, angle[..., None]], axis=-1)


@pytest.fixture
def make_run() -> Iterator[MakeRun]:
    """Return a function that makes a run of a swinging chain, or of given bodies, joints and poses."""
    opened: list[Run] = []

    def make(
        *,
        rods: int = 2,
        rows: int = 151,
        step: float = 0.02,
        model: dict[str, Any] | None = None,
        bodies: list[str] | None = None,
        joints: list[str] | None = None,
        poses: np.ndarray | None = None,
        title: str = "a swinging chain",
        integrator: dict[str, Any] | None = None,
        status: str = "complete",
        reason: str = "",
        quantities: frozenset[str] = QUANTITIES,
        change: Callable[[dict[str, np.ndarray]], None] = lambda data: None,
    ) -> Run:
        time = step * np.arange(rows)
        poses = swinging_chain(rods, time) if poses is None else poses
        bodies = [f"rod{k + 1}" for k in range(rods)] if bodies is None else bodies
        joints = [f"J{k + 1}" for k in range(rods)] if joints is None else joints
        constraints = [f"{joint}.{row}" for joint in joints for row in "xy"]
        gap = 1e-9 * time[:, None] ** 2 * (1.0 + np.arange(len(joints)))
        data = {
            "time": time,
            "trajectory/position": poses,
            "trajectory/velocity": np.zeros_like(poses),
            "trajectory/acceleration": np.zeros_like(poses),
            "trajectory/elapsed_s": time,
            "joints/misalignment": gap,
            "joints/velocity_misalignment": 3.0 * gap,
            "joints/angle_misalignment": np.zeros_like(gap),
            "joints/reaction_force": np.stack([gap, 9.81 + np.sin(3.0 * time)[:, None] + gap], axis=-1),
            "joints/reaction_torque": np.zeros_like(gap),
            "joints/angle": np.zeros_like(gap),
            "joints/driver_power": np.zeros_like(gap),
            "energy/kinetic": np.sin(time) ** 2,
            "energy/potential": np.cos(time) ** 2 - 5.0,
            "energy/total": np.full(rows, -4.0),
            "energy/dissipated": np.zeros(rows),
            "energy/work": np.zeros(rows),
            "energy/balance": 1e-11 * np.sin(7.0 * time),
        }
        for body in ("first", "second"):
            data[f"joints/reaction_force_{body}"] = data["joints/reaction_force"].copy()
        for name in ("position_residual", "velocity_residual", "multiplier"):
            data[f"constraints/{name}"] = np.zeros((rows, len(constraints)))
        change(data)
        spec = json.dumps(
            {
                "mbdkit": 1,
                "model": {"name": "n-pendulum", "n": rods} if model is None else model,
                "formulation": "index-1",
                "stabilization": "none",
                "integrator": integrator or {"name": "gauss", "stages": 2},
                "time": {"start": 0.0, "end": float(time[-1]) if rows else 1.0, "step": step},
                "title": title,
            }
        )
        names = ArchiveNames(
            bodies, joints, constraints, ["m"] * len(constraints), [("ground", bodies[0])] * len(joints)
        )
        digest = hashlib.sha256(spec.encode()).hexdigest()
        writer = ArchiveWriter(None, names, Origin(spec, digest, "a-run", {}), arrays=recorded_by(names, quantities))
        writer.append({key: data[key] for key in writer.row_keys})
        largest = np.max(data["joints/misalignment"], axis=0, initial=0.0)
        file = writer.finish(Ending(status, reason, {"steps": max(0, rows - 1)}, largest))
        assert file is not None
        opened.append(Run(file))
        return opened[-1]

    yield make
    for run in opened:
        run.close()
