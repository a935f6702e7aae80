"""Joints that transmit no motion: closed trains whose ratios contradict each other, and bodies that are held still."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from mbdkit import EquationsOfMotion, StepError
from mbdkit.plugin import GROUND, FunctionJoint, Joint, Revolute, SpecError, listed, quoted
from mbdkit.plugin.mechanisms import mechanism_size
from mbdkit.plugin.seams import ElementsByName, element_check, start_criterion
from mbdkit_transmissions.gears import Belt, Gear

if TYPE_CHECKING:
    from mbdkit import Mechanism
    from mbdkit.plugin import RunSpec
    from mbdkit.plugin.equations import AssembledState

TIMES, MOVE = 4, 0.05
"""Times of the run at which velocities are examined, and the share of an arbitrary velocity by which bodies move."""
STILL = 1e-9
"""Relative velocity, in sizes of the mechanism and radians, below which bodies do not move."""
AGREEMENT = 1e-9
"""Relative difference up to which two ratios agree, and distance [m] up to which two points do."""

Ratios = dict[str, dict[str, tuple[float, str]]]
"""For each body, the bodies that it turns: the ratio of their angles, and the joint."""


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


@start_criterion
def locked_joints(spec: RunSpec, start: AssembledState) -> Iterator[str]:
    """Yield a sentence if joints, among them some of this part, hold their bodies still.

    An arbitrary velocity that satisfies all constraints moves every joint that can move. Joints that do not move then,
    with drivers at several times, and not at a second position either, which excludes dead centres, are locked.
    """
    mechanism, begin = spec.mechanism(), spec.time.start
    equations = EquationsOfMotion.of(mechanism, begin)
    size, q = mechanism_size(mechanism, start.q) or 1.0, start.q.ravel()
    unit = np.tile([size, size, 1.0], len(start.q))
    arbitrary, locked = unit * np.random.default_rng(0).normal(size=len(q)), dict(mechanism.joints)
    try:
        for t in np.linspace(spec.time.final, begin, TIMES):
            v = equations.project_velocities(float(t), q, arbitrary)
            locked = {name: joint for name, joint in locked.items() if _is_still(joint, mechanism, q, v, size)}
            if not any(isinstance(joint, FunctionJoint) for joint in locked.values()):
                return
        move = MOVE * v / max(1.0, float(np.max(np.abs(v / unit))))
        q, v = equations.project(begin, q + move, arbitrary)
        locked = {name: joint for name, joint in locked.items() if _is_still(joint, mechanism, q, v, size)}
    except StepError:
        return
    while leaves := [name for name, joint in locked.items() if any(_ends(body, locked) == 1 for body in joint.bodies)]:
        del locked[leaves[0]]
    still = [name for name, joint in locked.items() if isinstance(joint, FunctionJoint)]
    if still:
        yield (
            f"{_named(list(locked))} hold their bodies still, so that {_named(still)} can transmit no motion; correct "
            "a ratio or an equation, or remove a joint; if this is intended, write `accept: [locked-joints]`"
        )


def _is_still(joint: Joint, mechanism: Mechanism, q: np.ndarray, v: np.ndarray, size: float) -> bool:
    """Return whether the bodies of a joint do not move relative to each other."""
    bodies = [*mechanism.bodies, GROUND]
    place, rate = (
        np.append(x, np.zeros(3)).reshape(-1, 3)[[bodies.index(body) for body in joint.bodies]] for x in (q, v)
    )
    dx, dy, _ = place[1] - place[0]
    vx, vy, turn = rate[1] - rate[0]
    turned = float(rate[0, 2])
    return max(math.hypot(vx + turned * dy, vy - turned * dx) / size, abs(turn)) < STILL


def _ends(body: str, joints: Mapping[str, Joint]) -> int:
    """Return how many joints a body has; 0 for the ground."""
    return 0 if body == GROUND else sum(body in joint.bodies for joint in joints.values())


def _named(names: list[str]) -> str:
    shown = [f"'{name}'" for name in names[:6]] + ["..."] * (len(names) > 6)
    return f"joint{'s' * (len(names) > 1)} {listed(shown, 'and')}"
