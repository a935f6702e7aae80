"""Quantities of a run in expressions of measures: their units, and their values in the recorded rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.archive.layout import MULTIPLIER_UNITS, RATE_UNITS
from mbdkit.base.units import Unit, read_unit
from mbdkit.events.event_expression import OF_ELEMENTS, Quantity
from mbdkit.mechanism.forces import PointForce, Torque
from mbdkit.spec.model_spec import ModelSpec

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


@dataclass(frozen=True)
class _Recorded:
    """A column of a run: the attribute of its history, its component (None: scalars, or all of a vector), and its unit.

    An empty unit depends on the element; see `_unit_of_element`.
    """

    column: str
    unit: str
    component: int | None = None
    is_vector: bool = False


def _vector(prefix: str, column: str, unit: str, x: str, y: str) -> dict[str, _Recorded]:
    """Return a vector and its two components."""
    return {
        prefix: _Recorded(column, unit, is_vector=True),
        x: _Recorded(column, unit, 0),
        y: _Recorded(column, unit, 1),
    }


_COLUMNS: Mapping[str, Mapping[str, _Recorded]] = {
    "bodies": {
        **_vector("position", "position", "m", "x", "y"),
        "angle": _Recorded("angle", "rad"),
        **_vector("velocity", "velocity", "m/s", "vx", "vy"),
        "angular_velocity": _Recorded("angular_velocity", "rad/s"),
        **_vector("acceleration", "acceleration", "m/s^2", "ax", "ay"),
        "angular_acceleration": _Recorded("angular_acceleration", "rad/s^2"),
    },
    "joints": {
        **_vector("force", "reaction_force", "N", "force_x", "force_y"),
        **_vector("force_first", "reaction_force_first", "N", "force_first_x", "force_first_y"),
        **_vector("force_second", "reaction_force_second", "N", "force_second_x", "force_second_y"),
        "torque": _Recorded("reaction_torque", "N m"),
        "angle": _Recorded("angle", ""),
        "driver_power": _Recorded("driver_power", "W"),
        "misalignment": _Recorded("misalignment", "m"),
        "velocity_misalignment": _Recorded("velocity_misalignment", "m/s"),
        "angle_misalignment": _Recorded("angle_misalignment", "rad"),
    },
    "forces": {
        "length": _Recorded("length", ""),
        "rate": _Recorded("rate", ""),
        "value": _Recorded("value", ""),
        "power": _Recorded("power", "W"),
        "potential": _Recorded("potential", "J"),
    },
    "markers": {
        **_vector("position", "position", "m", "x", "y"),
        **_vector("velocity", "velocity", "m/s", "vx", "vy"),
    },
    "beams": {
        "axial": _Recorded("axial", "N"),
        "shear": _Recorded("shear", "N"),
        "moment": _Recorded("moment", "N m"),
        "strain_energy": _Recorded("strain_energy", "J"),
    },
    "actuators": {"value": _Recorded("value", ""), "power": _Recorded("power", "W")},
    "energy": {
        name: _Recorded(name, "J") for name in ("kinetic", "potential", "total", "dissipated", "work", "balance")
    },
}

_EVENTS: Mapping[str, tuple[str, Callable[[np.ndarray], float]]] = {
    "time": ("s", lambda times: float(times[0]) if len(times) else np.nan),
    "last_time": ("s", lambda times: float(times[-1]) if len(times) else np.nan),
    "count": ("1", lambda times: float(len(times))),
}
"""Quantities of an event, from the times of its crossings."""

ATTRIBUTES: Mapping[str, Sequence[str]] = {
    **{kind: tuple(columns) for kind, columns in _COLUMNS.items()},
    "events": tuple(_EVENTS),
}
"""Names of the quantities of each kind of element."""


def is_over_time(quantity: Quantity) -> bool:
    """Return whether a quantity has a value in each recorded row; those of events have a single one."""
    return quantity.kind != "events"


def is_vector(quantity: Quantity) -> bool:
    """Return whether a quantity has an x and a y component."""
    return is_over_time(quantity) and _COLUMNS[quantity.kind][quantity.attribute].is_vector


def beam_along(quantity: Quantity) -> str:
    """Return the name of the beam along which a quantity has a value in each element; empty for other quantities."""
    is_along = quantity.kind == "beams" and quantity.attribute in OF_ELEMENTS and quantity.element is None
    return quantity.name if is_along else ""


def component_of(quantity: Quantity) -> tuple[str, int | None, bool]:
    """Return the column of a quantity in its history, its component or element, and whether it has all of these.

    Not of events.
    """
    found = _COLUMNS[quantity.kind][quantity.attribute]
    if quantity.kind == "beams":
        return found.column, quantity.element, bool(beam_along(quantity))
    return found.column, found.component, found.is_vector


def unit_of(quantity: Quantity, spec: ModelSpec) -> Unit:
    """Return the SI unit of a quantity of the runs of a spec."""
    if quantity.kind == "events":
        return read_unit(_EVENTS[quantity.attribute][0])
    text = _COLUMNS[quantity.kind][quantity.attribute].unit
    return read_unit(text or _unit_of_element(quantity, spec))


def _unit_of_element(quantity: Quantity, spec: ModelSpec) -> str:
    if quantity.kind == "actuators":
        return spec.actuator_units[quantity.name]
    mechanism = spec.mechanism()
    if quantity.kind == "joints":
        return mechanism.joints[quantity.name].coordinate_unit
    force = mechanism.forces[quantity.name]
    length = force.load.length_unit if isinstance(force, Torque | PointForce) else force.pathway.length_unit
    return {"length": length, "rate": RATE_UNITS[length], "value": MULTIPLIER_UNITS[length]}[quantity.attribute]


def recorded(quantity: Quantity, run: Run) -> np.ndarray:
    """Return the values of a quantity in T recorded rows, (T,).

    Those of a vector are (2, T), those along a beam (elements, T), and that of an event is (1,).

    Raises
    ------
    NotRecordedError
        If the run did not record it.
    """
    if quantity.kind == "events":
        times = np.asarray(run.events.of_name(quantity.name).time)
        return np.array([_EVENTS[quantity.attribute][1](times)])
    column, component, has_components = component_of(quantity)
    holder: Any = getattr(run, quantity.kind)
    values = np.asarray(getattr(holder[quantity.name] if quantity.name else holder, column))
    if has_components:
        return values.T
    return values if component is None else values[:, component]
