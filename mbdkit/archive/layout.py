"""Layout of a run archive: the single definition used by the writer, the checker and `schemas/archive.md`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

FORMAT = "mbdkit-run"
FORMAT_VERSION = "1.1"
VERSIONS = ("1.0", FORMAT_VERSION)
"""Versions of the format whose arrays the layout lists."""

#: Attribute of the group ``trajectory`` while the run is under way: the rows of the tables up to the last flush.
ROWS_FLUSHED = "rows_flushed"

#: Axes that grow during a run, in the order of `ROWS_FLUSHED`: recorded rows, intervals between them, and events.
GROWING = ("time", "interval", "event")

STATUSES = ("running", "complete", "failed", "interrupted")
REASONS = (
    "max-steps",
    "wall-time",
    "newton-failed",
    "singular",
    "step-too-small",
    "not-finite",
    "fell-apart",
    "energy-jump",
    "branch-left",
    "event",
    "plugin-error",
)
QUANTITIES = frozenset({"joints", "constraints", "energy", "forces", "markers", "beams"})

ROOT_ATTRIBUTES = (
    "format",
    "format_version",
    "status",
    "status_reason",
    "run_id",
    "created_utc",
    "spec",
    "spec_sha256",
    "data_sha256",
)
MEASURES = "measures"
"""Root attribute with the values and units of the measures of a run, in JSON; absent without measures."""
INTEGRALS = "integrals"
"""Root attribute with the time integrals that measures of the run need, by their integrands, in JSON and SI units."""
GRADIENTS = "gradients"
"""Root attribute with the derivatives of the measures by parameters, in JSON; absent without `gradients`."""
VERDICT_ATTRIBUTES = ("verdict", "verdict_reasons", "warnings")
"""Root attributes that say how far a run can be trusted; archives of earlier versions lack them."""

ATTRIBUTES_HASH = "attributes_sha256"
"""Root attribute with the hash of all that `data_sha256` leaves out; archives of earlier versions lack it."""

COUNTERS = (
    "steps",
    "accepted",
    "rejected",
    "rhs_evaluations",
    "jacobian_evaluations",
    "factorizations",
    "newton_iterations",
    "projections",
)
TIMINGS = ("setup_s", "wall_s", "finish_s", "cpu_s")

FLOAT = "<f8"
INTEGER = "<i8"
TEXT = "utf-8"

MIXED = "mixed"
COORDINATES = ("x", "y", "theta")
AXES = ("x", "y")

#: Units of the rate and of the multiplier of a constraint row, by the unit of its constraint function.
RATE_UNITS = {"m": "m/s", "rad": "rad/s"}
MULTIPLIER_UNITS = {"m": "N", "rad": "N m"}


@dataclass(frozen=True)
class Array:
    """One array of the archive.

    Parameters
    ----------
    path
        ``group/name`` in the file.
    dims
        Dimension scales of the axes: names of arrays in the same group.
    units
        SI units; ``mixed`` if they vary along an axis, ``1`` for names and counts.
    long_name
        Description, stored as the attribute ``long_name``.
    dtype
        ``<f8``, ``<i8`` or ``utf-8`` (variable-length strings).
    row_units
        If `units` is ``mixed``, the array in the same group that holds the units of each row.
    optional
        Whether an archive may lack the array.
    since
        Version of the format that introduced the array.
    """

    path: str
    dims: tuple[str, ...]
    units: str
    long_name: str
    dtype: str = FLOAT
    row_units: str = ""
    optional: bool = False
    since: str = "1.0"

    @cached_property
    def group(self) -> str:
        """Name of the array's group."""
        return self.path.partition("/")[0]

    @cached_property
    def name(self) -> str:
        """Name of the array within its group."""
        return self.path.partition("/")[2]

    @cached_property
    def is_scale(self) -> bool:
        """Whether the array is a dimension scale."""
        return self.dims == (self.name,)

    @cached_property
    def grows(self) -> bool:
        """Whether rows are appended during the run."""
        return self.dims[0] in GROWING

    @cached_property
    def key(self) -> str:
        """Key of the rows to append: the path of the array, or ``time`` for the times of all groups."""
        return "time" if self.dims == ("time",) and self.is_scale else self.path


#: Arrays with the attribute `not_unique`, which lists the joints with non-unique reactions in a redundant mechanism.
SHARED = (
    "joints/reaction_force",
    "joints/reaction_torque",
    "joints/reaction_force_first",
    "joints/reaction_force_second",
    "joints/driver_power",
    "constraints/multiplier",
)


def _time(group: str) -> Array:
    return Array(f"{group}/time", ("time",), "s", "time of the recorded row")


def _names(path: str, what: str) -> Array:
    return Array(path, (path.partition("/")[2],), "1", what, TEXT)


def _row_units(path: str, dim: str, what: str) -> Array:
    return Array(path, (dim,), "1", f"units of {what}, row by row", TEXT)


def _forces(name: str, units: str, what: str, row_units: str = "") -> Array:
    return Array(f"forces/{name}", ("time", "force"), units, what, row_units=row_units, since="1.1")


def _beams(name: str, units: str, what: str) -> Array:
    return Array(f"beams/{name}", ("time", "element"), units, what, since="1.1")


def _texts(path: str, dim: str, what: str) -> Array:
    return Array(path, (dim,), "1", what, TEXT, since="1.1")


def _events(name: str, dims: tuple[str, ...], units: str, what: str, dtype: str = FLOAT, row_units: str = "") -> Array:
    return Array(f"events/{name}", dims, units, what, dtype, row_units, optional=True)


def _accuracy(name: str, dims: tuple[str, ...], units: str, what: str, row_units: str = "") -> Array:
    return Array(f"accuracy/{name}", dims, units, what, row_units=row_units, optional=True)


def _accuracy_names(name: str, what: str, dim: str = "") -> Array:
    return Array(f"accuracy/{name}", (dim or name,), "1", what, TEXT, optional=True)


def _measured(path: str, dims: tuple[str, ...], units: str, what: str, row_units: str = "") -> Array:
    return Array(path, dims, units, what, row_units=row_units, optional=True, since="1.1")


def _measured_names(path: str, what: str, dim: str = "") -> Array:
    return Array(path, (dim or path.partition("/")[2],), "1", what, TEXT, optional=True, since="1.1")


_TBC = ("time", "body", "coordinate")
_TJ = ("time", "joint")
_TM = ("time", "constraint")
_TK = ("time", "observed")
_T = ("time",)
_N = ("interval",)
_E = ("event",)
_EBC = ("event", "body", "coordinate")

LAYOUT: tuple[Array, ...] = (
    _time("trajectory"),
    _names("trajectory/body", "name of the body"),
    _names("trajectory/coordinate", "coordinate of a body: its centre of mass in the global frame, and its angle"),
    _row_units("trajectory/row_units", "coordinate", "position"),
    _row_units("trajectory/velocity_row_units", "coordinate", "velocity"),
    _row_units("trajectory/acceleration_row_units", "coordinate", "acceleration"),
    Array("trajectory/position", _TBC, MIXED, "position and angle of the body", row_units="row_units"),
    Array("trajectory/velocity", _TBC, MIXED, "velocity and angular velocity", row_units="velocity_row_units"),
    Array(
        "trajectory/acceleration",
        _TBC,
        MIXED,
        "acceleration and angular acceleration, index-1, at the recorded state",
        row_units="acceleration_row_units",
    ),
    Array("trajectory/elapsed_s", _T, "s", "wall time since the first step"),
    _time("joints"),
    _names("joints/joint", "name of the joint"),
    _names("joints/axis", "axis of the global frame, or of the frame of a body"),
    Array("joints/first_body", ("joint",), "1", "first body of the joint, which exerts the reaction", TEXT),
    Array("joints/second_body", ("joint",), "1", "second body of the joint, on which the reaction acts", TEXT),
    Array("joints/misalignment", _TJ, "m", "distance by which the joint fails to meet"),
    Array("joints/velocity_misalignment", _TJ, "m/s", "relative point velocity in the constrained directions"),
    Array("joints/angle_misalignment", _TJ, "rad", "angle by which the joint fails to meet"),
    Array(
        "joints/reaction_force",
        ("time", "joint", "axis"),
        "N",
        "force of the first body on the second, global frame",
    ),
    Array("joints/reaction_torque", _TJ, "N m", "torque of the first body on the second, at the second's joint point"),
    Array(
        "joints/reaction_force_first",
        ("time", "joint", "axis"),
        "N",
        "reaction_force in the frame of the first body",
        since="1.1",
    ),
    Array(
        "joints/reaction_force_second",
        ("time", "joint", "axis"),
        "N",
        "reaction_force in the frame of the second body",
        since="1.1",
    ),
    _texts("joints/angle_row_units", "joint", "units of angle, row by row"),
    Array(
        "joints/angle",
        _TJ,
        MIXED,
        "angle of the second body relative to the first, not wrapped; of a slide, its travel",
        row_units="angle_row_units",
        since="1.1",
    ),
    Array("joints/driver_power", _TJ, "W", "power that a driver supplies; 0 for other joints", since="1.1"),
    Array("forces/time", _T, "s", "time of the recorded row", since="1.1"),
    _texts("forces/force", "force", "name of the force element"),
    _texts("forces/first_body", "force", "first body of the force element"),
    _texts("forces/second_body", "force", "second body of the force element; of a load, the body it acts on"),
    _texts("forces/row_units", "force", "units of length, row by row"),
    _texts("forces/rate_row_units", "force", "units of rate, row by row"),
    _texts("forces/value_row_units", "force", "units of value, row by row"),
    _forces("length", MIXED, "length or angle of the force element; 0 for a force at a point", "row_units"),
    _forces(
        "rate",
        MIXED,
        "rate of length; of a force at a point, the velocity of the point along the force",
        "rate_row_units",
    ),
    _forces(
        "value",
        MIXED,
        "tension, positive where it pulls together; torque on the second body, positive counter-clockwise; magnitude "
        "of a force at a point",
        "value_row_units",
    ),
    _forces("power", "W", "power that the force element supplies to the bodies"),
    _forces("potential", "J", "potential energy of the force element; 0 for loads and laws without a potential"),
    Array("markers/time", _T, "s", "time of the recorded row", since="1.1"),
    _texts("markers/marker", "marker", "name of the marker"),
    Array("markers/axis", ("axis",), "1", "axis of the global frame", TEXT, since="1.1"),
    _texts("markers/body", "marker", "body of the marker"),
    Array("markers/position", ("time", "marker", "axis"), "m", "position of the marker, global frame", since="1.1"),
    Array("markers/velocity", ("time", "marker", "axis"), "m/s", "velocity of the marker, global frame", since="1.1"),
    Array("beams/time", _T, "s", "time of the recorded row", since="1.1"),
    _texts("beams/element", "element", "name of the element of a beam: beam[number]"),
    _texts("beams/beam", "element", "beam of the element"),
    _beams("axial", "N", "axial force in the middle of the element, positive in tension"),
    _beams("shear", "N", "shear force in the middle of the element"),
    _beams("moment", "N m", "bending moment in the middle of the element"),
    _beams("strain_energy", "J", "strain energy of the element"),
    _time("constraints"),
    _names("constraints/constraint", "joint and row of the constraint: joint.row"),
    _row_units("constraints/row_units", "constraint", "position_residual"),
    _row_units("constraints/velocity_row_units", "constraint", "velocity_residual"),
    _row_units("constraints/multiplier_row_units", "constraint", "multiplier and method_multiplier"),
    Array("constraints/position_residual", _TM, MIXED, "constraint function Phi(q, t)", row_units="row_units"),
    Array(
        "constraints/velocity_residual",
        _TM,
        MIXED,
        "time derivative of the constraint function, Phi_q v + Phi_t",
        row_units="velocity_row_units",
    ),
    Array(
        "constraints/multiplier",
        _TM,
        MIXED,
        "Lagrange multiplier, index-1, at the recorded state",
        row_units="multiplier_row_units",
    ),
    Array(
        "constraints/method_multiplier",
        _TM,
        MIXED,
        "Lagrange multiplier as the integrator carries it; index-1 at the start",
        row_units="multiplier_row_units",
        optional=True,
    ),
    Array(
        "constraints/singularity_distance",
        _T,
        "1",
        "smallest singular value of the independent constraints' Jacobian in the mass metric, the rows of each point "
        "orthonormal: 1 where no joint feels another, 0 in a singular position",
        optional=True,
    ),
    _time("energy"),
    Array("energy/kinetic", _T, "J", "kinetic energy"),
    Array("energy/potential", _T, "J", "potential energy of gravity and springs"),
    Array("energy/total", _T, "J", "kinetic + potential energy"),
    Array("energy/dissipated", _T, "J", "energy dissipated since the start"),
    Array("energy/work", _T, "J", "work of applied loads and drivers since the start"),
    Array("energy/balance", _T, "J", "total + dissipated - work - total at the start: zero but for numerical error"),
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
        "largest of Baumgarte's terms 2 alpha Phi' + beta^2 Phi at a step of the interval (rows of angles: rad/s^2)",
        optional=True,
    ),
    _events("event", _E, "1", "number of the crossing, from 1, in order of time", INTEGER),
    _events("body", ("body",), "1", "name of the body", TEXT),
    _events(
        "coordinate",
        ("coordinate",),
        "1",
        "coordinate of a body: its centre of mass in the global frame, and its angle",
        TEXT,
    ),
    _events("row_units", ("coordinate",), "1", "units of position, row by row", TEXT),
    _events("velocity_row_units", ("coordinate",), "1", "units of velocity, row by row", TEXT),
    _events("name", _E, "1", "name of the event, as in the spec", TEXT),
    _events("time", _E, "s", "time at which its expression crossed zero"),
    _events("direction", _E, "1", "1 where it crossed zero upwards, -1 downwards", INTEGER),
    _events("position", _EBC, MIXED, "position and angle of the body then", row_units="row_units"),
    _events("velocity", _EBC, MIXED, "velocity and angular velocity then", row_units="velocity_row_units"),
    _accuracy("time", _T, "s", "time of the recorded row"),
    _accuracy_names("body", "name of the body"),
    _accuracy_names("coordinate", "coordinate of a body: its centre of mass in the global frame, and its angle"),
    _accuracy_names("row_units", "units of position_error, row by row", "coordinate"),
    _accuracy_names("velocity_row_units", "units of velocity_error, row by row", "coordinate"),
    _accuracy_names("joint", "name of the joint"),
    _accuracy(
        "position_error",
        _TBC,
        MIXED,
        "estimated error of position and angle so far, nan where unknown",
        "row_units",
    ),
    _accuracy(
        "velocity_error",
        _TBC,
        MIXED,
        "estimated error of velocity and angular velocity so far, nan where unknown",
        "velocity_row_units",
    ),
    _accuracy("reaction_error", _TJ, "N", "estimated norm of the error of reaction_force so far, nan where unknown"),
    _accuracy("torque_error", _TJ, "N m", "estimated error of reaction_torque so far, nan where unknown"),
    _measured("motion/time", _T, "s", "time of the recorded row"),
    _measured_names("motion/observed", "name of the observed quantity"),
    _measured_names("motion/row_units", "units of raw, fitted and residual, row by row", "observed"),
    _measured_names("motion/joint", "name of the joint"),
    _measured("motion/raw", _TK, MIXED, "measured value, nan in a gap", "row_units"),
    _measured("motion/fitted", _TK, MIXED, "value of the fitted mechanism, before smoothing", "row_units"),
    _measured("motion/residual", _TK, MIXED, "raw - fitted", "row_units"),
    _measured(
        "motion/raw_misalignment",
        _TJ,
        "m",
        "misalignment of the joint if the data alone place the bodies, nan where they do not",
    ),
    _measured("actuators/time", _T, "s", "time of the recorded row"),
    _measured_names("actuators/actuator", "name of the actuator"),
    _measured_names("actuators/row_units", "units of value, row by row", "actuator"),
    _measured(
        "actuators/value",
        ("time", "actuator"),
        MIXED,
        "torque on the second body, positive counter-clockwise; force along a travel or a coordinate; tension between "
        "two points",
        "row_units",
    ),
    _measured("actuators/power", ("time", "actuator"), "W", "power that the actuator supplies to the bodies"),
    _measured(
        "actuators/value_error",
        ("time", "actuator"),
        MIXED,
        "bound of the error of value that holds with a probability of 95 % at each time, nan where unknown",
        "row_units",
    ),
    _measured("loads/time", _T, "s", "time of the recorded row"),
    _measured_names("loads/load", "name of the measured load"),
    _measured_names("loads/axis", "axis of the global frame"),
    _measured_names("loads/body", "body that the load acts on", "load"),
    _measured("loads/force", ("time", "load", "axis"), "N", "force on the body, global frame"),
    _measured("loads/point", ("time", "load", "axis"), "m", "point of application, global frame"),
    _measured("loads/torque", ("time", "load"), "N m", "free torque on the body, positive counter-clockwise"),
    _measured("loads/power", ("time", "load"), "W", "power that the load supplies to the body"),
)

#: Groups whose numbers may be nan: unknown errors, and gaps in measured data.
MAY_BE_UNKNOWN = ("accuracy", "motion", "actuators")

#: Groups of inverse dynamics; those without elements are absent.
INVERSE_GROUPS = ("motion", "actuators", "loads")

#: Paths of the arrays of events; all of them are present if the spec has events.
EVENTS = tuple(array.path for array in LAYOUT if array.group == "events")

#: Paths of the arrays of estimated errors; all of them are present after a check of accuracy.
ACCURACY = tuple(array.path for array in LAYOUT if array.group == "accuracy")

#: Values of the arrays of `ACCURACY` along the axis ``coordinate``.
AXIS_NAMES: Mapping[str, tuple[str, ...]] = {
    "coordinate": COORDINATES,
    "row_units": ("m", "m", "rad"),
    "velocity_row_units": ("m/s", "m/s", "rad/s"),
}

#: Paths of the arrays of corrections, by the kind of stabilization.
CORRECTIONS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "baumgarte": ("steps/acceleration_correction",),
    "projection": ("steps/projections", "steps/position_correction", "steps/velocity_correction"),
}

#: Paths of arrays in the groups of `QUANTITIES` that are present even if their group is not recorded.
ALWAYS = frozenset(("joints/joint", "joints/first_body", "joints/second_body"))

BY_PATH: Mapping[str, Array] = {array.path: array for array in LAYOUT}
GROUPS = (
    "trajectory",
    "joints",
    "forces",
    "markers",
    "beams",
    "constraints",
    "energy",
    "steps",
    "events",
    "accuracy",
    *INVERSE_GROUPS,
)

#: Groups that exist only if the mechanism has such elements.
ELEMENTS = frozenset({"forces", "markers", "beams", "actuators", "loads"})


def is_timing(path: str) -> bool:
    """Whether the array at `path` holds wall time (name ending in ``_s``), which the hashes exclude."""
    return path.endswith("_s")


def is_hashed(path: str) -> bool:
    """Whether the array at `path` is part of the data: no wall time, no estimated error, no property of a file."""
    is_of_file = path.endswith(("/file_sha256", "/file_state"))
    return not is_timing(path) and not path.lstrip("/").startswith("accuracy/") and not is_of_file


def is_in(array: Array, version: str) -> bool:
    """Whether archives of a `version` 1.x have the array; all of them in versions later than `FORMAT_VERSION`."""
    return _minor(array.since) <= _minor(version)


def later(paths: Iterable[str], version: str) -> frozenset[str]:
    """Return those of the `paths` of arrays that archives of a `version` 1.x do not have."""
    return frozenset(path for path in paths if path in BY_PATH and not is_in(BY_PATH[path], version))


def _minor(version: str) -> float:
    text = version.partition(".")[2]
    return int(text) if text.isdecimal() else math.inf


@lru_cache(maxsize=64)
def recorded(
    quantities: frozenset[str], extra: frozenset[str] = frozenset(), version: str = FORMAT_VERSION
) -> tuple[Array, ...]:
    """Return the arrays of an archive that records `quantities`.

    Parameters
    ----------
    quantities
        Subset of `QUANTITIES`; trajectory, steps and the names of the joints are always recorded.
    extra
        Paths of the optional arrays to include.
    version
        Version of the format.
    """
    return tuple(
        array
        for array in LAYOUT
        if (array.group not in QUANTITIES or array.group in quantities or array.path in ALWAYS)
        and (not array.optional or array.path in extra)
        and is_in(array, version)
    )
