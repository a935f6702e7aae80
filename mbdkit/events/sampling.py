"""Samples of an event's scalar within a step, so dense that sign changes between two samples are rarely missed.

The sampling starts with the quarters of the step and is refined in three ways.

1. Between two samples, the arguments of ``sin``, ``cos`` and ``tan`` change by at most `LARGEST_TURN`.
2. Where the argument of ``abs``, or the difference of the operands of ``min`` or ``max``, changes sign, a sample is
   added, because the scalar may have an extremum there. These sign changes are detected as in 3.
   The same is done where a factor of a product or quotient changes sign, so that its sign between these is known.
3. A polynomial p of degree 4 is fitted through every five consecutive samples between two positions of 2. Its error is
   estimated from two differences: between p and the polynomial of degree 3 through four of the samples, and between the
   latter and a polynomial of degree 2. Where both p and its derivative are smaller than their errors, there may be a
   double root, and samples are added between these five. Where p changes sign between two samples of equal sign, a
   sample is added where p is largest with the opposite sign.

States within the step are evaluated from dense output, which consists of polynomials of a degree up to 11. An
expression without poles and without large factors in its exponents is therefore smooth on this scale. `MOST_SAMPLES`
limits the number of samples.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import pairwise

import numpy as np

from mbdkit.engine.linear_systems import inverse_of, product
from mbdkit.events.crossing import UndefinedError, bracket_root, sign

INSIDE = (0.25, 0.5, 0.75)  #: Relative positions in a step at which dense output is evaluated first.

#: Accuracy of the positions of kinks, and largest distance of two kinks between which no samples are added, as shares
#: of the step.
KINK, SHORTEST = 1e-13, 1e-12

#: Largest change of the argument of a periodic function between two samples [rad]; a period has at least 6 samples.
LARGEST_TURN = 1.0

MOST_SAMPLES = 2000  #: Largest number of samples of one event in a step.

#: Largest number of refinements of the same five samples; otherwise, a scalar that touches zero would be refined
#: forever.
DEEPEST = 10

#: Values of the scalar below this share of its largest value so far count as rounding errors. No samples are added
#: between five samples with such values.
NOISE = 1e-12

#: Safety factor of the estimated errors of a polynomial, and weight of the second estimate (degree 3 against degree 2).
#:
#: With these values, crossings are missed for 6 of 1000 polynomials of degree 5 to 7 with roots distributed evenly over
#: 1.6 steps. With a factor of 2 and without the second estimate, crossings are missed for 47 of them, and the number of
#: samples is three quarters of that with these values.
SAFETY, LOWER_SHARE = 4.0, 0.1

Values = Sequence[float]
Scalar = Callable[[Values], float]
Point = tuple[float, Values]


def refined(
    points: Sequence[Point],
    values_at: Callable[[float], Values],
    scalar: Scalar,
    phases: Sequence[Scalar],
    breaks: Sequence[Scalar],
    largest: float,
    *,
    is_product: bool = False,
) -> list[tuple[float, float]]:
    """Return samples (position in the step, value) of a scalar in order, with samples added where they are needed.

    - `points`: positions in the step, from 0 to 1, with the values of the quantities there.
    - `values_at`: function that evaluates the quantities at a position, by dense output.
    - `scalar`: the scalar of the event as a function of the quantities.
    - `phases`, `breaks`: arguments of the periodic functions in the scalar; and scalars at whose sign changes the
      derivative of the scalar is discontinuous: arguments of its `abs`, and differences of the operands of its `min`
      and `max`.
    - `largest`: largest absolute value of the scalar so far.
    - `is_product`: whether the scalar changes its sign only where one of `breaks` does.
    """
    known = dict(points)

    def at(value: float) -> Values:
        if value not in known:
            known[value] = values_at(value)
        return known[value]

    for phase in phases:
        _divide(known, at, phase)
    kinks: list[float] = []
    for argument in breaks:  # in the order of the expression, so that kinks of an argument are known before its own
        for left, right in pairwise(_sample_between_kinks(known, at, argument, kinks, 0.0)):
            if sign(left[1]) * sign(right[1]) < 0:
                with suppress(UndefinedError):
                    (kink, _), _ = bracket_root(_compose(argument, values_at), left, right, KINK)
                    kinks.append(kink)
                    at(kink)
    return _sample_between_kinks(known, at, scalar, kinks, largest, deepest=0 if is_product else DEEPEST)


def _compose(scalar: Scalar, values_at: Callable[[float], Values]) -> Callable[[float], float]:
    return lambda theta: scalar(values_at(theta))


def _sample_between_kinks(
    known: dict[float, Values],
    at: Callable[[float], Values],
    scalar: Scalar,
    kinks: Sequence[float],
    largest: float,
    deepest: int = DEEPEST,
) -> list[tuple[float, float]]:
    """Return samples of a scalar that is smooth between its kinks, with samples added where they are needed.

    `known` are the quantities at positions, to which `at` adds. The same five samples are refined `deepest` times.
    """
    samples = {position: scalar(known[position]) for position in known}

    def value(position: float) -> float:
        if position not in samples:
            samples[position] = scalar(at(position))
        return samples[position]

    stack: list[tuple[list[float], int]] = []
    for begin, end in pairwise(sorted({0.0, *kinks, 1.0})):
        if end - begin <= SHORTEST:
            continue
        places = [position for position in sorted(known) if begin <= position <= end]
        stack += [(places[max(0, min(k, len(places) - 5)) :][:5], 0) for k in range(0, max(1, len(places) - 1), 4)]
    while stack and len(samples) < MOST_SAMPLES:
        five, depth = stack.pop()
        if len(five) < 5:
            five = np.linspace(five[0], five[-1], 5).tolist()
        values = [value(position) for position in five]
        largest = max(largest, *(abs(x) for x in values if math.isfinite(x)), 0.0)
        if not all(map(math.isfinite, values)) or max(map(abs, values)) <= NOISE * largest:
            continue
        is_clear, more = _roots_are_clear(five, values)
        if not is_clear and depth < deepest:
            nine = sorted({*five, *(0.5 * (a + b) for a, b in pairwise(five))})
            stack += [(nine[:5], depth + 1), (nine[4:], depth + 1)]
        else:
            for position in more:
                value(position)
    return sorted(samples.items())


def _divide(known: dict[float, Values], at: Callable[[float], Values], phase: Scalar) -> None:
    """Add samples until a phase changes by at most `LARGEST_TURN` between two of them."""
    todo = list(pairwise(sorted(known)))
    while todo and len(known) < MOST_SAMPLES:
        a, b = todo.pop()
        turn = abs(phase(known[b]) - phase(known[a])) / LARGEST_TURN
        parts = min(math.ceil(turn), MOST_SAMPLES - len(known)) if math.isfinite(turn) else 1
        if parts > 1 and b - a > 1e-9:
            places = [a, *(a + (b - a) * k / parts for k in range(1, parts)), b]
            for position in places[1:-1]:
                at(position)
            todo += pairwise(places)


@lru_cache(maxsize=256)
def interpolation(nodes: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrices that map five values at `nodes` (from 0 to 1) to their polynomial of degree 4 and its errors.

    The first matrix (5, 5) yields the coefficients of the polynomial in ascending powers. The rows of the second matrix
    (4, 5) yield four largest differences: of the polynomial from the cubic through all but the middle node, of their
    derivatives, of this cubic from the parabola through three nodes, and of their derivatives.
    """
    x = np.array(nodes)
    inverse = inverse_of(np.vander(x, increasing=True))
    fine = np.linspace(0.0, 1.0, 33)

    def largest(roots: np.ndarray) -> list[float]:
        # The difference of two interpolants is the leading coefficient of the one of higher degree, times this
        # polynomial.
        apart = fine[:, None] - roots
        slope = np.sum([np.prod(np.delete(apart, i, axis=1), axis=1) for i in range(len(roots))], axis=0)
        return [float(np.max(np.abs(values))) for values in (np.prod(apart, axis=1), slope)]

    outer = np.array([0, 1, 3, 4])
    cubic = np.zeros(5)
    cubic[outer] = inverse_of(np.vander(x[outer], increasing=True))[3]
    estimates = np.outer(largest(x[outer]), inverse[4]), LOWER_SHARE * np.outer(largest(x[::2]), cubic)
    return inverse, SAFETY * np.vstack(estimates)


def _roots_are_clear(five: Sequence[float], values: Sequence[float]) -> tuple[bool, list[float]]:
    """Return whether a scalar has no double root near five samples, and the positions of missing samples.

    A sample is missing at an extremum of the polynomial through the five samples if the sign there differs from the
    sign at a neighbouring sample. A double root is possible if an extremum of the polynomial is smaller than its error,
    or if the derivative may vanish near a root.
    """
    begin, width = five[0], five[-1] - five[0]
    nodes = [round((position - begin) / width, 9) for position in five]
    if min(b - a for a, b in pairwise(nodes)) < 1e-6:
        return True, []
    inverse, error = interpolation(tuple(nodes))
    f = np.array(values)
    value_error, slope_error = np.max(np.abs(product(error, f)).reshape(2, 2), axis=0).tolist()
    coefficients: list[float] = product(inverse, f).tolist()
    slope = _derivative(coefficients)
    places = sorted({*nodes, *_quadratic_roots(*_derivative(slope))})  # the slope is monotone between these places
    rates = [_polynomial(slope, position) for position in places]
    more = []
    for (a, left), (b, right) in pairwise(zip(places, rates, strict=True)):
        if left * right < 0.0:
            position = _extremum(slope, a, b, left, right)
        elif min(abs(left), abs(right)) <= slope_error:
            position = a if abs(left) <= abs(right) else b
        else:
            continue
        value = _polynomial(coefficients, position)
        if abs(value) <= value_error:
            return False, []
        k = min(bisect_right(nodes, position), 4)
        if value * values[k - 1] < 0.0 or value * values[k] < 0.0:
            more.append(begin + width * position)
    return True, more


def _derivative(coefficients: Sequence[float]) -> list[float]:
    return [k * c for k, c in enumerate(coefficients)][1:]


def _quadratic_roots(c: float, b: float, a: float) -> list[float]:
    """Return the roots of ``a x^2 + b x + c`` between 0 and 1."""
    square = b * b - 4.0 * a * c
    if square < 0.0:
        return []
    half = -0.5 * (b + math.copysign(math.sqrt(square), b))
    roots = [*([half / a] if a else []), *([c / half] if half else [])]
    return [x for x in roots if 0.0 < x < 1.0]


def _polynomial(coefficients: Sequence[float], x: float) -> float:
    total = 0.0
    for c in reversed(coefficients):
        total = total * x + c
    return total


def _extremum(slope: Sequence[float], a: float, b: float, left: float, right: float) -> float:
    """Return the root between `a` and `b` of a polynomial whose values there are `left` and `right`."""
    for _ in range(4):  # regula falsi with bisection
        for position in (a - left * (b - a) / (right - left), 0.5 * (a + b)):
            if not a < position < b:
                continue
            rate = _polynomial(slope, position)
            if rate * left > 0.0:
                a, left = position, rate
            elif rate == 0.0:
                return position
            else:
                b, right = position, rate
    return a - left * (b - a) / (right - left)
