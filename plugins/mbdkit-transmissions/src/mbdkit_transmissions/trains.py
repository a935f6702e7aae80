"""Joints that transmit no motion: closed trains whose ratios contradict each other, and bodies that are held still."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from mbdkit import EquationsOfMotion, StepError
from mbdkit.plugin import GROUND, FunctionJoint, Joint, Revolute, RunSpec, SpecError, States, listed, quoted
from mbdkit.plugin.equations import CompiledMechanism
from mbdkit.plugin.seams import ElementsByName, EnergyRecord, element_check, rows_criterion
from mbdkit_transmissions.gears import Belt, Gear
from mbdkit_transmissions.joint_watcher import JointWatcher

#: Displacement that tells whether joints can move, and that up to which they have not moved, in sizes of the mechanism
#: and radians.
MOVE, STILL = 0.05, 1e-9
#: Relative difference up to which two ratios agree, and distance [m] up to which two points do.
AGREEMENT = 1e-9

#: For each body, the bodies that it turns: the ratio of their angles, and the joint.
Ratios = dict[str, dict[str, tuple[float, str]]]


@element_check
def check_trains(joints: Mapping[str, Gear | Belt], mechanism: ElementsByName, prefix: str) -> None:
    """Raise SpecError for the first joint that closes a train between axes of one body, and contradicts the others."""
    everything = {**mechanism.joints, **joints}
    for carrier in (GROUND, *mechanism.bodies):
        axes, turned = dict(_axes(carrier, everything)), Ratios()
        for name, joint in everything.items():
            if not isinstance(joint, Gear | Belt) or not all(
                body in axes and max(abs(x - y) for x, y in zip(axes[body], point, strict=True)) < AGREEMENT
                for body, point in zip(joint.bodies, joint.points, strict=True)
            ):
                continue
            a, b = joint.bodies
            if (known := _way(turned, a, b)) is None:
                turned.setdefault(a, {})[b] = joint.ratio, name
                turned.setdefault(b, {})[a] = 1.0 / joint.ratio, name
            elif abs(known[0] / joint.ratio - 1.0) > AGREEMENT:
                others = listed([f"'{other}'" for other in known[1]], "and")
                raise SpecError(
                    f"this joint turns '{b}' by {joint.ratio:.6g} times the angle of '{a}', but {others} "
                    f"{'turn' if len(known[1]) > 1 else 'turns'} it by {known[0]:.6g} times this angle, so that "
                    "nothing can turn; correct a ratio, or remove a joint",
                    key=f"{prefix}joints.{quoted(name)}",
                )


def _axes(carrier: str, joints: Mapping[str, Joint]) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield each body that turns about a fixed axis of a body, and this axis in its own frame."""
    for joint in joints.values():
        if isinstance(joint, Revolute) and joint.center is None and carrier in joint.bodies:
            (a, b), (xa, ya, xb, yb) = joint.bodies, joint.flat_points
            yield (b, (xb, yb)) if a == carrier else (a, (xa, ya))


def _way(turned: Ratios, a: str, b: str) -> tuple[float, list[str]] | None:
    """Return the ratio of the angle of b to that of a by joints that are known, and their names; None without a way."""
    ways: dict[str, tuple[float, list[str]]] = {a: (1.0, [])}
    bodies = [a]
    for body in bodies:
        for other, (ratio, name) in turned.get(body, {}).items():
            if other not in ways:
                ways[other] = ways[body][0] * ratio, [*ways[body][1], name]
                bodies.append(other)
    return ways.get(b)


class StillJoints(JointWatcher):
    """Joints of this part whose bodies have not moved relative to each other, and what holds them."""

    ARRAYS = ("first", "moved")

    def __init__(self, spec: RunSpec, size: float):
        self._spec, self._size = spec, size
        self._joints, self._bodies = spec.mechanism().joints, [*spec.mechanism().bodies, GROUND]
        self._names = [name for name, joint in self._joints.items() if isinstance(joint, FunctionJoint)]
        self._first, self._moved = np.full((len(self._names), 3), np.nan), np.zeros(len(self._names))

    def _poses(self, name: str, q: np.ndarray) -> np.ndarray:
        """Return the poses (T, 3) of a joint's second body in the frame of the first, for positions (T, n).

        Lengths are in sizes of the mechanism, angles in radians.
        """
        a, b = (q[:, 3 * i : 3 * i + 3].T for i in map(self._bodies.index, self._joints[name].bodies))
        (dx, dy, turn), c, s = b - a, np.cos(a[2]), np.sin(a[2])
        return np.column_stack([(c * dx + s * dy) / self._size, (c * dy - s * dx) / self._size, turn])

    def _note(self, states: States) -> None:
        for k in np.flatnonzero(self._moved < STILL):
            poses = self._poses(self._names[k], states.q)
            self._first[k] = np.where(np.isnan(self._first[k]), poses[0], self._first[k])
            self._moved[k] = max(self._moved[k], float(np.max(np.abs(poses - self._first[k]))))

    def findings(self, _energies: EnergyRecord, _integrals: Mapping[str, object]) -> Iterator[str]:
        """Yield a sentence if other joints hold the bodies of joints that have not moved.

        An arbitrary small displacement that satisfies all constraints moves every joint that can move.
        """
        if np.all(self._moved >= STILL):
            return
        begin, random = self._spec.time.start, np.random.default_rng(0)
        equations = EquationsOfMotion.of(self._spec.mechanism(), begin)
        unit = np.tile([self._size, self._size, 1.0], equations.n // 3)
        try:
            v = equations.project_velocities(begin, equations.q0, unit * random.normal(size=equations.n))
            moved = MOVE * v / max(1.0, float(np.max(np.abs(v / unit))))
            q = np.array([equations.q0, equations.project_positions(begin, equations.q0 + moved)])
        except StepError:
            return
        q = np.hstack([q, np.zeros((2, 3))])
        held = {
            name: joint for name, joint in self._joints.items() if np.ptp(self._poses(name, q), axis=0).max() < STILL
        }
        while free := [name for name, joint in held.items() if any(_count(body, held) == 1 for body in joint.bodies)]:
            del held[free[0]]
        locked = [name for name, moved in zip(self._names, self._moved, strict=True) if moved < STILL and name in held]
        if locked and not any(joint.is_driver for joint in held.values()):
            yield (
                f"{_named(list(held))} hold their bodies still, so that {_named(locked)} can transmit no motion; "
                "correct a ratio or an equation, or remove a joint; if it is intended, write `accept: [locked-joints]`"
            )


@rows_criterion
def watch_still_joints(spec: RunSpec, _compiled: CompiledMechanism, size: float) -> StillJoints:
    """Return what watches whether the joints of this part move."""
    return StillJoints(spec, size)


def _count(body: str, joints: Mapping[str, Joint]) -> int:
    """Return how many joints a body has; 0 for the ground."""
    return 0 if body == GROUND else sum(body in joint.bodies for joint in joints.values())


def _named(names: list[str]) -> str:
    shown = [f"'{name}'" for name in names[:6]] + ["..."] * (len(names) > 6)
    return f"joint{'s' * (len(names) > 1)} {listed(shown, 'and')}"
