"""The table of quantities: what runs record, in the order of the archive.

The layout of archives, the histories of `Run`, tables for export, expressions of events and measures, their derivatives
and charts of reports follow from it. To add a quantity, add a line to its kind; values that the engine does not compute
yet are computed in `mbdkit.quantities.states`, or by `mbdkit.engine.kernels.observe`. `written_groups.json` has the
groups that are not computed from states, such as the statistics of steps. Plugins add groups of their own, see
`mbdkit.quantities.registered_kinds`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbdkit.base.text import listed
from mbdkit.quantities.array import INTEGER, MIXED, TEXT, Array, Chart, Kind
from mbdkit.quantities.entries import (
    AXIS,
    BODY,
    COORDINATE,
    JOINT,
    TIME,
    computed,
    coordinate_units,
    name_array,
    quantity_group,
    unit_array,
)

if TYPE_CHECKING:
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.quantities.states import States

_T, _S, _TBC = ("time",), ("set/number",), ("time", "body", "coordinate")
_TJ, _TJA, _TF, _TKA = ("time", "joint"), ("time", "joint", "axis"), ("time", "force"), ("time", "marker", "axis")
_TE, _TM = ("time", "element"), ("time", "constraint")

_POSITION = ("x", "y", "angle")
_VELOCITY = ("vx", "vy", "angular_velocity")
_ACCELERATION = ("ax", "ay", "angular_acceleration")
_MISALIGNMENT: Mapping[str, object] = {
    "is_not_negative": True,
    "is_of_steps": True,
    "no_derivative": "a misalignment is an error of the method, and almost zero",
}


_POWER = "Power that each driver supplies to the mechanism."
_RELATIVE = "Of the second body of each joint relative to the first."


def _states_of(states: States) -> int:
    return len(states.mechanism.named_states)


def _length_unit(mechanism: Mechanism, name: str) -> str:
    force = mechanism.forces[name]
    return force.load.length_unit if hasattr(force, "load") else force.pathway.length_unit


def _written_kinds() -> Iterator[Kind]:
    """Yield the kinds of the groups that are not computed from states."""
    for group in json.loads(Path(__file__).with_name("written_groups.json").read_bytes()):
        yield quantity_group(group.pop("group"), *map(_written_array, group.pop("arrays")), **group)


def _written_array(entry: str | dict[str, Any]) -> Array:
    if isinstance(entry, str):
        return {"body": BODY, "coordinate": COORDINATE, "joint": JOINT, "axis": AXIS}[entry]
    if "units_of" in entry:
        return coordinate_units(entry["path"], entry["units_of"])
    fields: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}
    return Array(**fields)


# fmt: off
#: The kinds of the core, in the order of the groups of the archive; those of plugins come after them.
KINDS = (
    quantity_group(
        "trajectory",
        TIME, BODY, COORDINATE, coordinate_units("row_units", "position"),
        coordinate_units("velocity_row_units", "velocity"), coordinate_units("acceleration_row_units", "acceleration"),
        computed("position", _TBC, MIXED, "position and angle of the body", lambda s: s.by_body(s.q),
            row_units="row_units", vector="position", components=_POSITION, is_history=True,
            about=("position of the centre of mass", "angle from the global x axis, never wrapped")),
        computed("velocity", _TBC, MIXED, "velocity and angular velocity", lambda s: s.by_body(s.v),
            row_units="velocity_row_units", vector="velocity", components=_VELOCITY, is_history=True,
            about=("velocity of the centre of mass", "angular velocity")),
        computed("acceleration", _TBC, MIXED, "acceleration and angular acceleration, index-1, at the recorded state",
            lambda s: s.by_body(s.observed.acc),
            row_units="acceleration_row_units", vector="acceleration", components=_ACCELERATION,
            about=("acceleration of the centre of mass", "angular acceleration")),
        computed("elapsed_s", _T, "s", "wall time since the first step", lambda s: s.elapsed),
        word="bodies", one="body", example="angle", axis="body", is_bare=True,
    ),
    quantity_group(
        "joints",
        TIME, JOINT,
        replace(AXIS, long_name="axis of the global frame, or of the frame of a body"),
        name_array("first_body", "joint", "first body of the joint, which exerts the reaction",
            lambda names: [first for first, _ in names.joint_bodies], label="bodies"),
        name_array("second_body", "joint", "second body of the joint, on which the reaction acts",
            lambda names: [second for _, second in names.joint_bodies], label="bodies"),
        computed("misalignment", _TJ, "m", "distance by which the joint fails to meet", lambda s: s.misalignment,
            **_MISALIGNMENT, is_history=True),
        computed("velocity_misalignment", _TJ, "m/s", "relative point velocity in the constrained directions",
            lambda s: s.sums.misalignment(s.observed.phi_rate), **_MISALIGNMENT),
        computed("angle_misalignment", _TJ, "rad", "angle by which the joint fails to meet",
            lambda s: s.sums.angle_misalignment(s.observed.phi), **_MISALIGNMENT),
        computed("reaction_force", _TJA, "N", "force of the first body on the second, global frame",
            lambda s: s.reactions[:, :, :2],
            vector="force", components=("force_x", "force_y"), has_norm=True, is_shared=True, is_history=True),
        computed("reaction_torque", _TJ, "N m", "torque of the first body on the second, at the second's joint point",
            lambda s: s.reactions[:, :, 2], components=("torque",), is_shared=True, is_history=True),
        computed("reaction_force_first", _TJA, "N", "reaction_force in the frame of the first body",
            lambda s: s.observed.joints[:, :, 2:4],
            vector="force_first", components=("force_first_x", "force_first_y"), is_shared=True),
        computed("reaction_force_second", _TJA, "N", "reaction_force in the frame of the second body",
            lambda s: s.observed.joints[:, :, 4:6],
            vector="force_second", components=("force_second_x", "force_second_y"), is_shared=True),
        unit_array("angle_row_units", "joint", "angle", lambda names: names.joint_units or ["rad"] * len(names.joints),
            label="angle_units"),
        computed("angle", _TJ, MIXED,
            "angle of the second body relative to the first, not wrapped; of a slide, its travel",
            lambda s: s.coordinate,
            row_units="angle_row_units",
            charts=(Chart("joint-angles", "Angles of the joints", _RELATIVE, "angle", "rad"),
                Chart("travels", "Travels of the slides", _RELATIVE, "travel", "m"))),
        computed("driver_power", _TJ, "W", "power that a driver supplies; 0 for other joints",
            lambda s: s.observed.joints[:, :, 1],
            is_shared=True,
            charts=(Chart("driver-power", "Power of the drivers", _POWER, "power", "W"),)),
        unit_array("value_row_units", "joint", "friction",
            lambda names: names.joint_units or ["rad"] * len(names.joints),
            optional=True),
        computed("friction", _TJ, MIXED,
            "friction torque on the second body, positive counter-clockwise; of a slide, friction force on the second "
            "body along the travel; 0 for joints without friction",
            lambda s: s.friction, row_units="value_row_units", optional=True,
            charts=(Chart("friction-torques", "Friction torques in joints", _RELATIVE, "torque", "N m"),
                Chart("friction-forces", "Friction forces in slides", _RELATIVE, "force", "N"))),
        word="joints", one="joint", example="force", axis="joint", is_bare=True,
        unit_of=lambda mechanism, name: mechanism.joints[name].coordinate_unit,
    ),
    quantity_group(
        "forces",
        TIME,
        name_array("force", "force", "name of the force element", lambda names: names.forces),
        name_array("first_body", "force", "first body of the force element",
            lambda names: [first for first, _ in names.force_bodies], label="bodies"),
        name_array("second_body", "force", "second body of the force element; of a load, the body it acts on",
            lambda names: [second for _, second in names.force_bodies], label="bodies"),
        unit_array("row_units", "force", "length", lambda names: names.force_units),
        unit_array("rate_row_units", "force", "rate", lambda names: names.force_units),
        unit_array("value_row_units", "force", "value", lambda names: names.force_units, label="units"),
        computed("length", _TF, MIXED, "length or angle of the force element; 0 for a force at a point",
            lambda s: s.forces[:, :, 0], row_units="row_units"),
        computed("rate", _TF, MIXED, "rate of length; of a force at a point, the velocity of the point along the force",
            lambda s: s.forces[:, :, 1], row_units="rate_row_units"),
        computed("value", _TF, MIXED,
            "tension, positive where it pulls together; torque on the second body, positive counter-clockwise; "
            "magnitude of a force at a point",
            lambda s: s.forces[:, :, 2], row_units="value_row_units"),
        computed("power", _TF, "W", "power that the force element supplies to the bodies",
            lambda s: s.forces[:, :, 3]),
        computed("potential", _TF, "J",
            "potential energy of the force element; 0 for loads and laws without a potential",
            lambda s: s.forces[:, :, 4]),
        word="forces", one="force element", example="value", axis="force", is_optional=True,
        unit_of=_length_unit,
    ),
    quantity_group(
        "markers",
        TIME,
        name_array("marker", "marker", "name of the marker", lambda names: names.markers),
        AXIS,
        name_array("body", "marker", "body of the marker", lambda names: names.marker_bodies, label="body"),
        computed("position", _TKA, "m", "position of the marker, global frame", lambda s: s.observed.markers[:, :, :2],
            vector="position", components=("x", "y")),
        computed("velocity", _TKA, "m/s", "velocity of the marker, global frame",
            lambda s: s.observed.markers[:, :, 2:],
            vector="velocity", components=("vx", "vy")),
        word="markers", one="marker", example="x", axis="marker", is_optional=True,
    ),
    quantity_group(
        "beams",
        TIME,
        name_array("element", "element", "name of the element of a beam: beam[number]", lambda names: names.elements),
        name_array("beam", "element", "beam of the element", lambda names: names.element_beams),
        computed("axial", _TE, "N", "axial force in the middle of the element, positive in tension",
            lambda s: s.observed.beams[:, :, 0]),
        computed("shear", _TE, "N", "shear force in the middle of the element", lambda s: s.observed.beams[:, :, 1]),
        computed("moment", _TE, "N m", "bending moment in the middle of the element",
            lambda s: s.observed.beams[:, :, 2]),
        computed("strain_energy", _TE, "J", "strain energy of the element", lambda s: s.observed.beams[:, :, 3],
            of_whole=True),
        word="beams", one="beam", example="strain_energy", axis="element", owner="beam", is_optional=True,
    ),
    quantity_group(
        "states",
        TIME,
        name_array("state", "state", "name of the first-order state of a force element: element.state",
            lambda n: n.states),
        name_array("row_units", "state", "units of value, row by row", lambda n: n.state_units, label="units"),
        name_array("rate_row_units", "state", "units of rate, row by row",
            lambda names: [f"{unit}/s" for unit in names.state_units]),
        computed("value", ("time", "state"), MIXED, "value of the state", lambda s: s.z[:, : _states_of(s)],
            row_units="row_units",
            charts=(Chart("states", "First-order states", "States of elements and of the mechanism.", "value", ""),)),
        computed("rate", ("time", "state"), MIXED, "derivative of the state by time",
            lambda s: s.observed.state_rates[:, : _states_of(s)], row_units="rate_row_units"),
        optional=True, word="states", one="state", example="value", axis="state", is_optional=True,
        unit_of=lambda mechanism, name: mechanism.state_unit(name),
    ),
    quantity_group(
        "inputs",
        TIME,
        name_array("input", "input", "name of the input", lambda names: names.inputs),
        name_array("row_units", "input", "units of value, row by row", lambda names: names.input_units, label="units"),
        computed("value", ("time", "input"), MIXED, "value of the input",
            lambda s: s.z[:, [item.state for item in s.mechanism.inputs]], row_units="row_units",
            charts=(Chart("inputs", "Inputs", "Set by a program or by tables.", "value", ""),)),
        # xarray would hide arrays with the names of coordinates of the group above
        Array("set/number", _S, "1", "number of the setting, from 1, in order of time", INTEGER),
        Array("set/instant", _S, "s", "time at which the input was set"),
        Array("set/name", _S, "1", "name of the input", TEXT),
        Array("set/row_units", _S, "1", "units of value, row by row", TEXT),
        Array("set/value", _S, MIXED, "value to which the input was set", row_units="set/row_units"),
        optional=True, word="inputs", one="input", example="value", axis="input", is_optional=True,
        unit_of=lambda mechanism, name: mechanism.inputs[name].unit,
    ),
    quantity_group(
        "constraints",
        TIME,
        name_array("constraint", "constraint", "joint and row of the constraint: joint.row",
            lambda names: names.constraints),
        unit_array("row_units", "constraint", "position_residual", lambda names: names.constraint_units, label="units"),
        unit_array("velocity_row_units", "constraint", "velocity_residual", lambda names: names.constraint_units),
        unit_array("multiplier_row_units", "constraint", "multiplier and method_multiplier",
            lambda names: names.constraint_units),
        computed("position_residual", _TM, MIXED, "constraint function Phi(q, t)",
            lambda s: s.sums.by_row(s.observed.phi), row_units="row_units"),
        computed("velocity_residual", _TM, MIXED, "time derivative of the constraint function, Phi_q v + Phi_t",
            lambda s: s.sums.by_row(s.observed.phi_rate), row_units="velocity_row_units"),
        computed("multiplier", _TM, MIXED, "Lagrange multiplier, index-1, at the recorded state",
            lambda s: s.multiplier,
            row_units="multiplier_row_units", is_shared=True),
        computed("method_multiplier", _TM, MIXED,
            "Lagrange multiplier as the integrator carries it; index-1 at the start",
            lambda s: s.multiplier if s.multipliers is None else s.multipliers, row_units="multiplier_row_units",
            optional=True),
        computed("singularity_distance", _T, "1",
            "smallest singular value of the independent constraints' Jacobian in the mass metric, the rows of each "
            "point orthonormal: 1 where no joint feels another, 0 in a singular position",
            lambda s: s.observed.singularity_distance, optional=True),
        word="constraints", one="constraint", axis="constraint",
    ),
    quantity_group(
        "energy",
        TIME,
        computed("kinetic", _T, "J", "kinetic energy", lambda s: s.observed.kinetic, is_not_negative=True),
        computed("potential", _T, "J", "potential energy of gravity and springs", lambda s: s.observed.potential),
        computed("total", _T, "J", "kinetic + potential energy", lambda s: s.total_energy),
        computed("dissipated", _T, "J", "energy dissipated since the start", lambda s: s.dissipated, accumulates=True),
        computed("work", _T, "J", "work of applied loads and drivers since the start",
            lambda s: s.work, accumulates=True),
        computed("balance", _T, "J", "total + dissipated - work - total at the start: zero but for numerical error",
            lambda s: s.balance, accumulates=True),
        word="energy", example="total",
    ),
    *_written_kinds(),
)
# fmt: on


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
        text = f" of a {kind.one}{', [i] being its element i, from 0' if any(by_element) else ''}" if kind.one else ""
        kinds.append(f"{owner}{listed(written, 'and')}{text}")
    return f"{'; '.join(kinds[:-1])}; and {kinds[-1]}"
