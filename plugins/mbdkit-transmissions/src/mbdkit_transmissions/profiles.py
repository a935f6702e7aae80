"""Curves in the frame of a body: functions of one variable, given by an expression, a table or a number."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.plugin import SpecError, Table
from mbdkit.plugin.mechanisms import Profile

if TYPE_CHECKING:
    OfAngle = float | str | Table
    OfX = float | str | Table
else:
    OfAngle = Profile.key("angle")
    OfX = Profile.key("x")

CLOSED = 1e-9  #: Largest jump of a closed curve, relative to its size, where its angle passes 180 degrees.


def check_closed(radius: Profile, key: str) -> np.ndarray:
    """Raise SpecError unless a polar curve is closed and its radius is positive; return points (721,) of the radius."""
    angles = np.linspace(-np.pi, np.pi, 721)
    values = np.asarray(radius.value(angles), dtype=float)
    if not np.all(np.isfinite(values)) or np.min(values) <= 0.0:
        worst = float(angles[np.argmin(np.where(np.isfinite(values), values, -np.inf))])
        raise SpecError(f"the radius is not positive everywhere, for example at the angle {worst:.4g} rad", key=key)
    step = 1e-4
    begin, end = np.array([-np.pi, step - np.pi]), np.array([np.pi, np.pi + step])
    jump = float(np.max(np.abs(np.asarray(radius.value(begin)) - np.asarray(radius.value(end)))))
    if jump > CLOSED * float(np.max(values)):
        raise SpecError(
            f"the curve is not closed: its radius or slope differs by {jump:.3g} m between the angles -pi and pi; "
            "a table needs `ends: periodic` and covers 2*pi",
            key=key,
        )
    return values
