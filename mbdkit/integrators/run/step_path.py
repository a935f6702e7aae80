"""States at the ends of several steps and within them, which the step loop stores on request."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import subkernel


class StepPath(NamedTuple):
    """States of up to N consecutive steps, P in each step: at given shares of the step by dense output, and at its end.

    There are no steps if a call of the step loop stores none.
    """

    shares: np.ndarray  #: (P - 1,) shares of a step, from 0 to 1.
    stored: np.ndarray  #: (1,) number of steps that have been stored.
    attempts: np.ndarray  #: (N,) number of attempts until the end of each step.
    time: np.ndarray  #: (N,) ends of the steps [s].
    q: np.ndarray  #: (N, P, 3 (B + 1)) positions and velocities, and (N, P, Z) first-order states.
    v: np.ndarray
    z: np.ndarray


def new_path(steps: int, shares: tuple[float, ...], size: int, states: int) -> StepPath:
    """Return a path for up to `steps` steps of a mechanism with `size` coordinates and `states` first-order states."""
    parts = len(shares) + 1
    return StepPath(
        shares=np.array(shares),
        stored=np.zeros(1, dtype=np.int64),
        attempts=np.zeros(steps, dtype=np.int64),
        time=np.zeros(steps),
        q=np.zeros((steps, parts, size)),
        v=np.zeros((steps, parts, size)),
        z=np.zeros((steps, parts, states)),
    )


load_path = bundle_loader(lambda: new_path(1, (), 6, 0))


@subkernel
def has_room(path):
    """Return whether the path at an address has room for another step; true if the address is 0."""
    return path == 0 or load_path(path).stored[0] < len(load_path(path).time)


@subkernel
def store_state(path, part, q, v, z):
    """Store a state of the present step in the path at an address."""
    known = load_path(path)
    step = known.stored[0]
    copy(q, known.q[step, part])
    copy(v, known.v[step, part])
    copy(z, known.z[step, part])


@subkernel
def store_end(path, attempts, t, q, v, z):
    """Store the state at the end `t` of the present step in the path at an address, and count the step."""
    known = load_path(path)
    step = known.stored[0]
    store_state(path, len(known.shares), q, v, z)
    known.time[step] = t
    known.attempts[step] = attempts
    known.stored[0] = step + 1
