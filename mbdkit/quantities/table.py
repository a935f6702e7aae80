"""The table of quantities: what runs record, in the order of the archive.

The layout of archives, the histories of `Run`, tables for export, expressions of events and measures, their derivatives
and charts of reports follow from it. To add a quantity, add a line to its kind; values that the engine does not compute
yet are computed in `mbdkit.quantities.states`, or by `mbdkit.engine.kernels.observe`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from mbdkit.base.text import listed
from mbdkit.quantities.array import COORDINATE_UNITS, INTEGER, MIXED, TEXT, Array, Chart, Kind, Recorded
from mbdkit.quantities.names import AXES, COORDINATES

if TYPE_CHECKING:
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.quantities.names import ArchiveNames
    from mbdkit.quantities.states import States

#: Units of the rate and of the multiplier of a constraint row, by the unit of its constraint function.
RATE_UNITS = {"m": "m/s", "rad": "rad/s"}
MULTIPLIER_UNITS = {"m": "N", "rad": "N m"}

UNITS_OF_ELEMENT: Mapping[str, Mapping[str, str]] = {
    "rate_row_units": RATE_UNITS,
    "velocity_row_units": RATE_UNITS,
    "value_row_units": MULTIPLIER_UNITS,
    "multiplier_row_units": MULTIPLIER_UNITS,
}
"""Units of quantities, by the name of the array of units, and by the unit of the length or angle of the element.

In arrays of units that are not listed, each unit is that of the element itself.
"""

_T, _N, _E, _I = ("time",), ("interval",), ("event",), ("impact",)
_TBC, _EBC = ("time", "body", "coordinate"), ("event", "body", "coordinate")
_TJ, _TJA, _TF, _TKA = ("time", "joint"), ("time", "joint", "axis"), ("time", "force"), ("time", "marker", "axis")
_TE, _TM, _TK, _TA = ("time", "element"), ("time", "constraint"), ("time", "observed"), ("time", "actuator")
_TU, _TL, _TLA = ("time", "muscle"), ("time", "load"), ("time", "load", "axis")

_POSITION = ("x", "y", "angle")
_VELOCITY = ("vx", "vy", "angular_velocity")
_ACCELERATION = ("ax", "ay", "angular_acceleration")
_CONTACTS = {"no_derivative": "the derivatives of quantities of contacts with respect to parameters are not known"}
_MISALIGNMENT: Mapping[str, Any] = {
    "is_not_negative": True,
    "is_of_steps": True,
    "no_derivative": "a misalignment is an error of the method, and almost zero",
}

ChosenGroup = Literal["beams", "constraints", "energy", "forces", "joints", "markers"]
"""Groups of quantities that can be selected by `output.quantities`."""


def _of_muscles(name: str, units: str, what: str, **more: Any) -> Recorded:
    return _taken(name, _TU, units, what, lambda s: s.of_muscles(name), **more)


def _of_contacts(name: str, units: str, what: str, **more: Any) -> Recorded:
    return _taken(name, ("time", "contact"), units, what, lambda s: s.of_contacts(name), **_CONTACTS, **more)


def _of_ground(name: str, units: str, what: str, **more: Any) -> Recorded:
    dims = ("time", "foot", "axis") if "components" in more else ("time", "foot")
    return _taken(name, dims, units, what, lambda s: s.of_contacts(name, of_ground=True), **_CONTACTS, **more)


def _kind(group: str, *arrays: Array, since: str = "1.0", optional: bool = False, **more: Any) -> Kind:
    """Return a kind with the group in the paths of its arrays; `since` and `optional` apply to all of them."""
    placed = (
        replace(array, path=f"{group}/{array.path}", since=max(array.since, since), optional=array.optional or optional)
        for array in arrays
    )
    return Kind(tuple(placed), is_chosen=group in get_args(ChosenGroup), **more)


def _taken(
    name: str, dims: tuple[str, ...], units: str, what: str, take: Callable[[States], np.ndarray], **more: Any
) -> Recorded:
    """Return an array that is computed from states; see `Recorded` for the further arguments."""
    return Recorded(name, dims, units, what, take=take, **more)


def _texts(name: str, dim: str, what: str, texts: Callable[[ArchiveNames], Sequence[str]], **more: Any) -> Array:
    return Array(name, (dim,), "1", what, TEXT, texts=texts, **more)


def _units(name: str, dim: str, of: str, units: Callable[[ArchiveNames], Sequence[str]], **more: Any) -> Array:
    """Return an array of units that are determined by the units of the lengths or angles of elements."""
    derived = UNITS_OF_ELEMENT.get(name, {})
    what = f"units of {of}, row by row"
    return _texts(name, dim, what, lambda names: [derived.get(unit, unit) for unit in units(names)], **more)


def _of_coordinates(name: str, of: str) -> Array:
    return _texts(name, "coordinate", f"units of {of}, row by row", lambda names: COORDINATE_UNITS[name])


_POWER = "Power that each driver supplies to the mechanism."
_RELATIVE = "Of the second body of each joint relative to the first."
_TIME = Recorded("time", _T, "s", "time of the recorded row", take=lambda s: s.time)
_BODY = _texts("body", "body", "name of the body", lambda names: names.bodies)
_OF_BODY = "coordinate of a body: its centre of mass in the global frame, and its angle"
_COORDINATE = _texts("coordinate", "coordinate", _OF_BODY, lambda names: COORDINATES)
_JOINT = _texts("joint", "joint", "name of the joint", lambda names: names.joints)
_AXIS = _texts("axis", "axis", "axis of the global frame", lambda names: AXES)


def _length_unit(mechanism: Mechanism, name: str) -> str:
    force = mechanism.forces[name]
    return force.load.length_unit if hasattr(force, "load") else force.pathway.length_unit


# fmt: off
KINDS = (
    _kind(
        "trajectory",
        _TIME, _BODY, _COORDINATE, _of_coordinates("row_units", "position"),
        _of_coordinates("velocity_row_units", "velocity"), _of_coordinates("acceleration_row_units", "acceleration"),
        _taken("position", _TBC, MIXED, "position and angle of the body", lambda s: s.by_body(s.q),
            row_units="row_units", vector="position", components=_POSITION, is_history=True,
            about=("position of the centre of mass", "angle from the global x axis, never wrapped")),
        _taken("velocity", _TBC, MIXED, "velocity and angular velocity", lambda s: s.by_body(s.v),
            row_units="velocity_row_units", vector="velocity", components=_VELOCITY, is_history=True,
            about=("velocity of the centre of mass", "angular velocity")),
        _taken("acceleration", _TBC, MIXED, "acceleration and angular acceleration, index-1, at the recorded state",
            lambda s: s.by_body(s.observed.acc),
            row_units="acceleration_row_units", vector="acceleration", components=_ACCELERATION,
            about=("acceleration of the centre of mass", "angular acceleration")),
        _taken("elapsed_s", _T, "s", "wall time since the first step", lambda s: s.elapsed),
        word="bodies", one="body", example="angle", axis="body", is_bare=True,
    ),
    _kind(
        "joints",
        _TIME, _JOINT,
        replace(_AXIS, long_name="axis of the global frame, or of the frame of a body"),
        _texts("first_body", "joint", "first body of the joint, which exerts the reaction",
            lambda names: [first for first, _ in names.joint_bodies], label="bodies"),
        _texts("second_body", "joint", "second body of the joint, on which the reaction acts",
            lambda names: [second for _, second in names.joint_bodies], label="bodies"),
        _taken("misalignment", _TJ, "m", "distance by which the joint fails to meet", lambda s: s.misalignment,
            **_MISALIGNMENT, is_history=True),
        _taken("velocity_misalignment", _TJ, "m/s", "relative point velocity in the constrained directions",
            lambda s: s.sums.misalignment(s.observed.phi_rate), **_MISALIGNMENT),
        _taken("angle_misalignment", _TJ, "rad", "angle by which the joint fails to meet",
            lambda s: s.sums.angle_misalignment(s.observed.phi), **_MISALIGNMENT),
        _taken("reaction_force", _TJA, "N", "force of the first body on the second, global frame",
            lambda s: s.reactions[:, :, :2],
            vector="force", components=("force_x", "force_y"), has_norm=True, is_shared=True, is_history=True),
        _taken("reaction_torque", _TJ, "N m", "torque of the first body on the second, at the second's joint point",
            lambda s: s.reactions[:, :, 2], components=("torque",), is_shared=True, is_history=True),
        _taken("reaction_force_first", _TJA, "N", "reaction_force in the frame of the first body",
            lambda s: s.observed.joints[:, :, 2:4],
            since="1.1", vector="force_first", components=("force_first_x", "force_first_y"), is_shared=True),
        _taken("reaction_force_second", _TJA, "N", "reaction_force in the frame of the second body",
            lambda s: s.observed.joints[:, :, 4:6],
            since="1.1", vector="force_second", components=("force_second_x", "force_second_y"), is_shared=True),
        _units("angle_row_units", "joint", "angle", lambda names: names.joint_units or ["rad"] * len(names.joints),
            since="1.1", label="angle_units"),
        _taken("angle", _TJ, MIXED,
            "angle of the second body relative to the first, not wrapped; of a slide, its travel",
            lambda s: s.coordinate,
            since="1.1", row_units="angle_row_units",
            charts=(Chart("joint-angles", "Angles of the joints", _RELATIVE, "angle", "rad"),
                Chart("travels", "Travels of the slides", _RELATIVE, "travel", "m"))),
        _taken("driver_power", _TJ, "W", "power that a driver supplies; 0 for other joints",
            lambda s: s.observed.joints[:, :, 1],
            since="1.1", is_shared=True,
            charts=(Chart("driver-power", "Power of the drivers", _POWER, "power", "W"),)),
        _units("value_row_units", "joint", "friction", lambda names: names.joint_units or ["rad"] * len(names.joints),
            since="1.1", optional=True),
        _taken("friction", _TJ, MIXED,
            "friction torque on the second body, positive counter-clockwise; of a slide, friction force on the second "
            "body along the travel; 0 for joints without friction",
            lambda s: s.friction, row_units="value_row_units", since="1.1", optional=True,
            charts=(Chart("friction-torques", "Friction torques in joints", _RELATIVE, "torque", "N m"),
                Chart("friction-forces", "Friction forces in slides", _RELATIVE, "force", "N"))),
        word="joints", one="joint", example="force", axis="joint", is_bare=True,
        unit_of=lambda mechanism, name: mechanism.joints[name].coordinate_unit,
    ),
    _kind(
        "forces",
        _TIME,
        _texts("force", "force", "name of the force element", lambda names: names.forces),
        _texts("first_body", "force", "first body of the force element",
            lambda names: [first for first, _ in names.force_bodies], label="bodies"),
        _texts("second_body", "force", "second body of the force element; of a load, the body it acts on",
            lambda names: [second for _, second in names.force_bodies], label="bodies"),
        _units("row_units", "force", "length", lambda names: names.force_units),
        _units("rate_row_units", "force", "rate", lambda names: names.force_units),
        _units("value_row_units", "force", "value", lambda names: names.force_units, label="units"),
        _taken("length", _TF, MIXED, "length or angle of the force element; 0 for a force at a point",
            lambda s: s.forces[:, :, 0], row_units="row_units"),
        _taken("rate", _TF, MIXED, "rate of length; of a force at a point, the velocity of the point along the force",
            lambda s: s.forces[:, :, 1], row_units="rate_row_units"),
        _taken("value", _TF, MIXED,
            "tension, positive where it pulls together; torque on the second body, positive counter-clockwise; "
            "magnitude of a force at a point",
            lambda s: s.forces[:, :, 2], row_units="value_row_units"),
        _taken("power", _TF, "W", "power that the force element supplies to the bodies",
            lambda s: s.forces[:, :, 3]),
        _taken("potential", _TF, "J", "potential energy of the force element; 0 for loads and laws without a potential",
            lambda s: s.forces[:, :, 4]),
        since="1.1", word="forces", one="force element", example="value", axis="force", is_optional=True,
        unit_of=_length_unit,
    ),
    _kind(
        "markers",
        _TIME,
        _texts("marker", "marker", "name of the marker", lambda names: names.markers),
        _AXIS,
        _texts("body", "marker", "body of the marker", lambda names: names.marker_bodies, label="body"),
        _taken("position", _TKA, "m", "position of the marker, global frame", lambda s: s.observed.markers[:, :, :2],
            vector="position", components=("x", "y")),
        _taken("velocity", _TKA, "m/s", "velocity of the marker, global frame", lambda s: s.observed.markers[:, :, 2:],
            vector="velocity", components=("vx", "vy")),
        since="1.1", word="markers", one="marker", example="x", axis="marker", is_optional=True,
    ),
    _kind(
        "beams",
        _TIME,
        _texts("element", "element", "name of the element of a beam: beam[number]", lambda names: names.elements),
        _texts("beam", "element", "beam of the element", lambda names: names.element_beams),
        _taken("axial", _TE, "N", "axial force in the middle of the element, positive in tension",
            lambda s: s.observed.beams[:, :, 0]),
        _taken("shear", _TE, "N", "shear force in the middle of the element", lambda s: s.observed.beams[:, :, 1]),
        _taken("moment", _TE, "N m", "bending moment in the middle of the element",
            lambda s: s.observed.beams[:, :, 2]),
        _taken("strain_energy", _TE, "J", "strain energy of the element", lambda s: s.observed.beams[:, :, 3],
            of_whole=True),
        since="1.1", word="beams", one="beam", example="strain_energy", axis="element", owner="beam", is_optional=True,
    ),
    _kind(
        "states",
        _TIME,
        _texts("state", "state", "name of the first-order state of a force element: element.state", lambda n: n.states),
        _texts("row_units", "state", "units of value, row by row", lambda n: n.state_units, label="units"),
        _texts("rate_row_units", "state", "units of rate, row by row",
            lambda names: [f"{unit}/s" for unit in names.state_units]),
        _taken("value", ("time", "state"), MIXED, "value of the state", lambda s: s.z, row_units="row_units"),
        _taken("rate", ("time", "state"), MIXED, "derivative of the state by time", lambda s: s.observed.state_rates,
            row_units="rate_row_units"),
        since="1.1", optional=True, word="states", one="state", example="value", axis="state", is_optional=True,
        unit_of=lambda mechanism, name: mechanism.states[name].unit if name in mechanism.states else "1",
    ),
    _kind(
        "contacts",
        _TIME,
        _texts("contact", "contact", "name of the contact; of polygons and polylines, with a number",
            lambda names: names.names_of("contacts")),
        _texts("first_body", "contact", "first body of the contact, from which the normal points",
            lambda names: names.bodies_of("contacts", 0), label="bodies"),
        _texts("second_body", "contact", "second body of the contact",
            lambda names: names.bodies_of("contacts", 1), label="bodies"),
        _of_contacts("gap", "m", "distance of the two shapes, negative where they overlap"),
        _of_contacts("normal_force", "N", "force that pushes the bodies apart",
            charts=(Chart("contact-forces", "Normal forces of the contacts", "They push the bodies apart.", "force",
                "N"),)),
        _of_contacts("friction_force", "N",
            "friction force on the second body, along the normal turned by -90 degrees"),
        _of_contacts("slip", "m/s", "velocity of the second body relative to the first, in that direction"),
        _of_contacts("mode", "1", "0: open, 1: sticks, 2: slips"),
        since="1.1", optional=True, word="contacts", one="contact", example="normal_force", axis="contact",
        is_optional=True,
    ),
    _kind(
        "ground_reactions",
        _TIME,
        _texts("foot", "foot", "name of the body that may touch the ground", lambda names: names.feet),
        _AXIS,
        _of_ground("force", "N", "force of all contacts with the ground on the body, global frame",
            vector="force", components=("force_x", "force_y"), has_norm=True),
        _of_ground("normal_force", "N", "sum of the normal forces of these contacts", is_not_negative=True,
            charts=(Chart("ground-reactions", "Ground reactions", "Normal force of the ground on each body.", "force",
                "N"),)),
        _of_ground("center_of_pressure", "m",
            "point about which the contacts with the ground have no moment, global frame; nan where none is closed",
            vector="center_of_pressure", components=("center_of_pressure_x", "center_of_pressure_y")),
        since="1.1", optional=True, word="ground_reactions", one="ground reaction", example="force_y",
        axis="foot", is_optional=True, may_be_unknown=True,
    ),
    _kind(
        "constraints",
        _TIME,
        _texts("constraint", "constraint", "joint and row of the constraint: joint.row",
            lambda names: names.constraints),
        _units("row_units", "constraint", "position_residual", lambda names: names.constraint_units, label="units"),
        _units("velocity_row_units", "constraint", "velocity_residual", lambda names: names.constraint_units),
        _units("multiplier_row_units", "constraint", "multiplier and method_multiplier",
            lambda names: names.constraint_units),
        _taken("position_residual", _TM, MIXED, "constraint function Phi(q, t)",
            lambda s: s.sums.by_row(s.observed.phi), row_units="row_units"),
        _taken("velocity_residual", _TM, MIXED, "time derivative of the constraint function, Phi_q v + Phi_t",
            lambda s: s.sums.by_row(s.observed.phi_rate), row_units="velocity_row_units"),
        _taken("multiplier", _TM, MIXED, "Lagrange multiplier, index-1, at the recorded state", lambda s: s.multiplier,
            row_units="multiplier_row_units", is_shared=True),
        _taken("method_multiplier", _TM, MIXED,
            "Lagrange multiplier as the integrator carries it; index-1 at the start",
            lambda s: s.multiplier if s.multipliers is None else s.multipliers, row_units="multiplier_row_units",
            optional=True),
        _taken("singularity_distance", _T, "1",
            "smallest singular value of the independent constraints' Jacobian in the mass metric, the rows of each "
            "point orthonormal: 1 where no joint feels another, 0 in a singular position",
            lambda s: s.observed.singularity_distance, optional=True),
        word="constraints", one="constraint", axis="constraint",
    ),
    _kind(
        "energy",
        _TIME,
        _taken("kinetic", _T, "J", "kinetic energy", lambda s: s.observed.kinetic, is_not_negative=True),
        _taken("potential", _T, "J", "potential energy of gravity and springs", lambda s: s.observed.potential),
        _taken("total", _T, "J", "kinetic + potential energy", lambda s: s.total_energy),
        _taken("dissipated", _T, "J", "energy dissipated since the start", lambda s: s.dissipated, accumulates=True),
        _taken("work", _T, "J", "work of applied loads and drivers since the start",
            lambda s: s.work, accumulates=True),
        _taken("balance", _T, "J", "total + dissipated - work - total at the start: zero but for numerical error",
            lambda s: s.balance, accumulates=True),
        word="energy", example="total",
    ),
    _kind(
        "steps",
        Array("interval", _N, "1", "number of the recorded interval, from 1: it ends at that row", INTEGER),
        Array("time", _N, "s", "time at the end of the interval"),
        Array("steps", _N, "1", "steps taken in the interval", INTEGER),
        Array("size", _N, "s", "size of the last step of the interval"),
        Array("iterations", _N, "1", "stage iterations in the interval, summed over its steps", INTEGER),
        Array("iterations_max", _N, "1", "most stage iterations of a step of the interval", INTEGER),
        Array("rejected", _N, "1", "steps rejected in the interval", INTEGER),
        Array("projections", _N, "1", "projections of positions and velocities onto the constraints in the interval",
            INTEGER, optional=True),
        Array("position_correction", _N, "m",
            "largest change of positions by a projection in the interval: sqrt(dq^T M dq / total mass)", optional=True),
        Array("velocity_correction", _N, "m/s",
            "largest change of velocities by a projection in the interval: sqrt(dv^T M dv / total mass)",
            optional=True),
        Array("acceleration_correction", _N, "m/s^2",
            "largest of Baumgarte's terms 2 alpha Phi' + beta^2 Phi at a step of the interval (rows of angles: "
            "rad/s^2)",
            optional=True),
    ),
    _kind(
        "events",
        Array("event", _E, "1", "number of the crossing, from 1, in order of time", INTEGER),
        _BODY, _COORDINATE, _of_coordinates("row_units", "position"), _of_coordinates("velocity_row_units", "velocity"),
        Array("name", _E, "1", "name of the event, as in the spec", TEXT),
        Array("time", _E, "s", "time at which its expression crossed zero"),
        Array("direction", _E, "1", "1 where it crossed zero upwards, -1 downwards", INTEGER),
        Array("position", _EBC, MIXED, "position and angle of the body then", row_units="row_units",
            components=_POSITION),
        Array("velocity", _EBC, MIXED, "velocity and angular velocity then", row_units="velocity_row_units",
            components=_VELOCITY),
        optional=True, word="events", one="event", example="time",
    ),
    _kind(
        "impacts",
        Array("impact", _I, "1", "number of the impact, from 1, in order of time", INTEGER),
        Array("time", _I, "s", "time of the impact, or of the end of a geometric sequence of impacts that is left out"),
        Array("contact", _I, "1", "name of the contact, or of the driver whose velocity jumps", TEXT),
        Array("normal_impulse", _I, "N s",
            "impulse that pushes the bodies apart; 0 at the end of a sequence and for drivers"),
        Array("tangential_impulse", _I, "N s",
            "impulse of friction on the second body, along the normal turned by -90 degrees"),
        Array("energy_lost", _I, "J",
            "energy that all contacts dissipate at this time, or that drivers take; negative if drivers add it"),
        _JOINT, _AXIS,
        Array("reaction_impulse", ("impact", "joint", "axis"), "N s",
            "impulse of the first body of the joint on the second in all impacts at this time, global frame"),
        Array("reaction_torque_impulse", ("impact", "joint"), "N m s",
            "impulse of the torque of the first body on the second, at the second's joint point"),
        optional=True, word="impacts", one="impact", example="time", since="1.1",
    ),
    _kind(
        "accuracy",
        Array("time", _T, "s", "time of the recorded row"),
        _BODY, _COORDINATE, _of_coordinates("row_units", "position_error"),
        _of_coordinates("velocity_row_units", "velocity_error"), _JOINT,
        Array("position_error", _TBC, MIXED, "estimated error of position and angle so far, nan where unknown",
            row_units="row_units", components=tuple(f"{name}_error" for name in _POSITION)),
        Array("velocity_error", _TBC, MIXED,
            "estimated error of velocity and angular velocity so far, nan where unknown",
            row_units="velocity_row_units", components=tuple(f"{name}_error" for name in _VELOCITY)),
        Array("reaction_error", _TJ, "N", "estimated norm of the error of reaction_force so far, nan where unknown",
            components=("force_error",)),
        Array("torque_error", _TJ, "N m", "estimated error of reaction_torque so far, nan where unknown"),
        optional=True, may_be_unknown=True,
    ),
    _kind(
        "motion",
        Array("time", _T, "s", "time of the recorded row"),
        _texts("observed", "observed", "name of the observed quantity", lambda names: names.observed),
        _units("row_units", "observed", "raw, fitted and residual", lambda names: names.observed_units, label="units"),
        _JOINT,
        Array("raw", _TK, MIXED, "measured value, nan in a gap", row_units="row_units"),
        Array("fitted", _TK, MIXED, "value of the fitted mechanism, before smoothing", row_units="row_units"),
        Array("residual", _TK, MIXED, "raw - fitted", row_units="row_units"),
        Array("raw_misalignment", _TJ, "m",
            "misalignment of the joint if the data alone place the bodies, nan where they do not"),
        since="1.1", optional=True, word="motion", one="observed quantity", axis="observed", may_be_unknown=True,
    ),
    _kind(
        "actuators",
        Array("time", _T, "s", "time of the recorded row"),
        _texts("actuator", "actuator", "name of the actuator", lambda names: names.actuators),
        _units("row_units", "actuator", "value", lambda names: names.actuator_units, label="units"),
        _texts("kind", "actuator", "actuator, reserve of recruitment, or residual load from outside",
            lambda names: names.actuator_kinds, label="kind"),
        _taken("value", _TA, MIXED,
            "torque on the second body, positive counter-clockwise; force along a travel or a coordinate; tension "
            "between two points",
            lambda s: s.actuators[:, :, 0], row_units="row_units"),
        _taken("power", _TA, "W", "power that the actuator supplies to the bodies", lambda s: s.actuators[:, :, 1]),
        Array("value_error", _TA, MIXED,
            "bound of the error of value that holds with a probability of 95 % at each time, nan where unknown",
            row_units="row_units"),
        since="1.1", optional=True, word="actuators", one="actuator", example="value", axis="actuator",
        is_optional=True, may_be_unknown=True,
    ),
    _kind(
        "muscles",
        Array("time", _T, "s", "time of the recorded row"),
        _texts("muscle", "muscle", "name of the muscle", lambda names: names.muscles),
        _JOINT, _AXIS,
        _of_muscles("length", "m", "length of the path"),
        _of_muscles("rate", "m/s", "rate of length"),
        _of_muscles("fiber_length", "m", "length of the fibres; nan where recruitment does not need it"),
        _of_muscles("fiber_rate", "m/s", "rate of fiber_length"),
        _of_muscles("activation", "1", "activation, from 0 to 1",
            charts=(Chart("activations", "Activations of the muscles", "Active force over capacity.", "activation",
                "1"),)),
        _of_muscles("excitation", "1", "excitation, from 0 to 1; runs only"),
        _of_muscles("force", "N", "tension",
            charts=(Chart("tensions", "Tensions of the muscles", "Along the tendons.", "tension", "N"),)),
        _of_muscles("power", "W", "power that the muscle supplies to the bodies"),
        _of_muscles("fiber_power", "W", "power that the fibres supply; nan where fiber_length is"),
        _of_muscles("metabolic_power", "W", "power that the muscle consumes; nan without `metabolics`"),
        Array("force_error", _TU, "N",
            "bound of the error of force that holds with a probability of 95 % at each time, nan where unknown"),
        Array("certificate", _T, "1",
            "largest violation of the conditions of optimality by recruitment, relative to the size of each"),
        Array("reaction_force_without", _TJA, "N", "reaction_force if actuators produced the motion without muscles"),
        since="1.1", optional=True, word="muscles", one="muscle", example="force", axis="muscle", is_optional=True,
        may_be_unknown=True,
    ),
    _kind(
        "loads",
        Array("time", _T, "s", "time of the recorded row"),
        _texts("load", "load", "name of the measured load", lambda names: names.loads),
        _AXIS,
        _texts("body", "load", "body that the load acts on", lambda names: names.load_bodies, label="body"),
        Array("force", _TLA, "N", "force on the body, global frame"),
        Array("point", _TLA, "m", "point of application, global frame"),
        Array("torque", _TL, "N m", "free torque on the body, positive counter-clockwise"),
        Array("power", _TL, "W", "power that the load supplies to the body"),
        since="1.1", optional=True, word="loads", one="load", axis="load", is_optional=True,
    ),
)
# fmt: on
"""All kinds, in the order of the groups of the archive."""

BY_WORD: Mapping[str, Kind] = {kind.word: kind for kind in KINDS if kind.word}
BY_GROUP: Mapping[str, Kind] = {kind.group: kind for kind in KINDS}
RECORDED: Mapping[str, Recorded] = {
    array.key: array for kind in KINDS for array in kind.arrays if isinstance(array, Recorded)
}
"""Arrays with a value for each recorded state, by `Array.key`."""

_NAMES_ALONG = {
    array.name: array.texts for kind in KINDS for array in kind.arrays if array.is_scale and array.texts is not None
}
"""Functions that return the names along the axes that do not grow, by name of the axis."""


def sizes_of(names: ArchiveNames) -> dict[str, int]:
    """Return the lengths of the axes that do not grow, by name."""
    return {name: len(texts(names)) for name, texts in _NAMES_ALONG.items()}


def quantities_of_events() -> str:
    """Return the quantities that expressions of events may contain, as a list in words."""
    kinds = []
    for kind in KINDS:
        names = [name for name, attribute in kind.attributes.items() if attribute.in_events]
        if not names or not (kind.is_bare or kind.is_chosen):
            continue
        owner = f"{kind.word}.NAME" if kind.one and not kind.is_bare else "NAME" if kind.one else kind.word
        by_element = [bool(kind.owner) and not kind.attributes[name].array.of_whole for name in names]
        written = [f".{name}{'[i]' if indexed else ''}" for name, indexed in zip(names, by_element, strict=True)]
        of = f" of a {kind.one}{', [i] being its element i, from 0' if any(by_element) else ''}" if kind.one else ""
        kinds.append(f"{owner}{listed(written, 'and')}{of}")
    return f"{'; '.join(kinds[:-1])}; and {kinds[-1]}"
