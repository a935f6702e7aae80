"""Contacts between bodies: their shapes, friction, and the normal force of compliant contacts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import BeforeValidator, Field, GetJsonSchemaHandler, model_validator
from pydantic_core import CoreSchema

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.strict_model import StrictModel
from mbdkit.base.text import did_you_mean, listed
from mbdkit.mechanism.bodies import GROUND, Attachment, Element
from mbdkit.mechanism.element_kinds import ElementsByName, element_check
from mbdkit.mechanism.joints import Joint, Revolute, Weld
from mbdkit.mechanism.model_methods import of_models
from mbdkit.mechanism.values import BodyPair, NotNegative, Point, Positive, sequence
from mbdkit_contact.polylines import check_polyline, surface_of

Pair = tuple[float, float]

MOST_CORNERS = 16  #: Largest number of corners of a polygon.

#: Speed of separation [m/s] at which the law smooth-sphere-half-space without dissipation stops pushing.
#:
#: It is so large that it is never reached.
RELEASED = 1e300


class LineShape(StrictModel):
    """A straight line without ends, and the material on one side of it."""

    point: Point = (0.0, 0.0)
    """A point of the line in the body's frame [m]."""
    normal: Point
    """Direction (x, y) in the body's frame that points out of the material; any length."""

    @model_validator(mode="after")
    def _has_direction(self) -> LineShape:
        if elementary.hypot(*self.normal) == 0.0:
            raise SpecError("should be a direction other than [0, 0]", key="normal")
        return self

    @property
    def unit(self) -> Pair:
        """The normal with length 1."""
        size = elementary.hypot(*self.normal)
        return self.normal[0] / size, self.normal[1] / size


class CircleShape(StrictModel):
    """A circle of a body."""

    center: Point = (0.0, 0.0)
    """Center in the body's frame [m]."""
    radius: Positive
    """Radius [m]."""


class HoleShape(CircleShape):
    """A round hole in a body, inside which circles and points of other bodies move."""


Corners = Annotated[tuple[Point, ...], BeforeValidator(sequence)]


class PolylineFile(StrictModel):
    """A file with the points of a polyline: CSV with a line of headings, relative to the folder of the spec."""

    file: str
    """Name of the file."""
    x: str = "x"
    """Heading of the column of x."""
    y: str = "y"
    """Heading of the column of y."""
    unit: str = "m"
    """Unit of both columns."""


def _polyline(value: object) -> object:
    if isinstance(value, Mapping):
        raise SpecError("files of points are read from spec files only; in Python, give the points [[x, y], ...]")
    return sequence(value)


class _OrFile:
    """Annotation of points that spec files may give by a `PolylineFile`."""

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, object]:
        return {"anyOf": [handler(core), PolylineFile.model_json_schema()]}


#: Points of a polyline, or in spec files a table of them.
Polyline = Annotated[tuple[Point, ...], BeforeValidator(_polyline), _OrFile()]


class Shape(StrictModel):
    """The outline of a body where it touches others: exactly one of `line`, `polyline`, `point`, `circle`, `hole` and
    `polygon`.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("line", "polyline", "point", "circle", "hole", "polygon")

    line: LineShape | None = None
    """A straight line, ``{point: [x, y], normal: [x, y]}``, such as a floor."""
    polyline: Polyline | None = None
    """Uneven ground: points [[x, y], ...] in the body's frame [m], from left to right, with the material below. The
    first and the last segment continue straight without end. In a spec file, ``{file: NAME, x: COLUMN, y: COLUMN, unit:
    UNIT}`` reads the points from a table in CSV."""
    point: Point | None = None
    """A point (x, y) [m] in the body's frame."""
    circle: CircleShape | None = None
    """A circle, ``{center: [x, y], radius: r}``."""
    hole: HoleShape | None = None
    """A round hole, ``{center: [x, y], radius: r}``, such as a bearing that holds the circle of a journal."""
    polygon: Corners | None = None
    """A convex polygon: its corners [[x, y], ...] in the body's frame [m], counter-clockwise."""

    @model_validator(mode="after")
    def _one(self) -> Shape:
        names = [name for name in self.ABSENT_BY_DEFAULT if getattr(self, name) is not None]
        if len(names) != 1:
            what = f"not {listed(names, 'and')}" if names else "for example {circle: {radius: 0.1}}"
            raise SpecError(f"a shape is one of {listed(self.ABSENT_BY_DEFAULT, 'and')}, {what}")
        if self.polyline is not None:
            try:
                check_polyline(self.polyline)
            except SpecError as error:
                raise error.located(prefix="polyline") from None
        if self.polygon is not None:
            _check_convex(self.polygon)
        return self

    @property
    def kind(self) -> str:
        """Name of the kind of shape."""
        return next(name for name in self.ABSENT_BY_DEFAULT if getattr(self, name) is not None)

    @property
    def circle_of(self) -> tuple[Pair, float]:
        """Center and radius of a circle or hole, or of a point, whose radius is 0."""
        if self.point is not None:
            return self.point, 0.0
        round_shape = self.circle or self.hole
        assert round_shape is not None
        return round_shape.center, round_shape.radius

    def points(self) -> list[tuple[str, Pair]]:
        """Return (key, point in the frame of the body) of each point of the shape."""
        if self.line is not None:
            return [("line.point", self.line.point)]
        if self.point is not None:
            return [("point", self.point)]
        if (corners := self.polygon or self.polyline) is None:
            return [(f"{self.kind}.center", self.circle_of[0])]
        return [(f"{self.kind}[{i}]", corner) for i, corner in enumerate(corners)]


def _check_convex(corners: tuple[Pair, ...]) -> None:
    if not 3 <= len(corners) <= MOST_CORNERS:
        raise SpecError(f"a polygon has from 3 to {MOST_CORNERS} corners, not {len(corners)}", key="polygon")
    turns = 0.0
    for (ax, ay), (bx, by), (cx, cy) in zip(corners, corners[1:] + corners[:1], corners[2:] + corners[:2], strict=True):
        across = (bx - ax) * (cy - by) - (by - ay) * (cx - bx)
        if across <= 0.0:
            order = "with corners in counter-clockwise order, of which no three are on a line"
            raise SpecError(f"a polygon should be convex, {order}", key="polygon")
        turns += elementary.atan2(across, (bx - ax) * (cx - bx) + (by - ay) * (cy - by))
    if turns > 7.0:  # the edges of a star turn more than once
        raise SpecError("the edges of a polygon should not cross", key="polygon")


class Friction(StrictModel):
    """Coefficients of Coulomb's friction."""

    static: NotNegative
    """Ratio of the largest friction force to the normal force while the contact sticks."""
    kinetic: NotNegative
    """Ratio of the friction force to the normal force while the contact slips."""

    @model_validator(mode="after")
    def _in_order(self) -> Friction:
        if self.kinetic > self.static:
            too_large = f"should not be greater than `static`, {self.static:g}, but is {self.kinetic:g}"
            raise SpecError(too_large, key="kinetic")
        return self


class Compliance(StrictModel):
    """The normal force of the compliant treatment as a function of the indentation d and its rate d'.

    The indentation is the depth by which the two shapes overlap.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("dissipation", "impact_speed")

    law: Literal["hunt-crossley", "flores", "lankarani-nikravesh", "linear", "smooth-sphere-half-space"] = (
        "hunt-crossley"
    )
    """`hunt-crossley`: ``k d^(3/2) (1 + 3/2 c d')``; `flores` and `lankarani-nikravesh`: the same formula, with c
    computed from `restitution` and `impact_speed`; `linear`: ``k d + c d'``; `smooth-sphere-half-space`: the force of
    OpenSim for a circle on a line."""
    stiffness: Positive
    """Stiffness k [N/m^1.5]; for `linear` [N/m]; for `smooth-sphere-half-space` [N/m^2]."""
    dissipation: NotNegative | None = None
    """Dissipation c [s/m]; for `linear` [N s/m]. `flores` and `lankarani-nikravesh` always compute c from `restitution`
    and `impact_speed`, and `hunt-crossley` does so if `impact_speed` is given. Otherwise, the default is 0."""
    impact_speed: Positive | None = None
    """Speed of approach [m/s] at which an impact has the `restitution` of the contact."""
    transition_speed: Positive = 0.01
    """Slip [m/s] at which the regularised friction force reaches its static value."""

    @classmethod
    def chosen_unit(cls, name: str, data: Mapping[str, object]) -> str:
        """Return the unit of stiffness or dissipation in the chosen law; see `StrictModel.chosen_unit`."""
        law = data.get("law")
        return {
            "stiffness": {"linear": "N/m", "smooth-sphere-half-space": "N/m^2"}.get(str(law), "N/m^1.5"),
            "dissipation": "N s/m" if law == "linear" else "s/m",
        }.get(name, "")


class ContactPair(NamedTuple):
    """One possible contact point (row) of a contact: a line, circle, hole or polygon of one body, and a circle or point
    of the other.

    Attributes
    ----------
    name
        Name of the row: the name of the contact, followed by the names of both bodies if the contact has a group of
        bodies (`among`), and by the number of a corner if there is a polygon.
    key
        Key of the contact in a spec.
    bodies
        The two bodies, in the order that the formulas of the `kind` assume.
    kind
        Kind of geometry, and number of edges of the first body's polygon or of segments of a polyline, if there is one.
        The first body has a ``line``; both have circles (``circles``); the first body has a ``hole``; it has a polygon,
        and the row belongs to one ``edge`` and the corner at which this begins; both have polygons, and the row belongs
        to a corner of the second body's (``inside``); the first body has a ``polyline``; or the second body has one,
        and the row belongs to any ``corner`` of it that touches the first body's polygon.
    numbers
        Parameters of the geometry, in the frames of the bodies: center and radius of the circle; then a point and the
        normal of the line, or center and radius of the first body's circle or hole, or for each edge of the first
        body's polygon its start, normal and length. The three corners of an ``edge`` come before the latter. With a
        polyline: center and radius of the circle, the number of colors, the edges of the polygon, and the segments of
        the polyline (`mbdkit_contact.polylines`).
    radius
        Radius of the circle [m], 0 for a point.
    swapped
        Whether the order of the bodies is opposite to that in the contact.
    """

    name: str
    key: str
    bodies: tuple[str, str]
    kind: tuple[str, int]
    numbers: tuple[float, ...]
    radius: float
    swapped: bool = False

    @property
    def ordered(self) -> tuple[str, str]:
        """The two bodies in the order of the contact."""
        return (self.bodies[1], self.bodies[0]) if self.swapped else self.bodies


class Contact(Element):
    """Contact between two bodies, or between all pairs of several bodies.

    The normal points from the first body to the second. Normal and friction forces of a compliant contact act at the
    point midway between the two outlines.
    """

    KEYS_WITHOUT_LAST: ClassVar[tuple[str, ...]] = ("among",)
    """The shapes in `among` are a mapping by names of bodies."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("bodies", "among", "rolling_resistance", "compliance")

    bodies: BodyPair | None = None
    """Names of the two bodies [a, b]; `ground` is the fixed global frame."""
    among: Annotated[tuple[str, ...], BeforeValidator(sequence)] | None = None
    """Names of a group of bodies that may touch each other, as an alternative to `bodies`. All pairs of them are
    included, except pairs that a joint connects."""
    shapes: Annotated[tuple[Shape, ...], BeforeValidator(sequence)] | dict[str, Shape]
    """One shape for each of the two `bodies`; with `among`, a mapping from the body to its shape."""
    restitution: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Coefficient of restitution: ratio of the normal velocity after an impact to that before it."""
    friction: NotNegative | Friction = 0.0
    """Coefficient of friction, or ``{static: number, kinetic: number}``."""
    rolling_resistance: NotNegative = 0.0
    """Arm e of the normal force N when a circle rolls [m]: the torque e N opposes the relative angular velocity."""
    compliance: Compliance | None = None
    """Law of the normal force, which the compliant treatment needs."""

    @model_validator(mode="after")
    def _is_complete(self) -> Contact:
        if (self.bodies is None) == (self.among is None):
            raise SpecError("a contact has either `bodies`, two of them, or `among`", key="bodies")
        if self.bodies is not None:
            if not isinstance(self.shapes, tuple) or len(self.shapes) != 2:
                raise SpecError("should be two shapes [SHAPE, SHAPE], one for each of the `bodies`", key="shapes")
            _check_kinds(*self.shapes, "shapes")
        else:
            self._check_among()
        self._check_rolling()
        self._check_law()
        return self

    def _check_among(self) -> None:
        assert self.among is not None
        if len(set(self.among)) != len(self.among) or len(self.among) < 2:
            raise SpecError("should be two or more different bodies", key="among")
        if not isinstance(self.shapes, dict):
            raise SpecError("should be a mapping with one shape for each body, {BODY: SHAPE}", key="shapes")
        for name in self.shapes:
            if name not in self.among:
                hint = did_you_mean(name, self.among) or "; `among` does not list it"
                raise SpecError(f"'{name}' is not one of the bodies{hint}", key=f"shapes.{quoted(name)}")
        for name in self.among:
            if name not in self.shapes:
                raise SpecError(f"has no shape for '{name}'", key="shapes")
        for a, b in combinations(self.among, 2):
            _check_kinds(self.shapes[a], self.shapes[b], "shapes")

    def _check_rolling(self) -> None:
        for first, second in combinations([shape.kind for shape in self._ordered()], 2):
            if self.rolling_resistance > 0.0 and "circle" not in (first, second):
                raise SpecError(f"needs a circle that rolls, not a {first} and a {second}", key="rolling_resistance")

    def _check_law(self) -> None:
        if (own := self.compliance) is None:
            return
        law, speed, given = own.law, own.impact_speed, own.dissipation is not None
        of_speed = law in ("flores", "lankarani-nikravesh")
        if given and of_speed:
            message = f"the law {law} computes it from `restitution` and `impact_speed`; omit it"
            raise SpecError(message, key="compliance.dissipation")
        if of_speed and speed is None:
            message = f"is missing: the law {law} needs the impact speed to which `restitution` refers"
            raise SpecError(message, key="compliance.impact_speed")
        if speed is not None and law in ("linear", "smooth-sphere-half-space"):
            raise SpecError(f"the law {law} does not use it; give `dissipation`", key="compliance.impact_speed")
        if speed is not None and given:
            raise SpecError("give either `dissipation` or `impact_speed`", key="compliance.impact_speed")
        if law == "flores" and self.restitution == 0.0:
            raise SpecError("should be greater than 0: the law flores divides by it", key="restitution")
        kinds = sorted(shape.kind for shape in self._ordered())
        if law == "smooth-sphere-half-space" and any(pair != ("circle", "line") for pair in combinations(kinds, 2)):
            message = f"the law {law} needs a circle and a line, not {listed(kinds, 'and')}"
            raise SpecError(message, key="compliance.law")

    @property
    def by_body(self) -> list[tuple[str, str, str, Shape]]:
        """For each body: the key of its name, the key of its shape, its name, and its shape."""
        if self.bodies is not None:
            names = [(f"bodies[{i}]", f"shapes[{i}]", name) for i, name in enumerate(self.bodies)]
        else:
            names = [(f"among[{i}]", f"shapes.{quoted(name)}", name) for i, name in enumerate(self.among or ())]
        return [(*name, shape) for name, shape in zip(names, self._ordered(), strict=True)]

    def _ordered(self) -> list[Shape]:
        return [self.shapes[name] for name in self.among or ()] if isinstance(self.shapes, dict) else list(self.shapes)

    @property
    def friction_coefficients(self) -> Pair:
        """Static and kinetic coefficient of friction."""
        if isinstance(self.friction, Friction):
            return self.friction.static, self.friction.kinetic
        return self.friction, self.friction

    @property
    def dissipation(self) -> float:
        """Dissipation c of the force law, see `Compliance`."""
        own = self.compliance
        assert own is not None
        if own.dissipation is not None:
            return own.dissipation
        if own.impact_speed is None:
            return 0.0
        e = self.restitution
        # H. M. Lankarani and P. E. Nikravesh, J. Mech. Des. 112, 1990; P. Flores et al., Multibody Syst. Dyn. 25, 2011
        slope = {"lankarani-nikravesh": 0.75 * (1.0 - e * e), "hunt-crossley": 1.5 * (1.0 - e)}
        return (slope[own.law] if own.law in slope else 1.6 * (1.0 - e) / e) / (1.5 * own.impact_speed)

    def law_numbers(self, radius: float) -> dict[str, float]:
        """Return the parameters of the laws of normal force, friction and rolling resistance by name.

        Parameters
        ----------
        radius
            Radius of the circle [m]; 0 for a point.
        """
        own = self.compliance
        assert own is not None
        static, kinetic = self.friction_coefficients
        c, stiffness = self.dissipation, own.stiffness
        if own.law == "smooth-sphere-half-space":  # in the force k d^(3/2) of H. Hertz
            modulus = 0.5 * elementary.pow(stiffness, 2.0 / 3.0)
            stiffness = 4.0 / 3.0 * modulus * math.sqrt(radius * modulus)
        return {
            "stiffness": stiffness,
            "dissipation": c,
            "release": 2.0 / (3.0 * c) if c > 0.0 else RELEASED,
            "static": static,
            "kinetic": kinetic,
            "transition": own.transition_speed,
            "rolling": self.rolling_resistance,
        }

    def pairs(self, name: str, joints: Mapping[str, Joint]) -> Iterator[ContactPair]:
        """Yield the rows (possible contact points) of the contact.

        In a group of bodies (`among`), pairs of bodies that a joint connects are left out.
        """
        held = {frozenset(joint.bodies) for joint in joints.values() if not joint.is_driver}
        key = f"model.contacts.{quoted(name)}"
        for (_, _, a, first), (_, _, b, second) in combinations(self.by_body, 2):
            if self.among is None:
                yield from _rows(name, key, (a, b), first, second)
            elif frozenset((a, b)) not in held:
                yield from _rows(f"{name}.{a}.{b}", key, (a, b), first, second)

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element refers to."""
        return [(key, name) for key, _, name, _ in self.by_body]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        return [
            (f"{key}.{place}", name, point) for _, key, name, shape in self.by_body for place, point in shape.points()
        ]

    def extent_points(self) -> list[tuple[str, Pair]]:
        """Return (body name, point in the body's frame [m]) of each point that the extent of the mechanism includes.

        They are the corners of squares around circles, and not the shapes of the ground, whose extent says nothing
        about the bodies.
        """
        points = []
        for _, _, name, shape in self.by_body:
            round_shape = shape.circle or shape.hole
            radius = 0.0 if round_shape is None else round_shape.radius
            for _, (x, y) in shape.points() if name != GROUND else ():
                points += [(name, (x + side, y + side)) for side in (-radius, radius)]
        return points

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return [(key, name) for key, _, name, shape in self.by_body if shape.kind in ("line", "polyline", "polygon")]


def _check_kinds(first: Shape, second: Shape, key: str) -> None:
    kinds = {first.kind, second.kind}
    if kinds <= {"line", "polyline"}:
        message = "two lines cannot touch each other, because they have no ends; use a polygon for one of the bodies"
        raise SpecError(message, key=key)
    if kinds == {"point"}:
        raise SpecError("two points cannot touch; give one of them a radius, {circle: {center, radius}}", key=key)
    if "hole" in kinds:
        _check_hole(first, second, key)


def _check_hole(first: Shape, second: Shape, key: str) -> None:
    hole, other = (first, second) if first.kind == "hole" else (second, first)
    if other.kind not in ("circle", "point"):
        raise SpecError(f"a hole holds a circle or a point, not a {other.kind}", key=key)
    (_, room), (_, radius) = hole.circle_of, other.circle_of
    if radius >= room:
        less = f"its radius, {radius:g} m, should be less than the radius of the hole, {room:g} m"
        raise SpecError(f"the circle does not fit into the hole: {less}", key=key)


def _rows(name: str, key: str, bodies: tuple[str, str], first: Shape, second: Shape) -> Iterator[ContactPair]:
    order = {"line": 0, "polyline": 0, "polygon": 1, "hole": 2, "circle": 3, "point": 4}
    swapped = order[first.kind] > order[second.kind]
    if swapped:
        bodies, first, second = (bodies[1], bodies[0]), second, first

    def row(number: int | None, kind: str, numbers: Sequence[float], radius: float) -> ContactPair:
        text = name if number is None else f"{name}.{number}"
        count = 0 if first.polygon is None else len(first.polygon)
        return ContactPair(text, key, bodies, (kind, count), tuple(numbers), radius, swapped)

    if first.polyline is not None:
        yield from _rows_on_polyline(name, key, bodies, first.polyline, second, swapped)
        return
    if second.polygon is not None:
        for i, corner in enumerate(second.polygon):
            if first.line is not None:
                yield row(i, "line", (*corner, 0.0, *first.line.point, *first.line.unit), 0.0)
            else:
                yield row(i, "inside", (*corner, 0.0, *_edges(first.polygon or ())), 0.0)
        if first.polygon is not None:
            begin, bodies, swapped = len(second.polygon), (bodies[1], bodies[0]), not swapped
            first, second = second, first
            for i, corner in enumerate(second.polygon or (), begin):
                yield row(i, "inside", (*corner, 0.0, *_edges(first.polygon or ())), 0.0)
        return
    center, radius = second.circle_of
    if first.polygon is not None:
        corners = first.polygon
        for i in range(len(corners)):
            around = (*corners[i - 1], *corners[i], *corners[(i + 1) % len(corners)])
            yield row(i, "edge", (*center, radius, *around, *_edges(corners)), radius)
    elif first.line is not None:
        yield row(None, "line", (*center, radius, *first.line.point, *first.line.unit), radius)
    else:
        middle, other = first.circle_of
        yield row(None, "hole" if first.hole is not None else "circles", (*center, radius, *middle, other), radius)


def _rows_on_polyline(
    name: str, key: str, bodies: tuple[str, str], points: tuple[Pair, ...], second: Shape, swapped: bool
) -> Iterator[ContactPair]:
    """Yield the rows of a polyline and a circle, point or polygon, whose body is the second.

    First come those of the circle or of the corners of the polygon, for each color of the pieces, and then those of the
    corners of the polyline, for each of their colors (`mbdkit_contact.polylines`).
    """
    corners = second.polygon or ()
    (cx, cy), radius = ((0.0, 0.0), 0.0) if corners else second.circle_of
    lengths = (elementary.hypot(bx - ax, by - ay) for (ax, ay), (bx, by) in combinations(corners, 2))
    surface = surface_of(points, 2.0 * radius, max(lengths, default=0.0))
    outlines = (float(surface.colors), *_edges(corners), *surface.segments)
    own = surface.colors * max(len(corners), 1)
    count = own + (surface.corner_colors if corners else 0)
    for i in range(count):
        label = name if count == 1 else f"{name}.{i}"
        if i < own:
            x, y = corners[i % len(corners)] if corners else (cx, cy)
            numbers = (x, y, radius, *outlines)
            yield ContactPair(label, key, bodies, ("polyline", surface.segment_count), numbers, radius, swapped)
        else:
            numbers = (0.0, 0.0, 0.0, *outlines)
            yield ContactPair(label, key, bodies[::-1], ("corner", surface.segment_count), numbers, 0.0, not swapped)


def _edges(corners: tuple[Pair, ...]) -> tuple[float, ...]:
    """Return (x, y) of the start and of the unit outward normal of each edge, and its length, edge after edge."""
    edges: list[float] = []
    for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
        size = elementary.hypot(bx - ax, by - ay)
        edges += [ax, ay, (by - ay) / size, (ax - bx) / size, size]
    return tuple(edges)


@element_check
def check_contacts(contacts: Mapping[str, Contact], mechanism: ElementsByName, prefix: str) -> None:
    """Raise SpecError for the first contact whose bodies a weld, or a pin between two moving bodies, holds together.

    Two bodies overlap around their pin. A body that is pinned to the ground may touch other parts of the ground.
    """
    for key, contact in contacts.items():
        for name, joint in mechanism.joints.items() if contact.bodies is not None else ():
            holds = isinstance(joint, Weld) or (isinstance(joint, Revolute) and GROUND not in joint.bodies)
            if holds and set(joint.bodies) == set(contact.bodies or ()):
                held = "joint '{}' holds '{}' and '{}' together".format(name, *contact.bodies or ())
                why = f"{held}, so a contact between them would act against the joint; remove the joint or the contact"
                raise SpecError(why, key=f"{prefix}contacts.{quoted(key)}.bodies")


@of_models(Contact)
def add_contact(self, name, a=None, b=None, **keys):  # type: ignore[no-untyped-def]
    """Add a contact.

    >>> m = Mechanism()
    >>> ball = m.body("ball", mass=0.5, inertia=2e-4, position=(0.0, 1.0))
    >>> floor, outline = {"line": {"normal": (0, 1)}}, {"circle": {"radius": 0.03}}
    >>> m.contact("floor", m.ground, ball, shapes=[floor, outline], friction=0.4, compliance={"stiffness": 1e6})
    """
    for index, body in enumerate((a, b)):
        if keys.get("among") is None and body is None:
            key = f"model.contacts.{quoted(name)}.bodies[{index}]"
            raise SpecError("is missing: a contact needs two bodies, or `among`", key=key)
    self.add("contacts", name, bodies=None if a is None and b is None else (a, b), **keys)
