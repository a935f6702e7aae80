"""Histories of cuffs, with the columns of `mbdkit_wearable.quantities`."""

from __future__ import annotations

from mbdkit.plugin.archives import recorded_columns as columns


class CuffHistory(columns.Cuffs, of="cuffs"):
    """Displacement of a cuff in the frame of the limb, (normal, tangential) [m] and rotation [rad], and the forces of
    the device on the limb: normal and shear force [N], moment about the device's point [N m].
    """
