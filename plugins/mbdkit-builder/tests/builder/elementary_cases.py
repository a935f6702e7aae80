"""The elementary functions of the machine code: arguments for tests, special values, and errors against MPFR.

A new function is one entry of `CASES`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gmpy2
import numpy as np

Draw = Callable[[np.random.Generator, int], np.ndarray]
INF, NAN, PI = math.inf, math.nan, math.pi
MPFR = gmpy2.context(precision=150, emin=-20_000, emax=20_000)


def everywhere(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return finite doubles with random bits, so that all exponents are equally probable."""
    x = rng.integers(-(2**63), 2**63 - 1, count).view(np.float64)
    return np.where(np.isfinite(x), x, 0.5)


def tiny(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return subnormal numbers."""
    return rng.integers(-(2**52), 2**52, count) * 5e-324


def between(low: float, high: float) -> Draw:
    """Return a function that draws from an interval."""
    return lambda rng, count: rng.uniform(low, high, count)


def near(*points: float) -> Draw:
    """Return a function that draws numbers whose distances from one of these points are of all sizes."""

    def draw(rng: np.random.Generator, count: int) -> np.ndarray:
        distances = rng.choice([-1.0, 1.0], count) * 2.0 ** rng.uniform(-60, -1, count)
        return rng.choice(points, count) + distances

    return draw


def near_right_angles(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return the doubles next to multiples of pi/2, up to 2^17 of them, and some of their neighbours."""
    x = rng.integers(-(2**17), 2**17, count) * (PI / 2)
    return x + rng.integers(-2, 3, count) * np.spacing(x)


def multiples(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return small integers."""
    return rng.integers(-20, 21, count).astype(float)


def positive(draw: Draw) -> Draw:
    """Return a function that draws the absolute values."""
    return lambda rng, count: np.abs(draw(rng, count))


def at_least(low: float, draw: Draw) -> Draw:
    """Return a function that reflects numbers at `low` if they are below it."""
    return lambda rng, count: low + np.abs(draw(rng, count) - low)


@dataclass(frozen=True)
class Case:
    """A function with its arguments.

    Parameters
    ----------
    draws
        What arguments are drawn from, each for an equal share.
    exact
        The function in MPFR.
    special
        Arguments and the value that IEEE 754 or Annex F of C99 demands.
    symmetry
        -1 for odd functions, 1 for even ones, otherwise 0; with respect to the first argument.
    second
        What second arguments are drawn from.
    """

    draws: Sequence[Draw]
    exact: Callable[..., Any]
    special: Sequence[tuple[tuple[float, ...], float]]
    symmetry: int = 0
    second: Sequence[Draw] = ()

    def arguments(self, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Return first and second arguments, the latter equal to 1 for functions of one argument."""
        rng = np.random.default_rng(seed)
        x = _drawn(rng, self.draws, count)
        return x, rng.permutation(_drawn(rng, self.second, count)) if self.second else np.ones(count)


def _drawn(rng: np.random.Generator, draws: Sequence[Draw], count: int) -> np.ndarray:
    share = -(-count // len(draws))
    return np.concatenate([draw(rng, share) for draw in draws])[:count]


def largest_error(case: Case, x: np.ndarray, y: np.ndarray, values: np.ndarray) -> tuple[float, tuple[float, float]]:
    """Return the largest error of values in units of the last place, and the arguments where it occurs.

    Results that are not finite count as infinitely wrong, unless the exact value is not finite or overflows.
    """
    worst, where = 0.0, (NAN, NAN)
    arguments = zip(x.tolist(), y.tolist(), values.tolist(), strict=True)
    with gmpy2.context(MPFR):
        beyond = gmpy2.mpfr(2) ** 1024
        for a, b, value in arguments:
            exact = case.exact(gmpy2.mpfr(a), gmpy2.mpfr(b)) if case.second else case.exact(gmpy2.mpfr(a))
            if not gmpy2.is_finite(exact):
                error = 0.0 if value == exact or (value != value and gmpy2.is_nan(exact)) else INF
            else:
                unit = math.ulp(min(abs(float(exact)), 1.7976931348623157e308))
                value_ = math.copysign(1.0, value) * max(beyond, abs(exact)) if math.isinf(value) else gmpy2.mpfr(value)
                error = float(abs(value_ - exact) / unit)
                error = INF if error != error else error
            if error > worst:
                worst, where = error, (a, b)
    return worst, where


_ODD_ZERO = [((0.0,), 0.0), ((-0.0,), -0.0)]
_NO_LIMIT = [((INF,), NAN), ((-INF,), NAN), ((NAN,), NAN)]
_ANGLES = (everywhere, tiny, between(-PI / 4, PI / 4), between(-8.0, 8.0), between(-1e5, 1e5), near_right_angles)
_UNIT = (tiny, between(-1.0, 1.0), near(0.0), near(-0.5, 0.5), lambda rng, n: np.clip(near(-1.0, 1.0)(rng, n), -1, 1))
_ANY = (everywhere, tiny, between(-4.0, 4.0), near(-1.0, 1.0), near(0.0), multiples)
_PAIRS = [*_ANY, between(1.0, 2.0)]
_NOTHING_NEGATIVE = [((-1.0,), NAN), ((-5e-324,), NAN), ((-INF,), NAN), ((NAN,), NAN), ((INF,), INF)]
_LOGARITHM = [((1.0,), 0.0), ((0.0,), -INF), ((-0.0,), -INF), *_NOTHING_NEGATIVE]
_ODD_UNBOUNDED = [*_ODD_ZERO, ((INF,), INF), ((-INF,), -INF), ((NAN,), NAN), ((5e-324,), 5e-324)]
_POSITIVE = (positive(everywhere), positive(tiny), between(0.5, 2.0), near(1.0), near(0.5**0.5, 2**0.5))
_HYPERBOLIC = (between(-711.0, 711.0), between(-2.0, 2.0), near(0.0, 2.0**-28), near(710.4758600739439), tiny)
_GAMMA = (between(0.0, 172.0), between(0.0, 10.0), near(*range(20)), near(171.6), positive(tiny))

CASES = {
    "acos": Case(
        _UNIT, gmpy2.acos,
        [((1.0,), 0.0), ((-1.0,), PI), ((0.0,), PI / 2), ((1.0 + 2**-52,), NAN), ((-2.0,), NAN), *_NO_LIMIT],
    ),
    "asin": Case(
        _UNIT, gmpy2.asin,
        [((1.0,), PI / 2), ((-1.0,), -PI / 2), ((1.0 + 2**-52,), NAN), ((-2.0,), NAN), *_ODD_ZERO, *_NO_LIMIT], -1,
    ),
    "atan": Case(_ANY, gmpy2.atan, [((INF,), PI / 2), ((-INF,), -PI / 2), ((NAN,), NAN), *_ODD_ZERO], -1),
    "atan2": Case(
        _PAIRS, gmpy2.atan2,
        [
            ((0.0, -0.0), PI), ((-0.0, -0.0), -PI), ((0.0, 0.0), 0.0), ((-0.0, 0.0), -0.0), ((0.0, -1.0), PI),
            ((-0.0, -1.0), -PI), ((0.0, 1.0), 0.0), ((-0.0, 1.0), -0.0), ((-1.0, 0.0), -PI / 2),
            ((-1.0, -0.0), -PI / 2), ((1.0, 0.0), PI / 2), ((1.0, -0.0), PI / 2), ((1.0, -INF), PI),
            ((-1.0, -INF), -PI), ((1.0, INF), 0.0), ((-1.0, INF), -0.0), ((INF, 1.0), PI / 2), ((-INF, -1.0), -PI / 2),
            ((INF, -INF), 3 * PI / 4), ((-INF, -INF), -3 * PI / 4), ((INF, INF), PI / 4), ((-INF, INF), -PI / 4),
            ((NAN, 1.0), NAN), ((1.0, NAN), NAN), ((NAN, INF), NAN), ((INF, NAN), NAN),
        ],
        -1, _PAIRS,
    ),
    "cos": Case(_ANGLES, gmpy2.cos, [((0.0,), 1.0), ((-0.0,), 1.0), *_NO_LIMIT], 1),
    "fmod": Case(
        _PAIRS, gmpy2.fmod,
        [
            ((0.0, 3.0), 0.0), ((-0.0, 3.0), -0.0), ((INF, 1.0), NAN), ((1.0, 0.0), NAN), ((1.0, -0.0), NAN),
            ((1.0, INF), 1.0), ((-1.0, -INF), -1.0), ((6.0, 3.0), 0.0), ((-6.0, 3.0), -0.0), ((-7.0, -4.0), -3.0),
            ((NAN, 1.0), NAN), ((1.0, NAN), NAN), ((5e-324, 1.0), 5e-324), ((1e308, 5e-324), 0.0),
        ],
        -1, _PAIRS,
    ),
    "hypot": Case(
        _PAIRS, gmpy2.hypot,
        [
            ((INF, NAN), INF), ((NAN, -INF), INF), ((-INF, 1.0), INF), ((0.0, -0.0), 0.0), ((-3.0, 4.0), 5.0),
            ((NAN, 1.0), NAN), ((1.0, NAN), NAN), ((1.5e308, 1.5e308), INF), ((-0.0, -5e-324), 5e-324),
        ],
        1, _PAIRS,
    ),
    "sin": Case(_ANGLES, gmpy2.sin, [*_ODD_ZERO, *_NO_LIMIT, ((5e-324,), 5e-324)], -1),
    "tan": Case(_ANGLES, gmpy2.tan, [*_ODD_ZERO, *_NO_LIMIT, ((5e-324,), 5e-324)], -1),
    "acosh": Case(
        (between(1.0, 3.0), at_least(1.0, near(1.0)), at_least(1.0, everywhere), near(2.0**28)), gmpy2.acosh,
        [((1.0,), 0.0), ((1.0 - 2**-53,), NAN), ((0.0,), NAN), ((-1.0,), NAN), *_NOTHING_NEGATIVE],
    ),
    "asinh": Case((*_ANY, near(2.0**28, 2.0**-28)), gmpy2.asinh, _ODD_UNBOUNDED, -1),
    "atanh": Case(
        (*_UNIT[:3], lambda rng, n: np.clip(near(-1.0, 1.0)(rng, n), -1 + 2**-53, 1 - 2**-53)), gmpy2.atanh,
        [((1.0,), INF), ((-1.0,), -INF), ((1.0 + 2**-52,), NAN), ((-2.0,), NAN), *_ODD_ZERO, *_NO_LIMIT], -1,
    ),
    "cosh": Case(
        _HYPERBOLIC, gmpy2.cosh, [((0.0,), 1.0), ((INF,), INF), ((-INF,), INF), ((NAN,), NAN), ((711.0,), INF)], 1,
    ),
    "erf": Case(
        (between(-6.0, 6.0), between(-1.0, 1.0), near(0.0, 0.5, -1.25, 3.0), tiny), gmpy2.erf,
        [*_ODD_ZERO, ((INF,), 1.0), ((-INF,), -1.0), ((6.0,), 1.0), ((NAN,), NAN)], -1,
    ),
    "erfc": Case(
        (between(-6.0, 28.0), between(-1.0, 1.0), near(0.0, 0.5, -1.25, 3.0), between(26.0, 28.0), tiny), gmpy2.erfc,
        [((0.0,), 1.0), ((-0.0,), 1.0), ((INF,), 0.0), ((-INF,), 2.0), ((28.0,), 0.0), ((NAN,), NAN)],
    ),
    "exp": Case(
        (between(-746.0, 710.0), between(-1.0, 1.0), near(0.0, 709.78, -708.39, -745.13), tiny), gmpy2.exp,
        [
            ((0.0,), 1.0), ((-0.0,), 1.0), ((INF,), INF), ((-INF,), 0.0), ((NAN,), NAN), ((710.0,), INF),
            ((-746.0,), 0.0),
        ],
    ),
    "expm1": Case(
        (between(-60.0, 710.0), between(-1.0, 1.0), near(0.0, 709.78), tiny), gmpy2.expm1,
        [*_ODD_ZERO, ((INF,), INF), ((-INF,), -1.0), ((NAN,), NAN), ((710.0,), INF), ((-800.0,), -1.0)],
    ),
    "lgamma": Case(
        (*_GAMMA, positive(everywhere), near(1.0, 2.0), between(1e305, 2.55634816e305)), lambda x: gmpy2.lgamma(x)[0],
        [
            ((1.0,), 0.0), ((2.0,), 0.0), ((0.0,), INF), ((-0.0,), INF), ((-3.0,), INF), ((-1e300,), INF),
            ((INF,), INF), ((-INF,), INF), ((NAN,), NAN), ((3.0,), math.log(2.0)), ((1.7e308,), INF),
        ],
    ),
    "log": Case(_POSITIVE, gmpy2.log, _LOGARITHM),
    "log10": Case(_POSITIVE, gmpy2.log10, [*_LOGARITHM, *(((float(f"1e{n}"),), float(n)) for n in range(23))]),
    "log1p": Case(
        (between(-1.0, 2.0), positive(everywhere), near(0.0, 2**0.5 - 1), at_least(-1.0, near(-1.0)), tiny),
        gmpy2.log1p,
        [*_ODD_ZERO, ((-1.0,), -INF), ((-1.0 - 2**-52,), NAN), ((INF,), INF), ((-INF,), NAN), ((NAN,), NAN)],
    ),
    "log2": Case(_POSITIVE, gmpy2.log2, [*_LOGARITHM, *(((2.0**n,), float(n)) for n in (-1074, -1022, -1, 1, 1023))]),
    "pow": Case(
        _POSITIVE, lambda x, y: x**y,
        [
            *(((x, y), 1.0) for x in (NAN, INF, -INF, 0.0, -1.5) for y in (0.0, -0.0)),
            *(((1.0, y), 1.0) for y in (NAN, INF, -INF, 1e300)), *(((-1.0, y), 1.0) for y in (INF, -INF, 2.0, 1e300)),
            ((-1.0, 3.0), -1.0), ((-1.0, 2.0**53 - 1), -1.0), ((-2.0, 0.5), NAN), ((-2.0, 3.0), -8.0),
            ((-0.5, -2.0), 4.0), ((0.0, 3.0), 0.0), ((-0.0, 3.0), -0.0), ((0.0, 2.5), 0.0), ((-0.0, 2.0), 0.0),
            ((-0.0, 2.5), 0.0), ((0.0, -3.0), INF), ((-0.0, -3.0), -INF), ((-0.0, -2.0), INF), ((-0.0, -2.5), INF),
            ((0.0, -INF), INF), ((INF, 2.0), INF), ((INF, -2.0), 0.0), ((-INF, 3.0), -INF), ((-INF, 2.0), INF),
            ((-INF, 2.5), INF), ((-INF, -3.0), -0.0), ((-INF, -2.0), 0.0), ((-INF, -2.5), 0.0), ((2.0, INF), INF),
            ((2.0, -INF), 0.0), ((-0.5, INF), 0.0), ((-0.5, -INF), INF), ((0.0, INF), 0.0), ((NAN, 1.0), NAN),
            ((2.0, NAN), NAN), ((-2.0, NAN), NAN), ((INF, INF), INF), ((-INF, -INF), 0.0), ((10.0, 22.0), 1e22),
            ((3.0, 33.0), 3.0**33), ((2.0, 1023.0), 2.0**1023), ((2.0, -1074.0), 5e-324), ((2.0, 1024.0), INF),
            ((2.0, -1076.0), 0.0), ((-2.0, -1077.0), -0.0), ((2.25, 0.5), 1.5), ((6.25, 1.5), 15.625),
            ((1.0 + 2**-52, 1e300), INF), ((1.0 - 2**-53, 1e300), 0.0), ((5e-324, -1.0), INF), ((-5.0, 1e300), INF),
        ],
        0, (between(-10.0, 10.0), between(-1.0, 1.0), multiples, near(0.0), between(-1000.0, 1000.0)),
    ),
    "sinh": Case(_HYPERBOLIC, gmpy2.sinh, _ODD_UNBOUNDED, -1),
    "tanh": Case(
        (between(-23.0, 23.0), between(-2.0, 2.0), near(0.0, 2.0**-28, 22.0), tiny), gmpy2.tanh,
        [*_ODD_ZERO, ((INF,), 1.0), ((-INF,), -1.0), ((NAN,), NAN), ((5e-324,), 5e-324)], -1,
    ),
    "tgamma": Case(
        (*_GAMMA, between(-184.0, 0.0), between(-3.0, 3.0), near(*(-1.0 * n for n in range(1, 170, 7)))), gmpy2.gamma,
        [
            *(((float(n),), float(math.factorial(n - 1))) for n in range(1, 24)), ((0.0,), INF), ((-0.0,), -INF),
            ((-1.0,), NAN), ((-1e300,), NAN), ((INF,), INF), ((-INF,), NAN), ((NAN,), NAN), ((172.0,), INF),
            ((-184.5,), -0.0), ((-185.5,), 0.0), ((-1e9 - 0.5,), -0.0), ((5e-324,), INF), ((-5e-324,), -INF),
        ],
    ),
}  # fmt: skip
"""Cases by the name of the function in the C library."""
