"""Knots and corners of motions and loads: the times at which their value or a derivative is discontinuous.

*Knots* are the points of a table, at which the third derivative of a cubic spline, the fifth derivative of a quintic
spline, or the rate of a linear table is discontinuous. The knots of a periodic table repeat. *Corners* are the times at
which ``abs``, ``min`` or ``max`` switch between their operands, and the discontinuities of ``atan2``. The class
`Corner` represents both.

The arguments of these functions are sampled over the span of the run, at `SAMPLES` times and at all corners of nested
functions. Changes of sign between two samples are located by bisection. If two samples have equal signs, but the rates
at them indicate an extremum towards zero in between, the extremum is located first. Two changes of sign are therefore
missed only if there is more than one extremum between the two samples.

Other corners are hidden, as in ``asin(sin(t))`` or ``sqrt((t - 1)**2)``. Wherever a smooth operand leads to one, it has
a zero, a pole or an extremum there. At these times, the limits of both sides are compared: those of the polynomials
through the function on either side, over a small part of its `mbdkit.mechanism.motion_pieces`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mbdkit.expressions.jets import EPS, Jet, jet_and_switches
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.parser import Expression
from mbdkit.expressions.program import Program
from mbdkit.mechanism.motion_pieces import AT_START, UNIT_NODES, pieces_of, sharp_operands
from mbdkit.mechanism.values import Motion, Table, curve_of

SAMPLES = 10_000
"""Number of samples over the span of a run; fewer for long expressions."""

MOST_OPERATIONS = 50_000_000
"""Largest number of operations that one sampling of an argument may take."""

BISECTIONS = 80
"""Number of bisections; sufficient to reduce any interval to adjacent floating-point numbers."""

JUMP, JUMP_OF_LARGEST = 1e-9, 1e-13
"""Differences between the two sides of a time that count as rounding errors rather than as discontinuities.

The tolerance is `JUMP` times the larger magnitude of the two sides, plus `JUMP_OF_LARGEST` times the largest magnitude
over the run.
"""

SHARE_OF_PIECE = 1.0 / 16.0
"""Share of a piece over which a polynomial determines the limits at its end.

A piece is represented up to a hundredth of its range, and this share of it 16^9 times better.
"""

CLOSER = (1.0 / 16.0, 1.0 / 256.0, 1.0 / 4096.0)
"""Shares of a piece over which a jump at a hidden corner has to persist, as far as rounding errors let see."""

ACCURATE = np.array([10.0, 10.0, 1e-2])
"""Deviations of value, rate and acceleration at the margins of a hidden corner, as multiples of its errors."""

HIDDEN = np.array([1e-6, 1e-6, 1e-3])
"""Differences between two sides in value, rate and acceleration that count as errors, relative to their scales."""

MOST_KNOTS = 100_000
"""Largest number of knots of a periodic table that are examined; further ones repeat them."""

WIDEST_MARGIN = 1e-10
"""Rounding errors of the time of a corner up to this share of the span of the run are included in its margin."""


MOST_CACHED = 64
"""Largest number of motions whose corners are cached; they are needed three times per run.

The corners of a table with 10 000 points take 6 MB and 0.06 s.
"""


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
    pieces, corners = pieces_of(program, start, end), list[Corner]()
    length = np.diff(pieces.ends)
    places = [(seed, seed) for seed in pieces.seeds]
    for low, high in pieces.edges.tolist():  # neighbours count as one, and include the seed between them
        while places and (near := min(places, key=lambda place: abs(place[1] - low)))[1] >= low - rounding:
            if near[0] > high + rounding:
                break
            places.remove(near)
            low, high = min(low, near[0]), max(high, near[1])
        places.append((low, high))
    for low, high in sorted(places):
        before, after = (int(np.searchsorted(pieces.ends, t, side=s)) for t, s in ((low, "left"), (high, "right")))
        if not (before > 0 and after < len(pieces.ends)):
            continue
        time = next((seed for seed in pieces.seeds if low <= seed <= high), 0.5 * (low + high))
        width = max(high - time, time - low)
        beside = jet_of(program, np.array([low, low - 16.0 * width, high, high + 16.0 * width])).value
        if width > 0.0 and np.any(np.abs(beside[::2]) > 2.0 * np.abs(beside[1::2])):
            continue  # a pole, which no step can reach
        lengths = -length[before - 1], length[after - 1]
        first, second, floor, _ = _limits(program, low, high, lengths, rounding)
        jumps = np.abs(second - first) > floor + width * np.append(np.abs(first + second)[1:], 0.0)
        if not (np.all(np.isfinite(first + second)) and jumps.any()):  # not finite: outside the domain of a function
            continue
        for share in CLOSER:  # a narrow bend has no jump close by
            below, above, _, noise = _limits(program, low, high, [share * x for x in lengths], rounding)
            jump = np.abs(second - first)
            jumps &= ~((np.abs(above - below) < 0.5 * jump) & (noise < 0.3 * jump))
        if not jumps.any():
            continue
        margin = rounding + width
        while 10.0 * margin < widest:
            sides = jet_of(program, np.array([time - margin, time + margin])).derivatives
            moved = margin * np.append(np.maximum(np.abs(first), np.abs(second))[1:], 0.0)
            if np.all(np.abs(sides - [first, second]) <= floor * ACCURATE + moved):
                break
            margin *= 10.0
        corners.append(Corner(time, margin, False, *(tuple(x.tolist()) for x in (first, second, jumps))))
    return corners


def _limits(
    program: Program, low: float, high: float, lengths: Sequence[float], rounding: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return value, rate and acceleration before `low` and after `high` [s], differences that count as errors, and
    their part that is due to rounding.

    `lengths`: lengths of the pieces before and after, the first one negative [s]. The polynomial over `SHARE_OF_PIECE`
    of a piece is exact up to rounding errors.
    """
    limits, floors, noises, orders = [], [], [], np.arange(3.0)
    for time, length in zip((low, high), lengths, strict=True):
        size = length * SHARE_OF_PIECE
        jet = jet_of(program, time + np.copysign(rounding, size) + size * UNIT_NODES)
        with np.errstate(all="ignore"):
            limits.append(jet.value @ AT_START / size**orders)
        noises.append(10.0 * np.max(jet.rounding) * np.sum(np.abs(AT_START), axis=0) / np.abs(size) ** orders)
        scale = np.ptp(jet.value) / SHARE_OF_PIECE / np.abs(length) ** orders
        floors.append(noises[-1] + HIDDEN * (np.abs(limits[-1]) + scale))
    return limits[0], limits[1], np.maximum(*floors), np.maximum(*noises)


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
    found: list[float] = knots[(start <= knots) & (knots <= end)].tolist()
    return found


def _has_curve(table: Table) -> bool:
    try:
        with np.errstate(all="ignore"):
            return bool(np.all(np.isfinite(curve_of(table).c)))
    except (ValueError, np.linalg.LinAlgError):
        return False


def _described(
    motion: Motion, found: Iterable[tuple[float, float]], start: float, end: float, *, is_knot: bool
) -> tuple[Corner, ...]:
    """Return the corners at the `found` pairs of time and margin, each with the motion on both sides."""
    places = sorted(found)
    if not places:
        return ()
    times, margins = (np.array(column) for column in zip(*places, strict=True))
    before, after = (jet_of(motion, times + side * margins).derivatives for side in (-1.0, 1.0))
    with np.errstate(all="ignore"):
        over = np.abs(jet_of(motion, np.linspace(start, end, 201)).derivatives)
        largest = np.max(np.where(np.isfinite(over), over, 0.0), axis=0)
        difference = after - before
        # The next derivative explains the part of the difference that arises over the two margins.
        difference[:, :2] -= margins[:, None] * (before + after)[:, 1:]
        floor = JUMP * np.maximum(np.abs(before), np.abs(after)) + JUMP_OF_LARGEST * largest
        jumps = ~(np.abs(difference) <= floor)
    corners: list[Corner] = []
    columns = (x.tolist() for x in (times, margins, before, after, jumps))
    for time, margin, left, right, differs in zip(*columns, strict=True):
        if corners and time - corners[-1].time <= margin + corners[-1].margin:
            continue  # the same corner, found for another function
        corners.append(Corner(time, margin, is_knot, tuple(left), tuple(right), tuple(differs)))
    return tuple(corners)


@lru_cache(maxsize=MOST_CACHED)
def switching_times(program: Program, start: float, end: float, samples: int = SAMPLES) -> list[tuple[float, float]]:
    """Return the times [s] at which operations of a program switch between their operands, with their rounding errors.

    Switches whose argument is not finite are left out.

    `program`: a function of time. `start`, `end`: the span that is searched [s]. `samples`: number of samples over the
    span; fewer are taken of long programs.
    """
    times = np.linspace(start, end, max(1000, min(samples, MOST_OPERATIONS // len(program))) + 1)
    found: dict[float, float] = {}
    level = 0
    while True:
        level += 1
        _, switches = jet_and_switches(program, times)
        new: dict[float, float] = {}
        for number, switch in enumerate(switches):
            if switch.level == level:
                new.update(_changes(_argument_of(program, number), times, switch.argument))
        found.update(new)
        if level >= max((switch.level for switch in switches), default=0):
            return sorted(found.items())
        times = np.unique(np.concatenate([times, list(new)]))


def _argument_of(program: Program, number: int) -> Callable[[np.ndarray], Jet]:
    """Return the argument of a switch as a function of times (T,)."""
    return lambda times: jet_and_switches(program, times)[1][number].argument


def _changes(argument: Callable[[np.ndarray], Jet], times: np.ndarray, sampled: Jet) -> dict[float, float]:
    """Return the times at which an argument changes its sign, each with its rounding error [s]."""
    known = np.isfinite(sampled.value)
    times, g, rate = times[known], sampled.value[known], sampled.rate[known]
    sign = np.sign(g)
    zeros, others = sign == 0.0, np.flatnonzero(sign != 0.0)
    left, right = others[:-1], others[1:]
    opposite = sign[left] != sign[right]
    # An argument that is zero at several samples in a row begins and ceases to be zero at corners of nested functions,
    # which are found as such.
    isolated = right - left <= 2
    brackets = [(times[left[opposite & isolated]], times[right[opposite & isolated]])]
    adjacent = right - left == 1
    heads_to_zero = adjacent & ~opposite & (sign[left] * rate[left] < 0.0) & (sign[right] * rate[right] > 0.0)
    if heads_to_zero.any():
        a, b = times[left[heads_to_zero]], times[right[heads_to_zero]]
        middle = _bisected(lambda t: argument(t).rate, a, b)
        across = np.sign(argument(middle).value) == -sign[left[heads_to_zero]]
        brackets += [(a[across], middle[across]), (middle[across], b[across])]
    low, high = (np.concatenate(ends) for ends in zip(*brackets, strict=True))
    edges = [k for k in (0, len(times) - 1) if len(times) and zeros[k]]  # a zero at an end of the run
    if not len(low) and not edges:
        return {}
    roots = np.concatenate([_bisected(lambda t: argument(t).value, low, high), times[edges]])
    at = argument(roots)
    ends = np.maximum(np.abs(argument(low).value), np.abs(argument(high).value))
    with np.errstate(all="ignore"):
        noise = 2.0 * at.rounding / np.abs(at.rate)
    found = {}
    for k, root in enumerate(roots):
        if k < len(low) and not abs(at.value[k]) <= ends[k]:
            continue  # a pole, not a change of sign
        found[float(root)] = float(noise[k]) if np.isfinite(noise[k]) else 0.0
    return found


def _bisected(function: Callable[[np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return where `function` changes its sign between `low` and `high` (K,), up to adjacent floating-point numbers."""
    a, b = low.copy(), high.copy()
    if not len(a):
        return a
    sign = np.sign(function(a))
    for _ in range(BISECTIONS):
        middle = 0.5 * (a + b)
        if np.all((middle <= a) | (middle >= b)):
            break
        now = np.sign(function(middle))
        stays = now == sign
        a = np.where(stays | (now == 0.0), middle, a)
        b = np.where(~stays, middle, b)
    return b
