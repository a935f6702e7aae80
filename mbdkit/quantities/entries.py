"""Functions that make entries of the table of quantities: for the core, and for groups that plugins add."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from mbdkit.quantities.array import COORDINATE_UNITS, TEXT, Array, Kind, Recorded
from mbdkit.quantities.names import AXES, COORDINATES, ArchiveNames

if TYPE_CHECKING:
    from mbdkit.quantities.states import States

#: Units of the rate and of the multiplier of a constraint row, by the unit of its constraint function.
RATE_UNITS = {"m": "m/s", "rad": "rad/s"}
MULTIPLIER_UNITS = {"m": "N", "rad": "N m"}

#: Units of quantities, by the name of the array of units, and by the unit of the length or angle of the element.
#:
#: In arrays of units that are not listed, each unit is that of the element itself.
UNITS_OF_ELEMENT: Mapping[str, Mapping[str, str]] = {
    "rate_row_units": RATE_UNITS,
    "velocity_row_units": RATE_UNITS,
    "value_row_units": MULTIPLIER_UNITS,
    "multiplier_row_units": MULTIPLIER_UNITS,
}

#: Groups of quantities that can be selected by `output.quantities`.
ChosenGroup = Literal["beams", "constraints", "energy", "forces", "joints", "markers"]


def quantity_group(group: str, *arrays: Array, optional: bool = False, **more: Any) -> Kind:
    """Return a kind of quantities, whose arrays are a group of the archive.

    `group`: name of the group, which is added to the paths of the arrays. `arrays`: the arrays, with their names in the
    group as paths. `optional`: applies to all arrays; see `Array`. `more`: further arguments of `Kind`.
    """
    placed = tuple(
        replace(array, path=f"{group}/{array.path}", optional=array.optional or optional) for array in arrays
    )
    return Kind(placed, is_chosen=group in get_args(ChosenGroup), **more)


def computed(
    name: str, dims: tuple[str, ...], units: str, what: str, take: Callable[[States], np.ndarray], **more: Any
) -> Recorded:
    """Return an array that is computed from states; see `Recorded` for the further arguments."""
    return Recorded(name, dims, units, what, take=take, **more)


def name_array(name: str, dim: str, what: str, texts: Callable[[ArchiveNames], Sequence[str]], **more: Any) -> Array:
    """Return an array of names or other texts along the axis `dim`."""
    return Array(name, (dim,), "1", what, TEXT, texts=texts, **more)


def unit_array(name: str, dim: str, of: str, units: Callable[[ArchiveNames], Sequence[str]], **more: object) -> Array:
    """Return an array of units that are determined by the units of the lengths or angles of elements."""
    derived = UNITS_OF_ELEMENT.get(name, {})
    what = f"units of {of}, row by row"
    return name_array(name, dim, what, lambda names: [derived.get(unit, unit) for unit in units(names)], **more)


def coordinate_units(name: str, of: str) -> Array:
    """Return an array of the units of x, y and angle of bodies, or of their rates."""
    return name_array(name, "coordinate", f"units of {of}, row by row", lambda names: COORDINATE_UNITS[name])


TIME = Recorded("time", ("time",), "s", "time of the recorded row", take=lambda s: s.time)
BODY = name_array("body", "body", "name of the body", lambda names: names.bodies)
_OF_BODY = "coordinate of a body: its centre of mass in the global frame, and its angle"
COORDINATE = name_array("coordinate", "coordinate", _OF_BODY, lambda names: COORDINATES)
JOINT = name_array("joint", "joint", "name of the joint", lambda names: names.joints)
AXIS = name_array("axis", "axis", "axis of the global frame", lambda names: AXES)
