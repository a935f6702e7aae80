"""Pieces of functions of time: intervals over which a polynomial of degree 8 represents a function.

They tell how long a step may be without missing what a function does within it. As in Chebfun (Pachon, Platte and
Trefethen 2010, IMA J. Numer. Anal. 30, 898-916), the span of a run is bisected until the polynomial through
`NODES` Chebyshev points of each interval represents the function. Here it has to predict further samples, too. These
include the zeros and extrema of the operands of operations such as ``exp`` and ``tanh``: a feature that is far shorter
than those of the operand, such as a pulse, lies there. The pieces begin and end at these times, the *seeds*.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.frozen import dataclass
from mbdkit.expressions.jets import EPS, jet_and_switches
from mbdkit.expressions.program import Program
from mbdkit.mechanism.switching_times import seeds_of

NODES = 9  #: Number of points of a polynomial.

#: Largest deviation from the polynomial, as a share of the range of the function in the piece, and over the run.
LOCAL, FLOOR = 1e-2, 1e-6

#: Shares of a piece over which further polynomials determine the limits at a seed.
#:
#: A piece is represented up to `LOCAL`, and the first share 16^9 times better. Over the others, a jump has to persist.
SCALES = 16.0 ** -np.arange(1.0, 5.0)

LOOKS = 2000  #: Number of samples over a run that the polynomials have to predict.

#: Number of bisections after which a piece is not divided any further; the function practically jumps in it.
LEVELS = 34

MOST_PIECES = 20_000  #: If there are more pieces than this, they are not divided any further.

SMOOTH = 4  #: A function whose Chebyshev coefficients from this degree on are negligible does not limit steps.

SHARE = 0.5  #: Largest step, as a share of the length over which a polynomial represents a function.

#: Factor of `share_of_integrals`: the quadrature of a sine then has an error of one to seven times the tolerance.
OF_INTEGRALS = 1.5

#: Largest ratio of this length to that of a piece, whose polynomial would also represent the function farther away.
FARTHEST = 16.0

ALIKE = 4.0  #: Successive pieces that limit steps to sizes within this factor have one limit.

_ANGLES = np.pi * (np.arange(NODES) + 0.5) / NODES
UNIT_NODES = 0.5 - 0.5 * elementary.cos(_ANGLES)  #: Chebyshev points between 0 and 1, without the ends.
_TO_COEFFICIENTS = 2.0 / NODES * elementary.cos(np.outer(np.pi - _ANGLES, np.arange(NODES)))
_TO_COEFFICIENTS[:, 0] *= 0.5
_K = np.arange(NODES, dtype=float)
#: (NODES, 3) weights of the values at `UNIT_NODES` in value, rate and acceleration of the polynomial at 0.
AT_START = (_TO_COEFFICIENTS * (-1.0) ** _K) @ np.stack(
    [_K**0, -2.0 * _K**2, 4.0 * _K**2 * (_K**2 - 1.0) / 3.0], axis=1
)


@dataclass(frozen=True)
class Pieces:
    """The pieces of a function of time.

    - `ends`: (P + 1,) ends of the pieces [s].
    - `length`: (P,) length around each piece over which a polynomial represents the function; infinite at edges [s].
    - `is_plain`: (P,) whether the function is a cubic polynomial in the piece, so that it does not limit steps.
    - `seeds`: times between the start and the end of the run at which short features may lie [s].
    - `edges`: (E, 2) intervals in which the function practically jumps [s].
    """

    ends: np.ndarray
    length: np.ndarray
    is_plain: np.ndarray
    seeds: tuple[float, ...]
    edges: np.ndarray


@lru_cache(maxsize=64)
def pieces_of(program: Program, start: float, end: float) -> Pieces:
    """Return the pieces of a function of time from `start` to `end` [s]."""
    with np.errstate(all="ignore"):
        return _pieces_of(program, start, end)


def _pieces_of(program: Program, start: float, end: float) -> Pieces:
    seeds = seeds_of(program, start, end, LOOKS)

    def at(times: np.ndarray) -> np.ndarray:
        return np.asarray(jet_and_switches(program, times.ravel())[0].value).reshape(times.shape)

    def has_bend(seed: np.ndarray, length: np.ndarray) -> np.ndarray:
        """Return whether the rate at seeds as a limit from one side depends on the distance, as in a narrow bend."""
        limits, noise, scale = (x[..., 1] for x in limits_at(program, seed, length[:, None] * SCALES))
        scale = np.max(np.abs(limits), axis=1) + scale[:, 0]
        return np.asarray(~np.all(np.abs(np.diff(limits)) <= LOCAL * scale[:, None] + noise[:, 1:], axis=1))

    ends = np.array([start, *seeds, end])
    beside = 4.0 * EPS * max(abs(start), abs(end))
    looks = np.unique(np.concatenate([np.linspace(start, end, LOOKS), ends[1:-1] - beside, ends[1:-1] + beside]))
    seen = at(looks)
    finite = np.isfinite(seen)
    looks, seen = looks[finite], seen[finite]
    floor = FLOOR * float(np.ptp(seen)) + 64.0 * EPS * float(np.max(np.abs(seen))) if len(seen) else 0.0
    low, high, bent = ends[:-1], ends[1:], np.zeros(len(ends) - 1, dtype=bool)
    shortest = (end - start) * 0.5**LEVELS
    done: list[np.ndarray] = []
    count = 0
    while len(low):
        length = high - low
        values = at(low[:, None] + length[:, None] * UNIT_NODES)
        coefficients = values @ _TO_COEFFICIENTS
        place = np.searchsorted(low, looks, side="right") - 1
        within = (place >= 0) & (looks <= high[place])
        looks, seen, place = looks[within], seen[within], place[within]
        x = 2.0 * (looks - low[place]) / length[place] - 1.0
        predicted = np.polynomial.chebyshev.chebval(x, coefficients[place].T, tensor=False)
        deviation = np.sum(np.abs(coefficients[:, -2:]), axis=1)
        np.maximum.at(deviation, place, np.abs(predicted - seen))
        top, bottom = np.max(values, axis=1), np.min(values, axis=1)
        np.maximum.at(top, place, seen)
        np.minimum.at(bottom, place, seen)
        allowed = np.maximum(LOCAL * (top - bottom), floor)
        known = np.isfinite(deviation)
        good = (deviation <= allowed) | ~known
        begins, stops = np.isin(low, seeds), np.isin(high, seeds)
        for side, signed, at_seed in ((low, length, begins), (high, -length, stops)):
            check = np.flatnonzero(good & at_seed)
            good[check] = ~(bend := has_bend(side[check], signed[check]))
            bent[check] |= bend
        last = ~good & (length <= shortest)
        if count + 2 * len(low) > MOST_PIECES:
            good, last = np.ones_like(good), np.zeros_like(good)
        farther = length * np.clip((allowed / deviation) ** (1.0 / NODES), 1.0, FARTHEST)
        farther = np.where(last | ~known, np.inf, farther)
        is_plain = np.sum(np.abs(coefficients[:, SMOOTH:]), axis=1) <= allowed
        near = bent & (begins | stops) & ~last
        is_plain[near], farther[near] = False, length[near]
        taken = good | last
        done.append(np.stack([low, high, farther, last, is_plain], axis=1)[taken])
        count += int(np.sum(taken))
        low, high, bent = low[~taken], high[~taken], np.repeat(bent[~taken], 2)
        middle = 0.5 * (low + high)
        low, high = np.stack([low, middle], axis=1).ravel(), np.stack([middle, high], axis=1).ravel()
    table = np.concatenate(done)
    table = table[np.argsort(table[:, 0])]
    edges = table[table[:, 3] != 0.0, :2]
    return Pieces(np.append(table[:, 0], end), table[:, 2], table[:, 4] != 0.0, tuple(seeds), edges)


def limits_at(program: Program, times: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return value, rate and acceleration of a function as limits from one side, their rounding errors, and scales.

    Each polynomial goes through the values from one of `times` (K,) on, over one of its `sizes` (K, S), negative before
    it [s]. The arrays are (K, S, 3). Scales are the range of these values over the powers of the size.
    """
    beside = np.copysign(4.0 * EPS * np.maximum(np.abs(times), np.max(np.abs(sizes), axis=1))[:, None], sizes)
    at = (times[:, None] + beside)[..., None] + sizes[..., None] * UNIT_NODES
    jet = jet_and_switches(program, at.ravel())[0]
    values, rounding = jet.value.reshape(at.shape), np.max(jet.rounding.reshape(at.shape), axis=-1)
    powers = sizes[..., None] ** np.arange(3.0)
    with np.errstate(all="ignore"):
        noise = 10.0 * rounding[..., None] * np.sum(np.abs(AT_START), axis=0) / np.abs(powers)
        return values @ AT_START / powers, noise, np.ptp(values, axis=-1)[..., None] / np.abs(powers)


def share_of_integrals(rtol: float, order: float) -> float:
    """Return the largest step of a run with integrals by a method of an order, as a share of the length that a
    polynomial represents; `rtol` is its relative tolerance.
    """
    return min(SHARE, OF_INTEGRALS * float(elementary.pow(rtol, 1.0 / order)))


def step_limits(
    programs: Iterable[Program], start: float, end: float, most: int, share: float | None = None
) -> list[tuple[float, float]]:
    """Return the largest steps that do not miss what functions of time do, as pairs: from which time on, and step [s].

    There are at most `most` pairs, the first from `start` on; steps are to end where another limit begins. `share`:
    largest step as a share of the length over which a polynomial represents a function, for steps that are to integrate
    the function accurately.
    """
    ends, longest = np.array([start, end]), np.array([np.inf])
    for program in programs:
        pieces = pieces_of(program, start, end)
        sizes = np.where(pieces.is_plain, np.inf, SHARE * pieces.length)
        if share is not None:
            sizes = np.minimum(sizes, share * pieces.length)
        if np.any(sizes < end - start):
            both = np.union1d(ends, pieces.ends)
            within = 0.5 * (both[1:] + both[:-1])
            own, others = (x[np.searchsorted(at, within) - 1] for x, at in ((sizes, pieces.ends), (longest, ends)))
            ends, longest = both, np.minimum(own, others)
    if len(longest) == 1 and np.isinf(longest[0]):
        return []
    alike = ALIKE
    while True:
        limits: list[tuple[float, float]] = []
        least = most_of = 0.0
        for time, size in zip(ends[:-1].tolist(), np.minimum(longest, end - start).tolist(), strict=True):
            if limits and max(most_of, size) <= alike * min(least, size):
                least, most_of = min(least, size), max(most_of, size)
                limits[-1] = limits[-1][0], least
            else:
                least = most_of = size
                limits.append((time, size))
        if len(limits) <= most:
            return limits
        alike *= ALIKE
