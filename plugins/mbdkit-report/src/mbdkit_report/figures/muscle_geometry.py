"""Geometry of drawn muscles: points fixed to the bodies that their paths pass."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.mechanism.coordinate_function import CoordinateFunction, names_of, value_and_slopes
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.muscles import Muscle, PathItem
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_report.figures.cable_geometry import Place


def muscle_places(mechanism: Mechanism, muscle: Muscle) -> list[Place]:
    """Return the points of a muscle, from its origin to its insertion.

    Moving points are drawn at their initial positions; conditional points are left out. On a circle, the point farthest
    to the side of the path is used.
    """
    items = [item for item in muscle.path if item.when is None]
    places = [(item.on, _center(mechanism, item)) for item in items]
    found: list[Place] = []
    for index, item in enumerate(items):
        body, center = places[index]
        if item.wrap is None:
            found.append((body, center))
            continue
        (ax, ay), (bx, by) = (mechanism.to_global(*places[other]) for other in (index - 1, index + 1))
        size = math.hypot(bx - ax, by - ay) or 1.0
        reach = item.wrap.radius * (1.0 if item.wrap.side == "left" else -1.0) / size
        x, y = mechanism.to_global(body, center)
        found.append((body, mechanism.to_local(body, (x - reach * (by - ay), y + reach * (bx - ax)))))
    return found


def _center(mechanism: Mechanism, item: PathItem) -> tuple[float, float]:
    """Return a point, or the center of a circle, in the frame of its body at the start."""
    x, y = (_value(mechanism, part) for part in item.center)
    return x, y


def _value(mechanism: Mechanism, part: CoordinateFunction) -> float:
    if isinstance(part, int | float):
        return float(part)
    names = QuantityNames(mechanism)
    q = np.array([[x for body in mechanism.bodies.values() for x in (*body.position, body.angle)]])
    values = {name: names.coordinate(name).value(q) for name in names_of(part)}
    return float(value_and_slopes(part, values, 1)[0][0])
