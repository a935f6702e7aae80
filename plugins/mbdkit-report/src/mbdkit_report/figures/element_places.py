"""Points on the bodies through which cables over joints and the shapes of contacts are drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.pathways import JointAngles

if TYPE_CHECKING:
    from mbdkit_contact.contact import Shape

Place = tuple[str, tuple[float, float]]  #: Body, and point in its frame [m].
ON_CIRCLE = 24  #: Number of points of a circle.


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


def contact_places(mechanism: Mechanism, body: str, shape: Shape) -> list[Place]:
    """Return the points through which the shape of a contact is drawn; none for a point, which has no outline."""
    if shape.line is not None:
        nx, ny = shape.line.unit
        points = [_far_end(mechanism, body, shape.line.point, side) for side in ((-ny, nx), (ny, -nx))]
    elif shape.polyline is not None:
        polyline = shape.polyline
        ends = [(end, (end[0] - inner[0], end[1] - inner[1])) for end, inner in (polyline[:2], polyline[:-3:-1])]
        first, last = (_far_end(mechanism, body, *end) for end in ends)
        points = [first, *polyline, last]
    elif shape.circle is not None or shape.hole is not None:
        (x, y), radius = shape.circle_of
        turns = np.linspace(0.0, 2.0 * np.pi, ON_CIRCLE, endpoint=False).tolist()
        points = [(x + radius * math.cos(turn), y + radius * math.sin(turn)) for turn in turns]
    else:
        points = list(shape.polygon or ())
    closed = points[:1] if shape.line is None and shape.polyline is None else []
    return [(body, point) for point in [*points, *closed]]


def _far_end(
    mechanism: Mechanism, body: str, start: tuple[float, float], direction: tuple[float, float]
) -> tuple[float, float]:
    """Return the end of the drawn part of a line without end. It extends beyond all bodies by half of their total
    extent.
    """
    elements = [*mechanism.joints.values(), *mechanism.elements["contacts"].values()]
    places = [mechanism.to_global(name, point) for element in elements for _, name, point in element.attachments()]
    places += [body.position for body in mechanism.bodies.values()]
    room = 0.5 * float(np.max(np.ptp(np.array(places), axis=0))) or 1.0
    (x, y), (dx, dy), size = start, direction, math.hypot(*direction)
    local = [mechanism.to_local(body, place) for place in places]
    far = room + max(0.0, *(((px - x) * dx + (py - y) * dy) / size for px, py in local))
    return x + far * dx / size, y + far * dy / size
