"""Values of elements that are valid but improbable, such as free lengths in cm and cross-sections in mm^2."""

from __future__ import annotations

import math
from collections.abc import Iterator

from mbdkit.base.plain_data import quoted
from mbdkit.base.text import listed
from mbdkit.base.traced_numbers import dist, hypot, largest, sqrt
from mbdkit.mechanism.beams import Beam
from mbdkit.mechanism.forces import PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.improbable_bodies import STAND_IN, improbable_bodies, improbable_inertias
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.pathways import Coordinate
from mbdkit.mechanism.size import size_if_below, smaller_units

#: A coefficient of friction above this is improbable. Rubber on rough ground reaches about 1, racing tyres about 2,
#: and percentages are usually larger.
ROUGHEST = 5.0

#: A Young's modulus [Pa] below `SOFTEST`, that of the softest tissues, is improbable, and so is one below `SOFT`, that
#: of soft rubber, if the density [kg/m^3] is above `METAL`.
#:
#: Moduli of hard materials in GPa are at most 1200, and those of metals in MPa at most 4.1e5. A beam of E = 7e5 and
#: 5540 kg/m^3 is a common test of flexible pendulums.
SOFTEST, SOFT, METAL = 1e3, 5e5, 2500.0

#: A density below this [kg/m^3] is improbable. Light foams have about 30, and all metals less than 23 g/cm^3.
LIGHTEST = 20.0

#: A cross-section is improbable if it is deeper than the beam is long, or this many times as wide as the beam is long,
#: or wider than the beam is long and `THINNEST` times as wide as deep.
#:
#: Flexure hinges may be wide and short. An area in mm^2 makes the width of a rectangle of given I wrong by a factor of
#: 1e9, and an area in cm^2 by 1e6.
WIDEST = 100.0

#: If an improbable cross-section is more than this many times as deep as wide, its I has another unit, if it is more
#: than this many times as wide as deep, its A, and otherwise both.
#:
#: A wrong unit of I alone or A alone changes the ratio of width to depth by a factor of 1e8 or more.
THINNEST = 1e4

#: The free length of a spring is improbable if it exceeds this many lengths of the spring at the start, and `LARGE`
#: sizes of the mechanism.
#:
#: Free lengths in cm are too large by a factor of 100. In all packaged examples, free lengths are at most 1.3 times the
#: length at the start.
LONGEST = 10.0

#: The force of a spring at the start is improbable if its moment exceeds that of each other load so many times.
STRONGEST = 10.0

#: Lengths of elements (`Element.lengths_to_check`), and the deflection at the start of a one-sided spring along a
#: coordinate, are improbable if they exceed this many sizes of the mechanism.
#:
#: In all packaged examples, such lengths are at most 0.21 sizes.
LARGE = 3.0


def improbable_measured(mechanism: Mechanism) -> Iterator[tuple[str, str]]:
    """Yield ``inertia`` or ``units``, and a sentence without a full stop, for each improbable value of a measured
    mechanism.
    """
    for sentence in improbable_inertias(mechanism, STAND_IN):
        yield "inertia", sentence
    for values in (improbable_beams, improbable_lengths, improbable_bodies):
        for sentence in values(mechanism):
            yield "units", sentence


def improbable_frictions(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each element whose coefficient of friction is too large."""
    every = ((kind, *item) for kind, elements in mechanism.elements.items() for item in elements.items())
    for kind, name, element in every:
        largest, where = max(element.friction_coefficients, default=0.0), f"{kind}.{quoted(name)}"
        if largest > ROUGHEST:
            key = f"model.{where}.friction" if mechanism.name == "mechanism" else f"model, {where}"
            yield (
                f"the coefficient of friction of {largest:g} at {key} is above {ROUGHEST:g}; if it is in percent, "
                f"write {largest / 100:g}"
            )


def improbable_beams(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each modulus, density, cross-section and rotary inertia of a beam that
    is improbable.
    """
    for name, beam in mechanism.beams.items():
        where = f"model.beams.{quoted(name)}" if mechanism.name == "mechanism" else f"model, beam {name}"
        yield from _improbable_material(beam, where)
        yield from _improbable_section(beam, where)


_ADVICE = "if it is in another unit, write it with the unit, for example"


def _improbable_material(beam: Beam, where: str) -> Iterator[str]:
    if beam.E is not None and beam.E < SOFTEST:
        yield (
            f"Young's modulus of {beam.E:g} Pa at {where}.E is below {SOFTEST:g} Pa, that of the softest tissues; "
            f"{_ADVICE} `{beam.E:g} GPa`"
        )
    elif beam.E is not None and beam.E < SOFT and (beam.density or 0.0) > METAL:
        yield (
            f"Young's modulus of {beam.E:g} Pa at {where}.E is that of soft rubber, but the density of "
            f"{beam.density:g} kg/m^3 is that of a metal; {_ADVICE} `{beam.E:g} MPa`"
        )
    if beam.density is not None and beam.density < LIGHTEST:
        yield (
            f"the density of {beam.density:g} kg/m^3 at {where}.density is below that of light foams; "
            f"{_ADVICE} `{beam.density:g} g/cm^3`"
        )


def _improbable_section(beam: Beam, where: str) -> Iterator[str]:
    """Yield a sentence if the cross-section of a beam is too large for its length, or else if the rotary inertia is."""
    if beam.A is not None and beam.I is not None:
        depth = sqrt(12.0 * beam.I / beam.A)
        width = beam.A / depth
        is_sheet = width > beam.length and width > THINNEST * depth
        if depth > beam.length or width > WIDEST * beam.length or is_sheet:
            units = {"A": f"`A: {beam.A:g} mm^2`", "I": f"`I: {beam.I:g} mm^4`"}
            if max(width, depth) > THINNEST * min(width, depth):
                units.pop("A" if depth > width else "I")
            key = f"{where}.{next(iter(units))}" if len(units) == 1 else where
            yield (
                f"a rectangle with A = {beam.A:g} m^2 and I = {beam.I:g} m^4 at {key} is {depth:.3g} m deep and "
                f"{width:.3g} m wide, but the beam is {beam.length:.3g} m long; check {' and '.join(units)}, "
                f"and write values in other units with their units, for example {', '.join(units.values())}"
            )
            return
    mass, inertia = beam.inertia_per_length
    radius = sqrt(inertia / mass)
    if radius > beam.length:
        key, value, unit, example = _source_of_inertia(beam)
        source = "" if key == "rotary_inertia" else f"that follows from {value:g} {unit} "
        yield (
            f"the rotary inertia of {inertia:g} kg m {source}at {where}.{key} is that of {mass:g} kg/m at a distance "
            f"of {radius:.3g} m, but the beam is {beam.length:.3g} m long; {_ADVICE} `{value:g} {example}`"
        )


def _source_of_inertia(beam: Beam) -> tuple[str, float, str, str]:
    """Return key, value and unit from which the rotary inertia of a beam follows, and an example of another unit."""
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
    each element of a plugin with a length that is too large for the mechanism.
    """
    findings = []
    for name, force in mechanism.forces.items():
        if (free := getattr(force, "free_length", None)) is None or not isinstance(force, SpringDamper | Law):
            continue
        if force.pathway.is_line:
            length = dist(*(mechanism.to_global(body, point) for _, body, point in force.attachments()))
            if free > LONGEST * length:
                findings.append(("forces", name, "free_length", free, free, f" and the spring is {length:.3g} m long"))
        elif isinstance(force, Law) and (deflection := _deflection(mechanism, force, free)) > 0.0:
            deflected = f" and the spring is deflected by {deflection:.3g} m"
            findings.append(("forces", name, "free_length", free, deflection, deflected))
    findings += [
        (kind, name, key, length, length, "")
        for kind, elements in mechanism.elements.items()
        for name, element in elements.items()
        for key, length in element.lengths_to_check()
    ]
    size = size_if_below(mechanism, largest([0.0, *(length / LARGE for *_, length, _ in findings)]))
    for kind, name, key, value, length, also in findings:
        if length > LARGE * size > 0:
            is_given = mechanism.name == "mechanism"
            proposals = listed([f"`{value:g} {unit}`" for unit in smaller_units(abs(value), LARGE * size)], "or")
            where = f"model.{kind}.{quoted(name)}.{key}" if is_given else f"model, {kind.removesuffix('s')} {name}"
            yield (
                f"the {key.replace('_', ' ')} of {value:g} m at {where} is improbable: at the start, the mechanism has "
                f"a size of {size:.3g} m{also}; {_ADVICE} {proposals}"
            )


def improbable_preloads(mechanism: Mechanism) -> Iterator[str]:
    """Yield a sentence without a full stop for each spring whose free length or angle is not given, and whose force at
    the start exceeds all other loads by far; none if there is neither weight nor another load.
    """
    size = size_if_below(mechanism, math.inf) if mechanism.forces else 0.0
    weight = hypot(*mechanism.gravity) * sum(body.mass for body in mechanism.bodies.values())
    moments = {"": weight * size}  # [N m]
    springs = {}
    for name, force in mechanism.forces.items():
        arm = 1.0 if isinstance(force, TorsionSpring | Torque) else size
        if isinstance(force, SpringDamper | TorsionSpring):
            key, unit = ("free_length", "N") if force.is_line else ("free_angle", "N m")
            relaxed = force.model_copy(update={key: "start"}).placed(mechanism.bodies, "").linear.free
            load = abs(force.stiffness * (relaxed - force.linear.free))
            springs[name] = key, load, unit
            moments[name] = load * arm
        elif isinstance(force, Torque | PointForce):
            moments[name] = arm * hypot(*(value for value in force.load.values if isinstance(value, float)))
    for name, (key, load, unit) in springs.items():
        others = largest([moment for other, moment in moments.items() if other != name])
        if moments[name] > STRONGEST * others > 0.0 and key not in mechanism.forces[name].model_fields_set:
            yield (
                f"spring '{name}' begins with {load:.3g} {unit}, more than {STRONGEST:g} times as much as all weights "
                f"and other constant loads; if it is relaxed at the start, write `{key}: start`, otherwise `{key}: 0`"
            )


def _deflection(mechanism: Mechanism, law: Law, free_length: float) -> float:
    """Return by how much a one-sided spring along a coordinate is deflected at the start [m]; 0 for other laws and
    pathways, and for a spring that exerts no force.
    """
    pathway = law.pathway
    if law.law_id != "mbdkit:one-sided" or not isinstance(pathway, Coordinate):
        return 0.0
    first, second = pathway.bodies
    anchor = mechanism.to_local(first, mechanism.to_global(second, pathway.point))
    stretch = anchor["xy".index(pathway.coordinate)] - free_length
    deflection: float = largest(stretch if getattr(law, "acts", "") == "tension" else -stretch, 0.0)
    return deflection
