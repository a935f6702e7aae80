"""Values of a mechanism that are valid but improbable, such as inertias in kg mm^2 and friction in percent."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mbdkit.base.plain_data import quoted
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.size import mechanism_size

FAR_MASS = 10.0
"""An inertia is improbable if it exceeds the mass of the heaviest body times the square of this many sizes of the
mechanism.

Inertias that are given in kg mm^2 are too large by a factor of 1e6, and those in kg cm^2 by 1e4. The mass is that of
the heaviest body, because bodies of little mass may stand for gears and rotors. In all packaged examples, 5 sizes
would be enough.
"""

ROUGHEST = 5.0
"""A coefficient of friction above this is improbable. Rubber on rough ground reaches about 1, racing tyres about 2,
and percentages are usually larger.
"""


def improbable_inertias(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each body whose inertia is too large for the mechanism."""
    rigid = {name: body for name, body in mechanism.bodies.items() if body.inertia is not None}
    if not rigid:
        return
    heaviest = max(body.mass for body in mechanism.bodies.values())
    # The size takes longer to compute, and is at least the extent of the centres of mass. If no inertia is too large
    # for this extent, none is too large for the size.
    extent = max(max(x) - min(x) for x in zip(*(body.position for body in mechanism.bodies.values()), strict=True))
    if max(body.inertia or 0.0 for body in rigid.values()) <= heaviest * (FAR_MASS * extent) ** 2:
        return
    size = mechanism_size(mechanism, np.array([(*body.position, body.angle) for body in mechanism.bodies.values()]))
    for name, body in rigid.items():
        inertia = body.inertia or 0.0
        if size > 0 and inertia > heaviest * (FAR_MASS * size) ** 2:
            key = f"model.bodies.{quoted(name)}.inertia" if mechanism.name == "mechanism" else f"model, body {name}"
            yield (
                f"the inertia of {inertia:g} kg m^2 at {key} is that of its mass of {body.mass:g} kg at a distance of "
                f"{math.sqrt(inertia / body.mass):.3g} m, but the mechanism has a size of {size:.3g} m; if it is in "
                f"another unit, write it with the unit, for example `{inertia:g} kg*mm^2`"
            )


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
