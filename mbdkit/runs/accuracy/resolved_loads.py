"""Finds the time until which the steps of a run resolve its motions and loads, which are given functions of time.

All runs of one method can miss the same short pulse. A pulse between the evaluations of a step can be detected without
integration: the polynomial through the values of a motion at `NODES` times of a step must agree with the motion between
these times.
"""

from __future__ import annotations

import math

import numpy as np

from mbdkit.expressions.jets import EPS
from mbdkit.mechanism.motion_corners import jet_of
from mbdkit.mechanism.values import Motion
from mbdkit.runs.corners import stops_of
from mbdkit.spec import RunSpec

#: Number of times in a step at which a motion is assumed to be evaluated.
#:
#: DOP853 has this number of distinct stage times.
NODES = 8

#: Approximate number of samples over a run, and smallest number of samples in one step.
LOOKS, LOOKS_OF_STEP = 20_000, 16

UNRESOLVED = 1e-3  #: Largest deviation from the polynomial, as a share of the range of the motion over the run.


def resolved_until(spec: RunSpec, time: np.ndarray) -> float:
    """Return the time until which steps resolve all motions and loads [s]; inf if they do so to the end.

    `time`: (N,) ends of all steps, with the start [s].
    """
    varying = [motion for _, motion in spec.mechanism().motions() if _varies(motion)]
    if not varying or len(time) < 2:
        return math.inf
    margin = 4.0 * max(stops_of(spec).margins, default=4.0 * EPS * float(np.max(np.abs(time))))
    begin, end = time[:-1] + margin, time[1:] - margin  # a motion may be discontinuous at the ends of a step
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    samples = (np.arange(max(LOOKS_OF_STEP, LOOKS // len(begin))) + 0.5) / max(LOOKS_OF_STEP, LOOKS // len(begin))
    through = np.linalg.solve(np.vander(2 * nodes - 1, NODES).T, np.vander(2 * samples - 1, NODES).T)  # (NODES, M)
    first = math.inf
    for motion in varying:
        seen, sampled = (_values(motion, begin, end, at) for at in (nodes, samples))
        deviation = np.max(np.abs(seen @ through - sampled), axis=1)
        unresolved = np.flatnonzero(deviation > UNRESOLVED * float(np.ptp(sampled)))
        if len(unresolved):
            first = min(first, float(time[unresolved[0]]))
    return first


def _varies(motion: Motion) -> bool:
    return not isinstance(motion, int | float)


def _values(motion: Motion, begin: np.ndarray, end: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return a motion at the shares `at` (M,) of every step, (N, M)."""
    times = begin[:, None] + (end - begin)[:, None] * at
    return np.asarray(jet_of(motion, times.ravel()).value).reshape(times.shape)
