"""Recruitment of muscles whose activations change no faster than activation dynamics allow.

The programmes of all frames then form a single convex programme. Activations follow first-order dynamics with time
constants `rise` and `fall`, and excitations are between 0 and 1. An activation a in one frame, and a_next in the next
frame after the time h, therefore satisfy

    a_next >= a exp(-h / fall),    1 - a_next >= (1 - a) exp(-h / rise).

These inequalities are linear, like the inequalities for derivatives of activations by F. De Groote et al., Computer
Methods in Biomechanics and Biomedical Engineering 12:563-574, 2009. A primal-dual interior-point method with Mehrotra's
corrector determines which inequalities hold with equality. Newton's method, with these inequalities as equations, then
removes the error of the interior-point method.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import block_array, block_diag, coo_array, csc_array, csr_array, diags_array, eye_array, vstack

from mbdkit.base import elementary
from mbdkit.engine.linear_systems import SparseFactors
from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme, slope_of_cost
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import SOLVED, Shared

ITERATIONS = 80  #: Largest number of iterations of the interior-point method; 15 to 25 are usual.
#: Mean product of slacks and multipliers below which the interior-point method ends, if its residuals are small too.
GAP = 1e-13
POLISHED = 6  #: Number of Newton iterations in which active inequalities are equations.
#: Entries of the diagonal are preferred as pivots if they have this share of the largest entry of their column.
PIVOT = 0.1
REGULAR = 1e-11  #: Regularisation of the matrices; its effect is removed by iterative refinement.


@dataclass(frozen=True)
class ActivationDynamics:
    """Bounds of activations between frames.

    Attributes
    ----------
    falling, rising
        (T - 1, M) factors ``exp(-h / fall)`` and ``exp(-h / rise)`` of the first M unknowns.
    """

    falling: np.ndarray
    rising: np.ndarray

    @classmethod
    def of(cls, time: np.ndarray, fall: np.ndarray, rise: np.ndarray) -> ActivationDynamics:
        """Return the bounds for frames at times (T,) and time constants (M,) [s]."""
        step = np.diff(time)[:, None]
        return cls(elementary.exp(-step / fall), elementary.exp(-step / rise))


@dataclass(frozen=True)
class _Whole:
    """The problem: minimise the sum of ``|x|^p`` subject to ``equal x = right`` and ``less x <= most``.

    The unknowns x are divided by their weights.
    """

    equal: csr_array
    right: np.ndarray
    less: csr_array
    most: np.ndarray
    exponent: float

    def curvature(self, x: np.ndarray) -> np.ndarray:
        values: np.ndarray = self.exponent * (self.exponent - 1) * elementary.pow(np.abs(x), self.exponent - 2)
        return np.asarray(np.maximum(values, 1e-9))


def share_over_time(programme: Programme, exponent: float, dynamics: ActivationDynamics, start: np.ndarray) -> Shared:
    """Solve the programme of all frames with activation dynamics.

    Parameters
    ----------
    exponent
        p > 1, finite.
    start
        (T, N) solutions of the single frames, without activation dynamics.

    Returns
    -------
    Shared
        The solution, whose certificates include the inequalities between frames. They are infinite if there is no
        solution.
    """
    whole = _whole(programme, exponent, dynamics)
    weight = np.tile(programme.weight, len(programme.right))
    x, y, z = _interior(whole, np.ravel(start) / weight)
    x, y, z = _polished(whole, x, y, z)
    shape = programme.low.shape
    certificate = _certificate(whole, x, y, z, len(programme.right))
    certificate = np.where(np.max(certificate) <= SOLVED, certificate, np.inf)
    return Shared((x * weight).reshape(shape), certificate, -y.reshape(programme.right.shape) / programme.size)


def _whole(programme: Programme, exponent: float, dynamics: ActivationDynamics) -> _Whole:
    """Return the programme of all frames, with equations divided by their sizes."""
    frames, _, count = programme.matrix.shape
    weight = np.tile(programme.weight, frames)
    less, most = _between(programme, dynamics)
    array = eye_array(frames * count, format="csr")
    rows, limits = [less @ diags_array(weight)], [most]
    for side, bound in ((-1.0, programme.low), (1.0, programme.high)):
        known = np.flatnonzero(np.isfinite(np.ravel(bound)))
        rows.append(side * array[known])
        limits.append(side * (np.ravel(bound) / weight)[known])
    equal = block_diag(list(programme.matrix * programme.weight / programme.size[..., None]), format="csr")
    right = np.ravel(programme.right / programme.size)
    return _Whole(csr_array(equal), right, csr_array(vstack(rows)), np.concatenate(limits), exponent)


def _between(programme: Programme, dynamics: ActivationDynamics) -> tuple[csr_array, np.ndarray]:
    """Return the inequalities between frames, ``less x <= most``."""
    frames, _, count = programme.matrix.shape
    steps, muscles = dynamics.falling.shape
    place = (np.arange(steps)[:, None] * count + np.arange(muscles)).ravel()
    rows = np.tile(np.arange(len(place)), 2)
    columns, one = np.concatenate([place, place + count]), np.ones(len(place))
    shape = (len(place), frames * count)
    falling = csr_array((np.concatenate([dynamics.falling.ravel(), -one]), (rows, columns)), shape=shape)
    rising = csr_array((np.concatenate([-dynamics.rising.ravel(), one]), (rows, columns)), shape=shape)
    return csr_array(vstack([falling, rising])), np.concatenate([0 * one, 1 - dynamics.rising.ravel()])


def _interior(whole: _Whole, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unknowns and multipliers of equations and inequalities near the solution."""
    slack = np.maximum(whole.most - whole.less @ x, 0.1)
    one = _Iterate(whole, x, np.zeros(len(whole.right)), slack, np.full(len(slack), 0.1))
    for _ in range(ITERATIONS):
        if one.gap < GAP and one.residual < 1e-10:
            break
        ahead = one.step(one.slack * one.z)
        length = min(_longest(one.slack, ahead.slack), _longest(one.z, ahead.z), 1.0)
        left = float(np.mean((one.slack + length * ahead.slack) * (one.z + length * ahead.z)))
        center = elementary.pow(left / one.gap, 3.0) * one.gap
        change = one.step(one.slack * one.z + ahead.slack * ahead.z - center)
        length = min(1.0, 0.995 * min(_longest(one.slack, change.slack), _longest(one.z, change.z)))
        one = one.moved(change, length)
        if not np.all(np.isfinite(one.x)) or length < 1e-10:
            break
    return one.x, one.y, np.where(one.z > one.slack, one.z, 0.0)


@dataclass(frozen=True)
class _Iterate:
    """A point of the interior-point method, or a change of it.

    It consists of the unknowns, the multipliers of the equations, and the slacks and multipliers of the inequalities.
    """

    whole: _Whole
    x: np.ndarray
    y: np.ndarray
    slack: np.ndarray
    z: np.ndarray

    @property
    def gap(self) -> float:
        """Mean product of slacks and multipliers."""
        return float(np.mean(self.slack * self.z))

    @property
    def residual(self) -> float:
        """Largest residual of the optimality conditions, except slack * multiplier = 0."""
        return max(float(np.max(np.abs(residual), initial=0.0)) for residual in self._residuals)

    @cached_property
    def _residuals(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        one, x = self.whole, self.x
        dual = slope_of_cost(x, one.exponent) + one.equal.T @ self.y + one.less.T @ self.z
        return dual, one.equal @ x - one.right, one.less @ x + self.slack - one.most

    @cached_property
    def _system(self) -> _System:
        less = self.whole.less
        stiff = diags_array(self.whole.curvature(self.x)) + less.T @ diags_array(self.z / self.slack) @ less
        return _System(stiff, self.whole.equal)

    def step(self, product: np.ndarray) -> _Iterate:
        """Return the change by one Newton step, which reduces the residuals and `product` to zero to first order.

        `product` replaces the products slack * z of the optimality conditions.
        """
        (dual, equal, less), matrix = self._residuals, self.whole.less
        dx, dy = self._system.solved(-dual - matrix.T @ ((self.z * less - product) / self.slack), -equal)
        ds = -less - matrix @ dx
        return _Iterate(self.whole, dx, dy, ds, -(product + self.z * ds) / self.slack)

    def moved(self, change: _Iterate, length: float) -> _Iterate:
        """Return the point moved by a share `length` of a change."""
        pairs = zip((self.x, self.y, self.slack, self.z), (change.x, change.y, change.slack, change.z), strict=True)
        return _Iterate(self.whole, *(a + length * b for a, b in pairs))


def _longest(x: np.ndarray, change: np.ndarray) -> float:
    falls = change < 0
    with np.errstate(over="ignore"):  # infinite shares limit nothing
        return float(np.min(-x[falls] / change[falls], initial=np.inf))


class _System:
    """Solves linear systems with the matrix ``[stiff, equal^T; equal, 0]``."""

    def __init__(self, stiff: csr_array, equal: csr_array):
        rows = equal.shape[0]
        self._size = stiff.shape[0]
        self._matrix = csc_array(block_array([[stiff, equal.T], [equal, None]]))
        regular = np.concatenate([np.full(self._size, REGULAR), np.full(rows, -REGULAR)])
        entries = coo_array(self._matrix + diags_array(regular))
        # Each equation is eliminated after its unknowns, frame by frame; the factors then have few further entries.
        last, (row, column) = np.zeros(rows), coo_array(equal).coords
        np.maximum.at(last, row, column + 0.5)
        order = np.argsort(np.concatenate([np.arange(self._size), last]), kind="stable")
        row, column = entries.coords
        self._factors = SparseFactors(row, column, entries.data, order, PIVOT)

    def solved(self, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        right = np.concatenate([first, second])
        result = self._solved(right)
        for _ in range(3):
            result = result + self._solved(right - self._matrix @ result)
        return result[: self._size], result[self._size :]

    def _solved(self, right: np.ndarray) -> np.ndarray:
        return np.asarray(self._factors.solve(right[None])[0])


def _polished(whole: _Whole, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the solution in which inequalities with multipliers hold with equality; the given point if that is
    better.
    """
    given = x, y, z
    for _ in range(2):
        active = np.flatnonzero(z > 0)
        equal = csr_array(vstack([whole.equal, whole.less[active]]))
        right = np.concatenate([whole.right, whole.most[active]])
        every = np.concatenate([y, z[active]])
        for _ in range(POLISHED):
            if not np.all(np.isfinite(x)):
                return given
            dual = slope_of_cost(x, whole.exponent) + equal.T @ every
            dx, dy = _System(diags_array(whole.curvature(x)), equal).solved(-dual, right - equal @ x)
            x, every = x + dx, every + dy
        y, z = every[: len(y)], np.zeros(len(z))
        z[active] = every[len(y) :]
        if np.all(z >= 0):  # otherwise solve again, without the inequalities whose multipliers have the wrong sign
            break
    if not np.all(np.isfinite(x)):
        return given
    z = np.maximum(z, 0.0)
    worst, before = (float(np.max(_certificate(whole, *one, 1))) for one in ((x, y, z), given))
    return (x, y, z) if worst < before else given


def _certificate(whole: _Whole, x: np.ndarray, y: np.ndarray, z: np.ndarray, frames: int) -> np.ndarray:
    """Return the largest violation (T,) of the optimality conditions.

    Derivatives of the Lagrangian are relative to its largest term, and equations relative to their size. An inequality
    with a multiplier should hold with equality, so that its slack counts as violation too. The largest violation of all
    inequalities counts in every frame.
    """
    parts = slope_of_cost(x, whole.exponent), whole.equal.T @ y, whole.less.T @ z
    size = max(float(np.max(np.abs(part), initial=0.0)) for part in parts) or 1.0
    dual = np.max(np.abs(sum(parts) / size).reshape(frames, -1), axis=1)
    equal = np.max(np.abs(whole.equal @ x - whole.right).reshape(frames, -1), axis=1, initial=0.0)
    beyond = whole.less @ x - whole.most
    wrong = float(np.max(np.where(z > 0, np.abs(beyond), np.maximum(beyond, 0.0)), initial=0.0))
    return np.asarray(np.maximum(np.maximum(dual, equal), wrong))


def smallest_supplement_over_time(programme: Programme, dynamics: ActivationDynamics) -> np.ndarray:
    """Return the smallest terms (T, K) that, added to the left sides ``matrix x``, give the programme of all frames a
    solution.

    The sum of their magnitudes, relative to the sizes of the equations, is minimised.
    """
    whole = _whole(programme, 2.0, dynamics)
    rows, unknowns = whole.equal.shape
    array = eye_array(rows)
    cost = np.append(np.zeros(unknowns), np.ones(2 * rows))
    result = linprog(
        cost,
        A_eq=csc_array(block_array([[whole.equal, array, -array]])),
        b_eq=whole.right,
        A_ub=csc_array(block_array([[whole.less, csr_array((len(whole.most), 2 * rows))]])),
        b_ub=whole.most,
        bounds=[*[(None, None)] * unknowns, *[(0.0, None)] * (2 * rows)],
        method="highs",
    )
    parts = result.x[unknowns:]
    return np.asarray((parts[:rows] - parts[rows:]).reshape(programme.right.shape) * programme.size)
