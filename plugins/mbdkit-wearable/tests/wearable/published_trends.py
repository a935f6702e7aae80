"""Misfits as in published experiments: ``python -m tests.wearable.published_trends`` prints largest forces of orthoses.

Each line is a motion, a device, the offset forward and upward [mm] and the factor of the stiffness of the tissue; the
force that the device adds to the knee, the shear of the cuffs of thigh and shank [N], and the help transmitted.
"""

from __future__ import annotations

from typing import Any

import mbdkit
from mbdkit_wearable.misfit.study import MOTIONS, base

CASES = [
    *(("hinge", 0.0, upward, 1.0) for upward in (-30, -20, -12, -10, 0, 10, 12, 20, 30)),
    *(("hinge", forward, 0.0, 1.0) for forward in (-20, -12, 12, 20)),
    *(("four-bar", forward, 0.0, 1.0) for forward in (-12, 0, 12)),
    *(("self-aligning", 0.0, upward, 1.0) for upward in (0, 20)),
    *(("hinge", 0.0, 20.0, tissue) for tissue in (1 / 3, 3.0)),
]


def measured(spec: dict[str, Any], forward: float, upward: float, tissue: float = 1.0) -> dict[str, float]:
    """Return the measures of a run with an offset [mm]."""
    numbers = {"forward": forward / 1e3, "upward": upward / 1e3, "turn": 0.0, "tissue": tissue}
    run = mbdkit.run(spec | {"parameters": numbers})
    return {name: float(run.measures[name]) for name in ("added", "shear_thigh", "shear_shank", "transmitted")}


if __name__ == "__main__":
    for name, make in MOTIONS.items():
        motion = make()
        for device, *numbers in CASES:
            values = measured(base(motion, device), *numbers)
            told = "  ".join(f"{key} {value:7.3g}" for key, value in values.items())
            print(f"{name:8} {device:14} {numbers[0]:5g} {numbers[1]:5g} {numbers[2]:5.2g}   {told}", flush=True)
