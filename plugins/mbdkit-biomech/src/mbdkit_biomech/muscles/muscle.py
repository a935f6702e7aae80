"""Muscles: paths along points and circles of bodies, and the parameters of a muscle of Hill type."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.strict_model import StrictModel
from mbdkit.base.text import did_you_mean, listed
from mbdkit.mechanism.bodies import Attachment, Element
from mbdkit.mechanism.coordinate_function import (
    CoordinateExpressionError,
    CoordinateFunction,
    names_of,
    value_and_slopes,
)
from mbdkit.mechanism.element_kinds import ElementsByName, element_check
from mbdkit.mechanism.model_methods import of_models
from mbdkit.mechanism.state_values import Value, of_state, of_time
from mbdkit.mechanism.values import Motion, NotNegative, Number, Point, Positive, pair, sequence
from mbdkit.registry.target import Target
from mbdkit_biomech.muscles.patella import Patella

#: Largest number of circles between two points of a path. It is limited because all patterns of touched circles are
#: enumerated.
MOST_CIRCLES = 4

#: Pennation angles from this value on are refused, because the force along the tendon would almost vanish.
TOO_STEEP = math.radians(80)


def _point(value: object) -> object:
    """Accept a list of two or three items."""
    plain = sequence(value)
    if not isinstance(plain, tuple) or len(plain) not in (2, 3):
        raise SpecError(f"should be a point [x, y] or [x, y, z], not {plain!r}")
    return plain


PathPoint = Annotated[
    tuple[CoordinateFunction, ...], BeforeValidator(_point, json_schema_input_type=list[CoordinateFunction])
]
Range = Annotated[tuple[Number, Number], BeforeValidator(pair("a range [lowest, highest]"))]


class WrapCircle(StrictModel):
    """A circle of a body that a path is pulled taut around."""

    body: str
    """Name of the body."""
    center: Point
    """Center in the body's frame [m]."""
    radius: Positive
    """Radius [m]."""
    side: Literal["left", "right"]
    """Side of the center on which the path passes, seen along the path. If it passes on the left, the path turns
    clockwise around the circle."""


class PathItem(StrictModel):
    """A point of the path of a muscle, or a circle between two points that the path wraps around."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("body", "point", "when", "wrap")

    body: str | None = None
    """Name of the body of the point."""
    point: PathPoint | None = None
    """The point in the body's frame [m]: [x, y], or [x, y, z], where z is an offset perpendicular to the plane; lengths
    include this offset. x and y may be expressions of named coordinates, or tables of a coordinate, ``{table:
    [[coordinate, ...], [value, ...]], of: knee_flexion}``; such a point moves in the frame of its body."""
    when: dict[str, Range] | None = None
    """Ranges of quantities, such as ``{knee.angle: [-2.0, -0.3]}``: the path has the point only while all of these
    quantities are in their ranges. By default, the path always has the point."""
    wrap: WrapCircle | None = None
    """Instead of a point: a circle. The path touches it only where the straight line would cross it."""

    @model_validator(mode="after")
    def _one_kind(self) -> PathItem:
        if self.wrap is not None:
            for key in ("body", "point", "when"):
                if getattr(self, key) is not None:
                    raise SpecError("belongs to a point: an item is either a point or a `wrap`", key=key)
            return self
        for key in ("body", "point"):
            if getattr(self, key) is None:
                raise SpecError("is missing: a point of a path has `body` and `point`, a circle has `wrap`", key=key)
        for name, (low, high) in (self.when or {}).items():
            if not low < high:
                raise SpecError(f"the range [{low:g}, {high:g}] is empty", key=f"when.{name}")
        return self

    @property
    def on(self) -> str:
        """Name of the body of the point or circle."""
        body = self.body if self.wrap is None else self.wrap.body
        assert body is not None
        return body

    @property
    def center(self) -> tuple[CoordinateFunction, CoordinateFunction]:
        """The point, or the center of the circle, in the body's frame."""
        if self.wrap is not None:
            return self.wrap.center
        assert self.point is not None
        return self.point[0], self.point[1]

    @property
    def offset(self) -> float:
        """Offset z of the point [m]; 0 for circles, which represent cylinders."""
        if self.point is None or len(self.point) < 3:
            return 0.0
        return float(value_and_slopes(self.point[2], {}, 1)[0][0])

    @property
    def moves(self) -> bool:
        """Whether the point moves in the frame of its body."""
        return any(not isinstance(part, int | float) for part in self.center)


class Activation(StrictModel):
    """First-order dynamics of the activation, which follows the excitation in runs."""

    rise: Positive = 0.01
    """Time constant of rising activation [s]."""
    fall: Positive = 0.04
    """Time constant of falling activation [s]."""
    initial: Annotated[float, Field(ge=0, le=1)] = 0.05
    """Activation at the start."""


class Metabolics(StrictModel):
    """How the energy that a muscle consumes is estimated."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("mass", "smoothing")

    model: Literal["umberger", "bhargava"] = "umberger"
    """`umberger`: B. R. Umberger et al. (2003), with the changes of Umberger (2010); `bhargava`: L. J. Bhargava et al.
    (2004)."""
    slow_fibers: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Share of slow-twitch fibres."""
    aerobic_factor: Positive = 1.5
    """Factor that multiplies the heat of `umberger`: 1.5 under aerobic, 1.0 under anaerobic conditions."""
    specific_tension: Positive = 250000.0
    """Isometric force per area of the cross-section [Pa], from which the default of `mass` follows."""
    density: Positive = 1059.7
    """Density of the muscle [kg/m^3]."""
    mass: Positive | None = None
    """Mass of the muscle [kg]; by default, max_force / specific_tension * density * optimal_length."""
    smoothing: NotNegative = 0.0
    """Width of the transitions from shortening to lengthening, and of others with a corner, relative to the largest
    velocity, the optimal length and full activation. Predictions that minimize metabolic power need about 0.01."""

    @model_validator(mode="after")
    def _factor_has_effect(self) -> Metabolics:
        if self.model == "bhargava" and self.aerobic_factor != 1.5:
            raise SpecError("has no effect on the model bhargava; leave it out", key="aerobic_factor")
        return self


def _as_metabolics(value: object) -> object:
    return {"model": value} if isinstance(value, str) else value


class Muscle(Element):
    """A Hill-type muscle along a path: a fibre in series with a tendon, to which it is inclined by the pennation angle.

    Its tension pulls the ends of its path together. The angle between fibre and tendon changes so that the thickness of
    the muscle, ``optimal_length * sin(pennation)``, is constant.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("excitation", "metabolics", "patella")
    equilibrium: ClassVar[Target] = Target("mbdkit_biomech.muscles.acting_muscles:equilibrium_of")

    path: Annotated[list[PathItem], Field(min_length=2)]
    """Points and circles from origin to insertion; the first and the last item are points without `when`."""
    max_force: Positive
    """Isometric force of the fibres at optimal length and full activation [N]."""
    optimal_length: Positive
    """Length of the fibres at which they exert their largest active force [m]."""
    tendon_length: NotNegative
    """Length of the tendon without force [m]."""
    pennation: NotNegative = 0.0
    """Angle between fibres and tendon at the optimal length [rad]."""
    curves: Literal["de-groote-fregly", "millard"] = "de-groote-fregly"
    """Curves of force by length and velocity: closed formulas of De Groote et al. (2016), or the Bezier curves of
    Millard et al. (2013)."""
    tendon: Literal["rigid", "elastic"] = "rigid"
    """Whether the tendon has a constant length, or is elastic."""
    patella: Patella | None = None
    """For a muscle of the quadriceps, whose path ends at the patella on the thigh: the patella and its ligament, which
    pulls the shank; ``{}`` in a model `leg`. None by default."""
    damping: NotNegative = 0.1
    """Damping of the fibres: the damping force at the velocity `max_velocity`, as a share of `max_force`."""
    activation: Activation = Activation()
    """Time constants of the activation, and its initial value."""
    excitation: Value | None = None
    """Excitation between 0 and 1, required in runs: a number, an expression of t or of the state, or a table of time.
    Recruitment in inverse dynamics does not use it."""
    max_velocity: Positive = 10.0
    """Velocity of shortening at which fibres exert no active force, in optimal lengths per second."""
    weight: Positive = 1.0
    """Weight in recruitment, which minimises the sum of (activation / weight)^exponent."""
    metabolics: Annotated[
        Metabolics | None,
        BeforeValidator(_as_metabolics, json_schema_input_type=Metabolics | Literal["umberger", "bhargava"]),
    ] = None
    """Model of the energy that the muscle consumes: a name, or a name and its options; none by default."""

    @model_validator(mode="after")
    def _is_possible(self) -> Muscle:
        for index, end in ((0, "first"), (len(self.path) - 1, "last")):
            if self.path[index].wrap is not None:
                raise SpecError(f"the {end} item of a path is a point, not a circle", key=f"path[{index}].wrap")
            if self.path[index].when is not None:
                raise SpecError(f"the {end} point of a path cannot have `when`", key=f"path[{index}].when")
        if self.patella is None and len({item.on for item in self.path}) == 1:
            raise SpecError(f"has all its points on '{self.path[0].on}', so the muscle has no effect", key="path")
        if isinstance(self.excitation, int | float) and not 0 <= self.excitation <= 1:
            raise SpecError(f"should be between 0 and 1, not {self.excitation:g}", key="excitation")
        if self.pennation >= TOO_STEEP:
            raise SpecError(
                f"should be less than {TOO_STEEP:.4g} rad (80 degrees), not {self.pennation:g}; angles are in radians",
                key="pennation",
            )
        circles = 0
        for index, item in enumerate(self.path):
            circles = 0 if item.wrap is None else circles + 1
            if circles > MOST_CIRCLES:
                raise SpecError(
                    f"there are more than {MOST_CIRCLES} circles between two points", key=f"path[{index}].wrap"
                )
        return self

    @property
    def thickness(self) -> float:
        """Thickness perpendicular to the tendon, which is constant [m]."""
        return self.optimal_length * elementary.sin(self.pennation)

    @property
    def mass(self) -> float:
        """Mass of the muscle [kg]; only with `metabolics`."""
        own = self.metabolics
        assert own is not None
        volume = self.max_force / own.specific_tension * self.optimal_length
        return own.density * volume if own.mass is None else own.mass

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the first-order states of the muscle in a run."""
        return ("activation",) if self.tendon == "rigid" else ("activation", "fiber_length")

    def lengths_to_check(self) -> list[tuple[str, float]]:
        """Return the optimal length of the fibres."""
        return [("optimal_length", self.optimal_length)]

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element refers to."""
        keys = ("body" if item.wrap is None else "wrap.body" for item in self.path)
        found = [(f"path[{k}].{key}", item.on) for k, (key, item) in enumerate(zip(keys, self.path, strict=True))]
        return found if self.patella is None else [*found, ("patella", self.path[-1].on)]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        return [
            (f"path[{index}].{'point' if item.wrap is None else 'wrap.center'}", item.on, (float(x), float(y)))
            for index, item in enumerate(self.path)
            for x, y in [item.center]
            if isinstance(x, int | float) and isinstance(y, int | float)
        ]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return [place for place, item in zip(self.places(), self.path, strict=False) if item.moves]

    def motions(self) -> list[tuple[str, Motion]]:
        """Return (key, value) of each prescribed function of time."""
        return [] if self.excitation is None else of_time([("excitation", self.excitation)])

    def expressions(self) -> list[tuple[str, str]]:
        """Return (key, text) of each expression of the state."""
        return [] if self.excitation is None else of_state([("excitation", self.excitation)])


@element_check
def check_moving_points(muscles: Mapping[str, Muscle], mechanism: ElementsByName, prefix: str = "") -> None:
    """Raise SpecError for the first point with an unknown name, or whose offset z depends on a coordinate.

    Parameters
    ----------
    mechanism
        The mechanism, or its data.
    prefix
        Beginning of the key of the error.
    """
    coordinates = mechanism.coordinates
    for name, muscle in muscles.items():
        for index, item in enumerate(muscle.path):
            for axis, part in enumerate(item.point or ()):
                key = f"{prefix}muscles.{quoted(name)}.path[{index}].point[{axis}]"
                for used in names_of(part):
                    if used not in coordinates:
                        known = f"; coordinates: {listed(list(coordinates)) or 'none'}"
                        text = f"'{part}'" if isinstance(part, str) else "the table"
                        hint = did_you_mean(used, list(coordinates)) or known
                        what = f"contains '{used}', which is neither a coordinate of the model nor a parameter{hint}"
                        raise CoordinateExpressionError(f"{text} {what}", key=key)
                    if axis == 2:
                        what = "the offset from the plane is constant: a number, or an expression of parameters"
                        raise CoordinateExpressionError(what, key=key)


@of_models(Muscle)
def add_muscle(self, name, path, **keys):  # type: ignore[no-untyped-def]
    """Add a muscle. In runs it exerts a force; in inverse dynamics, `recruitment` computes its share of the moments.

    >>> m = Mechanism()
    >>> shank = m.body("shank", mass=3.0, inertia=0.05, position=(0.0, -0.2))
    >>> m.revolute("knee", m.ground, shank, at=(0.0, 0.0))
    >>> path = [{"body": "ground", "point": (-0.03, 0.3)}, {"body": shank, "point": (-0.03, 0.1)}]
    >>> m.muscle("flexor", path, max_force=2000.0, optimal_length=0.11, tendon_length=0.3)
    """
    self.add("muscles", name, path=path, **keys)
