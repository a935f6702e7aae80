"""Warnings about studies that vary initial values which assembly changes."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import path_text
from mbdkit.engine.consistent_start import Starts
from mbdkit.runs.preparation import build
from mbdkit.spec import RunSpec

KEPT = 0.01
"""Share of the range of an initial value by which assembly may change this range without a warning."""

ROUNDING = 1e-9
"""Ranges of initial values below this share of the largest value count as rounding errors."""

KEYS = (("position", 0), ("position", 1), ("angle",), ("velocity", 0), ("velocity", 1), ("angular_velocity",))
"""Keys of the initial values of a body."""


def start_warnings_of_study(specs: Iterable[RunSpec]) -> list[str]:
    """Return a list with a warning if starts after assembly do not follow the initial values that runs vary.

    Otherwise, the list is empty.

    Parameters
    ----------
    specs
        Specs of some runs of the study, such as the first and the last.
    """
    free = [spec for spec in specs if spec.model_item.name == "mechanism"]
    if not free or any(set(spec.mechanism().bodies) != set(free[0].mechanism().bodies) for spec in free):
        return []
    given = np.array([_given(spec) for spec in free])
    if not np.any(np.ptp(given, axis=0)):
        return []
    starts, changes, kept = Starts(), [], []
    for spec, values in zip(free, given, strict=True):
        with suppress(SpecError):  # the run reports this error itself
            _, start = build(spec, starts)
            now = np.hstack([start.q.reshape(-1, 3), start.v.reshape(-1, 3)])
            changes.append(now - values)
            kept.append(values)
    if len(kept) < 2:
        return []
    off, span = np.ptp(changes, axis=0), np.ptp(kept, axis=0)
    varies = span > ROUNDING * np.max(np.abs(kept))
    share = np.divide(off, span, out=np.zeros_like(off), where=varies)
    body, column = np.unravel_index(int(np.argmax(share)), share.shape)
    if not share[body, column] > KEPT:
        return []
    first, last = (int(np.argmin(np.array(kept)[:, body, column])), int(np.argmax(np.array(kept)[:, body, column])))
    a, b = (kept[place][body, column] for place in (first, last))
    moved = [kept[place][body, column] + changes[place][body, column] for place in (first, last)]
    key = path_text(("model", "bodies", list(free[0].mechanism().bodies)[body], *KEYS[column]))
    text = (
        f"the runs vary {key} from {a:.4g} to {b:.4g}, but the start after assembly from {moved[0]:.4g} to "
        f"{moved[1]:.4g}, because the joints connect it with other initial values; vary all values that belong "
        f"together, or use expressions of one parameter"
    )
    return [text]


def _given(spec: RunSpec) -> np.ndarray:
    """Return the given initial coordinates and velocities of all bodies, (B, 6)."""
    return np.array(
        [
            (*body.position, body.angle, *body.velocity, body.angular_velocity)
            for body in spec.mechanism().bodies.values()
        ]
    )
