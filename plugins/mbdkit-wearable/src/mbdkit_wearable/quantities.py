"""Group of the archive that cuffs add: displacements, forces and power."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.plugin import Chart, Recorded, name_array, quantity_group
from mbdkit.plugin.archives import TIME, computed
from mbdkit_wearable.cuff import DIRECTIONS

if TYPE_CHECKING:
    from mbdkit.plugin import States


def cuffs_in(states: States) -> dict[str, np.ndarray]:
    """Return the quantities (T, C) of C cuffs in T states by name; ``displacement`` is (T, C, 3)."""
    cuffs = states.mechanism.extensions["cuffs"]
    zero = np.array([cuff.zeros for cuff in cuffs])
    values = states.observed.forces[:, np.array([cuff.forces for cuff in cuffs])]  # (T, C, 3, length ... potential)
    force = values[..., 2]
    return {
        "displacement": values[..., 0] - zero,
        "normal_force": force[..., 0],
        "shear_force": force[..., 1],
        "moment": force[..., 2],
        "power": values[..., 3].sum(axis=2),
    }


def _of_cuffs(name: str, units: str, what: str, **more: object) -> Recorded:
    dims = ("time", "cuff", "coordinate") if "components" in more else ("time", "cuff")
    return computed(name, dims, units, what, lambda s: s.of(cuffs_in)[name], **more)


# fmt: off
CUFFS = quantity_group(
    "cuffs",
    TIME,
    name_array("cuff", "cuff", "name of the cuff", lambda names: names.names_of("cuffs")),
    name_array("limb", "cuff", "body of the limb", lambda names: names.bodies_of("cuffs", 0), label="bodies"),
    name_array("device", "cuff", "body of the device", lambda names: names.bodies_of("cuffs", 1), label="bodies"),
    name_array("coordinate", "coordinate", "component of displacements", lambda names: DIRECTIONS),
    name_array("row_units", "coordinate", "units of displacement, row by row", lambda names: ("m", "m", "rad")),
    _of_cuffs("displacement", "mixed", "displacement of the device's point in the frame of the limb",
        row_units="row_units", components=DIRECTIONS,
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
