"""Group of the archive that cuffs add: displacements, forces and power."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.plugin import Array, Chart, Recorded, name_array, quantity_group
from mbdkit_wearable.cuff import DIRECTIONS

if TYPE_CHECKING:
    from mbdkit.plugin import States
    from mbdkit_wearable.acting_cuffs import ActingCuff


def cuffs_in(states: States) -> dict[str, np.ndarray]:
    """Return the quantities (T, C) of C cuffs in T states by name; ``length`` is (T, C, 3).

    If states are derivatives, all arrays have a last axis of parameters.
    """
    cuffs: tuple[ActingCuff, ...] = states.mechanism.extensions["cuffs"]
    values = states.observed.forces[:, np.array([cuff.forces for cuff in cuffs])]
    length, _, force, power, _ = np.moveaxis(values, 3, 0)
    # archives hold the tension of a force, but the torque on the second body, which is the device
    normal, shear, on_device = np.moveaxis(force, 2, 0)
    forces = {"normal_force": normal, "shear_force": shear, "moment": -on_device}
    return {"length": length, **forces, "power": power.sum(axis=2)}


def displacements(states: States) -> np.ndarray:
    """Return the displacements (T, C, 3) of C cuffs in T states."""
    cuffs: tuple[ActingCuff, ...] = states.mechanism.extensions["cuffs"]
    return np.asarray(states.of(cuffs_in)["length"] - np.array([cuff.zeros for cuff in cuffs]))


def _of_cuffs(name: str, units: str, what: str, **more: Any) -> Recorded:
    return Recorded(name, ("time", "cuff"), units, what, take=lambda s: s.of(cuffs_in)[name], **more)


# fmt: off
CUFFS = quantity_group(
    "cuffs",
    Array("time", ("time",), "s", "time of the recorded row"),
    name_array("cuff", "cuff", "name of the cuff", lambda names: names.names_of("cuffs")),
    name_array("limb", "cuff", "body of the limb", lambda names: names.bodies_of("cuffs", 0), label="bodies"),
    name_array("device", "cuff", "body of the device", lambda names: names.bodies_of("cuffs", 1), label="bodies"),
    name_array("coordinate", "coordinate", "x: along the axis of the cuff, y: tangential, theta: rotation",
        lambda names: ("x", "y", "theta")),
    name_array("row_units", "coordinate", "units of displacement, row by row", lambda names: ("m", "m", "rad")),
    Recorded("displacement", ("time", "cuff", "coordinate"), "mixed",
        "displacement of the device's point in the frame of the limb", take=displacements,
        row_units="row_units", components=DIRECTIONS, vector="displacement",
        no_derivative="the derivatives of displacements of cuffs are not known; those of their forces are",
        about=("displacement of the device's point in the frame of the limb", "rotation of the device in the limb")),
    _of_cuffs("normal_force", "N", "force of the device on the limb, along the axis of the cuff",
        charts=(Chart("cuff-forces", "Normal forces of the cuffs", "They act on the limbs, along their axes.",
            "force", "N"),)),
    _of_cuffs("shear_force", "N", "force of the device on the limb, along the axis turned by 90 degrees",
        charts=(Chart("cuff-shear", "Shear forces of the cuffs", "They act on the limbs, along the skin.", "force",
            "N"),)),
    _of_cuffs("moment", "N m", "moment of the device on the limb about the device's point, counter-clockwise"),
    _of_cuffs("power", "W", "power that the cuff supplies to both bodies"),
    optional=True, word="cuffs", one="cuff", example="normal_force", axis="cuff", is_optional=True,
)
# fmt: on
