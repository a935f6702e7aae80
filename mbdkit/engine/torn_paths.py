"""Muscles whose path has no length because it cannot pass a wrapping circle."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.workspace import Workspace


def torn_path(workspace: Workspace, t: float, q: np.ndarray, v: np.ndarray) -> str:
    """Return a clause that names a muscle whose path cannot pass a circle at a position; empty if there is none.

    Parameters
    ----------
    workspace
        The mechanism; its working arrays are overwritten.
    t, q, v
        Time [s], positions and velocities (3 (B + 1),).
    """
    mechanism, scratch = workspace.mechanism, workspace.scratch
    top = mechanism.topology
    if not mechanism.muscles or not np.all(np.isfinite(q)):
        return ""
    tangents_at(workspace.engine, t, q, v, np.zeros_like(q), np.zeros((len(top.pairs), 2)))
    rows = np.flatnonzero(np.isnan(scratch.s[:, 0]) & (top.springs[:, 5] > 0))
    names = [mechanism.muscles[place].force.name for place in top.force_place[rows] - len(mechanism.forces)]
    if not names:
        return ""
    return f"muscle '{names[0]}' would pass a circle on its other side, or a point of its path is inside of a circle"
