"""Bodies that are valid but improbable, such as those with inertias in kg mm^2 or lengths in mm."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from itertools import combinations

from pydantic import BaseModel

from mbdkit.base.plain_data import quoted
from mbdkit.base.text import listed
from mbdkit.base.traced_numbers import dist, hypot, largest, second_largest, sqrt
from mbdkit.mechanism.beams import parts_of
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.size import points_of_elements, size_if_below, smaller_units
from mbdkit.mechanism.values import Point

#: An inertia is improbable if it exceeds the mass of the heaviest body times the square of this many sizes of the
#: mechanism.
#:
#: Inertias that are given in kg mm^2 are too large by a factor of 1e6, and those in kg cm^2 by 1e4. The mass is that of
#: the heaviest body, because bodies of little mass may stand for gears and rotors. In all packaged examples, 5 sizes
#: would be enough.
FAR_MASS = 10.0

#: The radius of gyration of a body is improbable if it exceeds this many sizes of the mechanism, and if the mass of the
#: body is at least a share of `STAND_IN` of the heaviest body, so that it does not stand for a gear or a rotor.
#:
#: In all packaged examples, radii of gyration are at most 1.0 sizes.
WIDE, STAND_IN = 1.5, 0.01

#: A body is improbable if its joints are this many times as far from its centre of mass as any point of the other
#: bodies from theirs, or as their radii of gyration and the lengths of beams.
#:
#: A length in mm is too large by a factor of 1000. In all packaged examples, the ratio is at most 10.
OUTSIZE = 300.0

#: A rigid body longer than `LONG` [m] is improbable if its mass divided by the square of its length is below `LIGHT`
#: [kg/m^2], unless at least `LINKS` bodies have the same mass and length.
#:
#: A steel bar of 100 m and 5 kg has a diameter of 2.8 mm and cannot be rigid. The limit depends on the square of the
#: length because longer bars must be thicker to be equally rigid. Ropes and tethers are lighter, and may consist of
#: equal links. A length in mm divides this ratio by 1e6, so that links of 80 mm are found up to 3.2 kg. The lightest
#: long body of the packaged examples is an ideal rod of 20 m and 1 kg, at 5 times the limit.
LONG, LIGHT, LINKS = 10.0, 5e-4, 3

#: Body heights [m] and body masses [kg] of people outside these ranges are improbable.
HEIGHTS, MASSES = (0.3, 3.0), (2.0, 400.0)

#: A radius of gyration between these shares of the length of a body, the largest distance between its joints, markers
#: and other points, is probably that about a joint.
#:
#: If no mass is beyond these points, the share is at most 0.5. It is 0.58 for a uniform rod about its end, and 0.53 and
#: 0.54 for the shank and the thigh about the knee and the hip (D. A. Winter, Biomechanics and motor control of human
#: movement, 4th edition, table 4.1). If the share is larger, the points say nothing about the size of the body.
ABOUT_JOINT = (0.51, 0.9)


def improbable_inertias(mechanism: Mechanism, share: float = math.inf) -> Iterator[str]:
    """Yield a sentence without a full stop for each body whose inertia, or radius of gyration, is too large for the
    mechanism, except nodes of beams.

    The limit is `FAR_MASS`, which flywheels, gears and rotors satisfy, too; or `WIDE` for bodies with at least a share
    of the mass of the heaviest one, such as `STAND_IN` in measured mechanisms, whose bodies are mostly limbs and rods.
    """
    heaviest = largest([0.0, *(body.mass for body in mechanism.bodies.values())])
    limits = {
        name: WIDE if body.mass >= share * heaviest else FAR_MASS * sqrt(heaviest / body.mass)
        for name, body in mechanism.bodies.items()
    }
    parts = parts_of(mechanism.beams)
    radii = {
        name: sqrt(body.inertia / body.mass)
        for name, body in mechanism.bodies.items()
        if body.inertia is not None and name not in parts
    }
    size = size_if_below(mechanism, largest([0.0, *(radius / limits[name] for name, radius in radii.items())]))
    for name, radius in radii.items():
        if radius > limits[name] * size > 0:
            body = mechanism.bodies[name]
            key = f"model.bodies.{quoted(name)}.inertia" if mechanism.name == "mechanism" else f"model, body {name}"
            units = smaller_units(radius, limits[name] * size)
            proposals = listed([f"`{body.inertia:g} kg*{unit}^2`" for unit in units], "or")
            yield (
                f"the inertia of {body.inertia:g} kg m^2 at {key} is that of its mass of {body.mass:g} kg at a "
                f"distance of {radius:.3g} m, but the mechanism has a size of {size:.3g} m; if it is in "
                f"another unit, write it with the unit, for example {proposals}"
            )


def inertias_about_joints(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each body whose inertia is probably given about a joint.

    The limits are those of `ABOUT_JOINT`, for bodies with at least a share of `STAND_IN` of the largest mass. They
    apply to measured mechanisms; flywheels, cranks and chassis have such inertias, too.
    """
    heaviest = largest([0.0, *(body.mass for body in mechanism.bodies.values())])
    jointed = {name for joint in mechanism.joints.values() for _, name, _ in joint.attachments()}
    points: dict[str, list[Point]] = {name: [] for name in mechanism.bodies}
    for name, point in points_of_elements(mechanism):
        if name != GROUND:
            points[name].append(point)
    for name, body in mechanism.bodies.items():
        if body.inertia is None or name not in jointed or body.mass < STAND_IN * heaviest:
            continue
        length = largest([0.0, *(dist(*pair) for pair in combinations(points[name], 2))])
        radius = sqrt(body.inertia / body.mass)
        if ABOUT_JOINT[0] * length < radius < ABOUT_JOINT[1] * length:
            yield (
                f"the inertia of {body.inertia:g} kg m^2 of body '{name}'{_place_of(mechanism, name)} is that of its "
                f"mass at a distance of {radius:.3g} m, more than half of its length of {length:.3g} m; inertias refer "
                f"to the centre of mass, not to a joint"
            )


def improbable_bodies(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop if a body is too large for the others, or too light for its length.

    The limits are `OUTSIZE` and, if no body exceeds it, `LONG` and `LIGHT`.
    """
    points: dict[str, list[Point]] = {name: [(0.0, 0.0)] for name in mechanism.bodies}
    for joint in mechanism.joints.values():
        for _, name, point in joint.attachments():
            if name != GROUND:
                points[name].append(point)
    reach = {name: largest([hypot(*one) for one in found]) for name, found in points.items()}
    if sentence := _outsize(mechanism, reach):
        yield sentence
    elif 2.0 * largest([0.0, *reach.values()]) > LONG:  # otherwise no body can be longer
        yield from _light(mechanism, points)


def _outsize(mechanism: Mechanism, reach: dict[str, float]) -> str:
    """Return a sentence if a body is too large for the others, otherwise an empty text.

    `reach` is the largest distance of the joints of each body from its centre of mass [m].
    """
    if len(reach) < 2:
        return ""
    if not largest([*reach.values()]) > OUTSIZE * second_largest([*reach.values()]):
        return ""  # before the size of all other elements is computed
    longest, name = max((length, name) for name, length in reach.items())
    sizes = [beam.length for beam in mechanism.beams.values()]
    sizes += [sqrt((body.inertia or 0.0) / body.mass) for other, body in mechanism.bodies.items() if other != name]
    sizes += [hypot(*point) for other, point in points_of_elements(mechanism) if other not in (name, GROUND)]
    if not longest > OUTSIZE * max(sizes) > 0.0:
        return ""
    return (
        f"the joints of body '{name}'{_place_of(mechanism, name)} are up to {longest:.3g} m away from its centre of "
        f"mass, but no other body is larger than {max(sizes):.2g} m; if a length is in mm, write it with the unit, for "
        f"example `80 mm`"
    )


def _light(mechanism: Mechanism, points: dict[str, list[Point]]) -> Iterator[str]:
    """Yield a sentence about the lightest of the bodies that are too light for their lengths.

    `points` are the joints and the centre of mass of each body in its frame [m]; their largest distance is its length.
    """
    lengths = {
        name: largest([dist(*pair) for pair in combinations(found, 2)]) if len(found) > 1 else 0.0
        for name, found in points.items()
    }
    light = {
        name: density
        for name, length in lengths.items()
        if length > LONG and (density := mechanism.bodies[name].mass / length / length) < LIGHT
    }
    links = Counter((mechanism.bodies[name].mass, round(lengths[name], 6)) for name in light)
    if few := [name for name in light if links[mechanism.bodies[name].mass, round(lengths[name], 6)] < LINKS]:
        name = min(few, key=light.__getitem__)
        yield (
            f"body '{name}'{_place_of(mechanism, name)} is {lengths[name]:.3g} m long, but has a mass of only "
            f"{mechanism.bodies[name].mass:.3g} kg; if its length is in mm, write it with the unit, for example "
            f"`{lengths[name]:.3g} mm`"
        )


def _place_of(mechanism: Mechanism, body: str) -> str:
    """Return where a body is in a spec, for sentences; empty if its mechanism comes from a model."""
    return f" at model.bodies.{quoted(body)}" if mechanism.name == "mechanism" else ""


def improbable_people(model: BaseModel) -> Iterator[str]:
    """Yield a sentence without a full stop for a body height and a body mass that no person has.

    Models of people have the options `height` [m] and `body_mass` [kg].
    """
    height, mass = getattr(model, "height", None), getattr(model, "body_mass", None)
    if height is None or mass is None:
        return
    if not HEIGHTS[0] <= height <= HEIGHTS[1]:
        advice = f"; if it is in cm, write `{height:g} cm`" if height > HEIGHTS[1] else ""
        yield f"the body height of {height:g} m at model.height is that of no person{advice}"
    if not MASSES[0] <= mass <= MASSES[1]:
        advice = f"; if it is in g, write `{mass:g} g`" if mass > MASSES[1] else ""
        yield f"the body mass of {mass:g} kg at model.body_mass is that of no person{advice}"
