"""Values of a mechanism that are valid but improbable, such as inertias in kg mm^2 and free lengths in cm."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations

from pydantic import BaseModel

from mbdkit.base.plain_data import quoted
from mbdkit.base.text import listed
from mbdkit.mechanism.beams import Beam, parts_of
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.contacts import Contact
from mbdkit.mechanism.forces import SpringDamper
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.pathways import Coordinate
from mbdkit.mechanism.values import Point

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

ABOUT_JOINT = (0.51, 0.9)
"""A radius of gyration between these shares of the length of a body, the largest distance between its joints, markers
and other points, is probably that about a joint.

If no mass is beyond these points, the share is at most 0.5. It is 0.58 for a uniform rod about its end, and 0.53 and
0.54 for the shank and the thigh about the knee and the hip (D. A. Winter, Biomechanics and motor control of human
movement, 4th edition, table 4.1). If the share is larger, the points say nothing about the size of the body.
"""

ROUGHEST = 5.0
"""A coefficient of friction above this is improbable. Rubber on rough ground reaches about 1, racing tyres about 2,
and percentages are usually larger.
"""

SOFTEST, SOFT, METAL = 1e3, 5e5, 2500.0
"""A Young's modulus [Pa] below `SOFTEST`, that of the softest tissues, is improbable, and so is one below `SOFT`, that
of soft rubber, if the density [kg/m^3] is above `METAL`.

Moduli of hard materials in GPa are at most 1200, and those of metals in MPa at most 4.1e5. A beam of E = 7e5 and 5540
kg/m^3 is a common test of flexible pendulums.
"""

LIGHTEST = 20.0
"""A density below this [kg/m^3] is improbable. Light foams have about 30, and all metals less than 23 g/cm^3."""

WIDEST = 100.0
"""A cross-section is improbable if it is deeper than the beam is long, or this many times as wide as the beam is long,
or wider than the beam is long and `THINNEST` times as wide as deep.

Flexure hinges may be wide and short. An area in mm^2 makes the width of a rectangle of given I wrong by a factor of
1e9, and an area in cm^2 by 1e6.
"""

THINNEST = 1e4
"""If an improbable cross-section is more than this many times as deep as wide, its I has another unit, if it is more
than this many times as wide as deep, its A, and otherwise both.

A wrong unit of I alone or A alone changes the ratio of width to depth by a factor of 1e8 or more.
"""

LONGEST = 10.0
"""The free length of a spring is improbable if it exceeds this many lengths of the spring at the start, and `LARGE`
sizes of the mechanism.

Free lengths in cm are too large by a factor of 100. In all packaged examples, free lengths are at most 1.3 times the
length at the start.
"""

LARGE = 3.0
"""The optimal length of a muscle, and the deflection at the start of a one-sided spring along a coordinate, are
improbable if they exceed this many sizes of the mechanism.

In all packaged examples, optimal lengths are at most 0.21 sizes.
"""

OUTSIZE = 300.0
"""A body is improbable if its joints are this many times as far from its centre of mass as any point of the other
bodies from theirs, or as their radii of gyration and the lengths of beams.

A length in mm is too large by a factor of 1000. In all packaged examples, the ratio is at most 10.
"""

LONG, LIGHT, LINKS = 10.0, 5e-4, 3
"""A rigid body longer than `LONG` [m] is improbable if its mass divided by the square of its length is below `LIGHT`
[kg/m^2], unless at least `LINKS` bodies have the same mass and length.

A steel bar of 100 m and 5 kg has a diameter of 2.8 mm and cannot be rigid. The limit depends on the square of the
length because longer bars must be thicker to be equally rigid. Ropes and tethers are lighter, and may consist of equal
links. A length in mm divides this ratio by 1e6, so that links of 80 mm are found up to 3.2 kg. The lightest long body
of the packaged examples is an ideal rod of 20 m and 1 kg, at 5 times the limit.
"""

HEIGHTS, MASSES = (0.3, 3.0), (2.0, 400.0)
"""Body heights [m] and body masses [kg] of people outside these ranges are improbable."""


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
    """Yield a sentence for each body whose radius of gyration is too large, except nodes of beams.

    The limit is `WIDE` for bodies with at least this share of the mass of the heaviest one, and `FAR_MASS` for others.
    """
    heaviest = max((body.mass for body in mechanism.bodies.values()), default=0.0)
    limits = {
        name: WIDE if body.mass >= share * heaviest else FAR_MASS * math.sqrt(heaviest / body.mass)
        for name, body in mechanism.bodies.items()
    }
    parts = parts_of(mechanism.beams)
    radii = {
        name: math.sqrt(body.inertia / body.mass)
        for name, body in mechanism.bodies.items()
        if body.inertia is not None and name not in parts
    }
    size = _size_if_below(mechanism, max((radius / limits[name] for name, radius in radii.items()), default=0.0))
    for name, radius in radii.items():
        if radius > limits[name] * size > 0:
            body = mechanism.bodies[name]
            key = f"model.bodies.{quoted(name)}.inertia" if mechanism.name == "mechanism" else f"model, body {name}"
            units = _smaller_units(radius, limits[name] * size)
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
    heaviest = max((body.mass for body in mechanism.bodies.values()), default=0.0)
    jointed = {name for joint in mechanism.joints.values() for _, name, _ in joint.attachments()}
    points: dict[str, list[Point]] = {name: [] for name in mechanism.bodies}
    for name, point in _points(mechanism):
        if name != GROUND:
            points[name].append(point)
    for name, body in mechanism.bodies.items():
        if body.inertia is None or name not in jointed or body.mass < STAND_IN * heaviest:
            continue
        length = max((math.dist(*pair) for pair in combinations(points[name], 2)), default=0.0)
        radius = math.sqrt(body.inertia / body.mass)
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
    reach = {name: max(math.hypot(*one) for one in found) for name, found in points.items()}
    if largest := _outsize(mechanism, reach):
        yield largest
    elif 2.0 * max(reach.values(), default=0.0) > LONG:  # otherwise no body can be longer
        yield from _light(mechanism, points)


def _outsize(mechanism: Mechanism, reach: dict[str, float]) -> str:
    """Return a sentence if a body is too large for the others, otherwise an empty text.

    `reach` is the largest distance of the joints of each body from its centre of mass [m].
    """
    if len(reach) < 2:
        return ""
    (second, _), (largest, name) = sorted((length, name) for name, length in reach.items())[-2:]
    if not largest > OUTSIZE * second:
        return ""  # before the size of all other elements is computed
    sizes = [beam.length for beam in mechanism.beams.values()]
    sizes += [math.sqrt((body.inertia or 0.0) / body.mass) for other, body in mechanism.bodies.items() if other != name]
    sizes += [math.hypot(*point) for other, point in _points(mechanism) if other not in (name, GROUND)]
    if not largest > OUTSIZE * max(sizes) > 0.0:
        return ""
    return (
        f"the joints of body '{name}'{_place_of(mechanism, name)} are up to {largest:.3g} m away from its centre of "
        f"mass, but no other body is larger than {max(sizes):.2g} m; if a length is in mm, write it with the unit, for "
        f"example `80 mm`"
    )


def _light(mechanism: Mechanism, points: dict[str, list[Point]]) -> Iterator[str]:
    """Yield a sentence about the lightest of the bodies that are too light for their lengths.

    `points` are the joints and the centre of mass of each body in its frame [m]; their largest distance is its length.
    """
    lengths = {
        name: max(math.dist(*pair) for pair in combinations(found, 2)) if len(found) > 1 else 0.0
        for name, found in points.items()
    }
    links = Counter((mechanism.bodies[name].mass, round(length, 6)) for name, length in lengths.items())
    light = {
        name: mass / length**2
        for name, length in lengths.items()
        if length > LONG and (mass := mechanism.bodies[name].mass) < LIGHT * length**2
        if links[mass, round(length, 6)] < LINKS
    }
    if light:
        name = min(light, key=light.__getitem__)
        yield (
            f"body '{name}'{_place_of(mechanism, name)} is {lengths[name]:.3g} m long, but has a mass of only "
            f"{mechanism.bodies[name].mass:.3g} kg; if its length is in mm, write it with the unit, for example "
            f"`{lengths[name]:.3g} mm`"
        )


def _place_of(mechanism: Mechanism, body: str) -> str:
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


def _smaller_units(length: float, limit: float) -> list[str]:
    """Return those of cm and mm in which a length is at most `limit` metres; if there are none, mm."""
    return [unit for unit, factor in (("cm", 1e-2), ("mm", 1e-3)) if factor * length <= limit] or ["mm"]


def _size_if_below(mechanism: Mechanism, limit: float) -> float:
    """Return the size of a mechanism if it may be below `limit`, otherwise a lower bound of the size, which takes less
    time to compute [m].
    """
    centres = [body.position for body in mechanism.bodies.values()]
    least = _extent(centres) if centres else 0.0
    return least if limit <= least else _extent([*centres, *(mechanism.to_global(*one) for one in _points(mechanism))])


def _extent(points: Sequence[tuple[float, float]]) -> float:
    """Return the longer side of the bounding box of points, parallel to the axes [m]."""
    return float(max(max(x) - min(x) for x in zip(*points, strict=True)))


def _points(mechanism: Mechanism) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield the bodies of the points of all elements, and the points in the frames of these bodies.

    They include the corners of squares around the circles of contacts, but not the shapes of the ground, whose extent
    says nothing about the bodies.
    """
    for elements in mechanism.elements.values():
        for element in elements.values():
            if not isinstance(element, Contact):
                for _, name, point in element.attachments():
                    yield name, point
                continue
            for _, _, name, shape in element.by_body:
                round_shape = shape.circle or shape.hole
                radius = 0.0 if round_shape is None else round_shape.radius
                for _, (x, y) in shape.points() if name != GROUND else ():
                    for side in (-radius, radius):
                        yield name, (x + side, y + side)


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


def rolling_point_masses(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each point mass with a round shape that friction cannot turn."""
    for name, contact in mechanism.contacts.items():
        for _, _, body, shape in contact.by_body:
            circle = shape.circle
            is_point_mass = body != GROUND and mechanism.bodies[body].inertia is None
            if is_point_mass and circle is not None and circle.radius > 0 and max(contact.coefficients) > 0:
                yield (
                    f"body '{body}' is a point mass (it has no inertia), so that the friction of contact '{name}' does "
                    f"not turn its circle of {circle.radius:g} m, and it slides instead of rolling; give `inertia`"
                )


def improbable_beams(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each modulus, density, cross-section and rotary inertia of a beam that
    is improbable.
    """
    for name, beam in mechanism.beams.items():
        place = f"model.beams.{quoted(name)}" if mechanism.name == "mechanism" else f"model, beam {name}"
        yield from _improbable_material(beam, place)
        yield from _improbable_section(beam, place)


_ADVICE = "if it is in another unit, write it with the unit, for example"


def _improbable_material(beam: Beam, place: str) -> Iterator[str]:
    if beam.E is not None and beam.E < SOFTEST:
        yield (
            f"Young's modulus of {beam.E:g} Pa at {place}.E is below {SOFTEST:g} Pa, that of the softest tissues; "
            f"{_ADVICE} `{beam.E:g} GPa`"
        )
    elif beam.E is not None and beam.E < SOFT and (beam.density or 0.0) > METAL:
        yield (
            f"Young's modulus of {beam.E:g} Pa at {place}.E is that of soft rubber, but the density of "
            f"{beam.density:g} kg/m^3 is that of a metal; {_ADVICE} `{beam.E:g} MPa`"
        )
    if beam.density is not None and beam.density < LIGHTEST:
        yield (
            f"the density of {beam.density:g} kg/m^3 at {place}.density is below that of light foams; "
            f"{_ADVICE} `{beam.density:g} g/cm^3`"
        )


def _improbable_section(beam: Beam, place: str) -> Iterator[str]:
    """Yield a sentence if the cross-section of a beam is too large for its length, or else if the rotary inertia is."""
    if beam.A is not None and beam.I is not None:
        depth = math.sqrt(12.0 * beam.I / beam.A)
        width = beam.A / depth
        is_sheet = width > beam.length and width > THINNEST * depth
        if depth > beam.length or width > WIDEST * beam.length or is_sheet:
            units = {"A": f"`A: {beam.A:g} mm^2`", "I": f"`I: {beam.I:g} mm^4`"}
            if max(width, depth) > THINNEST * min(width, depth):
                units.pop("A" if depth > width else "I")
            key = f"{place}.{next(iter(units))}" if len(units) == 1 else place
            yield (
                f"a rectangle with A = {beam.A:g} m^2 and I = {beam.I:g} m^4 at {key} is {depth:.3g} m deep and "
                f"{width:.3g} m wide, but the beam is {beam.length:.3g} m long; check {' and '.join(units)}, "
                f"and write values in other units with their units, for example {', '.join(units.values())}"
            )
            return
    mass, inertia = beam.inertia_per_length
    radius = math.sqrt(inertia / mass)
    if radius > beam.length:
        key, value, unit, example = _source_of_inertia(beam)
        source = "" if key == "rotary_inertia" else f"that follows from {value:g} {unit} "
        yield (
            f"the rotary inertia of {inertia:g} kg m {source}at {place}.{key} is that of {mass:g} kg/m at a distance "
            f"of {radius:.3g} m, but the beam is {beam.length:.3g} m long; {_ADVICE} `{value:g} {example}`"
        )


def _source_of_inertia(beam: Beam) -> tuple[str, float, str, str]:
    """Return the key from which the rotary inertia of a beam follows, its value, its unit and an example of another
    unit.
    """
    bending = None if beam.stiffness is None else beam.stiffness.bending
    if beam.rotary_inertia is not None:
        return "rotary_inertia", beam.rotary_inertia, "kg m", "kg*mm^2/m"
    if beam.I is not None and (beam.density is not None or bending is None):
        return "I", beam.I, "m^4", "mm^4"
    assert bending is not None
    return "stiffness.bending", bending, "N m^2", "N*mm^2"


def improbable_lengths(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each spring whose free length is too large for its length at the start
    and for the mechanism, for each one-sided spring along a coordinate that is deflected too far at the start, and for
    each muscle whose optimal length is too large for the mechanism.
    """
    found = []
    for name, force in mechanism.forces.items():
        free = getattr(force, "free_length", None)
        if free is None or not isinstance(force, SpringDamper | Law):
            continue
        if force.pathway.is_line:
            length = math.dist(*(mechanism.to_global(body, point) for _, body, point in force.attachments()))
            if free > LONGEST * length:
                found.append(("forces", name, "free_length", free, free, f" and the spring is {length:.3g} m long"))
        elif isinstance(force, Law) and (deflection := _deflection(mechanism, force, free)) > 0.0:
            told = f" and the spring is deflected by {deflection:.3g} m"
            found.append(("forces", name, "free_length", free, deflection, told))
    for name, muscle in mechanism.muscles.items():
        found.append(("muscles", name, "optimal_length", muscle.optimal_length, muscle.optimal_length, ""))
    size = _size_if_below(mechanism, max((length / LARGE for *_, length, _ in found), default=0.0))
    for kind, name, key, value, length, also in found:
        if length > LARGE * size > 0:
            is_given = mechanism.name == "mechanism"
            proposals = listed([f"`{value:g} {unit}`" for unit in _smaller_units(abs(value), LARGE * size)], "or")
            place = f"model.{kind}.{quoted(name)}.{key}" if is_given else f"model, {kind.removesuffix('s')} {name}"
            yield (
                f"the {key.replace('_', ' ')} of {value:g} m at {place} is improbable: at the start, the mechanism has "
                f"a size of {size:.3g} m{also}; {_ADVICE} {proposals}"
            )


def _deflection(mechanism: Mechanism, law: Law, free_length: float) -> float:
    """Return by how much a one-sided spring along a coordinate is deflected at the start [m]; 0 for other laws and
    pathways, and for a spring that exerts no force.
    """
    pathway = law.pathway
    if law.law_id != "mbdkit:one-sided" or not isinstance(pathway, Coordinate):
        return 0.0
    first, second = pathway.bodies
    place = mechanism.to_local(first, mechanism.to_global(second, pathway.point))
    stretch = place["xy".index(pathway.coordinate)] - free_length
    return max(stretch if getattr(law, "acts", "") == "tension" else -stretch, 0.0)
