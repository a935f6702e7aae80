"""Reactions that a real cam or wheel cannot have: a force that pulls, and more friction than there is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from mbdkit.plugin import GROUND, Finding, RunSpec, States
from mbdkit.plugin.equations import CompiledMechanism
from mbdkit.plugin.seams import EnergyRecord, rows_criterion
from mbdkit_transmissions.gears import Rolling
from mbdkit_transmissions.joint_watcher import JointWatcher

#: Forces up to this share of the largest reaction at the bodies of a joint are rounding errors.
ROUND_OFF = 1e-9


class _Touching(NamedTuple):
    """A joint that can only push: its name, its first row, the sign of pushing multipliers, and its friction.

    `around` are the rows of all joints of its bodies.
    """

    name: str
    row: int
    around: list[int]
    sign: float = 1.0
    friction: float | None = None
    rolls: bool = False


class Reactions(JointWatcher):
    """Largest pulling forces of such joints, reactions around them, and the friction that rolling wheels need."""

    ARRAYS = ("size", "pull", "pull_time", "need", "need_time")

    def __init__(self, joints: list[_Touching]):
        self._joints = joints
        self._size, self._pull, self._pull_time, self._need, self._need_time = np.zeros((5, len(joints)))

    def _note(self, states: States) -> None:
        for k, joint in enumerate(self._joints):
            normal = -joint.sign * states.multiplier[:, joint.row]
            self._size[k] = max(self._size[k], float(np.max(np.abs(states.multiplier[:, joint.around]))))
            worst = int(np.argmin(normal))
            if -normal[worst] > self._pull[k]:
                self._pull[k], self._pull_time[k] = -normal[worst], states.time[worst]
            if joint.rolls:
                across = np.abs(states.multiplier[:, joint.row + 1])
                ratio = np.divide(across, normal, out=np.zeros_like(normal), where=normal > ROUND_OFF * self._size[k])
                worst = int(np.argmax(ratio))
                if ratio[worst] > self._need[k]:
                    self._need[k], self._need_time[k] = ratio[worst], states.time[worst]

    def findings(self, _energies: EnergyRecord, _integrals: Mapping[str, object]) -> Iterator[Finding]:
        """Yield a sentence for each joint that pulls or slips."""
        for k, joint in enumerate(self._joints):
            if self._pull[k] > ROUND_OFF * self._size[k]:
                yield Finding(
                    "lift-off",
                    "doubtful",
                    f"joint '{joint.name}' pulls with {self._pull[k]:.4g} N at t = {self._pull_time[k]:.6g} s, where a "
                    "real one would lift off; a spring or more weight would hold it",
                )
            if joint.friction is not None and self._need[k] > joint.friction:
                yield Finding(
                    "rolling-friction",
                    "doubtful",
                    f"joint '{joint.name}' needs a coefficient of friction of {self._need[k]:.4g} to roll at t = "
                    f"{self._need_time[k]:.6g} s, but has {joint.friction:g}, so that it would slip",
                )


@rows_criterion
def watch_reactions(spec: RunSpec, compiled: CompiledMechanism, _size: float) -> Reactions | None:
    """Return what watches the cams and rolling wheels of a mechanism; None if there are none."""
    mechanism = spec.mechanism()
    labels, joints = [row.label for row in compiled.rows], []
    for name, joint in mechanism.joints.items():
        bodies = set(joint.bodies) - {GROUND}
        beside = [
            pairs
            for others, pairs in zip(compiled.joint_bodies, compiled.joint_pairs, strict=True)
            if bodies & {*others}
        ]
        around = [i for i, row in enumerate(compiled.rows) if any(row.pair in pairs for pairs in beside)]
        if joint.type == "cam" or isinstance(joint, Rolling):
            touching = _Touching(name, labels.index(f"{name}.normal"), around)
            if isinstance(joint, Rolling):
                sign = joint.push(mechanism.relative_pose(joint))
                touching = touching._replace(sign=sign, friction=joint.available_friction, rolls=True)
            joints.append(touching)
    return Reactions(joints) if joints else None
