"""Sections of a spec of inverse dynamics: measured motion and its smoothing, loads, actuators, muscles and time."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from mbdkit.base.errors import SpecError
from mbdkit.base.text import shown
from mbdkit.base.units import read_unit
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.values import BodyPair, Points, Positive, pair
from mbdkit.spec.item_names import CriterionName
from mbdkit.spec.sections import Count, Section
from mbdkit_biomech.persons.person_sections import Center, PlaneAxes

Named = Annotated[str, Field(min_length=1)]


def _or_text(key: str, kind: object) -> BeforeValidator:
    """Return the validator of a section of which a text may take the place: the value of this key."""
    return BeforeValidator(lambda x: {key: x} if isinstance(x, str) else x, json_schema_input_type=kind)


class ColumnOfTable(Section):
    """A column of a table and its unit; a text alone is the heading of a column in SI units."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("scale", "deviation")

    column: Named
    """Heading of the column."""
    unit: str | None = None
    """Unit of the numbers, such as deg or mm; by default the unit that the file states, otherwise the SI unit (m, rad,
    N, N m)."""
    scale: Annotated[float, Field(allow_inf_nan=False)] = 1.0
    """Factor by which the numbers are multiplied, such as -1 for an angle that is counted in the other direction."""
    deviation: Positive | None = None
    """Standard deviation of the noise, in the unit of the column. By default, the noise of columns of the motion is
    estimated from the residuals, and columns of loads count as exact."""

    @model_validator(mode="after")
    def _has_a_unit(self) -> ColumnOfTable:
        if self.scale == 0:
            raise SpecError("must not be 0, which would make all values equal", key="scale")
        if self.unit is not None:
            try:
                read_unit(self.unit)
            except SpecError as error:
                raise error.located(prefix="unit") from None
        return self


class TimeColumn(Section):
    """The column with the times of a table; a text alone is the heading of a column in seconds."""

    column: Named = "time"
    """Heading of the column."""
    unit: str = "s"
    """Unit of the times, such as ms."""

    @model_validator(mode="after")
    def _has_a_unit_of_time(self) -> TimeColumn:
        try:
            given = read_unit(self.unit)
        except SpecError as error:
            raise error.located(prefix="unit") from None
        if not given.is_like(read_unit("s")):
            raise SpecError(f"'{shown(self.unit)}' is not a unit of time (s, ms)", key="unit")
        return self

    @property
    def factor(self) -> float:
        """Factor from the numbers of the column to seconds."""
        return read_unit(self.unit).factor


class Gaps(Section):
    """How gaps in columns (cells that are empty or NaN) are bridged."""

    longest: Positive
    """Longest time between the samples on both sides of a gap [s]; a longer gap is refused."""
    interpolation: Literal["linear", "cubic"] = "cubic"
    """`linear`, or `cubic`: the cubic spline through the other samples of the column. The interpolation is used only if
    the other columns do not determine the pose in the gap."""


class ObservedColumn(ColumnOfTable):
    """The column with the measured values of one quantity."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (*ColumnOfTable.ABSENT_BY_DEFAULT, "gaps")

    weight: Positive = 1.0
    """Factor of the squared residual of the column, in SI units, in the fit of the mechanism."""
    rate: Named | None = None
    """Heading of a column with the first derivative, in the same unit per second, for motions that are not smoothed."""
    acceleration: Named | None = None
    """Heading of a column with the second derivative; given together with `rate`."""
    gaps: Gaps | None = None
    """How gaps of this column are bridged; by default, as `motion.gaps` says."""

    @model_validator(mode="after")
    def _has_both_derivatives(self) -> ObservedColumn:
        if (self.rate is None) != (self.acceleration is None):
            missing = "rate" if self.rate is None else "acceleration"
            raise SpecError("is missing: `rate` and `acceleration` are given together or not at all", key=missing)
        return self


#: A column of a table, or one SI value for all times.
Column = Annotated[ColumnOfTable | float, _or_text("column", ColumnOfTable | str | float)]
ColumnPair = Annotated[
    tuple[Column, Column],
    BeforeValidator(
        pair("two components, such as [force_x, 0.0]: each the heading of a column or a number in SI units")
    ),
]
Observed = Annotated[ObservedColumn, _or_text("column", ObservedColumn | str)]
Times = Annotated[TimeColumn, _or_text("column", TimeColumn | str)]


class NoSmoothing(Section):
    """No smoothing; derivatives of the polynomial of degree four through five neighbouring samples, or from columns."""

    name: Literal["none"] = "none"


class QuinticSpline(Section):
    """No smoothing; derivatives of the natural quintic spline through all samples."""

    name: Literal["quintic"] = "quintic"


class SmoothingSpline(Section):
    """A cubic smoothing spline, which minimises the sum of squared residuals + parameter * integral of the squared
    curvature.
    """

    name: Literal["spline"] = "spline"
    parameter: Annotated[float, Field(ge=0)] | None = None
    """Weight of the curvature [s^3]; by default, chosen by generalized cross-validation for each coordinate."""


class Butterworth(Section):
    """A Butterworth low-pass filter, forward and backward (no phase lag), then the natural quintic spline."""

    name: Literal["butterworth"] = "butterworth"
    cutoff: Positive
    """Frequency at which both passes together reduce the amplitude by 3 dB [Hz]."""
    order: Annotated[Count, Field(le=10)] = 2
    """Order of the filter in each of the two passes."""
    padding: Annotated[float, Field(ge=0)] | None = None
    """Duration by which both ends are extended by odd reflection [s]; by default two periods of the cutoff, and at most
    the length of the motion."""


class OpenSimFilter(Section):
    """The filter of OpenSim: samples padded by half their number and resampled, third-order Butterworth in two
    passes.
    """

    name: Literal["opensim"] = "opensim"
    cutoff: Positive
    """Cutoff of each of the two passes [Hz]."""


_Smoothing = Annotated[
    NoSmoothing | QuinticSpline | SmoothingSpline | Butterworth | OpenSimFilter, Field(discriminator="name")
]
Smoothing = Annotated[_Smoothing, _or_text("name", _Smoothing | Literal["none", "quintic", "spline"])]


class ErrorBars(Section):
    """How the errors of the results are estimated from the noise of the data."""

    samples: Annotated[Count, Field(ge=20)] = 400
    """Number of samples of the noise that are smoothed to find its covariance."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the random numbers."""


#: Name of a criterion: one of those that items of the kind ``criterion`` list for inverse dynamics.
Criterion = Annotated[str, CriterionName("inverse")]

Data = dict[str, list[float | None]]  #: Columns of a table by heading; None and NaN are gaps.


def _one_source(section: MeasuredMotion | Load, *, required: bool) -> None:
    if section.file is not None and section.data is not None:
        raise PydanticCustomError("mbdkit", "takes either `file` or `data`, not both")
    if required and section.file is None and section.data is None:
        raise PydanticCustomError("mbdkit", "needs `file` (a table) or `data` (columns by heading)")


class MeasuredMotion(Section):
    """The measured motion: a table, and the quantities of the mechanism that its columns contain.

    Quantities are JOINT.angle (relative angle, or travel of a slide), BODY.x, BODY.y, BODY.angle, MARKER.x and
    MARKER.y; where a name is not unique, joints.NAME.angle, bodies.NAME.angle and so on. Coordinates that the model
    names, such as knee_flexion, are quantities too.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (
        *("file", "data", "gaps", "errors", "belt"),
        *("plane", "clusters", "centers", "static"),
    )

    file: Named | None = None
    """Table with a column of times: CSV, Vicon CSV, Qualisys TSV, OpenSim .mot or .sto, .trc, C3D, or a run archive;
    relative to the folder of the spec."""
    data: Data | None = None
    """Columns of numbers by heading, as an alternative to `file`; null, None and NaN are gaps."""
    time: Times = TimeColumn()
    """Column with the times."""
    columns: dict[str, Observed] | None = None
    """The column of each observed quantity; by default, all columns whose headings are such quantities."""
    smooth: Smoothing = NoSmoothing()
    """How the independent coordinates are smoothed and differentiated: a name, or a name and its options."""
    gaps: Gaps | None = None
    """How gaps in the data are bridged; by default, gaps are refused. `gaps` of a column takes precedence."""
    errors: ErrorBars | Literal["none"] = ErrorBars()
    """How the errors of the results are estimated; `none` leaves them unknown, whatever `uncertainty` states, and saves
    the time of the estimate."""
    plane: PlaneAxes | Literal["fit"] | None = None
    """Plane of motion of a person (`subject`): axes of the laboratory, or `fit`, the default, to find it."""
    clusters: dict[str, list[Named]] | None = None
    """Markers of each segment of a person, by body: at least three, not on a line. Bodies are `trunk` (markers of the
    pelvis), `thigh`, `shank` and `foot`, and with two legs also `thigh_left`, `shank_left` and `foot_left`."""
    centers: dict[str, Center] | None = None
    """How each joint centre of a person is determined, by joint (`hip`, `knee`, `ankle`, `hip_left`, ...):
    `functional`, from the motion; `hip-regression`, from landmarks of the pelvis; `{midpoint: [MARKER, MARKER]}`; or
    `static`, midway between medial and lateral markers that have such names. By default, the motion is combined with
    the regression of hips, and with medial and lateral markers of other joints, if the landmarks are there."""
    static: Named | None = None
    """File of a calibration trial of the person, in which the person stands upright for some time; joints that are
    bent in it are calibrated by it. Several motions of a person may share it."""
    belt: Annotated[float, Field(allow_inf_nan=False)] = 0.0
    """Speed with which the belt of a treadmill moves backward [m/s]; feet that rest on it move as fast."""

    @model_validator(mode="after")
    def _complete(self) -> MeasuredMotion:
        _one_source(self, required=True)
        if self.columns == {}:
            raise SpecError("should have at least one column", key="columns")
        return self

    @property
    def is_run(self) -> bool:
        """Whether the file is the archive of a run."""
        return self.file is not None and self.file.lower().endswith(".h5")

    def gaps_of(self, name: str) -> Gaps | None:
        """Return how gaps in the column of an observed quantity are bridged; None if they are refused."""
        column = None if self.columns is None else self.columns[name]
        return self.gaps if column is None or column.gaps is None else column.gaps


class Load(Section):
    """A measured load on a body: a force at a point that may move, a free torque, or both."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("file", "data", "time", "kind", "plates")

    body: Named
    """Body that the load acts on."""
    kind: Literal["plate", "other"] | None = None
    """`plate` if a force plate measured the load, which then acts near the outline of the body; otherwise `other`. The
    kind decides which criteria of the verdict apply. The default is `plate` if columns give the point of application
    in the global frame, otherwise `other`."""
    file: Named | None = None
    """Table of the load; by default, the table of the motion."""
    data: Data | None = None
    """Columns of numbers by heading, as an alternative to `file`."""
    time: Times | None = None
    """Column with the times. The default is `motion.time` for a load in the table of the motion, and the column named
    `time` for a load in its own table."""
    force: ColumnPair | None = None
    """Columns of the force (x, y) on the body, in the global frame; a number is a constant component [N]."""
    point: ColumnPair | None = None
    """Columns of the point at which the force acts, or numbers [m]; by default, the body's centre of mass."""
    point_frame: Named = GROUND
    """Body in whose frame the point is given; by default, the global frame."""
    torque: Column | None = None
    """Column of a free torque on the body, positive counter-clockwise."""
    interpolation: Literal["linear", "cubic"] = "linear"
    """How loads are interpolated to the times of the motion."""
    plates: Annotated[list[Count], Field(min_length=1)] | None = None
    """Numbers of force plates of the C3D file of a person, as in the headings `plate1.force.x`; `body` is the foot on
    which they act. Replaces `force`, `point` and `torque`."""

    @property
    def is_plate(self) -> bool:
        """Whether the load counts as that of a force plate."""
        if self.kind is not None:
            return self.kind == "plate"
        given = self.point is not None and any(not isinstance(one, float) for one in self.point)
        return given and self.point_frame == GROUND

    @model_validator(mode="after")
    def _complete(self) -> Load:
        _one_source(self, required=False)
        if self.plates is not None:
            for key in ("file", "data", "force", "point", "torque"):
                if getattr(self, key) is not None:
                    raise SpecError("cannot be given with `plates`, from which it follows", key=key)
            return self
        if self.force is None and self.torque is None:
            keys = "`force: [ground_force_vx, ground_force_vy], point: [ground_force_px, ground_force_py]`"
            hint = f"; OpenSim's files often have {keys}" if str(self.file).endswith((".mot", ".sto")) else ""
            message = (
                "needs `force` (two columns), `torque` (a column) or, for a person, `plates` (numbers, of C3D files)"
            )
            raise PydanticCustomError("mbdkit", f"{message}{hint}")
        if self.point is not None and self.force is None:
            raise SpecError("is a point of application, but there is no `force`", key="point")
        return self


class Actuator(Section):
    """An actuator: on the coordinate of a joint, between two points or two bodies, or on a coordinate of a body.

    Without `joint`, `bodies` and `body`, the actuator acts on the coordinate of the model that has the same name; its
    value is then the generalized force of this coordinate, with the sign of the coordinate.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("joint", "bodies", "points", "body", "coordinate")

    joint: Named | None = None
    """Joint on whose relative angle or travel the actuator acts. Its value is the torque or force on the second
    body."""
    bodies: BodyPair | None = None
    """The two bodies between which the actuator acts, as an alternative to `joint`. With `points`, the value of the
    actuator is a tension that pulls the points together. Otherwise, it is a torque on the second body, positive
    counter-clockwise, with its reaction on the first."""
    points: Points | None = None
    """Points of attachment, each in the frame of its body [m]."""
    body: Named | None = None
    """Body on which the actuator acts from the ground, as an alternative to `joint`; requires `coordinate`."""
    coordinate: Literal["x", "y", "angle"] | None = None
    """Coordinate of `body`: a force at its centre of mass along a global axis, or a torque."""
    weight: Positive = 1.0
    """Weight of the value of the actuator. If there are more actuators than degrees of freedom, the sum of
    (weight * value)^2 is minimised; torques are divided by the characteristic length of the mechanism."""

    @model_validator(mode="after")
    def _complete(self) -> Actuator:
        names = [name for name in ("joint", "bodies", "body") if getattr(self, name) is not None]
        if len(names) > 1:
            raise PydanticCustomError("mbdkit", "needs only one of `joint`, `bodies` and `body`")
        if self.bodies is not None and self.bodies[0] == self.bodies[1]:
            raise SpecError(f"are both '{shown(self.bodies[0])}': an actuator acts between two bodies", key="bodies")
        if self.points is not None and self.bodies is None:
            raise SpecError("is missing: `points` are points of `bodies`", key="bodies")
        if (self.body is None) != (self.coordinate is None):
            missing = "body" if self.body is None else "coordinate"
            raise SpecError("is missing: `body` and `coordinate` are given together", key=missing)
        return self


class Recruitment(Section):
    """How muscles share the moments of actuators.

    In each frame, the sum of ``(activation / weight)^exponent`` over the muscles and of ``(reserve / its optimal
    force)^exponent`` over the reserves is minimised. Muscles and reserves together exert the moment of each actuator
    that a muscle acts on.
    """

    exponent: Annotated[int, Field(ge=1, le=20)] | Literal["inf"] = 2
    """Exponent of the terms of the sum over muscles and reserves that is minimised: a whole number, or `inf` to
    minimise the largest term. With 1 and `inf`, several solutions may be optimal; the one with the smallest sum of
    squares is then chosen."""
    minimum: Annotated[float, Field(ge=0, lt=1)] = 0.01
    """Smallest activation."""
    reserves: Positive | dict[str, Positive] = Field(default_factory=dict)
    """Reserve actuators, which act in addition to the muscles; none by default. Their optimal force or torque [N or N
    m], one value for all actuators or one by name, costs as much as the full activation of a muscle with weight 1. The
    smaller this optimal force is, the less the reserve is used."""
    capacity: Literal["full", "isometric"] = "full"
    """Largest active tension of a muscle: `full`, max_force times the curves of force by length and velocity times the
    cosine of the pennation; or `isometric`, max_force, which requires rigid tendons."""
    passive: bool = False
    """Whether the passive force of the fibres is added to their active force."""
    dynamics: Literal["none", "activation"] = "none"
    """`activation`: from one frame to the next, activations change at most as fast as activation dynamics with the time
    constants of each muscle allow for excitations between 0 and 1. Otherwise, frames are independent of each other."""


class Frontal(Section):
    """The two compartments of each knee, which carry the moment of the ground's force about its forward axis.

    Neither compartment can pull, so that recruitment finds forces of muscles with which the compression of the knee is
    at least twice this moment, divided by the width. The bound is soft: its standard deviation follows from that of the
    place of the knee.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("deviation",)

    width: Annotated[float, Field(gt=0, le=0.1)] = 0.046
    """Distance of the middles of the medial and the lateral compartment [m]."""
    deviation: Annotated[float, Field(ge=0, le=0.1)] | None = None
    """Standard deviation of the centre of the knee across the plane of motion [m]; by default, that of its
    calibration."""


class Emg(Section):
    """Columns with the EMG of a muscle."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("column", "channels", "file")

    column: Annotated[str, Field(min_length=1)] | None = None
    """Heading of the column, or name of the analog channel of a C3D file: an envelope, or a raw signal, which is
    rectified about its mean and filtered at 6 Hz."""
    channels: Annotated[list[Annotated[str, Field(min_length=1)]], Field(min_length=1)] | None = None
    """Several columns or channels of this muscle, instead of `column`."""
    file: Named | None = None
    """C3D file, or table with these columns and `time` [s], at any rate; by default, that of the motion."""
    scale: Literal["estimated"] | Positive = "estimated"
    """Activation divided by the envelope. If it is not known, it is estimated from the activations that the moments of
    the joints need, so that no maximal contraction is needed."""
    deviation: Annotated[float, Field(gt=0, le=10)] = 0.4
    """Standard deviation of the activation that the EMG shows, relative to it. The default is 0.3 for the EMG, and 0.28
    for the strength of the muscle, which scales its activations. Channels with an estimated scale that disagree with
    the activations have a larger one."""
    delay: Annotated[float, Field(ge=0, le=0.5)] = 0.07
    """Time from the EMG to the force of the muscle [s]."""

    def model_post_init(self, _context: object) -> None:
        """Raise SpecError unless one of `column` and `channels` is given."""
        if (self.column is None) == (self.channels is None):
            raise SpecError("or `channels` is needed, but not both", key="column")

    @property
    def columns(self) -> list[str]:
        """Headings of the columns."""
        return self.channels or [self.column or ""]


class Span(Section):
    """The part of the motion that is used; all of it by default."""

    start: float | None = None
    """Start time [s]; earlier samples are left out."""
    end: float | None = None
    """End time [s]; later samples are left out."""

    @model_validator(mode="after")
    def _in_order(self) -> Span:
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise SpecError(f"must be later than the start at {self.start!r}, not {self.end!r}", key="end")
        return self
