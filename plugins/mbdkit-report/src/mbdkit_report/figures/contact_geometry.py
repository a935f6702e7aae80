"""Geometry of the drawn shapes of contacts: lines through points fixed to the bodies."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.mechanism.contacts import LineShape, Shape
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_report.figures.cable_geometry import Place

ON_CIRCLE = 24
"""Number of points of a circle."""


def contact_places(mechanism: Mechanism, body: str, shape: Shape) -> list[Place]:
    """Return the points through which the shape of a contact is drawn; none for a point, which has no outline."""
    if shape.line is not None:
        points = _line(mechanism, body, shape.line)
    elif shape.circle is not None or shape.hole is not None:
        (x, y), radius = shape.circle_of
        turns = np.linspace(0.0, 2.0 * np.pi, ON_CIRCLE, endpoint=False).tolist()
        points = [(x + radius * math.cos(turn), y + radius * math.sin(turn)) for turn in turns]
    else:
        points = list(shape.polygon or ())
    closed = points[:1] if shape.line is None else []
    return [(body, point) for point in [*points, *closed]]


def _line(mechanism: Mechanism, body: str, line: LineShape) -> list[tuple[float, float]]:
    """Return the ends of the drawn part of a line, which extends beyond all bodies by half of their total extent."""
    (x, y), (nx, ny) = line.point, line.unit
    elements = [*mechanism.joints.values(), *mechanism.contacts.values()]
    places = [mechanism.to_global(name, point) for element in elements for _, name, point in element.attachments()]
    places += [body.position for body in mechanism.bodies.values()]
    local = [mechanism.to_local(body, place) for place in places]
    along = [(px - x) * ny - (py - y) * nx for px, py in local]
    room = 0.5 * float(np.max(np.ptp(np.array(places), axis=0))) or 1.0
    return [(x + s * ny, y - s * nx) for s in (min(along) - room, max(along) + room)]
