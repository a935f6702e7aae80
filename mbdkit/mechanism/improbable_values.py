"""Values of a mechanism that are valid but improbable, such as inertias in kg mm^2 and friction in percent."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from mbdkit.base.plain_data import quoted
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.contacts import Contact
from mbdkit.mechanism.mechanism import Mechanism

FAR_MASS = 10.0
"""An inertia is improbable if it exceeds the mass of the heaviest body times the square of this many sizes of the
mechanism.

Inertias that are given in kg mm^2 are too large by a factor of 1e6, and those in kg cm^2 by 1e4. The mass is that of
the heaviest body, because bodies of little mass may stand for gears and rotors. In all packaged examples, 5 sizes
would be enough.
"""

WIDE, STAND_IN = 1.5, 0.01
"""The radius of gyration of a body is improbable if it exceeds this many sizes of the mechanism, and if the mass of the
body is at least a share of `STAND_IN` of the heaviest body, so that it does not stand for a gear or a rotor.

In all packaged examples, radii of gyration are at most 1.0 sizes.
"""

ROUGHEST = 5.0
"""A coefficient of friction above this is improbable. Rubber on rough ground reaches about 1, racing tyres about 2,
and percentages are usually larger.
"""


def improbable_inertias(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each body whose inertia is too large for the mechanism.

    The limit is that of `FAR_MASS`, which flywheels, gears and rotors satisfy, too.
    """
    yield from _too_wide(mechanism, math.inf)


def improbable_radii(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each body whose radius of gyration is too large for the mechanism.

    The limit is that of `WIDE`, for measured mechanisms, whose bodies are mostly limbs and rods.
    """
    yield from _too_wide(mechanism, STAND_IN)


def _too_wide(mechanism: Mechanism, share: float) -> Iterator[str]:
    """Yield a sentence for each body whose radius of gyration is too large.

    The limit is `WIDE` for bodies with at least this share of the mass of the heaviest one, and `FAR_MASS` for others.
    """
    heaviest = max((body.mass for body in mechanism.bodies.values()), default=0.0)
    limits = {
        name: WIDE if body.mass >= share * heaviest else FAR_MASS * math.sqrt(heaviest / body.mass)
        for name, body in mechanism.bodies.items()
    }
    radii = {
        name: math.sqrt(body.inertia / body.mass) for name, body in mechanism.bodies.items() if body.inertia is not None
    }
    # The size takes longer to compute, and is at least the extent of the centres of mass. If no radius is too large
    # for this extent, none is too large for the size.
    centres = [body.position for body in mechanism.bodies.values()]
    if not radii or all(radius <= limits[name] * _extent(centres) for name, radius in radii.items()):
        return
    size = _extent([*centres, *_points(mechanism)])
    for name, radius in radii.items():
        if size > 0 and radius > limits[name] * size:
            body = mechanism.bodies[name]
            key = f"model.bodies.{quoted(name)}.inertia" if mechanism.name == "mechanism" else f"model, body {name}"
            yield (
                f"the inertia of {body.inertia:g} kg m^2 at {key} is that of its mass of {body.mass:g} kg at a "
                f"distance of {radius:.3g} m, but the mechanism has a size of {size:.3g} m; if it is in "
                f"another unit, write it with the unit, for example `{body.inertia:g} kg*mm^2`"
            )


def _extent(points: Sequence[tuple[float, float]]) -> float:
    """Return the longer side of the bounding box of points, parallel to the axes [m]."""
    return float(max(max(x) - min(x) for x in zip(*points, strict=True)))


def _points(mechanism: Mechanism) -> Iterator[tuple[float, float]]:
    """Yield the global positions of the points of all elements at the start.

    They include the corners of squares around the circles of contacts, but not the shapes of the ground, whose extent
    says nothing about the bodies.
    """
    for elements in mechanism.elements.values():
        for element in elements.values():
            if not isinstance(element, Contact):
                for _, name, point in element.attachments():
                    yield mechanism.to_global(name, point)
                continue
            for _, _, name, shape in element.by_body:
                round_shape = shape.circle or shape.hole
                radius = 0.0 if round_shape is None else round_shape.radius
                for _, (x, y) in shape.points() if name != GROUND else ():
                    for side in (-radius, radius):
                        yield mechanism.to_global(name, (x + side, y + side))


def improbable_frictions(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each contact and joint whose coefficient of friction is too large."""
    found = {
        f"joints.{quoted(name)}": friction.coefficients
        for name, joint in mechanism.joints.items()
        if (friction := getattr(joint, "friction", None)) is not None
    } | {f"contacts.{quoted(name)}": contact.coefficients for name, contact in mechanism.contacts.items()}
    for place, coefficients in found.items():
        if max(coefficients) > ROUGHEST:
            key = f"model.{place}.friction" if mechanism.name == "mechanism" else f"model, {place}"
            yield (
                f"the coefficient of friction of {max(coefficients):g} at {key} is above {ROUGHEST:g}; if it is in "
                f"percent, write {max(coefficients) / 100:g}"
            )
