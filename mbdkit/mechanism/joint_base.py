"""Base classes of joints, and constraints: what the engine, the checks and the plots ask of a joint type."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

from mbdkit.base.errors import SpecError, blaming
from mbdkit.base.frozen import dataclass
from mbdkit.mechanism.angle_function import Center
from mbdkit.mechanism.bodies import Attachment, Between
from mbdkit.mechanism.values import Motion, Points

if TYPE_CHECKING:
    import numpy as np

    from mbdkit.expressions.recorded import Recorded

#: Plot symbol of a joint: a pin at its point, a guide along its axis, a weld, a bar between its points, or none.
Mark = Literal["pin", "slide", "weld", "bar", "none"]


class Pose(NamedTuple):
    """Position and angle of the second body in the frame of the first one; with the ground as first body, in the global
    frame.

    In a `PoseFunction`, the entries are numbers that record operations: use ``+ - * / **`` and the functions of NumPy,
    such as ``np.sin`` and ``np.arctan2``.
    """

    #: Position of the second body's point relative to that of the first body, along the first body's x axis [m].
    x: Any
    y: Any  #: The same along the y axis [m].
    angle: Any  #: Angle of the second body minus that of the first [rad]; turns are counted.
    first: Any  #: Angle of the first body [rad]; 0 for the ground.
    t: Any  #: Time [s].


Function = Callable[[Pose, Mapping[str, Any]], Any]


@dataclass(frozen=True)
class PoseFunction:
    """A constraint: a smooth function of a `Pose`, which is zero where the joint fits.

    Parameters
    ----------
    function
        Function ``function(pose, p)``; `p` has the parameters by name. It is called once, with numbers that record
        operations, and is differentiated up to third order. Equal functions share a program; so this should be a
        function of a module, or an object of a frozen dataclass that can be called.
    parameters
        Names and values of the parameters.
    """

    function: Function
    parameters: tuple[tuple[str, float], ...] = ()


class RecordedFunction(NamedTuple):
    """A `PoseFunction` as a graph of terms."""

    value: Recorded
    pose: tuple[Recorded, ...]  #: The inputs that are the entries of the `Pose`; the last one is the time.
    parameters: dict[str, Recorded]  #: The inputs that are parameters.


def record_function(function: Function, parameters: Sequence[str], joint: str) -> RecordedFunction:
    """Call a function of a pose once, with numbers that record operations.

    Raises SpecError, which names the joint, if the function cannot be computed.
    """
    from mbdkit.expressions.recorded import Recorder  # most mechanisms have no such joint

    recorder = Recorder()
    pose = tuple(recorder.input(variable) for variable in Pose._fields)
    given = {parameter: recorder.input(f"parameter {parameter}") for parameter in parameters}
    with blaming(f"the constraint of joint '{joint}' cannot be computed", SpecError):
        return RecordedFunction(recorder.constant(function(Pose(*pose), given)), pose, given)


@dataclass(frozen=True)
class Constraint:
    """One kinematic constraint of a joint: one or two scalar equations (rows) of the same unit.

    Attributes
    ----------
    kind
        Name of the symbolic definition of the constraint, such as ``revolute`` or ``fixed_angle``.
    first_row
        Index of the first row of the constraint among the rows of the joint.
    rows
        Number of rows.
    points
        Point on each body, in the frame of that body, (x_a, y_a, x_b, y_b) [m].
    constants
        Up to two further parameters of the constraint; unused ones are zero.
    motion
        Prescribed function of time; None if there is none.
    center
        Displacement of the first body's point as a function of the relative angle; None if the point is fixed.
    function
        The constraint itself, if it is a function of the relative pose (kind ``function``); else None.
    """

    kind: str
    first_row: int
    rows: int
    points: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    constants: tuple[float, float] = (0.0, 0.0)
    motion: Motion | None = None
    center: Center | None = None
    function: PoseFunction | None = None


#: The line of a slide: a's point in a's frame and b's point in b's frame [m], unit vector in a's frame; each (x, y).
Travel = tuple[float, float, float, float, float, float]


class JointBase(Between):
    """Base class of joints: the properties of a joint type that the engine, the checks and the plots use."""

    mark: ClassVar[Mark] = "pin"
    is_driver: ClassVar[bool] = False
    """Whether the joint prescribes a motion."""
    _point_moves: ClassVar[bool] = False

    @property
    def point_moves_on_first(self) -> bool:
        """Whether b's point can move in a's frame; the reaction on a then acts at b's point."""
        return self._point_moves

    @property
    def joins_points(self) -> bool:
        """Whether the joint makes its two points coincide."""
        return False

    @property
    def travel(self) -> Travel | None:
        """The line along which b's point travels from a's point; None if the coordinate of the joint is an angle.

        The coordinate of a joint is the travel, or ``angle_b - angle_a``.
        """
        return None

    @property
    def coordinate_unit(self) -> str:
        """Unit of the coordinate of the joint: m for a travel, rad for an angle."""
        return "rad" if self.travel is None else "m"

    @property
    def flat_points(self) -> tuple[float, float, float, float]:
        """The points (x_a, y_a, x_b, y_b) [m], each in the frame of its body, to which a `Pose` refers."""
        return 0.0, 0.0, 0.0, 0.0

    def constraints(self, start: Pose) -> list[Constraint]:
        """Return the constraints of the joint.

        Parameters
        ----------
        start
            The relative pose at the initial positions before assembly, for joints that keep or count angles from there.
        """
        raise NotImplementedError

    def gap(self, separation: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Return the misalignment of the joint as a vector, (F, 2) [m].

        Parameters
        ----------
        separation
            (F, 2) vector from the first body's point to the second body's point, in the global frame [m]; F instants.
        angles
            (F, 2) angles of the first and the second body [rad].
        """
        return separation


@dataclass(frozen=True)
class SideForce:
    """A force of a joint along the line between its two points, in proportion to the size of a reaction.

    The radial part of the force between two teeth is one. It follows the reaction as friction does.

    Attributes
    ----------
    row
        Index of the constraint row whose multiplier is the reaction.
    ratio
        Force divided by the size of this multiplier; positive if it pulls the points together.
    name, key
        Name of the force in messages, and the key of the joint that causes it.
    """

    row: int
    ratio: float
    name: str
    key: str


class FunctionJoint(JointBase):
    """Base class of joints whose constraints are functions of the relative pose, one row each, such as gears.

    Subclasses are added by a `JointKind`. They define `type`, `rows`, `units` and `functions`, and further fields. The
    reaction of the joint acts at the second body's point, with a torque on both bodies.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("points",)

    points: Points = ((0.0, 0.0), (0.0, 0.0))
    """Origins of the relative pose: one point of each body in the frame of that body [m]; the centres of mass by
    default."""
    mark: ClassVar[Mark] = "none"
    _point_moves: ClassVar[bool] = True

    if TYPE_CHECKING:  # a field, and attributes of the class or properties, of subclasses

        @property
        def type(self) -> str:
            """Value of the key `type`."""

        @property
        def rows(self) -> tuple[str, ...]:
            """Name of each constraint row."""

        @property
        def units(self) -> tuple[str, ...]:
            """Unit of each row, m or rad: whether it counts as misalignment or as angular misalignment."""

    @property
    def flat_points(self) -> tuple[float, float, float, float]:
        """The points (x_a, y_a, x_b, y_b) [m], each in the frame of its body, to which a `Pose` refers."""
        return (*self.points[0], *self.points[1])

    @property
    def ends(self) -> Points:
        """The points."""
        return self.points

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        (a, b), (xa, ya, xb, yb) = self.bodies, self.flat_points
        return [("points[0]", a, (xa, ya)), ("points[1]", b, (xb, yb))]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return self.places()

    def functions(self, start: Pose) -> Sequence[PoseFunction]:
        """Return the constraint of each row.

        Raises SpecError, with a key below that of the joint, if the bodies cannot be joined at the start.

        Parameters
        ----------
        start
            The relative pose at the initial positions before assembly, in numbers.
        """
        raise NotImplementedError

    def side_force(self) -> SideForce | None:
        """Return the force along the line between both points that follows a reaction; None if there is none."""
        return None

    def lines(self, start: Pose) -> Sequence[Sequence[tuple[int, tuple[float, float]]]]:
        """Return the lines with which the joint is drawn.

        Returns
        -------
        sequence
            Each line is a sequence of vertices: 0 for the first or 1 for the second body, and a point in the frame of
            this body [m].
        """
        return []

    def constraints(self, start: Pose) -> list[Constraint]:
        """Return the constraints of the joint."""
        return [
            Constraint("function", row, 1, self.flat_points, function=function)
            for row, function in enumerate(self.functions(start))
        ]

    def gap(self, separation: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Return the misalignment of the joint as a vector, (F, 2) [m]; zero, since it has no direction of its own."""
        return 0.0 * separation
