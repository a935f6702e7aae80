"""Integrals and extrema of quantities of the motion between the ends of the steps of a run.

The states between the ends of steps are those of the polynomials of degree 11 of `step_interpolation`, whose error is
below that of the steps. Operations such as `abs`, `min` and `max` change the form of an integrand at certain points.
The integrand is integrated by Gauss-Legendre quadrature between these points, and extrema are searched among the
samples of the quadrature and at these points. Without this division, measures would be of first or second order if such
a point lies within a step.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from itertools import pairwise

import numpy as np

from mbdkit.archive.measured_values import Integrals
from mbdkit.base import elementary
from mbdkit.base.frozen import dataclass
from mbdkit.base.quadrature import gauss_on_unit
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.observed_states import StateObserver
from mbdkit.measures.reductions import Functional, Series
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.states import States
from mbdkit.runs.step_interpolation import StepEnds

#: Number of nodes of Gauss-Legendre quadrature in a step, or in each piece of a step that such points divide.
#:
#: The order of this quadrature, 16, suffices for steps of a quarter of a period.
POINTS = 8
_NODES, _WEIGHTS = gauss_on_unit(POINTS)
#: Times at which quantities are sampled in a step, from 0 at its start to 1 at its end (shares of the step).
_PLACES = np.array([0.0, *_NODES, 1.0])
_INNER = slice(1, -1)

#: Accuracy, as a share of the step, to which a point at which an operation changes its form is located.
AT_ROOT = 1e-14
#: Largest number of iterations of this search; regula falsi with bisection needs about ten.
MOST_ITERATIONS = 60

#: Largest possible rise of a quantity within a step above its values at both ends.
#:
#: It is a multiple of the second differences of the values at ends: four times the rise of a parabola.
POTENTIAL = 0.5
#: Largest possible rise within a step above the samples, as a multiple of their second differences: twice the rise of a
#: parabola.
RISE = 0.25
NOISE = 1e-12  #: Second differences below this share of the values count as rounding errors.
EQUAL = 1e-9  #: Two extrema that differ by less than this share of the range of a quantity count as equal.
MANY = 64  #: Quantities at more times than this are kept for the next functional.
#: If there are at most this many steps, all are searched for an extremum, whatever the second differences.
FEW = 64
#: Accuracy of the time of an extremum in the first search, as a share of the step.
#:
#: The time is then refined as the root of the derivative of a polynomial through `PEAK_POINTS` values up to `AROUND`
#: steps away, which is exact up to rounding errors. A search for the largest value would give only half of the digits.
PEAK = 1e-3
AROUND, PEAK_POINTS = 0.02, 7
SAME = 1e-14  #: Two neighbouring values count as equal if their relative difference is below this.


@dataclass(frozen=True)
class Peak:
    """An extremum.

    `value`: value of the extremum; nan if the quantity is undefined somewhere. `time`: time of the extremum [s].
    `switch`: index of the operation that changes its form at this time; -1 if the quantity is smooth there, or if the
    time is an end of the motion.
    """

    value: float
    time: float
    switch: int = -1


@dataclass(frozen=True)
class Quadrature:
    """Times (T,) and weights (T,) of the quadrature of an integral over time [s]."""

    time: np.ndarray
    weight: np.ndarray


class MotionPart:
    """The motion of a run over some consecutive steps, between two discontinuities of its motions and loads.

    - `observer`: evaluates states.
    - `names`: names of the elements.
    - `ends`: the ends of these steps, with further ends on both sides if available (N,). If first-order states are
      interpolated, their columns follow those of the positions, and their rates follow the velocities.
    - `steps`: the steps, as indices of their starts in `ends`.
    - `sides`: first and last time at which motions and loads are evaluated [s].
    """

    def __init__(
        self,
        observer: StateObserver,
        names: ArchiveNames,
        ends: StepEnds,
        steps: range,
        sides: tuple[float, float] = (-np.inf, np.inf),
    ):
        self._observer, self._names, self.ends, self.steps, self.sides = observer, names, ends, steps, sides
        self._last: dict[bytes, Series] = {}

    @property
    def size(self) -> np.ndarray:
        """(S,) sizes of the steps [s]."""
        return np.diff(self.ends.time[self.steps.start : self.steps.stop + 1])

    def times(self, steps: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Return the times [s] at the shares `places` of steps; step 0 is the first one of this part."""
        begin = self.ends.time[self.steps.start + steps]
        return np.asarray(begin + places * (self.ends.time[self.steps.start + steps + 1] - begin))

    @property
    def nodes(self) -> np.ndarray:
        """Times of the nodes of the quadrature over steps that no point divides [s]."""
        count = len(self.steps)
        return self.times(np.repeat(np.arange(count), POINTS), np.tile(_NODES, count))

    def series(self, time: np.ndarray) -> Series:
        """Return the quantities at times [s], in order.

        Those of the last call with many times are kept, because functionals of the same steps have the same samples.
        """
        key = time.tobytes() if len(time) > MANY else b""
        if key in self._last:
            return self._last[key]
        series = self._series_of(time, *self.ends.at(time), self.ends.held_at(time))
        if key:
            self._last = {key: series}
        return series

    @cached_property
    def at_ends(self) -> Series:
        """The quantities at the ends of the steps. All extrema are first compared there."""
        some = slice(self.steps.start, self.steps.stop + 1)
        time = self.ends.time[some]
        return self._series_of(time, self.ends.q[some], self.ends.v[some], self.ends.held_at(time))

    def _series_of(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, held: np.ndarray) -> Series:
        mechanism, seen = self._observer.workspace.mechanism, np.clip(time, *self.sides)
        n = mechanism.size
        q, v, z = (np.ascontiguousarray(x) for x in (q[:, :n], v[:, :n], q[:, n:] if q.shape[1] > n else held))
        states = States(mechanism, seen, q, v, lambda: observed_at(self._observer, seen, q, v, z), z=z)
        return Series(seen, lambda quantity: quantity.taker(self._names)(states).T)


def observed_at(observer: StateObserver, time: np.ndarray, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> Observed:
    """Return the quantities at given states; nan from the first state without unique accelerations on."""
    arrays = observer.arrays(len(time))
    if (singular := observer.observe(time, q, v, arrays, z=z)) is not None:
        for values in arrays:
            values[singular.row :] = np.nan
    return arrays


@dataclass(frozen=True)
class Sampled:
    """Samples of a functional over some steps of a part of the motion, and the points at which an operation changes its
    form.

    `part`, `functional`, `known`, `duration`: see `sampled`. `steps`: (S,) indices of the steps. `values`: (S, P)
    samples at the shares `_PLACES` of each step; (2, S, P) for a vector. `roots`: (R, 3) step, share of the step, and
    index of the operation that changes its form there, in order of time.
    """

    part: MotionPart
    functional: Functional
    known: Integrals
    duration: float
    steps: np.ndarray
    values: np.ndarray
    roots: np.ndarray

    def at(self, time: np.ndarray) -> np.ndarray:
        """Return the quantity at times [s], in order, (T,), or (2, T) of a vector."""
        values = self.functional.values(self.part.series(time), self.known, self.duration)
        return np.broadcast_to(values, (*values.shape[:-1], len(time)))

    def integral(self) -> np.ndarray:
        """Return the integral over the steps, (1,), or (2,) of a vector."""
        cut = np.unique(self.roots[:, 0])
        whole = ~np.isin(self.steps, cut)
        size = self.part.size[self.steps[whole]]
        total = np.einsum("...sp,p,s->...", self.values[..., whole, _INNER], _WEIGHTS, size)
        if len(cut):
            pieces = self.quadrature(cut)
            total = total + np.sum(self.at(pieces.time) * pieces.weight, axis=-1)
        return np.atleast_1d(total)

    def quadrature(self, steps: np.ndarray) -> Quadrature:
        """Return the quadrature over some steps, split at the roots."""
        number, share, _ = self.roots[np.isin(self.roots[:, 0], steps)].T
        number = np.concatenate([np.repeat(steps, 2), number.astype(int)])
        borders = np.unique(np.column_stack([number, np.concatenate([np.tile([0.0, 1.0], len(steps)), share])]), axis=0)
        begins = np.flatnonzero(borders[1:, 0] == borders[:-1, 0])
        number, lengths = borders[begins, 0].astype(int), np.diff(borders[:, 1])[begins, None]
        places = borders[begins, 1, None] + lengths * _NODES
        weight = lengths * _WEIGHTS * self.part.size[number, None]
        return Quadrature(self.part.times(np.repeat(number, POINTS), places.ravel()), weight.ravel())

    def peak(self, best: float = -np.inf) -> Peak:
        """Return the extremum over the steps; nan if the quantity is undefined somewhere.

        `best` is the largest value found so far (for a minimum, of ``-x``); peaks that cannot reach it are skipped.
        """
        if np.isnan(self.values).any():
            return Peak(np.nan, np.nan)
        sign = -1.0 if self.functional.reduction == "min" else 1.0
        return max(self.peaks(best), key=lambda peak: sign * peak.value)

    def peaks(self, best: float = -np.inf) -> list[Peak]:
        """Return the extremum over the steps, and other local extrema that may be equally large."""
        sign = -1.0 if self.functional.reduction == "min" else 1.0
        steps, places = np.repeat(self.steps, len(_PLACES)), np.tile(_PLACES, len(self.steps))
        kind, values = np.full(len(steps), -1), sign * self.values.ravel()
        if len(self.roots):
            number, share, switch = self.roots.T
            at_roots = sign * self.at(self.part.times(number.astype(int), share))
            steps, places = np.concatenate([steps, number.astype(int)]), np.concatenate([places, share])
            kind, values = np.concatenate([kind, switch.astype(int)]), np.concatenate([values, at_roots])
            order = np.lexsort((places, steps))
            steps, places, kind, values = steps[order], places[order], kind[order], values[order]
        time = self.part.times(steps, places)
        best = max(best, float(np.max(values)))
        peaks: list[Peak] = []
        before, after = np.roll(values, 1), np.roll(values, -1)
        before[0], after[-1] = values[0], values[-1]
        bend = np.abs(before - 2.0 * values + after)
        spread = float(np.max(values) - np.min(values))
        rise = np.where(bend > NOISE * np.max(np.abs(values)), RISE * bend, 0.0)
        tops = np.flatnonzero((values >= before) & (values >= after))
        tops = tops[np.argsort(-(values + rise)[tops], kind="stable")]
        for middle in [*tops[:1], *(tops[1:][rise[tops[1:]] > 0.0])]:  # constant quantities have many equal values
            if peaks and values[middle] + rise[middle] < best - EQUAL * spread:
                break
            peak = Peak(sign * float(values[middle]), float(time[middle]), int(kind[middle]))
            own = np.flatnonzero(steps[max(0, middle - 1) : middle + 2] == steps[middle]) + max(0, middle - 1)
            between = time[[own[0], middle, own[-1]] if peak.switch >= 0 else [own[0], own[-1]]]
            margin = SAME * abs(values[middle]) if peak.switch >= 0 else 0.0
            for begin, end in pairwise(between.tolist() if rise[middle] > 0.0 else ()):
                refined = self._refined(sign, begin, end, float(self.part.size[steps[middle]]))
                if refined is not None and refined[1] > sign * peak.value + margin:
                    peak = Peak(sign * refined[1], refined[0])
            peaks.append(peak)
            best = max(best, sign * peak.value)
        return peaks

    def _refined(self, sign: float, begin: float, end: float, step: float) -> tuple[float, float] | None:
        """Return time and value of the largest ``sign * x`` between two times; None if these are too close together."""
        if not end - begin > 2.0 * PEAK * step:
            return None
        from scipy.optimize import minimize_scalar  # takes a quarter of a second to load

        minimum = minimize_scalar(
            lambda t: -sign * float(self.at(np.array([t]))[0]),
            bounds=(begin, end), method="bounded", options={"xatol": PEAK * step},
        )  # fmt: skip
        around = min(AROUND * step, 0.25 * (end - begin))
        middle = min(max(float(minimum.x), begin + around), end - around)
        angles = np.pi * (np.arange(PEAK_POINTS)[::-1] + 0.5) / PEAK_POINTS
        values = sign * self.at(middle + around * elementary.cos(angles))
        values = values - values[0]  # small, unlike the values, whose sums would be rounded
        # the polynomial through the values, in Chebyshev polynomials; a fit would use LAPACK, which rounds differently
        # on other processors
        powers = [float(sum(values * elementary.cos(k * angles))) for k in range(PEAK_POINTS)]
        rate = np.polynomial.Chebyshev(powers).deriv()  # but for a factor and a constant
        bend, share = rate.deriv(), (float(minimum.x) - middle) / around
        with np.errstate(all="ignore"):
            for _ in range(4):
                share -= float(rate(share) / bend(share))
        root, value = middle + around * share, -float(minimum.fun)
        at_root = sign * float(self.at(np.array([root]))[0]) if abs(share) <= 1.0 else -np.inf
        # near the extremum, values differ by rounding errors only, and do not tell which time is more accurate
        return root if at_root >= value - SAME * abs(value) else float(minimum.x), max(at_root, value)


def sampled(
    part: MotionPart, functional: Functional, known: Integrals, duration: float, steps: np.ndarray | None = None
) -> Sampled:
    """Sample a functional over steps of a part, and locate the points at which its operations change their form.

    `known`: values of the inner functionals of `functional`. `duration`: duration of the run [s]. `steps`: indices of
    the steps in the part; by default all.
    """
    steps = np.arange(len(part.steps)) if steps is None else steps
    count = len(steps)

    def at(number: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the values and switches at shares (G, P) of G steps."""
        time = part.times(np.repeat(number, places.shape[1]), places.ravel())
        return functional.values_and_switches(part.series(time), known, duration, len(number))

    values, switches = at(steps, np.tile(_PLACES, (count, 1)))
    roots: list[tuple[int, float, int]] = []
    for index, switch in enumerate(switches):
        bracketed = _brackets(switch, lambda g, s, index=index: at(steps[g], _beside(s))[1][index][:, 1])  # type: ignore[misc]
        group, share = _roots(*bracketed, lambda g, s, index=index: at(steps[g], _beside(s))[1][index][:, 1])  # type: ignore[misc]
        roots += [(int(steps[g]), float(s), index) for g, s in zip(group, share, strict=True)]
    shape = values.shape[:-1]
    whole = np.broadcast_to(values, (*shape, count * len(_PLACES))).reshape(*shape, count, len(_PLACES))
    return Sampled(part, functional, known, duration, steps, whole, np.array(sorted(roots)).reshape(-1, 3))


def steps_of_extremum(
    part: MotionPart, functional: Functional, known: Integrals, duration: float, best: float
) -> tuple[np.ndarray, float]:
    """Return the indices of the steps in which an extremum may lie, and the largest value known so far.

    This largest value is the maximum of `best` and of the values at the ends of all steps.

    `known`, `duration`: see `sampled`. `best`: the largest value found so far (for a minimum, of ``-x``).
    """
    sign = -1.0 if functional.reduction == "min" else 1.0
    values = sign * functional.values(part.at_ends, known, duration)
    count = len(part.steps)
    values = np.broadcast_to(values, count + 1)
    largest = int(np.argmax(values))
    before, best = best, max(best, float(values[largest]))
    if count <= FEW or not np.all(np.isfinite(values)):
        return np.arange(count), best
    bend = np.abs(np.diff(values, 2))
    bend = np.concatenate([bend[:1], bend, bend[-1:]])  # repeated for the first and the last step
    wide = np.maximum(bend, np.maximum(np.append(bend[1:], 0.0), np.append(0.0, bend[:-1])))
    rise = POTENTIAL * np.maximum(wide[:-1], wide[1:])
    may_exceed = np.maximum(values[:-1], values[1:]) + rise > best
    may_exceed[min(largest, count - 1)] |= best > before  # one of many steps, if the quantity is constant over them
    return np.flatnonzero(may_exceed), best


#: Function that returns a scalar at shares of steps (G,) from the indices of the steps (G,) and the shares (G,).
_At = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _beside(share: np.ndarray) -> np.ndarray:
    """Return the shares 0 and `share` of G steps, (G, 2).

    The start is included because vectors are compared with their values there.
    """
    return np.stack([np.zeros_like(share), share], axis=1)


def _brackets(values: np.ndarray, at: _At) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return brackets of the roots of a scalar with samples (G, P), one row for each step.

    For each root, these are the index of the row, the shares before and after the root, and the values at these
    shares. If three samples approach zero without a change of sign, the vertex of the parabola through them is sampled
    as well.
    """
    a, b, c = values[:, :-2], values[:, 1:-1], values[:, 2:]
    dips = (a * b > 0.0) & (b * c > 0.0) & (np.abs(b) <= np.abs(a)) & (np.abs(b) <= np.abs(c)) & (a != c)
    group, middle = np.nonzero(dips)
    x, y, z = _PLACES[middle], _PLACES[middle + 1], _PLACES[middle + 2]
    fa, fb, fc = (part[group, middle] for part in (a, b, c))
    with np.errstate(all="ignore"):
        slope, next_slope = (fb - fa) / (y - x), (fc - fb) / (z - y)
        curve = (next_slope - slope) / (z - x)
        vertex = 0.5 * (x + y) - 0.5 * slope / curve
    near = (vertex > x) & (vertex < z) & (vertex != y)
    group, vertex = group[near], vertex[near]
    extra = at(group, vertex) if len(group) else np.zeros(0)
    crosses = extra * fb[near] < 0.0
    group, vertex, extra = group[crosses], vertex[crosses], extra[crosses]
    all_groups = np.concatenate([np.repeat(np.arange(len(values)), len(_PLACES)), group])
    places, samples = np.concatenate([np.tile(_PLACES, len(values)), vertex]), np.concatenate([values.ravel(), extra])
    order = np.lexsort((places, all_groups))
    all_groups, places, samples = all_groups[order], places[order], samples[order]
    changes = (all_groups[1:] == all_groups[:-1]) & (np.sign(samples[1:]) * np.sign(samples[:-1]) < 0.0)
    first = np.flatnonzero(changes)
    exact = np.flatnonzero((samples == 0.0) & (places > 0.0) & (places < 1.0))  # the sample itself is a root
    lower, upper = np.concatenate([first, exact]), np.concatenate([first + 1, exact])
    return all_groups[lower], places[lower], places[upper], samples[lower], samples[upper]


def _roots(
    group: np.ndarray, a: np.ndarray, b: np.ndarray, fa: np.ndarray, fb: np.ndarray, at: _At
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and shares of all roots, each between `a` and `b`, by the Illinois method with bisection.

    The roots are computed simultaneously.
    """
    a, b, fa, fb = a.copy(), b.copy(), fa.copy(), fb.copy()
    for iteration in range(MOST_ITERATIONS):
        open_ = np.flatnonzero((b - a > AT_ROOT) & (fa != 0.0) & (fb != 0.0))
        if not len(open_):
            break
        x, y, fx, fy = a[open_], b[open_], fa[open_], fb[open_]
        middle = 0.5 * (x + y) if iteration % 3 == 2 else (x * fy - y * fx) / (fy - fx)
        inside = np.clip(middle, x + 0.25 * AT_ROOT, y - 0.25 * AT_ROOT)
        value = at(group[open_], inside)
        left = value * fx > 0.0
        a[open_], fa[open_] = np.where(left, inside, x), np.where(left, value, np.where(value == 0.0, fx, 0.5 * fx))
        b[open_], fb[open_] = np.where(left, y, inside), np.where(left, 0.5 * fy, value)
        b[open_] = np.where(~np.isfinite(value), x, b[open_])
    return group, np.where(fa == 0.0, a, np.where(fb == 0.0, b, 0.5 * (a + b)))
