"""Warnings about limits of angles in radians that are probably meant in degrees."""

from __future__ import annotations

import re
from collections.abc import Iterator

from mbdkit.base.plain_data import path_text
from mbdkit.runs.angles_in_degrees import looks_like_degrees
from mbdkit_design.design_spec import DesignSpec
from mbdkit_design.gains import measure_units

#: What expressions contain that convert radians to degrees, or whose angles are multiples of pi.
_CONVERSION = re.compile(r"\bpi\b|\b180\b|\b57\.[23]|\b0?\.0174")


def limits_in_degrees(spec: DesignSpec) -> Iterator[str]:
    """Yield a warning for each limit without a unit of an angle that is above one turn, and probably in degrees."""
    angles = {name for (_, name), unit in measure_units(spec).items() if unit == "rad"}
    for name, limit in spec.subject_to.items():
        if name not in angles or "unit" in limit.measure or _CONVERSION.search(limit.value):
            continue
        for key, value in (("max", limit.max), ("min", limit.min)):
            if value is not None and looks_like_degrees(value):
                yield (
                    f"the angle of {value:g} rad at {path_text(('subject_to', name, key))} is more than a full "
                    f"rotation; if degrees are intended, write `{key}: {value:.16g} deg`, otherwise "
                    f"`{key}: {value:.16g} rad`"
                )
