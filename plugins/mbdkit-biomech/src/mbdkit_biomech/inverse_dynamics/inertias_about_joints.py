"""Inertias of measured mechanisms that are probably given about a joint instead of the centre of mass."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations

from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.extent import points_of_elements
from mbdkit.mechanism.improbable_bodies import STAND_IN, place_of
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.values import Point

ABOUT_JOINT = (0.51, 0.9)
"""A radius of gyration between these shares of the length of a body, the largest distance between its joints, markers
and other points, is probably that about a joint.

If no mass is beyond these points, the share is at most 0.5. It is 0.58 for a uniform rod about its end, and 0.53 and
0.54 for the shank and the thigh about the knee and the hip (D. A. Winter, Biomechanics and motor control of human
movement, 4th edition, table 4.1). If the share is larger, the points say nothing about the size of the body.
"""


def inertias_about_joints(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each body whose inertia is probably given about a joint.

    The limits are those of `ABOUT_JOINT`, for bodies with at least a share of `STAND_IN` of the largest mass. They
    apply to measured mechanisms; flywheels, cranks and chassis have such inertias, too.
    """
    heaviest = max((body.mass for body in mechanism.bodies.values()), default=0.0)
    jointed = {name for joint in mechanism.joints.values() for _, name, _ in joint.attachments()}
    points: dict[str, list[Point]] = {name: [] for name in mechanism.bodies}
    for name, point in points_of_elements(mechanism):
        if name != GROUND:
            points[name].append(point)
    for name, body in mechanism.bodies.items():
        if body.inertia is None or name not in jointed or body.mass < STAND_IN * heaviest:
            continue
        length = max((math.dist(*pair) for pair in combinations(points[name], 2)), default=0.0)
        radius = math.sqrt(body.inertia / body.mass)
        if ABOUT_JOINT[0] * length < radius < ABOUT_JOINT[1] * length:
            yield (
                f"the inertia of {body.inertia:g} kg m^2 of body '{name}'{place_of(mechanism, name)} is that of its "
                f"mass at a distance of {radius:.3g} m, more than half of its length of {length:.3g} m; inertias refer "
                f"to the centre of mass, not to a joint"
            )
