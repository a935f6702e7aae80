"""Convex programmes of recruitment: what is minimised in each frame, subject to what; and the
interior-point method for the programmes of all frames at once.

Unknowns x, multipliers y of the equations, and multipliers of bounds and inequalities are advanced together by steps of
Newton's method for the optimality conditions (S. Mehrotra, SIAM J. Optim. 2:575-601, 1992). Unlike the unknowns as
functions of the multipliers, these conditions are smooth for p > 2 where an unknown is 0, such as the distance to a
target that is almost reached. With a cost of higher order, two things differ from Mehrotra's method:

- The curvature of the cost is that at the larger one of x and of the unknown that belongs to the multipliers. Steps
  from near 0, where the curvature at x vanishes, would be far too long.
- The products of slacks and multipliers stay above a share of the largest derivative of the Lagrangian, which steps
  reduce more slowly than for a quadratic cost. Otherwise, unknowns get stuck at bounds before the others are settled.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.linear_systems import least_norms, products


@dataclass(frozen=True)
class Programme:
    """Convex programmes of T frames with N unknowns and K equations.

    Attributes
    ----------
    matrix, right
        Coefficients (T, K, N) and right sides (T, K) of the equations.
    low, high
        (T, N) bounds; may be infinite.
    weight
        (N,) weights of the unknowns, positive.
    lowest
        (T, K) lowest multipliers: -inf for equations, 0 for inequalities ``matrix x >= right``.
    """

    matrix: np.ndarray
    right: np.ndarray
    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray
    lowest: np.ndarray = field(default_factory=lambda: np.array(-np.inf))

    def __post_init__(self) -> None:
        object.__setattr__(self, "lowest", np.broadcast_to(self.lowest, self.right.shape))

    @property
    def size(self) -> np.ndarray:
        """Size (T, K) of each equation: magnitude of its right side, and sum of the magnitudes of its terms with all
        unknowns at their finite upper bounds.
        """
        largest = np.where(np.isfinite(self.high), np.abs(self.high), 0.0)
        size: np.ndarray = np.abs(self.right) + products(np.abs(self.matrix), largest)
        return np.where(size > 0, size, 1.0)

    def only(self, rows: np.ndarray) -> Programme:
        """Return the programmes of a selection of frames."""
        arrays = {name: getattr(self, name)[rows] for name in ("matrix", "right", "low", "high", "lowest")}
        return replace(self, **arrays)

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Return what the equations lack (T, K) with unknowns (T, N)."""
        return np.asarray(self.right - products(self.matrix, x))


def slope_of_cost(x: np.ndarray, p: float) -> np.ndarray:
    """Return the derivatives of the costs ``|x|^p``."""
    return np.asarray(p * np.sign(x) * elementary.pow(np.abs(x), p - 1))


#: Largest number of steps. 10 to 15 are usual; none of 4,944 programmes of a walk with 3 to 20 channels of EMG needed
#: more than 27 for exponents of 3 and 4, and all but one of 4,944 ended for an exponent of 8.
STEPS = 200
#: Least mean product of slacks and multipliers that a step aims at, relative to the largest derivative of the
#: Lagrangian.
CENTERED = 1e-3
#: Largest residual, and mean product of slacks and multipliers, relative to derivatives of the cost, at which a frame
#: ends.
ENDED = 1e-14
INSIDE = 0.1  #: Distance from bounds at the start, relative to that of both bounds, or to 1 if there is one.
#: Least derivative of the cost to which errors are relative, least slack, and regularisation of the Jacobian with a
#: diagonal of 1.
SIZE, LEAST, ROUNDING = 1e-200, 1e-15, 1e-14
SHARE = 0.99  #: Share of the step to the nearest bound that is made.

#: Unknowns (T, N), multipliers (T, K) of the equations, those (T, 2 N + K) of lower bounds, upper bounds and
#: inequalities, and slacks (T, K) of the inequalities.
State = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def near_optimum(own: Programme, x: np.ndarray, y: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray]:
    """Return unknowns (T, N) and multipliers (T, K) near the optimum, for weights of 1 and p > 1.

    `x`, `y` are estimates of them. Frames without solution diverge.
    """
    has, is_free, count = _has(own), own.low < own.high, x.shape[1]
    inside = INSIDE * np.where(has[:, :count] & has[:, count : 2 * count], own.high - own.low, 1.0)
    x = np.where(is_free, np.maximum(np.minimum(x, own.high - inside), own.low + inside), own.low)
    size = np.maximum(np.max(np.abs(slope_of_cost(x, p)), axis=1, keepdims=True), SIZE)
    y = np.where(has[:, 2 * count :], np.maximum(y, size), y)
    z = np.hstack([np.where(has, size, 0.0)[:, : 2 * count], np.where(has[:, 2 * count :], y, 0.0)])
    state = x, y, z, np.where(has[:, 2 * count :], np.maximum(-own.residual(x), INSIDE), 0.0)
    found, left, programme = [part.copy() for part in state], np.arange(len(x)), own
    for _ in range(STEPS):
        state, error = _step(own, state, p)
        for whole, part in zip(found, state, strict=True):
            whole[left] = part
        on = np.flatnonzero(error > ENDED)
        if len(on) < len(left):
            left, own = left[on], own.only(on)
            state = tuple(part[on] for part in state)  # type: ignore[assignment]
        if not len(left):
            break
    x, y, z, slack = found
    z = z / np.maximum(np.max(np.abs(slope_of_cost(x, p)), axis=1, keepdims=True), SIZE)
    at_low = has[:, :count] & (z[:, :count] > x - programme.low)
    at_high = has[:, count : 2 * count] & (z[:, count : 2 * count] > programme.high - x)
    x = np.where(at_low, programme.low, np.where(at_high, programme.high, x))
    return x, np.where(has[:, 2 * count :] & (z[:, 2 * count :] < slack), 0.0, y)


def _has(own: Programme) -> np.ndarray:
    """Return which multipliers exist (T, 2 N + K): those of finite bounds of unknowns that can change, and of
    inequalities.
    """
    is_free = own.low < own.high
    return np.hstack([np.isfinite(own.low) & is_free, np.isfinite(own.high) & is_free, np.isfinite(own.lowest)])


def _step(own: Programme, state: State, p: float) -> tuple[State, np.ndarray]:
    """Return the state after a step, and the errors (T,) before it, see `ENDED`."""
    x, y, z, beyond = state
    has, is_free, transposed = _has(own), own.low < own.high, np.swapaxes(own.matrix, 1, 2)
    is_unequal, places = np.isfinite(own.lowest), range(y.shape[1])
    split = x.shape[1], 2 * x.shape[1]
    slack = np.where(has, np.maximum(np.hstack([x - own.low, own.high - x, beyond]), LEAST), 1.0)
    above, below, _ = np.split(z, split, axis=1)
    derivative, cost = products(transposed, y) + above - below, slope_of_cost(x, p)
    dual, primal = np.where(is_free, derivative - cost, 0.0), own.residual(x) + beyond
    wrong, size = (np.max(np.abs(part), axis=1, keepdims=True) for part in (dual, np.hstack([derivative, cost])))
    terms = np.maximum(np.sum(has, axis=1, keepdims=True), 1)
    gap, size = np.sum(slack * z, axis=1, keepdims=True) / terms, np.maximum(size, SIZE)
    error = np.maximum(np.maximum(wrong, gap) / size, np.max(np.abs(primal), axis=1, keepdims=True))[:, 0]

    larger = np.maximum(np.abs(x), elementary.pow(np.abs(derivative) / p, 1.0 / (p - 1.0)))
    stiff = np.split(z / slack, split, axis=1)
    curvature = p * (p - 1.0) * elementary.pow(larger, p - 2.0) + stiff[0] + stiff[1]
    gives = np.where(is_free, 1.0 / np.maximum(curvature, 1e-300), 0.0)
    jacobian = products(own.matrix * gives[:, None], transposed)
    jacobian[:, places, places] += np.where(is_unequal, beyond / np.where(is_unequal, y, 1.0), 0.0)
    scale = np.sqrt(np.maximum(jacobian[:, places, places], 1e-300))
    jacobian /= scale[:, :, None] * scale[:, None]
    jacobian[:, places, places] += ROUNDING

    def change(target: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return changes of unknowns, multipliers, slacks and their multipliers after which products of the last two
        are `target` (T, 2 N + K) to first order.
        """
        push, pull, _ = np.split(np.where(has, target / slack, 0.0) - z, split, axis=1)
        first = dual + push - pull
        second = primal + np.where(is_unequal, target[:, split[1] :] / np.where(is_unequal, y, 1.0) - beyond, 0.0)
        dy = least_norms(jacobian, (second - products(own.matrix, gives * first)) / scale, 0.0) / scale
        dx = gives * (first + products(transposed, dy))
        ds = np.hstack([dx, -dx, np.where(is_unequal, products(own.matrix, dx) - primal, 0.0)])
        return dx, dy, ds, np.where(has, (target - z * ds) / slack - z, 0.0)

    def longest(ds: np.ndarray, dz: np.ndarray) -> np.ndarray:
        """Return the longest step (T, 1) that keeps slacks and multipliers positive."""
        shares = [np.where(has & (d < 0), -v / d, np.inf) for v, d in ((slack, ds), (z, dz))]
        return np.asarray(np.min(np.hstack(shares), axis=1, keepdims=True))

    *_, ds, dz = change(np.zeros_like(z))
    length = np.minimum(1.0, longest(ds, dz))
    after = np.sum(np.where(has, (slack + length * ds) * (z + length * dz), 0.0), axis=1, keepdims=True) / terms
    center = np.maximum(gap * elementary.pow(np.maximum(after, 0.0) / np.maximum(gap, 1e-300), 3.0), CENTERED * wrong)
    dx, dy, ds, dz = change(np.where(has, center - ds * dz, 0.0))
    length = np.minimum(1.0, SHARE * longest(ds, dz))
    x, y, z, beyond = (a + length * d for a, d in zip(state, (dx, dy, dz, ds[:, split[1] :]), strict=True))
    z[:, split[1] :] = np.where(is_unequal, y, 0.0)
    return (x, y, z, beyond), error
