"""Histories of cuffs, with the columns of `mbdkit_wearable.quantities`."""

from __future__ import annotations

from mbdkit.plugin.archives import recorded_columns as columns


class CuffHistory(columns.Cuffs, of="cuffs"):
    """One cuff: displacement and rotation in the frame of the limb, and the forces of the device on the limb.

    The displacement (T, 2) [m] has a normal and a tangential component. The moment [N m] is about the device's point.
    """
