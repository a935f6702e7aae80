"""Quantities of a run in expressions of measures: their units, and their values at the recorded times."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.units import Unit, read_unit
from mbdkit.events.event_expression import WordsOfKinds
from mbdkit.quantities.entries import UNITS_OF_ELEMENT
from mbdkit.quantities.quantity import Quantity
from mbdkit.spec.model_spec import ModelSpec

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

#: Functions that compute the quantities of an event from the times of its crossings.
_EVENTS: Mapping[str, tuple[str, Callable[[np.ndarray], float]]] = {
    "time": ("s", lambda times: float(times[0]) if len(times) else np.nan),
    "last_time": ("s", lambda times: float(times[-1]) if len(times) else np.nan),
    "count": ("1", lambda times: float(len(times))),
}

#: Names of the quantities of each kind of element.
ATTRIBUTES: Mapping[str, Sequence[str]] = WordsOfKinds(lambda kind: tuple(kind.attributes), {"events": tuple(_EVENTS)})


def unit_of(quantity: Quantity, spec: ModelSpec) -> Unit | None:
    """Return the SI unit of a quantity of the runs of a spec; None for a first-order state whose unit is not a known
    one.

    Raises SpecError if the quantity is the friction of a joint without friction.
    """
    if quantity.kind == "events":
        return read_unit(_EVENTS[quantity.attribute][0])
    recorded_array = quantity.recorded
    if recorded_array.units:
        return read_unit(recorded_array.units)
    if quantity.of.unit_of is None:
        return read_unit(spec.actuator_units[quantity.name])
    mechanism = spec.mechanism()
    is_friction = (quantity.kind, quantity.attribute) == ("joints", "friction")
    if is_friction and getattr(mechanism.joints[quantity.name], "friction", None) is None:
        raise SpecError(f"joint '{quantity.name}' has no friction")
    of_element = quantity.of.unit_of(mechanism, quantity.name)
    if quantity.kind == "states":
        try:
            return read_unit(of_element if quantity.attribute == "value" else f"{of_element}/s")
        except SpecError:
            return None
    return read_unit(UNITS_OF_ELEMENT.get(recorded_array.array.row_units, {}).get(of_element, of_element))


def of_event(quantity: Quantity, times: np.ndarray) -> float:
    """Return a quantity of an event from the times of its crossings [s]."""
    return _EVENTS[quantity.attribute][1](times)


def recorded(quantity: Quantity, run: Run) -> np.ndarray:
    """Return the values of a quantity in T recorded rows, (T,).

    The shape is (2, T) for a vector, (elements, T) along a beam, and (1,) for an event.

    Raises NotRecordedError if the run did not record the quantity.
    """
    if quantity.kind == "events":
        return np.array([of_event(quantity, np.asarray(run.events.of_name(quantity.name).time))])
    holder: Any = getattr(run, quantity.kind)
    index = holder[quantity.name].index if quantity.name else None
    return quantity.select(run.column(quantity.recorded.array.path, index, None)).T
