"""Geometry of a drawn cable over several joints: points on the bodies that it passes."""

from __future__ import annotations

import math
from collections.abc import Mapping

from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.pathways import JointAngles

Place = tuple[str, tuple[float, float]]
"""Body, and point in its frame [m]."""


def cable_places(joints: Mapping[str, Joint], pathway: JointAngles) -> list[Place]:
    """Return the points that a cable over pulleys passes, from its first body to its last one.

    The cable passes every joint at a distance equal to the radius. It passes on the side on which its tension turns the
    second body in the direction given by the sign of the radius. It ends beside the centres of mass of the first and
    the last body, unless these are the ground.
    """
    passed = [joints[name] for name in pathway.radii]
    places: list[Place] = []
    for index, (joint, radius) in enumerate(zip(passed, pathway.radii.values(), strict=True)):
        first, second = joint.bodies
        before, after = _centre(joints, joint, first), _centre(joints, joint, second)
        if index == 0 and first != GROUND:
            places.append((first, _beside((0.0, 0.0), before, radius)[0]))
        if second == GROUND:
            places.append((first, _beside((0.0, 0.0), before, radius)[1]))
            continue
        following = passed[index + 1] if index + 1 < len(passed) else None
        leads_on = following is not None and second in following.bodies
        far = _centre(joints, following, second) if following is not None and leads_on else (0.0, 0.0)
        near_side, far_side = _beside(after, far, radius)
        places.append((second, near_side))
        if not leads_on:
            places.append((second, far_side))
    return places


def _beside(start: tuple[float, float], end: tuple[float, float], radius: float) -> list[tuple[float, float]]:
    """Return two points shifted by a radius to the left of the direction from `start` to `end`."""
    along = (end[0] - start[0], end[1] - start[1])
    size = math.hypot(*along) or 1.0
    across = (-radius * along[1] / size, radius * along[0] / size)
    return [(point[0] + across[0], point[1] + across[1]) for point in (start, end)]


def _centre(joints: Mapping[str, Joint], joint: Joint, body: str) -> tuple[float, float]:
    """Return the point of a joint in the frame of one of its bodies [m]. For a driver without points, the point of
    another joint between the same bodies is used; the origin if there is none.
    """
    for one in (joint, *joints.values()):
        if set(one.bodies) == set(joint.bodies):
            for _, name, point in one.attachments():
                if name == body:
                    return point
    return 0.0, 0.0
