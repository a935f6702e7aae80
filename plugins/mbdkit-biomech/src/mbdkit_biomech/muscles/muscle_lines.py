"""Lines with which muscles are drawn."""

from __future__ import annotations

import math

import numpy as np

from mbdkit.mechanism.coordinate_function import CoordinateFunction, names_of, value_and_slopes
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import element_lines
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.muscles.muscle import Muscle

Place = tuple[str, tuple[float, float]]  #: Body, and point in its frame [m].


@element_lines
def muscle_lines(muscle: Muscle, mechanism: Mechanism) -> list[list[Place]]:
    """Return the line of a muscle, from its origin to its insertion.

    Moving points are drawn at their initial positions; conditional points are left out. On a circle, the point farthest
    to the side of the path is used.
    """
    items = [item for item in muscle.path if item.when is None]
    places: list[Place] = []
    for item in items:  # a point, or the center of a circle, in the frame of its body at the start
        x, y = (_value(mechanism, part) for part in item.center)
        places.append((item.on, (x, y)))
    results: list[Place] = []
    for index, item in enumerate(items):
        body, center = places[index]
        if item.wrap is None:
            results.append((body, center))
            continue
        (ax, ay), (bx, by) = (mechanism.to_global(*places[other]) for other in (index - 1, index + 1))
        size = math.hypot(bx - ax, by - ay) or 1.0
        reach = item.wrap.radius * (1.0 if item.wrap.side == "left" else -1.0) / size
        x, y = mechanism.to_global(body, center)
        results.append((body, mechanism.to_local(body, (x - reach * (by - ay), y + reach * (bx - ax)))))
    return [results]


def _value(mechanism: Mechanism, part: CoordinateFunction) -> float:
    if isinstance(part, int | float):
        return float(part)
    names = QuantityNames(mechanism)
    q = np.array([[x for body in mechanism.bodies.values() for x in (*body.position, body.angle)]])
    values = {name: names.coordinate(name).value(q) for name in names_of(part)}
    return float(value_and_slopes(part, values, 1)[0][0])
