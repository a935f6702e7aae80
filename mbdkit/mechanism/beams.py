"""Flexible beams: nodes that are bodies, and the elements between them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError, model_validator

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, quoted
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.beam_shape import END_CORRECTIONS, INTEGRATION, NODE_SHARES, Place, curved, straight
from mbdkit.mechanism.bodies import Body
from mbdkit.mechanism.forces import PointForce
from mbdkit.mechanism.values import Motion, MotionPair, NotNegative, Number, Point, Positive, Table, sequence

#: In a beam with ``shear: none``, shear causes this share of the deflection of a cantilever that carries a force at
#: its end.
SHEAR_SHARE = 1e-6

MOST_ELEMENTS = 20_000


Start = Annotated[tuple[Number, Number, Number], BeforeValidator(sequence)]


class BeamStiffness(StrictModel):
    """Stiffnesses of the cross-section of a beam; omitted ones follow from `E`, `G`, `A` and `I`."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("axial", "shear", "bending")

    axial: Positive | None = None
    """Axial stiffness [N], ``E A`` by default."""
    shear: Positive | Literal["none"] | None = None
    """Shear stiffness [N], ``shear_factor G A`` by default; or `none` for a beam with negligible shear: the stiffness
    is then ``3e6 bending / length^2``, so that shear causes 1e-6 of the deflection of a cantilever that carries a force
    at its end."""
    bending: Positive | None = None
    """Bending stiffness [N m^2], ``E I`` by default."""


class SectionStiffness(NamedTuple):
    """Axial and shear stiffness [N], and bending stiffness [N m^2]."""

    axial: float
    shear: float
    bending: float


class BeamSection(NamedTuple):
    """A cross-section at which an element is integrated.

    - `element`: number of the element in its beam.
    - `nodes`: names of the nodes of the element.
    - `shape`: values of the shape functions of these nodes at the cross-section.
    - `slope`: derivatives of the shape functions with respect to the arc length [1/m].
    - `length`: length of the part of the beam that the cross-section represents [m].
    - `reference`: axial strain plus 1, shear strain and curvature [1/m] of the stress-free beam.
    """

    element: int
    nodes: tuple[str, ...]
    shape: tuple[float, ...]
    slope: tuple[float, ...]
    length: float
    reference: tuple[float, float, float]


class Beam(StrictModel):
    """A flexible beam: a geometrically exact (Reissner) beam with axial, shear and bending strain.

    Its nodes are the bodies ``NAME.0``, ``NAME.1``, ..., numbered from one end to the other. Joints and forces refer to
    them as to any other body. In the stress-free shape, the angle of a node is the angle of the tangent to the beam, in
    the direction from a to b or along the points.
    """

    # `nu` is not in the list because it may be 0; an empty value counts as absent.
    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (
        "type", "a", "b", "points", "E", "G", "A", "I", "density", "stiffness", "mass_per_length", "rotary_inertia",
        "load", "load_frame", "start", "corrected",
    )  # fmt: skip

    type: Literal["beam"] = "beam"
    a: Point | None = None
    """First end (x, y) [m] of a straight beam, global frame."""
    b: Point | None = None
    """Second end (x, y) [m]."""
    points: Annotated[tuple[Point, ...], BeforeValidator(sequence), Field(min_length=3)] | None = None
    """Three or more points (x, y) [m] of a curved beam, as an alternative to `a` and `b`. A cubic spline through them
    is the stress-free shape."""
    elements: Annotated[int, Field(ge=1, le=MOST_ELEMENTS)] = 16
    """Number of elements."""
    nodes: Literal[2, 3] = 2
    """Nodes of an element: with 2, n elements have n + 1 nodes and errors of order 2 in the length of an element; with
    3, they have 2 n + 1 nodes and errors of order 4."""
    corrected: bool = False
    """Whether elements with two nodes are corrected, which costs no computing time: masses and loads are assigned to
    the nodes by Gregory's rule, and an additional shear flexibility represents the bending inside each element. Errors
    in bending are then about as small as with three nodes; forces in the two elements at each end are less accurate."""
    E: Positive | None = None
    """Young's modulus [Pa]."""
    G: Positive | None = None
    """Shear modulus [Pa]; or give `nu`."""
    nu: Annotated[float, Field(gt=-1.0, lt=0.5, allow_inf_nan=False)] | None = None
    """Poisson's ratio, from which ``G = E / (2 (1 + nu))``."""
    A: Positive | None = None
    """Area of the cross-section [m^2]."""
    I: Positive | None = None  # noqa: E741
    """Second moment of area of the cross-section [m^4]."""
    shear_factor: Positive = 5.0 / 6.0
    """Shear correction factor of the cross-section; 5/6 is that of a rectangle."""
    density: Positive | None = None
    """Mass density [kg/m^3]."""
    stiffness: BeamStiffness | None = None
    """Stiffnesses of the cross-section, in place of those that follow from `E`, `G`, `A` and `I`."""
    mass_per_length: Positive | None = None
    """Mass per length [kg/m]; ``density A`` by default."""
    rotary_inertia: Positive | None = None
    """Moment of inertia per length [kg m]; by default ``density I``, or ``mass_per_length bending / axial`` if
    `density` or `I` is missing."""
    damping: NotNegative = 0.0
    """Retardation time [s] of the material (Kelvin-Voigt): a strain e with the rate de/dt causes the stress that the
    strain e + damping de/dt would cause without damping."""
    velocity: Point = (0.0, 0.0)
    """Initial velocity (x, y) [m/s] of the first node."""
    angular_velocity: Number = 0.0
    """Initial angular velocity [rad/s] of the beam, which starts to move as a rigid body that rotates about its first
    node."""
    load: MotionPair | None = None
    """Distributed load (x, y) [N/m] in addition to gravity: numbers, expressions of t, or tables."""
    load_frame: Literal["global", "body"] = "global"
    """Frame of the components of `load`: `global`, or `body`, in which case the load turns with the beam."""
    start: Annotated[tuple[Start, ...], BeforeValidator(sequence)] | None = None
    """Initial x, y and angle [m, m, rad] of every node, if the beam starts under stress; by default, it starts in its
    stress-free shape."""

    @model_validator(mode="after")
    def _consistent(self) -> Beam:
        self._check_shape()
        self._check_material()
        if self.corrected and self.nodes != 2:
            raise SpecError("is for elements with two nodes; those with three are accurate without it", key="corrected")
        with np.errstate(all="ignore"):
            if not np.all(np.isfinite(self.places)):
                raise SpecError("the curve through them turns back sharply; add points between", key="points")
            if not math.isfinite(self.highest_frequency):
                raise SpecError("its stiffness is too large, or its mass or length too small, for double precision")
        if self.start is not None and len(self.start) != self.node_count:
            message = f"should have x, y and angle of each of the {self.node_count} nodes, not {len(self.start)} rows"
            raise SpecError(message, key="start")
        return self

    def _check_shape(self) -> None:
        ends = {"a": self.a, "b": self.b}
        if self.points is not None:
            for key, end in ends.items():
                if end is not None:
                    raise SpecError("give the shape either by `a` and `b` or by `points`, not both", key=key)
            for i, (side, other) in enumerate(zip(self.points, self.points[1:], strict=False)):
                if side == other:
                    raise SpecError("is the same point as the one before", key=f"points[{i + 1}]")
            return
        for key, end in ends.items():
            if end is None:
                raise SpecError(
                    "is missing: a beam needs its ends `a` and `b` (x, y) [m], or `points` of its curve", key=key
                )
        if self.a == self.b:
            raise SpecError("is the same point as `a`: a beam needs a length", key="b")

    def _check_material(self) -> None:
        given = self.stiffness or BeamStiffness()
        needed = []
        if given.axial is None:
            needed += [("E", "stiffness.axial"), ("A", "stiffness.axial")]
        if given.bending is None:
            needed += [("E", "stiffness.bending"), ("I", "stiffness.bending")]
        if self.mass_per_length is None:
            needed += [("density", "mass_per_length"), ("A", "mass_per_length")]
        for key, instead in needed:
            if getattr(self, key) is None:
                raise SpecError(f"is missing; or give `{instead}`", key=key)
        if self.G is not None and self.nu is not None:
            raise SpecError("give the shear modulus either as `G` or by `nu`, not both", key="nu")
        if given.shear is None:
            if self.G is None and (self.nu is None or self.E is None):
                raise SpecError(
                    "is missing: Poisson's ratio, or `G`, or `stiffness: {shear: none}` for a slender beam", key="nu"
                )
            if self.A is None:
                raise SpecError("is missing; or give `stiffness.shear`", key="A")

    # ---- cross-section -------------------------------------------------------------------------------------------

    @property
    def section_stiffness(self) -> SectionStiffness:
        """Stiffness of the cross-section."""
        given = self.stiffness or BeamStiffness()
        axial = given.axial or (self.E or 0.0) * (self.A or 0.0)
        bending = given.bending or (self.E or 0.0) * (self.I or 0.0)
        if given.shear == "none":
            return SectionStiffness(axial, 3.0 * bending / (SHEAR_SHARE * (self.length * self.length)), bending)
        modulus = self.G or (self.E or 0.0) / (2.0 * (1.0 + (self.nu or 0.0)))
        return SectionStiffness(axial, given.shear or self.shear_factor * modulus * (self.A or 0.0), bending)

    @property
    def element_stiffness(self) -> SectionStiffness:
        """Stiffness with which elements are computed; if they are corrected, the shear stiffness is smaller.

        An element of length h that is integrated at a single cross-section does not bend under a bending moment that
        varies linearly along it. The residual bending flexibility ``h^2 / (12 bending)`` adds this deflection to the
        deflection by shear. The small deflections of a straight beam with forces at its nodes are then exact. R. H.
        MacNeal, A simple quadrilateral shell element, Computers & Structures 8 (1978).
        """
        section = self.section_stiffness
        if not self.corrected:
            return section
        residual = self.element_length * self.element_length / (12.0 * section.bending)
        return section._replace(shear=1.0 / (1.0 / section.shear + residual))

    @property
    def inertia_per_length(self) -> tuple[float, float]:
        """Mass per length [kg/m] and moment of inertia per length [kg m]."""
        mass = self.mass_per_length or (self.density or 0.0) * (self.A or 0.0)
        if self.rotary_inertia is not None:
            return mass, self.rotary_inertia
        if self.density is not None and self.I is not None:
            return mass, self.density * self.I
        stiffness = self.section_stiffness
        return mass, mass * stiffness.bending / stiffness.axial

    @cached_property
    def highest_frequency(self) -> float:
        """Upper bound of the natural frequencies of the free beam [rad/s]: the highest natural frequency of a single
        free element.

        B. M. Irons, Applications of a theorem on eigenvalues to finite element problems (1970).
        """
        length, (mass, inertia) = self.element_length, self.inertia_per_length
        stiffness = np.zeros((3 * self.nodes, 3 * self.nodes))
        for point in INTEGRATION[self.nodes]:
            shape, slope, none = np.array(point.shape), np.array(point.slope) / length, np.zeros(self.nodes)
            # Derivatives of axial strain, shear strain and curvature with respect to x, y and angle of the nodes.
            strains = (slope, none, none), (none, slope, -shape), (none, none, slope)
            for modulus, strain in zip(self.element_stiffness, strains, strict=True):
                row = np.column_stack(strain).ravel()
                stiffness += point.weight * length * modulus * np.outer(row, row)
        least = [min(self.node_lengths) / length] * 2 if self.corrected else NODE_SHARES[self.nodes]
        root = np.sqrt(np.outer(least, (mass, mass, inertia)).ravel() * length)
        scaled = stiffness / np.outer(root, root)
        return float(np.sqrt(np.linalg.eigvalsh(scaled)[-1])) if np.all(np.isfinite(scaled)) else math.inf

    # ---- shape ---------------------------------------------------------------------------------------------------

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return self.elements * (self.nodes - 1) + 1

    @cached_property
    def _shape(self) -> tuple[list[Place], float]:
        if self.points is not None:
            return curved(self.points, self.node_count)
        assert self.a is not None
        assert self.b is not None
        return straight(self.a, self.b, self.node_count), elementary.hypot(self.b[0] - self.a[0], self.b[1] - self.a[1])

    @property
    def places(self) -> list[Place]:
        """Position and angle of every node of the stress-free beam."""
        return self._shape[0]

    @property
    def length(self) -> float:
        """Arc length without stress [m]."""
        return self._shape[1]

    @property
    def element_length(self) -> float:
        """Arc length of an element without stress [m]."""
        return self.length / self.elements

    def node_names(self, name: str) -> tuple[str, ...]:
        """Return the names of the nodes of the beam `name`."""
        return tuple(f"{name}.{i}" for i in range(self.node_count))

    @property
    def node_lengths(self) -> list[float]:
        """For each node, the length of the part of the beam whose mass and load are assigned to this node [m]."""
        lengths = [0.0] * self.node_count
        for element in range(self.elements):
            for i, share in enumerate(NODE_SHARES[self.nodes]):
                lengths[element * (self.nodes - 1) + i] += share * self.element_length
        if self.corrected and self.elements > 1:
            for i, share in enumerate(END_CORRECTIONS):
                lengths[i] += share * self.element_length
                lengths[-1 - i] += share * self.element_length
        return lengths

    # ---- parts ---------------------------------------------------------------------------------------------------

    def bodies(self, name: str) -> dict[str, Body]:
        """Return the nodes of the beam `name`."""
        mass, inertia = self.inertia_per_length
        starts = self.places if self.start is None else [Place(*coordinate) for coordinate in self.start]
        first, omega = starts[0], self.angular_velocity
        try:
            return {
                node: Body(
                    mass=mass * length,
                    inertia=inertia * length,
                    position=(at.x, at.y),
                    angle=at.angle,
                    velocity=(self.velocity[0] - omega * (at.y - first.y), self.velocity[1] + omega * (at.x - first.x)),
                    angular_velocity=omega,
                )
                for node, length, at in zip(self.node_names(name), self.node_lengths, starts, strict=True)
            }
        except ValidationError:
            raise SpecError(
                "the masses, moments of inertia or velocities of its nodes are zero, negative or too large for "
                "double precision",
                key=f"beams.{quoted(name)}",
            ) from None

    def loads(self, name: str) -> dict[str, PointForce]:
        """Return the forces on the nodes, by name, that replace the distributed load of the beam `name`."""
        if self.load is None:
            return {}
        return {
            f"{node}.load": PointForce(
                body=node, value=(_times(self.load[0], length), _times(self.load[1], length)), frame=self.load_frame
            )
            for node, length in zip(self.node_names(name), self.node_lengths, strict=True)
        }

    def sections(self, name: str) -> Iterator[BeamSection]:
        """Yield the cross-sections at which the elements of the beam `name` are integrated."""
        names, places, length = self.node_names(name), self.places, self.element_length
        is_straight = self.points is None
        for element in range(self.elements):
            first = element * (self.nodes - 1)
            some = slice(first, first + self.nodes)
            for point in INTEGRATION[self.nodes]:
                slope = tuple(x / length for x in point.slope)
                reference = (1.0, 0.0, 0.0) if is_straight else _strains(places[some], point.shape, slope)
                yield BeamSection(element, names[some], point.shape, slope, point.weight * length, reference)


#: Suffix of the name by which a spec refers to the last node of a beam, whatever its number of elements.
LAST = ".last"


def last_nodes(beams: Mapping[str, Beam]) -> dict[str, str]:
    """Return the name of the last node of each beam, such as ``tube.16``, by its other name, such as ``tube.last``."""
    return {f"{name}{LAST}": beam.node_names(name)[-1] for name, beam in beams.items()}


def named_body(name: str, bodies: Sequence[str]) -> str:
    """Return the name of a body of a mechanism: for ``BEAM.last`` that of the last node of the beam, otherwise `name`
    itself.
    """
    beam = name.removesuffix(LAST)
    if name in bodies or beam == name:
        return name
    return next((body for body in reversed(bodies) if beam_of(body) == beam), name)


def with_body(element: Any, path: Path, body: str) -> Any:
    """Return a copy of an element in which the name at a key path within the element is replaced by `body`."""
    if not path:
        return body
    head, *rest = path
    if isinstance(element, tuple):
        assert isinstance(head, int)
        return (*element[:head], with_body(element[head], tuple(rest), body), *element[head + 1 :])
    return element.model_copy(update={str(head): with_body(getattr(element, str(head)), tuple(rest), body)})


def beam_of(node: str) -> str:
    """Return the name of the beam in the name of a node such as ``tube.0``; empty if the name does not end in a number.

    Whether such a beam exists is not checked.
    """
    beam, _, number = node.rpartition(".")
    return beam if number.isdecimal() else ""


def parts_of(beams: Mapping[str, Beam]) -> frozenset[str]:
    """Return the names of all nodes and loads that belong to beams."""
    return frozenset(part for name, beam in beams.items() for part in (*beam.node_names(name), *beam.loads(name)))


def written_key(beams: Mapping[str, Beam], kind: str, name: str, key: str = "") -> str:
    """Return the key path at which a spec states `key` of an element of a kind such as ``bodies``: for nodes and loads
    that belong to a beam, the key path of the beam or of its `load`.
    """
    beam = beam_of(name.removesuffix(".load"))
    path = (kind, quoted(name), key) if beam not in beams else ("beams", quoted(beam), "load" * (kind == "forces"))
    return ".".join(filter(None, ("model", *path)))


def _strains(places: list[Place], shape: tuple[float, ...], slope: tuple[float, ...]) -> tuple[float, float, float]:
    """Return axial strain plus 1, shear strain and curvature [1/m] of a cross-section with its nodes at `places`."""
    dx, dy, turn = (sum(s * x for s, x in zip(slope, values, strict=True)) for values in zip(*places, strict=True))
    angle = sum(n * position.angle for n, position in zip(shape, places, strict=True))
    c, s = elementary.cos(angle), elementary.sin(angle)
    return c * dx + s * dy, c * dy - s * dx, turn


def _times(motion: Motion, factor: float) -> Motion:
    """Return a function of time multiplied by a number."""
    if isinstance(motion, str):
        return f"({motion})*{factor!r}"
    if isinstance(motion, Table):
        at, values = motion.table
        return motion.model_copy(update={"table": (at, tuple(factor * x for x in values))})
    return factor * motion
