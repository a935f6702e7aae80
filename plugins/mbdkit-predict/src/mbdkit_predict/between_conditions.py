"""How far a motion exceeds its conditions along the path between the collocation points.

A condition may be narrower than any sampling, such as a gate that is open for 1e-5 of the motion. Narrow features of an
expression are at zeros and extrema of its operands, which are not narrow: ``exp(-((t - 0.4)/1e-5)**2)`` has its peak at
the zero of ``t - 0.4``. These zeros and extrema are located along the motion, and values at ever smaller distances from
them are examined, so that no width is too small.

A violation changes the objective to first order by its product with the multipliers nearby. Where a condition contains
controls or reactions, which may jump, only the integrals of violations count.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdkit_predict.jumps import MotionPath
from mbdkit_predict.point_functions import OF_STATE
from mbdkit_predict.transcription import AlongPath, Mesh, Transcription

SAMPLES = 2000  #: Number of samples of a motion at least, between which zeros and extrema are located.
BISECTIONS, SECTIONS = 50, 40  #: Iterations by which zeros and extrema of operands are located.
GOLDEN = 0.5 * (3.0 - 5.0**0.5)
#: Distances from zeros and extrema at which values are examined, in multiples of the distance of samples.
GRADED = np.concatenate([[0.0], *(side * 2.0 ** -np.arange(41.0) for side in (-1.0, 1.0))])
ROUNDED = 1e-8  #: Violations below this share of the size of a condition are rounding errors of the optimizer.
#: Largest half width of a narrow violation, as a share of the interval; and ends of the intervals that are made there,
#: in multiples of the half width.
NARROW, CUTS = 1.0 / 16.0, np.array([-1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0])


class Violation(NamedTuple):
    """A time between two collocation points at which a condition is exceeded."""

    name: str
    time: float  #: When it is exceeded most [s].
    half: float  #: Half the time during which it is exceeded [s].
    size: float  #: How far it is exceeded.
    share: float  #: The same as a share of the terms of the condition.
    change: float  #: First-order change of the objective.
    interval: int
    is_narrow: bool  #: Whether halving of the interval would not find it soon.

    @property
    def cuts(self) -> list[float]:
        """Times at which intervals should end [s]."""
        return [self.time + self.half * cut for cut in CUTS.tolist()]

    def is_large(self, change: float, share: float) -> bool:
        """Return whether the change of the objective or the share is above its limit."""
        return self.change > change or self.share > share


def violations_between(method: Transcription, mesh: Mesh) -> list[Violation]:
    """Return where a solution exceeds its conditions between the collocation points, the largest share first."""
    conditions = method.along_path(mesh)
    if not conditions:
        return []
    path, ends = MotionPath(method, mesh), mesh.values["duration"] @ mesh.grid.ends
    knots = [time for table in method.spec.tables.values() for time in table.table[0] if time < ends[-1]]
    spacing = ends[-1] / SAMPLES
    samples = np.unique(np.concatenate([np.linspace(0.0, ends[-1], SAMPLES + 1), mesh.times, ends, knots]))
    expressions = [x for one in conditions for x in (one.path.expression, one.path.operands)]
    operands = ca.Function("operands", path.given, [ca.vertcat(*expressions)])
    special = _zeros_and_extrema(path, operands, samples)
    near = np.clip((special[:, None] + spacing * GRADED).ravel(), 0.0, ends[-1])
    samples = np.union1d(samples, near)
    found = list[Violation]()
    for one in conditions:
        found += _violations(method, mesh, path, one, samples)
    return sorted(found, key=lambda violation: -violation.share)


def _zeros_and_extrema(path: MotionPath, function: ca.Function, times: np.ndarray) -> np.ndarray:
    """Return the times (K,) of zeros and extrema of the values of a function between samples."""
    values = path.along(function, times)
    steps = np.diff(values, axis=1)
    steps[abs(steps) <= 1e-12 * abs(values).max(axis=1, keepdims=True, initial=0.0)] = 0.0

    def at(rows: np.ndarray, times: np.ndarray) -> np.ndarray:
        return np.asarray(path.along(function, times)[rows, np.arange(len(rows))])

    rows, first, last, side = _changes(np.sign(values))
    low, high = times[first], times[last]
    for _ in range(BISECTIONS * bool(len(rows))):
        middle = 0.5 * (low + high)
        is_before = np.sign(at(rows, middle)) == side
        low, high = np.where(is_before, middle, low), np.where(is_before, high, middle)
    zeros = 0.5 * (low + high)
    rows, first, last, side = _changes(np.sign(steps))
    low, high = times[first], times[last + 1]
    for _ in range(SECTIONS * bool(len(rows))):
        left, right = low + GOLDEN * (high - low), high - GOLDEN * (high - low)
        rises = side * at(rows, left) < side * at(rows, right)
        low, high = np.where(rises, left, low), np.where(rises, high, right)
    return np.unique(np.concatenate([zeros, 0.5 * (low + high)]))


def _changes(signs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return rows, columns before and after, and signs before all changes of signs (K, T), with zeros in between."""
    before = np.maximum.accumulate(np.where(signs == 0.0, 0, np.arange(signs.shape[1])), axis=1)
    filled = np.take_along_axis(signs, before, axis=1)
    rows, first = np.nonzero(filled[:, :-1] * filled[:, 1:] < 0.0)
    return rows, before[rows, first], first + 1, filled[rows, first]


def _violations(
    method: Transcription, mesh: Mesh, path: MotionPath, condition: AlongPath, samples: np.ndarray
) -> list[Violation]:
    _, expression, low, high, phase, *_ = condition.path
    terms = _terms(expression)
    value, *rows = path.along(ca.Function("terms", path.given, [ca.vertcat(expression, *terms)]), samples)
    intervals = np.minimum(np.searchsorted(path.ends, samples), len(path.ends) - 1)
    shift = 0.0 if condition.path.peak is None else mesh.values["peak"][condition.path.peak]
    beyond = np.nan_to_num(np.maximum(low - value + shift, value - shift - high), nan=0.0, neginf=0.0)
    if phase is not None:
        beyond[method.phase_of[mesh.grid.phase[intervals]] != phase] = 0.0
    sizes = abs(np.nan_to_num(rows))
    is_steady = not any(ca.depends_on(expression, x) for x in _varying(method))
    size = sizes.max() if is_steady else np.trapezoid(sizes, samples).max()
    size = max(size, *(abs(x) * (1.0 if is_steady else samples[-1]) for x in (low, high) if np.isfinite(x)), 1e-300)
    slopes, lengths = abs(condition.slopes).reshape(len(path.ends), -1), mesh.values["duration"] @ mesh.grid.lengths
    if not is_steady:
        slopes = slopes / np.outer(lengths, method.b)
    padded = np.pad(slopes.sum(axis=1) if is_steady else slopes.max(axis=1), 1)
    nearby = padded[:-2] + padded[1:-1] + padded[2:]
    edges = np.flatnonzero(np.diff((beyond > ROUNDED * sizes.max()).astype(int), prepend=0, append=0))
    found = list[Violation]()
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        around = slice(max(first - 1, 0), last + 1)
        at, times = first + int(beyond[first:last].argmax()), samples[around]
        missed = beyond[at] if is_steady else np.trapezoid(beyond[around], times)
        k = int(intervals[at])
        half, is_narrow = 0.5 * float(np.ptp(times)), np.ptp(times) < 2.0 * NARROW * lengths[k]
        row = float(samples[at]), half, float(beyond[at]), missed / size, nearby[k] * missed, k, is_narrow
        found.append(Violation(condition.path.name, *row))
    return found


def _varying(method: Transcription) -> list[ca.SX]:
    """Return symbols of what may jump: accelerations, multipliers and controls, but not measured functions."""
    system = method.system
    measured = {f"measured.{name}" for name in method.spec.tables}
    u = [x for x, name in zip(ca.vertsplit(system.u), method.spec.chosen.control_states, strict=True)
         if name not in measured]  # fmt: skip
    return [*(system.symbols[name] for name in OF_STATE if name != "u" and system.symbols[name].numel()), *u]


def _terms(expression: ca.SX) -> list[ca.SX]:
    """Return the terms of sums, and of the sums among these."""
    terms, waiting, known = list[ca.SX](), [expression], set[int]()
    while waiting:
        term = waiting.pop()
        if term.element_hash() not in known:
            known.add(term.element_hash())
            is_sum = not term.is_leaf() and term.op() in (ca.OP_ADD, ca.OP_SUB)
            (waiting if is_sum else terms).extend([term.dep(0), term.dep(1)] if is_sum else [term])
    return terms
