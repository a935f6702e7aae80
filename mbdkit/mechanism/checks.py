"""Checks that involve several elements of a mechanism: names, references, springs without effect, ranges of tables."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Container, Iterable, Mapping
from typing import Any

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import LONGEST_NAME, quoted, value_text
from mbdkit.base.text import did_you_mean, listed, shortened
from mbdkit.base.traced_numbers import dist, largest
from mbdkit.mechanism.beams import LAST, Beam, beam_of, parts_of
from mbdkit.mechanism.bodies import GROUND, Body, Element
from mbdkit.mechanism.forces import Force, PointForce, SpringDamper, Torque
from mbdkit.mechanism.joints import Joint, Revolute
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism_data import NO_BODY, Assembly
from mbdkit.mechanism.pathways import JointAngles
from mbdkit.mechanism.values import Motion, Table

#: A run may extend beyond a table by this share of the longer of both spans, because the end of a run is a sum of
#: rounded steps.
ROUNDING = 1e-9

#: Two points coincide if their distance [m] is at most this; if a coordinate exceeds 1 m, the tolerance is this times
#: the largest coordinate.
COINCIDENT = 1e-12


def check_mechanism(
    bodies: Mapping[str, Body],
    beams: Mapping[str, Beam],
    elements: Mapping[str, Mapping[str, Element]],
    joints: Mapping[str, Joint],
    assembly: Assembly,
) -> None:
    """Raise SpecError, with the key path, for the first error in a mechanism.

    `elements`: all elements by kind and name; its entry ``joints`` is the same mapping as `joints`.
    """
    parts = parts_of(beams)
    own = {kind: [name for name in named if name not in parts] for kind, named in elements.items()}
    check_names([name for name in bodies if name not in parts], beams, own)
    points = {name for name, body in bodies.items() if body.inertia is None}
    pins = defaultdict[frozenset[str], list[tuple[str, Any]]](list)  # by bodies: traced numbers have no hash
    for name, joint in joints.items():
        if joint.joins_points:
            pins[frozenset(ends := _ends(joint))].append((name, ends))
    for key, element in (
        (f"model.{kind}.{quoted(name)}", value) for kind, named in elements.items() for name, value in named.items()
    ):
        _check_element(key, element, bodies, points)
        if isinstance(element, Law) and isinstance(element.pathway, JointAngles):
            _check_joint_angles(f"{key}.pathway.angles", element.pathway, joints, points)
        if (line := _line(element)) is not None:
            ends = _ends(line)
            if pin := next((name for name, held in pins[frozenset(ends)] if held == ends), ""):
                message = f"joint '{pin}' holds these two points together, so a spring between them has no effect"
                raise SpecError(message, key=f"{key}.{line.pathway_key}points")
    for index, name in enumerate(assembly.fix):
        check_known(name, bodies, f"model.assembly.fix[{index}]")


def check_names(bodies: Iterable[str], beams: Collection[str], elements: Mapping[str, Iterable[str]]) -> None:
    """Raise SpecError if there are neither bodies nor beams, or for the first name that is not valid.

    A body must not have a name that could be the name of a node of a beam.
    """
    if not (bodies or beams):
        raise SpecError(NO_BODY, key="model.bodies")
    for kind, names in {"bodies": bodies, "beams": beams, **elements}.items():
        for name in names:
            key = f"model.{kind}.{quoted(name)}"
            check_name(name, key)
            if kind == "bodies" and (beam := beam_of(name) or name.removesuffix(LAST)) in beams and beam != name:
                raise SpecError(f"'{name}' would be a node of the beam '{beam}'; choose another name", key=key)


def check_tables(motions: Iterable[tuple[str, Motion]], start: float, end: float) -> None:
    """Raise SpecError for the first table that is not periodic and does not cover the times from `start` to `end`
    [s].
    """
    for key, motion in motions:
        if not isinstance(motion, Table) or motion.period:
            continue
        first, last = motion.span
        slack = ROUNDING * max(last - first, end - start)
        if start < first - slack or end > last + slack:
            message = f"the table covers {first!r} s to {last!r} s, but the run goes from {start!r} s to {end!r} s"
            raise SpecError(message, key=f"{key}.table[0]")


def check_centers(joints: Mapping[str, Joint], placed: Callable[[str], Body]) -> None:
    """Raise a SpecError for the first moving center whose table does not cover the angle at the start.

    `placed`: function that returns the body with a given name, at its position after assembly.
    """
    for name, joint in joints.items():
        if not isinstance(joint, Revolute) or joint.center is None:
            continue
        a, b = (0.0 if body == GROUND else placed(body).angle for body in joint.bodies)
        angle = b - a
        if (outside := joint.center.outside(angle)) is not None:
            key, table = outside
            first, last = table.span
            message = f"the table covers {first:.6g} rad to {last:.6g} rad, but the joint starts at {angle:.6g} rad"
            raise SpecError(message, key=f"model.joints.{quoted(name)}.center.{key}.table[0]")


def check_springs(forces: Mapping[str, Force], placed: Callable[[str], Body]) -> None:
    """Raise a SpecError for the first force along a line whose ends coincide at the start.

    The direction of such a force is undefined. Spring-dampers whose stiffness or free length is zero are allowed.

    `placed`: function that returns the body with a given name, at its position after assembly.
    """
    for name, force in forces.items():
        if (line := line_of_undefined_direction(force)) is None:
            continue
        a, b = (point if body == GROUND else placed(body).to_global(point) for _, body, point in line.attachments())
        if dist(a, b) <= COINCIDENT * largest(1.0, *map(abs, (*a, *b))):
            raise SpecError(
                f"the two ends coincide at the start, at ({a[0]:.6g}, {a[1]:.6g}), so the direction of the force is "
                "undefined; move one of the points, or use a spring-damper with free_length 0",
                key=f"model.forces.{quoted(name)}.{line.pathway_key}points",
            )


def line_of_undefined_direction(force: Element) -> SpringDamper | Law | None:
    """Return the element if it is a force along the line between two points whose direction is undefined where the
    points coincide, otherwise None. The force of a spring-damper whose stiffness or free length is zero vanishes there.
    """
    return None if isinstance(force, SpringDamper) and 0.0 in force.linear[::2] else _line(force)


def check_name(name: object, key: str) -> None:
    """Raise a SpecError unless `name` is a valid name of an element or event in specs and archives."""
    if not isinstance(name, str):
        raise SpecError(f"should be text, not {value_text(name)}", key=key)
    if name == GROUND:
        raise SpecError("the name 'ground' is reserved for the global frame; choose another name", key=key)
    if len(name) > LONGEST_NAME:
        message = f"has {len(name)} characters; a name has at most {LONGEST_NAME}"
        raise SpecError(message, key=key.replace(name, shortened(name)))
    if not name or name != name.strip() or "/" in name or not name.isprintable():
        raise SpecError(f"should be non-empty printable text without '/' and surrounding spaces, not {name!r}", key=key)


def check_known(name: object, bodies: Iterable[str], key: str) -> None:
    """Raise a SpecError unless `name` is the ground or one of the `bodies`."""
    if not isinstance(name, str):
        raise SpecError(f"should be text, not {value_text(name)}", key=key)
    if name != GROUND and name not in bodies:
        known = [GROUND, *bodies]
        if nodes := [other for other in known if beam_of(other) == name]:
            raise SpecError(
                f"'{name}' is a beam; name one of its nodes, '{nodes[0]}' to '{nodes[-1]}', or '{name}{LAST}'", key=key
            )
        beam = beam_of(name)
        if nodes := [other for other in known if beam and beam_of(other) == beam]:
            raise SpecError(f"there is no node '{name}'; the beam '{beam}' has '{nodes[0]}' to '{nodes[-1]}'", key=key)
        hint = did_you_mean(name, known) or f"; there are {listed(known[:6])}{', ...' * (len(known) > 6)}"
        raise SpecError(f"there is no body '{name}'{hint}", key=key)


def _line(force: Element) -> SpringDamper | Law | None:
    """Return the element if it is a force along the line between two points, otherwise None."""
    return force if isinstance(force, SpringDamper | Law) and force.pathway.is_line else None


def _ends(element: Joint | SpringDamper | Law) -> dict[str, tuple[float, float]]:
    """Return the two ends of an element: for each body, the point in its frame."""
    return {name: point for _, name, point in element.attachments()}


def _described(element: Element) -> str:
    match element:
        case Law():
            return f"pathway of type {element.pathway.type}"
        case PointForce():
            return "force in its frame"
    return str(getattr(element, "type", type(element).__name__.lower()))


def _check_element(key: str, element: Element, bodies: Iterable[str], point_masses: Container[str]) -> None:
    places = element.places()
    for place, body in places:
        check_known(body, bodies, f"{key}.{place}")
    if len(places) == 2 and places[0][1] == places[1][1]:
        where, body = places[1]
        raise SpecError(f"the two bodies must differ; both are '{body}'", key=f"{key}.{where}")
    if isinstance(element, Torque | PointForce) and element.body == GROUND:
        raise SpecError(f"a {element.type} on the ground has no effect; name a body", key=f"{key}.body")
    for place, body in element.angles():
        if body in point_masses:
            message = f"'{body}' is a point mass (it has no inertia), so it has no angle for a {_described(element)}"
            raise SpecError(message, key=f"{key}.{place}")
    for place, body, point in element.attachments():
        if body in point_masses and point != (0.0, 0.0):
            raise SpecError(
                f"'{body}' is a point mass (it has no inertia), so its only point is [0, 0]", key=f"{key}.{place}"
            )


def _check_joint_angles(
    key: str, pathway: JointAngles, joints: Mapping[str, Joint], point_masses: Container[str]
) -> None:
    """Raise a SpecError, with a key below `key`, unless all joints of a pathway exist and have an angle."""
    with_angle = [name for name, joint in joints.items() if joint.coordinate_unit == "rad"]
    for name in pathway.radii:
        here = f"{key}.{quoted(name)}"
        if name not in joints:
            hint = did_you_mean(name, with_angle) or (f"; there are {listed(with_angle)}" if with_angle else "")
            raise SpecError(f"there is no joint '{name}'{hint}", key=here)
        if name not in with_angle:
            raise SpecError(f"joint '{name}' is of type {joints[name].type}, which has no angle", key=here)
        for body in joints[name].bodies:
            if body in point_masses:
                raise SpecError(
                    f"joint '{name}' holds '{body}', a point mass (it has no inertia), which has no angle", key=here
                )
