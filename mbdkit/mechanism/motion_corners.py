"""Knots and corners of motions and loads: the times at which their value or a derivative is discontinuous.

*Knots* are the points of a table, at which the third derivative of a cubic spline, the fifth derivative of a quintic
spline, or the rate of a linear table is discontinuous. The knots of a periodic table repeat. *Corners* are the times at
which ``abs``, ``min`` or ``max`` switch between their operands, and the discontinuities of ``atan2``. The class
`Corner` represents both.

Other corners are hidden, as in ``asin(sin(t))`` or ``sqrt((t - 1)**2)``. Wherever a smooth operand leads to one, it has
a zero, a pole or an extremum there. At these times, the limits of both sides are compared: those of the polynomials
through the function on either side, over a small part of its `mbdkit.mechanism.motion_pieces`.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from mbdkit.base.frozen import dataclass
from mbdkit.expressions.jets import EPS, Jet, jet_and_switches
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.parser import Expression
from mbdkit.expressions.program import Program
from mbdkit.mechanism.motion_pieces import SCALES, limits_at, pieces_of
from mbdkit.mechanism.switching_times import SAMPLES, sharp_operands, switching_times
from mbdkit.mechanism.values import Motion, Table, curve_of

#: Differences between the two sides of a time that count as rounding errors rather than as discontinuities.
#:
#: The tolerance is `JUMP` times the larger magnitude of the two sides, plus `JUMP_OF_LARGEST` times the largest
#: magnitude over the run.
JUMP, JUMP_OF_LARGEST = 1e-9, 1e-13

#: A difference between both sides is no jump if it is more than twice as large at this multiple of the margins.
FARTHER = 1e4

#: Deviations of value, rate and acceleration at the margins of a hidden corner, as multiples of its errors.
ACCURATE = np.array([10.0, 10.0, 1e-2])

#: Differences between two sides in value, rate and acceleration that count as errors, relative to their scales.
HIDDEN = np.array([1e-6, 1e-6, 1e-3])

#: Largest number of knots of a periodic table that are examined; further ones repeat them.
MOST_KNOTS = 100_000

#: Rounding errors of the time of a corner up to this share of the span of the run are included in its margin.
WIDEST_MARGIN = 1e-10


#: Largest number of motions whose corners are cached; they are needed three times per run.
#:
#: The corners of a table with 10 000 points take 6 MB and 0.06 s.
MOST_CACHED = 64


@dataclass(frozen=True)
class Corner:
    """A time at which a motion or one of its derivatives is discontinuous.

    - `time`: the time [s].
    - `margin`: uncertainty of `time` due to rounding [s]. Only within this distance of `time` is it uncertain whether
      another time is before or after the corner.
    - `is_knot`: whether the corner is a point of a table.
    - `before`, `after`: value, rate and acceleration of the motion before and after `time`.
    - `jumps`: whether the value, the rate and the acceleration are discontinuous.
    """

    time: float
    margin: float
    is_knot: bool
    before: tuple[float, float, float]
    after: tuple[float, float, float]
    jumps: tuple[bool, bool, bool]

    @property
    def is_smooth(self) -> bool:
        """Whether value, rate and acceleration are continuous."""
        return not any(self.jumps)


def jet_of(motion: Motion | Program, times: np.ndarray) -> Jet:
    """Return a motion and its derivatives at `times` (T,)."""
    if isinstance(motion, str | tuple):
        return jet_and_switches(program_of(motion), times)[0]
    none = np.zeros(len(times))
    if not isinstance(motion, Table):
        return Jet(none + motion, none, none, none)
    curve = curve_of(motion)
    value = curve(times)
    return Jet(value, curve(times, 1), curve(times, 2), EPS * np.abs(value))


def program_of(motion: str | Program) -> Program:
    """Return the program of an expression of time."""
    return Expression.parse(motion).program if isinstance(motion, str) else motion


@lru_cache(maxsize=MOST_CACHED)
def corners_of(motion: Motion | Program, start: float, end: float, samples: int = SAMPLES) -> tuple[Corner, ...]:
    """Return the knots and corners of a motion from `start` to `end` [s], both included, in order of time.

    `motion`: a number, an expression of t, its program, or a table. `start`, `end`: the span of the run [s]. `samples`:
    number of samples over the span.
    """
    rounding = 4.0 * EPS * max(abs(start), abs(end))
    widest = WIDEST_MARGIN * (end - start)
    if isinstance(motion, Table):
        times = [(t, rounding) for t in _knots(motion, start, end)] if _has_curve(motion) else []
        return _described(motion, times, start, end, is_knot=True)
    if not isinstance(motion, str | tuple):
        return ()
    program = program_of(motion)
    switches = [OPERATIONS[name] for name, _ in program if name in OPERATIONS and OPERATIONS[name].switch]
    roots = switching_times(program, start, end, samples) if switches else []
    # A noise above `widest` occurs where the argument crosses zero slowly, as in abs(t**3). Several derivatives then
    # agree on both sides, so the exact time does not matter.
    times = [(t, rounding + (noise if noise <= widest else 0.0)) for t, noise in roots]
    corners = _described(motion, times, start, end, is_knot=False)
    # Not every switch is a corner: atan2 is smooth at y = 0 if x > 0, and sin(atan2(y, x)) is smooth everywhere.
    wraps = any(operation.jumps for operation in switches)
    corners = tuple(corner for corner in corners if not wraps or not corner.is_smooth)
    if not sharp_operands(program):
        return corners
    known = np.array([-np.inf, *(corner.time for corner in corners), np.inf])
    hidden = [
        corner
        for corner in _hidden_corners(program, start, end, rounding, widest)
        if np.min(np.abs(known - corner.time)) > 4.0 * rounding
    ]
    return tuple(sorted([*corners, *hidden], key=lambda corner: corner.time))


def _hidden_corners(program: Program, start: float, end: float, rounding: float, widest: float) -> list[Corner]:
    """Return the corners among the zeros, poles and extrema of operands of sharp operations, and practical jumps.

    The margin is the smallest at which value, rate and acceleration are accurate on both sides, up to `widest`: near
    x = 1, for example, the derivatives of ``asin(x)`` amplify rounding errors.
    """
    pieces, corners, places = pieces_of(program, start, end), list[Corner](), list[tuple[float, float]]()
    for low, high in sorted([*((seed, seed) for seed in pieces.seeds), *map(tuple, pieces.edges.tolist())]):
        if places and low <= places[-1][1] + rounding:  # neighbours, and the seed between them, count as one
            places[-1] = places[-1][0], max(places[-1][1], high)
        else:
            places.append((low, high))
    for low, high in places:
        before, after = int(np.searchsorted(pieces.ends, low)), int(np.searchsorted(pieces.ends, high, side="right"))
        time = next((seed for seed in pieces.seeds if low <= seed <= high), 0.5 * (low + high))
        width = max(high - time, time - low)
        beside = jet_of(program, np.array([low, low - 16.0 * width, high, high + 16.0 * width])).value
        is_pole = width > 0.0 and np.any(np.abs(beside[::2]) > 2.0 * np.abs(beside[1::2]))  # which no step can reach
        if is_pole or not 0 < before <= after < len(pieces.ends):
            continue
        sizes = SCALES * np.array([[pieces.ends[before - 1] - low], [pieces.ends[after] - high]])
        limits, noise, scale = limits_at(program, np.array([low, high]), sizes)
        first, second = limits[:, 0]
        floor = np.max((noise + HIDDEN * (np.abs(limits) + scale))[:, 0], axis=0)
        jump, noise = np.abs(limits[1] - limits[0]), np.max(noise, axis=0)
        jumps = jump[0] > floor + width * np.append(np.abs(first + second)[1:], 0.0)
        # a narrow bend has no jump close by, as far as rounding errors let see
        jumps &= ~np.any((jump[1:] < 0.5 * jump[0]) & (noise[1:] < 0.3 * jump[0]), axis=0)
        if not (np.all(np.isfinite(first + second)) and jumps.any()):  # not finite: outside the domain of a function
            continue
        margin = rounding + width
        while 10.0 * margin < widest:
            sides = jet_of(program, np.array([time - margin, time + margin])).derivatives
            moved = margin * np.append(np.maximum(np.abs(first), np.abs(second))[1:], 0.0)
            if np.all(np.abs(sides - limits[:, 0]) <= floor * ACCURATE + moved):
                break
            margin *= 10.0
        corners.append(Corner(time, margin, False, *(tuple(x.tolist()) for x in (first, second, jumps))))
    return corners


def overshoot(table: Table) -> float:
    """Return by how much the curve of a table exceeds the range of its values, as a share of this range."""
    values = np.array(table.table[1])
    low, high = values.min(), values.max()
    if not _has_curve(table) or low == high:
        return 0.0
    curve = curve_of(table)
    turns = np.asarray(curve.derivative().roots(extrapolate=False))
    reached = np.concatenate([values, curve(turns[np.isfinite(turns)])])
    return float(max(low - reached.min(), reached.max() - high) / (high - low))


def _knots(table: Table, start: float, end: float) -> list[float]:
    """Return the times from `start` to `end` at which two pieces of the curve of a table meet, in order."""
    times = curve_of(table).x
    if not table.period:
        return [float(t) for t in times[1:-1] if start <= t <= end]
    first = np.floor((start - times[0]) / table.period)
    periods = min(np.ceil((end - times[0]) / table.period) - first + 1, np.ceil(MOST_KNOTS / (len(times) - 1)))
    knots = (times[:-1] + table.period * (first + np.arange(periods))[:, None]).ravel()
    return [*knots[(start <= knots) & (knots <= end)].tolist()]


def _has_curve(table: Table) -> bool:
    try:
        with np.errstate(all="ignore"):
            return bool(np.all(np.isfinite(curve_of(table).c)))
    except (ValueError, np.linalg.LinAlgError):
        return False


def _described(
    motion: Motion | Program, rows: Iterable[tuple[float, float]], start: float, end: float, *, is_knot: bool
) -> tuple[Corner, ...]:
    """Return the corners at the `found` pairs of time and margin, each with the motion on both sides."""
    if not (places := sorted(rows)):
        return ()
    times, margins = (np.array(column) for column in zip(*places, strict=True))

    def sides(margins: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the motion on both sides, and by how much it differs; the next derivative explains what arises over
        the two margins.
        """
        before, after = (jet_of(motion, times + side * margins).derivatives for side in (-1.0, 1.0))
        difference = after - before
        slopes = (before + after)[:, 1:]
        difference[:, :2] -= margins[:, None] * np.where(np.isfinite(slopes), slopes, 0.0)
        return before, after, np.abs(difference)

    with np.errstate(all="ignore"):
        over = np.abs(jet_of(motion, np.linspace(start, end, 201)).derivatives)
        largest = np.max(np.where(np.isfinite(over), over, 0.0), axis=0)
        before, after, difference = sides(margins)
        floor = JUMP * np.maximum(np.abs(before), np.abs(after)) + JUMP_OF_LARGEST * largest
        # powers such as (t - 1)**0.5 have no jump, but grow at once
        jumps = ~(difference <= floor) & ~(difference < 0.5 * sides(FARTHER * margins)[2])
    corners: list[Corner] = []
    columns = (x.tolist() for x in (times, margins, before, after, jumps))
    for time, margin, left, right, differs in zip(*columns, strict=True):
        if corners and time - corners[-1].time <= margin + corners[-1].margin:
            continue  # the same corner, found for another function
        corners.append(Corner(time, margin, is_knot, tuple(left), tuple(right), tuple(differs)))
    return tuple(corners)
