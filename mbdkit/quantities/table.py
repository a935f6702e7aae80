"""The table of quantities: what runs record, in the order of the archive.

The layout of archives, the histories of `Run`, tables for export, expressions of events and measures, their derivatives
and charts of reports follow from it. To add a quantity, add a `Recorded` to its kind; values that the engine does not
compute yet are computed in `mbdkit.quantities.states`, or by `mbdkit.engine.kernels.observe`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from mbdkit.quantities.array import (
    COORDINATE_UNITS,
    INTEGER,
    MIXED,
    TEXT,
    Array,
    Chart,
    Kind,
    Recorded,
)
from mbdkit.quantities.names import AXES, COORDINATES

if TYPE_CHECKING:
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.quantities.names import ArchiveNames

#: Units of the rate and of the multiplier of a constraint row, by the unit of its constraint function.
RATE_UNITS = {"m": "m/s", "rad": "rad/s"}
MULTIPLIER_UNITS = {"m": "N", "rad": "N m"}

UNITS_OF_ELEMENT: Mapping[str, Mapping[str, str]] = {
    "rate_row_units": RATE_UNITS,
    "velocity_row_units": RATE_UNITS,
    "value_row_units": MULTIPLIER_UNITS,
    "multiplier_row_units": MULTIPLIER_UNITS,
}
"""Units of quantities of an element by its unit of length or angle, by the array that holds them; else, that unit."""

NO_MISALIGNMENT = "a misalignment is an error of the method, and almost zero"

Texts = Callable[["ArchiveNames"], Sequence[str]]

_TBC = ("time", "body", "coordinate")
_TJ = ("time", "joint")
_TJA = ("time", "joint", "axis")
_TM = ("time", "constraint")
_TK = ("time", "observed")
_TA = ("time", "actuator")
_T = ("time",)
_N = ("interval",)
_E = ("event",)
_EBC = ("event", "body", "coordinate")

_POSITION = ("x", "y", "angle")
_VELOCITY = ("vx", "vy", "angular_velocity")
_ACCELERATION = ("ax", "ay", "angular_acceleration")
_COORDINATE = "coordinate of a body: its centre of mass in the global frame, and its angle"


def _time(group: str, since: str = "1.0") -> Array:
    return Recorded(f"{group}/time", _T, "s", "time of the recorded row", since=since)


def _texts(
    path: str, dim: str, what: str, texts: Texts, since: str = "1.1", *, optional: bool = False, label: str = ""
) -> Array:
    dims = (dim or path.partition("/")[2],)
    return Array(path, dims, "1", what, TEXT, since=since, optional=optional, texts=texts, label=label)


def _units(
    path: str,
    dim: str,
    of: str,
    base: Texts,
    since: str = "1.0",
    *,
    optional: bool = False,
    label: str = "",
) -> Array:
    units = UNITS_OF_ELEMENT.get(path.partition("/")[2])

    def texts(names: ArchiveNames) -> Sequence[str]:
        return base(names) if units is None else [units[one] for one in base(names)]

    return _texts(path, dim, f"units of {of}, row by row", texts, since, optional=optional, label=label)


def _of_coordinates(path: str, of: str, *, optional: bool = False) -> Array:
    units = COORDINATE_UNITS[path.partition("/")[2]]
    what = f"units of {of}, row by row"
    return _texts(path, "coordinate", what, lambda names: units, "1.0", optional=optional)


def _bodies(group: str, *, optional: bool = False) -> tuple[Array, Array]:
    return (
        _texts(f"{group}/body", "", "name of the body", lambda names: names.bodies, "1.0", optional=optional),
        _texts(f"{group}/coordinate", "", _COORDINATE, lambda names: COORDINATES, "1.0", optional=optional),
    )


def _axes(group: str, what: str, since: str, *, optional: bool = False) -> Array:
    return _texts(f"{group}/axis", "", what, lambda names: AXES, since, optional=optional)


def _joints(group: str, since: str = "1.0", *, optional: bool = False) -> Array:
    return _texts(f"{group}/joint", "", "name of the joint", lambda names: names.joints, since, optional=optional)


def _joint_units(names: ArchiveNames) -> Sequence[str]:
    return names.joint_units or ["rad"] * len(names.joints)


_TRAJECTORY = Kind(
    (
        _time("trajectory"),
        *_bodies("trajectory"),
        _of_coordinates("trajectory/row_units", "position"),
        _of_coordinates("trajectory/velocity_row_units", "velocity"),
        _of_coordinates("trajectory/acceleration_row_units", "acceleration"),
        Recorded(
            "trajectory/position",
            _TBC,
            MIXED,
            "position and angle of the body",
            row_units="row_units",
            take=lambda s: s.by_body(s.q),
            vector="position",
            components=_POSITION,
            about=("position of the centre of mass", "angle from the global x axis, never wrapped"),
            is_history=True,
        ),
        Recorded(
            "trajectory/velocity",
            _TBC,
            MIXED,
            "velocity and angular velocity",
            row_units="velocity_row_units",
            take=lambda s: s.by_body(s.v),
            vector="velocity",
            components=_VELOCITY,
            about=("velocity of the centre of mass", "angular velocity"),
            is_history=True,
        ),
        Recorded(
            "trajectory/acceleration",
            _TBC,
            MIXED,
            "acceleration and angular acceleration, index-1, at the recorded state",
            row_units="acceleration_row_units",
            take=lambda s: s.by_body(s.observed.acc),
            vector="acceleration",
            components=_ACCELERATION,
            about=("acceleration of the centre of mass", "angular acceleration"),
        ),
        Recorded("trajectory/elapsed_s", _T, "s", "wall time since the first step", take=lambda s: s.elapsed),
    ),
    word="bodies",
    one="body",
    example="angle",
    axis="body",
    is_bare=True,
)

_JOINTS = Kind(
    (
        _time("joints"),
        _joints("joints"),
        _axes("joints", "axis of the global frame, or of the frame of a body", "1.0"),
        _texts(
            "joints/first_body",
            "joint",
            "first body of the joint, which exerts the reaction",
            lambda names: [first for first, _ in names.joint_bodies],
            "1.0",
            label="bodies",
        ),
        _texts(
            "joints/second_body",
            "joint",
            "second body of the joint, on which the reaction acts",
            lambda names: [second for _, second in names.joint_bodies],
            "1.0",
            label="bodies",
        ),
        Recorded(
            "joints/misalignment",
            _TJ,
            "m",
            "distance by which the joint fails to meet",
            take=lambda s: s.misalignment,
            no_derivative=NO_MISALIGNMENT,
            is_not_negative=True,
            is_history=True,
        ),
        Recorded(
            "joints/velocity_misalignment",
            _TJ,
            "m/s",
            "relative point velocity in the constrained directions",
            take=lambda s: s.velocity_misalignment,
            no_derivative=NO_MISALIGNMENT,
            is_not_negative=True,
        ),
        Recorded(
            "joints/angle_misalignment",
            _TJ,
            "rad",
            "angle by which the joint fails to meet",
            take=lambda s: s.angle_misalignment,
            no_derivative=NO_MISALIGNMENT,
            is_not_negative=True,
        ),
        Recorded(
            "joints/reaction_force",
            _TJA,
            "N",
            "force of the first body on the second, global frame",
            take=lambda s: s.reactions[:, :, :2],
            vector="force",
            components=("force_x", "force_y"),
            has_norm=True,
            is_shared=True,
            is_history=True,
        ),
        Recorded(
            "joints/reaction_torque",
            _TJ,
            "N m",
            "torque of the first body on the second, at the second's joint point",
            take=lambda s: s.reactions[:, :, 2],
            components=("torque",),
            is_shared=True,
            is_history=True,
        ),
        Recorded(
            "joints/reaction_force_first",
            _TJA,
            "N",
            "reaction_force in the frame of the first body",
            since="1.1",
            take=lambda s: s.observed.joints[:, :, 2:4],
            vector="force_first",
            components=("force_first_x", "force_first_y"),
            is_shared=True,
        ),
        Recorded(
            "joints/reaction_force_second",
            _TJA,
            "N",
            "reaction_force in the frame of the second body",
            since="1.1",
            take=lambda s: s.observed.joints[:, :, 4:6],
            vector="force_second",
            components=("force_second_x", "force_second_y"),
            is_shared=True,
        ),
        _units("joints/angle_row_units", "joint", "angle", _joint_units, "1.1", label="angle_units"),
        Recorded(
            "joints/angle",
            _TJ,
            MIXED,
            "angle of the second body relative to the first, not wrapped; of a slide, its travel",
            row_units="angle_row_units",
            since="1.1",
            take=lambda s: s.coordinate,
            charts=(
                Chart(
                    "joint-angles",
                    "Angles of the joints",
                    "Of the second body of each joint relative to the first.",
                    "angle",
                    "rad",
                ),
                Chart(
                    "travels",
                    "Travels of the slides",
                    "Of the second body of each joint relative to the first.",
                    "travel",
                    "m",
                ),
            ),
        ),
        Recorded(
            "joints/driver_power",
            _TJ,
            "W",
            "power that a driver supplies; 0 for other joints",
            since="1.1",
            take=lambda s: s.observed.joints[:, :, 1],
            is_shared=True,
            charts=(
                Chart(
                    "driver-power",
                    "Power of the drivers",
                    "Power that each driver supplies to the mechanism.",
                    "power",
                    "W",
                ),
            ),
        ),
    ),
    word="joints",
    one="joint",
    example="force",
    axis="joint",
    is_bare=True,
    is_chosen=True,
    unit_of=lambda mechanism, name: mechanism.joints[name].coordinate_unit,
)


def _length_unit(mechanism: Mechanism, name: str) -> str:
    force = mechanism.forces[name]
    return force.load.length_unit if hasattr(force, "load") else force.pathway.length_unit


def _force(name: str, column: int, units: str, what: str, row_units: str = "") -> Recorded:
    return Recorded(
        f"forces/{name}",
        ("time", "force"),
        units,
        what,
        row_units=row_units,
        since="1.1",
        take=lambda s: s.observed.forces[:, :, column],
    )


_FORCES = Kind(
    (
        _time("forces", "1.1"),
        _texts("forces/force", "force", "name of the force element", lambda names: names.forces),
        _texts(
            "forces/first_body",
            "force",
            "first body of the force element",
            lambda names: [first for first, _ in names.force_bodies],
            label="bodies",
        ),
        _texts(
            "forces/second_body",
            "force",
            "second body of the force element; of a load, the body it acts on",
            lambda names: [second for _, second in names.force_bodies],
            label="bodies",
        ),
        _units("forces/row_units", "force", "length", lambda names: names.force_units, "1.1"),
        _units("forces/rate_row_units", "force", "rate", lambda names: names.force_units, "1.1"),
        _units("forces/value_row_units", "force", "value", lambda names: names.force_units, "1.1", label="units"),
        _force("length", 0, MIXED, "length or angle of the force element; 0 for a force at a point", "row_units"),
        _force(
            "rate",
            1,
            MIXED,
            "rate of length; of a force at a point, the velocity of the point along the force",
            "rate_row_units",
        ),
        _force(
            "value",
            2,
            MIXED,
            "tension, positive where it pulls together; torque on the second body, positive counter-clockwise; "
            "magnitude of a force at a point",
            "value_row_units",
        ),
        _force("power", 3, "W", "power that the force element supplies to the bodies"),
        _force("potential", 4, "J", "potential energy of the force element; 0 for loads and laws without a potential"),
    ),
    word="forces",
    one="force element",
    example="value",
    axis="force",
    is_chosen=True,
    is_optional=True,
    unit_of=_length_unit,
)

_MARKERS = Kind(
    (
        _time("markers", "1.1"),
        _texts("markers/marker", "marker", "name of the marker", lambda names: names.markers),
        _axes("markers", "axis of the global frame", "1.1"),
        _texts("markers/body", "marker", "body of the marker", lambda names: names.marker_bodies, label="body"),
        Recorded(
            "markers/position",
            ("time", "marker", "axis"),
            "m",
            "position of the marker, global frame",
            since="1.1",
            take=lambda s: s.observed.markers[:, :, :2],
            vector="position",
            components=("x", "y"),
        ),
        Recorded(
            "markers/velocity",
            ("time", "marker", "axis"),
            "m/s",
            "velocity of the marker, global frame",
            since="1.1",
            take=lambda s: s.observed.markers[:, :, 2:],
            vector="velocity",
            components=("vx", "vy"),
        ),
    ),
    word="markers",
    one="marker",
    example="x",
    axis="marker",
    is_chosen=True,
    is_optional=True,
)


def _beam(name: str, column: int, units: str, what: str, *, of_whole: bool = False) -> Recorded:
    return Recorded(
        f"beams/{name}",
        ("time", "element"),
        units,
        what,
        since="1.1",
        take=lambda s: s.observed.beams[:, :, column],
        of_whole=of_whole,
    )


_BEAMS = Kind(
    (
        _time("beams", "1.1"),
        _texts("beams/element", "element", "name of the element of a beam: beam[number]", lambda names: names.elements),
        _texts("beams/beam", "element", "beam of the element", lambda names: names.element_beams),
        _beam("axial", 0, "N", "axial force in the middle of the element, positive in tension"),
        _beam("shear", 1, "N", "shear force in the middle of the element"),
        _beam("moment", 2, "N m", "bending moment in the middle of the element"),
        _beam("strain_energy", 3, "J", "strain energy of the element", of_whole=True),
    ),
    word="beams",
    one="beam",
    example="strain_energy",
    axis="element",
    owner="beam",
    is_chosen=True,
    is_optional=True,
)

_CONSTRAINTS = Kind(
    (
        _time("constraints"),
        _texts(
            "constraints/constraint",
            "constraint",
            "joint and row of the constraint: joint.row",
            lambda names: names.constraints,
            "1.0",
        ),
        _units(
            "constraints/row_units",
            "constraint",
            "position_residual",
            lambda names: names.constraint_units,
            label="units",
        ),
        _units(
            "constraints/velocity_row_units", "constraint", "velocity_residual", lambda names: names.constraint_units
        ),
        _units(
            "constraints/multiplier_row_units",
            "constraint",
            "multiplier and method_multiplier",
            lambda names: names.constraint_units,
        ),
        Recorded(
            "constraints/position_residual",
            _TM,
            MIXED,
            "constraint function Phi(q, t)",
            row_units="row_units",
            take=lambda s: s.by_row(s.observed.phi),
        ),
        Recorded(
            "constraints/velocity_residual",
            _TM,
            MIXED,
            "time derivative of the constraint function, Phi_q v + Phi_t",
            row_units="velocity_row_units",
            take=lambda s: s.by_row(s.observed.phi_rate),
        ),
        Recorded(
            "constraints/multiplier",
            _TM,
            MIXED,
            "Lagrange multiplier, index-1, at the recorded state",
            row_units="multiplier_row_units",
            take=lambda s: s.multiplier,
            is_shared=True,
        ),
        Recorded(
            "constraints/method_multiplier",
            _TM,
            MIXED,
            "Lagrange multiplier as the integrator carries it; index-1 at the start",
            row_units="multiplier_row_units",
            optional=True,
            take=lambda s: s.method_multiplier,
        ),
        Recorded(
            "constraints/singularity_distance",
            _T,
            "1",
            "smallest singular value of the independent constraints' Jacobian in the mass metric, the rows of each "
            "point orthonormal: 1 where no joint feels another, 0 in a singular position",
            optional=True,
            take=lambda s: s.observed.singularity_distance,
        ),
    ),
    word="constraints",
    one="constraint",
    axis="constraint",
    is_chosen=True,
)

_ENERGY = Kind(
    (
        _time("energy"),
        Recorded("energy/kinetic", _T, "J", "kinetic energy", take=lambda s: s.observed.kinetic, is_not_negative=True),
        Recorded(
            "energy/potential", _T, "J", "potential energy of gravity and springs", take=lambda s: s.observed.potential
        ),
        Recorded("energy/total", _T, "J", "kinetic + potential energy", take=lambda s: s.total_energy),
        Recorded(
            "energy/dissipated",
            _T,
            "J",
            "energy dissipated since the start",
            take=lambda s: s.dissipated,
            accumulates=True,
        ),
        Recorded(
            "energy/work",
            _T,
            "J",
            "work of applied loads and drivers since the start",
            take=lambda s: s.work,
            accumulates=True,
        ),
        Recorded(
            "energy/balance",
            _T,
            "J",
            "total + dissipated - work - total at the start: zero but for numerical error",
            take=lambda s: s.balance,
            accumulates=True,
        ),
    ),
    word="energy",
    example="total",
    is_chosen=True,
)

_STEPS = Kind(
    (
        Array("steps/interval", _N, "1", "number of the recorded interval, from 1: it ends at that row", INTEGER),
        Array("steps/time", _N, "s", "time at the end of the interval"),
        Array("steps/steps", _N, "1", "steps taken in the interval", INTEGER),
        Array("steps/size", _N, "s", "size of the last step of the interval"),
        Array("steps/iterations", _N, "1", "stage iterations in the interval, summed over its steps", INTEGER),
        Array("steps/iterations_max", _N, "1", "most stage iterations of a step of the interval", INTEGER),
        Array("steps/rejected", _N, "1", "steps rejected in the interval", INTEGER),
        Array(
            "steps/projections",
            _N,
            "1",
            "projections of positions and velocities onto the constraints in the interval",
            INTEGER,
            optional=True,
        ),
        Array(
            "steps/position_correction",
            _N,
            "m",
            "largest change of positions by a projection in the interval: sqrt(dq^T M dq / total mass)",
            optional=True,
        ),
        Array(
            "steps/velocity_correction",
            _N,
            "m/s",
            "largest change of velocities by a projection in the interval: sqrt(dv^T M dv / total mass)",
            optional=True,
        ),
        Array(
            "steps/acceleration_correction",
            _N,
            "m/s^2",
            "largest of Baumgarte's terms 2 alpha Phi' + beta^2 Phi at a step of the interval (rows of angles: "
            "rad/s^2)",
            optional=True,
        ),
    )
)


def _event(name: str, dims: tuple[str, ...], units: str, what: str, dtype: str = "<f8", **more: object) -> Array:
    return Array(f"events/{name}", dims, units, what, dtype, optional=True, **more)  # type: ignore[arg-type]


_EVENTS = Kind(
    (
        _event("event", _E, "1", "number of the crossing, from 1, in order of time", INTEGER),
        *_bodies("events", optional=True),
        _of_coordinates("events/row_units", "position", optional=True),
        _of_coordinates("events/velocity_row_units", "velocity", optional=True),
        _event("name", _E, "1", "name of the event, as in the spec", TEXT),
        _event("time", _E, "s", "time at which its expression crossed zero"),
        _event("direction", _E, "1", "1 where it crossed zero upwards, -1 downwards", INTEGER),
        _event(
            "position",
            _EBC,
            MIXED,
            "position and angle of the body then",
            row_units="row_units",
            components=_POSITION,
        ),
        _event(
            "velocity",
            _EBC,
            MIXED,
            "velocity and angular velocity then",
            row_units="velocity_row_units",
            components=_VELOCITY,
        ),
    ),
    word="events",
    one="event",
    example="time",
)


def _error(name: str, dims: tuple[str, ...], units: str, what: str, **more: object) -> Array:
    what = f"{what} so far, nan where unknown"
    return Array(f"accuracy/{name}", dims, units, what, optional=True, **more)  # type: ignore[arg-type]


_ACCURACY = Kind(
    (
        Array("accuracy/time", _T, "s", "time of the recorded row", optional=True),
        *_bodies("accuracy", optional=True),
        _of_coordinates("accuracy/row_units", "position_error", optional=True),
        _of_coordinates("accuracy/velocity_row_units", "velocity_error", optional=True),
        _joints("accuracy", optional=True),
        _error(
            "position_error",
            _TBC,
            MIXED,
            "estimated error of position and angle",
            row_units="row_units",
            components=tuple(f"{name}_error" for name in _POSITION),
        ),
        _error(
            "velocity_error",
            _TBC,
            MIXED,
            "estimated error of velocity and angular velocity",
            row_units="velocity_row_units",
            components=tuple(f"{name}_error" for name in _VELOCITY),
        ),
        _error(
            "reaction_error", _TJ, "N", "estimated norm of the error of reaction_force", components=("force_error",)
        ),
        _error("torque_error", _TJ, "N m", "estimated error of reaction_torque"),
    ),
    may_be_unknown=True,
)


def _measured(path: str, dims: tuple[str, ...], units: str, what: str, row_units: str = "") -> Array:
    return Array(path, dims, units, what, row_units=row_units, optional=True, since="1.1")


_MOTION = Kind(
    (
        _measured("motion/time", _T, "s", "time of the recorded row"),
        _texts("motion/observed", "", "name of the observed quantity", lambda names: names.observed, optional=True),
        _units(
            "motion/row_units",
            "observed",
            "raw, fitted and residual",
            lambda names: names.observed_units,
            "1.1",
            optional=True,
            label="units",
        ),
        _joints("motion", "1.1", optional=True),
        _measured("motion/raw", _TK, MIXED, "measured value, nan in a gap", "row_units"),
        _measured("motion/fitted", _TK, MIXED, "value of the fitted mechanism, before smoothing", "row_units"),
        _measured("motion/residual", _TK, MIXED, "raw - fitted", "row_units"),
        _measured(
            "motion/raw_misalignment",
            _TJ,
            "m",
            "misalignment of the joint if the data alone place the bodies, nan where they do not",
        ),
    ),
    word="motion",
    one="observed quantity",
    axis="observed",
    may_be_unknown=True,
)

_ACTUATORS = Kind(
    (
        _measured("actuators/time", _T, "s", "time of the recorded row"),
        _texts("actuators/actuator", "", "name of the actuator", lambda names: names.actuators, optional=True),
        _units(
            "actuators/row_units",
            "actuator",
            "value",
            lambda names: names.actuator_units,
            "1.1",
            optional=True,
            label="units",
        ),
        Recorded(
            "actuators/value",
            _TA,
            MIXED,
            "torque on the second body, positive counter-clockwise; force along a travel or a coordinate; tension "
            "between two points",
            row_units="row_units",
            optional=True,
            since="1.1",
            take=lambda s: s.actuators[:, :, 0],
        ),
        Recorded(
            "actuators/power",
            _TA,
            "W",
            "power that the actuator supplies to the bodies",
            optional=True,
            since="1.1",
            take=lambda s: s.actuators[:, :, 1],
        ),
        _measured(
            "actuators/value_error",
            _TA,
            MIXED,
            "bound of the error of value that holds with a probability of 95 % at each time, nan where unknown",
            "row_units",
        ),
    ),
    word="actuators",
    one="actuator",
    example="value",
    axis="actuator",
    is_optional=True,
    may_be_unknown=True,
)

_TL = ("time", "load")
_LOADS = Kind(
    (
        _measured("loads/time", _T, "s", "time of the recorded row"),
        _texts("loads/load", "", "name of the measured load", lambda names: names.loads, optional=True),
        _axes("loads", "axis of the global frame", "1.1", optional=True),
        _texts(
            "loads/body",
            "load",
            "body that the load acts on",
            lambda names: names.load_bodies,
            optional=True,
            label="body",
        ),
        _measured("loads/force", (*_TL, "axis"), "N", "force on the body, global frame"),
        _measured("loads/point", (*_TL, "axis"), "m", "point of application, global frame"),
        _measured("loads/torque", _TL, "N m", "free torque on the body, positive counter-clockwise"),
        _measured("loads/power", _TL, "W", "power that the load supplies to the body"),
    ),
    word="loads",
    one="load",
    axis="load",
    is_optional=True,
)

KINDS = (
    _TRAJECTORY,
    _JOINTS,
    _FORCES,
    _MARKERS,
    _BEAMS,
    _CONSTRAINTS,
    _ENERGY,
    _STEPS,
    _EVENTS,
    _ACCURACY,
    _MOTION,
    _ACTUATORS,
    _LOADS,
)
"""All kinds, in the order of the groups of the archive."""

BY_WORD: Mapping[str, Kind] = {kind.word: kind for kind in KINDS if kind.word}
BY_GROUP: Mapping[str, Kind] = {kind.group: kind for kind in KINDS}
RECORDED: Mapping[str, Recorded] = {
    array.key: array for kind in KINDS for array in kind.arrays if isinstance(array, Recorded)
}
"""Arrays with a value for each recorded state, by `Array.key`."""
