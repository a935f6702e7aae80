"""Whether gears, racks, belts and slots stay where they work: what is checked at the start is watched in the run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from mbdkit.plugin import GROUND, Finding, FunctionJoint, RunSpec, States, Table
from mbdkit.plugin.equations import CompiledMechanism
from mbdkit.plugin.seams import EnergyRecord, rows_criterion
from mbdkit_transmissions.cams import Slot
from mbdkit_transmissions.gears import PITCH, Belt, Gear, Rack
from mbdkit_transmissions.joint_watcher import JointWatcher

ROUNDING = 1e-9  #: A pin may pass the end of a table by this share of the length of the table.


class Range(NamedTuple):
    """Values of a length [m] for which a joint works; `says` describes a value outside, and what to do."""

    low: float
    high: float
    says: str


def range_of(joint: FunctionJoint) -> Range | None:
    """Return the range of `length_in` within which a joint works; None if it works everywhere."""
    if isinstance(joint, Gear | Rack):
        wanted, what = (abs(joint.wanted), "centres") if isinstance(joint, Gear) else (joint.radius, "centre and line")
        says = f"has {what} that are {{:.6g}} m apart, but works at {wanted:.6g} m only; other joints must hold them"
        return Range((1.0 - PITCH) * wanted, (1.0 + PITCH) * wanted, says)
    if isinstance(joint, Belt):
        says = f"has axes that are {{:.6g}} m apart, so that its pulleys of {joint.radii[0]:.6g} m and "
        return Range(sum(joint.radii), math.inf, f"{says}{joint.radii[1]:.6g} m meet; other joints must hold them")
    if isinstance(joint, Slot) and isinstance(joint.curve.y, Table) and not joint.curve.y.period:
        first, last = joint.curve.y.span
        slack = ROUNDING * (last - first)
        says = "has its pin at x = {:.6g} m, beyond the end of the table of its curve, which goes "
        says += f"from {first:.6g} to {last:.6g} m; extend the table, or stop the pin there"
        return Range(first - slack, last + slack, says)
    return None


def length_in(joint: FunctionJoint, poses: np.ndarray) -> np.ndarray:
    """Return the length [m] whose range is `range_of`, in relative poses (T, 3) of b's point in a's frame."""
    x, y, angle = poses.T
    if isinstance(joint, Slot):
        return np.asarray(x)
    if not isinstance(joint, Rack):
        return np.asarray(np.hypot(x, y))
    c, s = np.cos(angle), np.sin(angle)
    ex, ey = np.array(joint.axis) / math.hypot(*joint.axis)
    return np.asarray(np.abs(ex * (s * x - c * y) + ey * (c * x + s * y)))


class Meshing(JointWatcher):
    """The first time at which each joint has left its range, and the value that is farthest outside."""

    ARRAYS = ("first", "worst", "excess")

    def __init__(self, joints: Mapping[str, FunctionJoint], bodies: list[str]):
        self._joints, self._bodies = joints, bodies
        self._ranges = {name: known for name, joint in joints.items() if (known := range_of(joint)) is not None}
        self._first, self._worst = np.full(len(self._ranges), np.nan), np.zeros(len(self._ranges))
        self._excess = np.zeros(len(self._ranges))

    def __bool__(self) -> bool:
        return bool(self._ranges)

    def _poses(self, joint: FunctionJoint, states: States) -> np.ndarray:
        points, angles = [], []
        for body, (x, y) in zip(joint.bodies, np.reshape(joint.flat_points, (2, 2)), strict=True):
            index = len(self._bodies) if body == GROUND else self._bodies.index(body)
            px, py, angle = states.q[:, 3 * index : 3 * index + 3].T
            c, s = np.cos(angle), np.sin(angle)
            points.append((px + c * x - s * y, py + s * x + c * y))
            angles.append(angle)
        dx, dy = np.subtract(points[1], points[0])
        c, s = np.cos(angles[0]), np.sin(angles[0])
        return np.column_stack([c * dx + s * dy, c * dy - s * dx, angles[1] - angles[0]])

    def _note(self, states: States) -> None:
        for k, (name, known) in enumerate(self._ranges.items()):
            values = length_in(self._joints[name], self._poses(self._joints[name], states))
            excess = np.maximum(known.low - values, values - known.high)
            if math.isnan(self._first[k]) and np.any(excess > 0.0):
                self._first[k] = states.time[np.argmax(excess > 0.0)]
            worst = int(np.argmax(excess))
            if excess[worst] > self._excess[k]:
                self._excess[k], self._worst[k] = excess[worst], values[worst]

    def findings(self, _energies: EnergyRecord, _integrals: Mapping[str, object]) -> Iterator[Finding]:
        """Yield a sentence for each joint that has left its range."""
        for k, (name, known) in enumerate(self._ranges.items()):
            if not math.isnan(self._first[k]):
                sentence = (
                    f"joint '{name}' {known.says.format(self._worst[k])}; this begins at t = {self._first[k]:.6g} s"
                )
                yield Finding("meshing", "doubtful", sentence)


@rows_criterion
def watch_meshing(spec: RunSpec, _compiled: CompiledMechanism, _size: float) -> Meshing | None:
    """Return what watches the gears, racks, belts and slots of a mechanism; None if none can leave its range."""
    mechanism = spec.mechanism()
    joints = {name: joint for name, joint in mechanism.joints.items() if isinstance(joint, Gear | Rack | Belt | Slot)}
    return Meshing(joints, list(mechanism.bodies)) or None
