"""Selection of steps that certainly contain no event, for many steps at once.

`mbdkit.events.sampling` and `mbdkit.events.crossing` examine one step. Here, their conditions for further samples and
for crossings are evaluated on arrays of steps, or replaced by wider ones that are simpler. A step that meets none of
them needs no further examination.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mbdkit.engine.workspace import Workspace
from mbdkit.events.crossing import LOW
from mbdkit.events.event_expression import CompiledExpression, Function, RunExpression
from mbdkit.events.quantities import QuantityEvaluator
from mbdkit.events.sampling import INSIDE, LARGEST_TURN, NOISE, interpolation
from mbdkit.integrators.interface import ConsecutiveSteps
from mbdkit.quantities.quantity import Quantity

_PLACES = (0.0, *INSIDE, 1.0)

#: Relative margin of comparisons, which covers the different rounding errors of arrays and numbers.
MARGIN = 1e-6


def _control_points() -> np.ndarray:
    """Return the matrix (20, 5) that maps values at `_PLACES` to Bezier control points.

    These are the control points of the polynomial of degree 4 through the values, for each quarter of the step. The
    polynomial lies between the smallest and the largest of them.
    """
    x, powers = np.array(_PLACES), np.linalg.inv(np.vander(_PLACES, increasing=True))
    bernstein = [math.comb(4, k) * x**k * (1.0 - x) ** (4 - k) for k in range(5)]
    to_points = np.linalg.inv(np.array(bernstein).T)
    return np.vstack([to_points @ np.vander(begin + 0.25 * x, increasing=True) @ powers for begin in _PLACES[:-1]])


_CONTROL_POINTS = _control_points()
_ERRORS = interpolation(_PLACES)[1][::2]  #: (2, 5) matrix that yields the estimated errors of the polynomial.


class Screen:
    """Counts the steps before the first one that may contain an event.

    `workspace`: the workspace of the run. Pivots are chosen independently of it. `expressions`: expressions of the
    events. `places`: index of each of their quantities, from 1.
    """

    def __init__(self, workspace: Workspace, expressions: Sequence[RunExpression], places: Mapping[Quantity, int]):
        self._workspace, self._own = workspace, workspace.with_own_pivots()
        self._quantities = QuantityEvaluator(self._own, list(places))
        self._expressions = [expression.compiled(places, of_arrays=True) for expression in expressions]

    def clear_steps(self, states: ConsecutiveSteps, signs: list[int], largest: list[float]) -> int:
        """Return the number of steps before the first one that may contain an event.

        `states`: states at the start of the first step, and at the shares `INSIDE` and the end of each step. `signs`,
        `largest`: last non-zero sign and largest absolute value of each expression so far. They are replaced by those
        at the end of the clear steps.
        """
        self._own.clamp_motions(*self._workspace.scratch.sides)
        columns = self._quantities.columns(*states)
        known = [_by_step(expression.value, columns) for expression in self._expressions]
        clear = np.ones((len(known) + 1, len(known[0]) + 1), dtype=bool)
        clear[-1, -1] = False
        for number, (expression, values) in enumerate(zip(self._expressions, known, strict=True)):
            if not (now := signs[number]):
                nonzero = values[values != 0.0]
                now = -1 if len(nonzero) and nonzero[0] < 0.0 else 1
            clear[number, :-1] = _is_clear(now * values, largest[number]) & _is_even(expression, columns)
        count = int(np.argmin(np.all(clear, axis=0)))
        for number, values in enumerate(known):
            at_ends = np.sign(values[:count, [0, -1]]).ravel()
            signs[number] = int([signs[number], *at_ends[at_ends != 0.0]][-1])
            largest[number] = max(largest[number], float(np.max(np.abs(values[:count]), initial=0.0)))
        return count


def _by_step(function: Function, columns: Sequence[np.ndarray]) -> np.ndarray:
    """Return values (K, 5) of a function at the start of each of K steps, within it, and at its end.

    All are nan if an operation is undefined somewhere, such as 1/0, which is an error for numbers.
    """
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        values = np.broadcast_to(function(columns), columns[0].shape)
    return np.lib.stride_tricks.sliding_window_view(values, len(_PLACES))[:: len(_PLACES) - 1]


def _is_even(expression: CompiledExpression, columns: Sequence[np.ndarray]) -> np.ndarray:
    """Return whether each step needs no samples for phases and for kinks (K,)."""
    even = np.ones((len(columns[0]) - 1) // (len(_PLACES) - 1), dtype=bool)
    for phase in expression.phases:
        even &= np.all(np.abs(np.diff(_by_step(phase, columns))) <= LARGEST_TURN, axis=1)
    for argument in expression.breaks:
        values = _by_step(argument, columns)
        even &= _is_clear(np.where(values[:, :1] < 0.0, -values, values), 0.0)
    return even


@np.errstate(all="ignore")
def _is_clear(own: np.ndarray, largest: float) -> np.ndarray:
    """Return whether the scalar of an event stays away from zero in each step (K,); false if it is not finite.

    `own`: (K, 5) values of the scalar, multiplied by its last non-zero sign. `largest`: largest absolute value so far.
    """
    largest_in_step = np.max(np.abs(own), axis=1)
    # a polynomial whose values are larger than its error has no double root, nor has it a root between two samples
    is_away = np.min(own @ _CONTROL_POINTS.T, axis=1) > np.max(np.abs(own @ _ERRORS.T), axis=1)
    is_noise = largest_in_step <= NOISE * np.maximum(np.maximum.accumulate(largest_in_step), largest)
    # the extremum of the parabola through three values, which `crossings` examines
    a, b, c = own[:, :-2], own[:, 1:-1], own[:, 2:]
    bend = a - 2.0 * b + c
    dips = (bend > 0.0) & (np.abs(c - a) <= 2.0 * bend) & (b - (c - a) ** 2 / (8.0 * bend) < (LOW + MARGIN) * b)
    stays = np.isfinite(largest_in_step) & np.all(own >= 0.0, axis=1) & ~np.any(dips, axis=1)
    return np.asarray(stays & (is_noise | is_away))
