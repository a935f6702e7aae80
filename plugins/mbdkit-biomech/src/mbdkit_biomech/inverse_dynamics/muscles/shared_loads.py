"""How muscles share loads: the convex programme of recruitment, solved for all frames at once.

In each frame, ``sum of |x / weight|^p`` is minimised subject to ``matrix x = right`` and bounds of x. For p > 1, the
dual problem is solved. Its unknowns are the multipliers y of the K equations; K is small. Each component of x follows
from the same component of ``g = matrix^T y`` and is clipped to its bounds, so that ``matrix x(y) = right`` is a system
of K equations for y. The Jacobian, ``matrix diag(dx/dg) matrix^T``, is symmetric. Newton's method with a line search on
the concave dual function solves the system to rounding errors. For p = 2 the system is piecewise linear, and the
iteration ends once the right bounds are active. A proximal term keeps the Jacobian regular (method of multipliers). The
term is reduced from problem to problem, and each problem starts from the multipliers of the previous one.

For p = 1, and for p = infinity, where the largest ``|x / weight|`` is minimised, HiGHS solves linear programmes. If
there are several solutions, the one with the smallest sum of squares is chosen. The multipliers of one solution
determine the set of all solutions: unknowns whose reduced costs do not vanish are at the same bounds in all of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.sparse.csgraph import connected_components

from mbdkit.engine.stacked_matrices import least_norms, products
from mbdkit.plugin.equations import elementary

ITERATIONS = 60
"""Largest number of Newton iterations of one proximal problem; 5 to 15 are usual."""
PROXIMAL = (1e-2, 1e-4, 1e-10, *(1e-11,) * 8)
"""Proximal terms of the successive problems, relative to half the trace of the product of the matrix and its transpose.

Three problems usually suffice.
"""
ROUNDING = 1e-14
"""Rounding errors of the dual function, relative to its terms."""
REACHED = 1e-13
"""Residual of the equations, relative to their size, at which the iteration ends."""
SOLVED = 1e-9
"""A frame counts as solved if its certificate (see `Shared`) is at most this; otherwise, it counts as a frame without
solution.
"""
REDUCED_COST = 1e-7
"""Unknowns are at the same bound in all solutions of a linear programme if the magnitude of their reduced cost exceeds
this; the costs in the programme are 1.
"""
TIGHT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
"""Options of HiGHS."""
NO_SHARE = 1e-11
"""Largest coefficient, relative to the size of an equation, of an unknown that does not act in it."""
LEAST_SLOPE = 1e-12
"""Lower bound of the derivatives dx/dg for p > 2, relative to the largest one; smaller values are raised to this bound.

At x = 0, where the derivative is infinite, it is computed as 0, and then raised to the bound.
"""


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
    """

    matrix: np.ndarray
    right: np.ndarray
    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """Size (T, K) of each equation: magnitude of its right side, and sum of the magnitudes of its terms with all
        unknowns at their finite upper bounds.
        """
        largest = np.where(np.isfinite(self.high), np.abs(self.high), 0.0)
        size: np.ndarray = np.abs(self.right) + np.sum(np.abs(self.matrix) * largest[:, None], axis=2)
        return np.where(size > 0, size, 1.0)

    def only(self, rows: np.ndarray) -> Programme:
        """Return the programmes of a selection of frames."""
        return Programme(self.matrix[rows], self.right[rows], self.low[rows], self.high[rows], self.weight)


@dataclass(frozen=True)
class Shared:
    """Solutions of T programmes.

    Attributes
    ----------
    value
        (T, N) unknowns.
    certificate
        (T,) largest violation of the optimality conditions; inf if there is no solution. The residual of an equation is
        relative to its size, and a derivative of the Lagrangian with the wrong sign is relative to the largest
        derivative of the cost.
    multipliers
        (T, K) multipliers of the equations, which are the derivatives of the cost with respect to the right sides; nan
        for linear programmes.
    """

    value: np.ndarray
    certificate: np.ndarray
    multipliers: np.ndarray


def share_loads(programme: Programme, exponent: float, start: np.ndarray | None = None) -> Shared:
    """Solve the programmes of all frames.

    Parameters
    ----------
    exponent
        p: 1, 2, 3, ..., or infinity, for which the largest ``|x / weight|`` is minimised.
    start
        (T, K) multipliers of similar programmes, which save iterations for 1 < p < infinity.
    """
    # The programme is scaled such that all weights are 1, all equations have size 1, and the multipliers are about as
    # large as the cost.
    size, weight = programme.size, programme.weight
    scaled = Programme(
        programme.matrix * weight / size[..., None],
        programme.right / size,
        programme.low / weight,
        programme.high / weight,
        np.ones_like(weight),
    )
    if exponent == 1 or math.isinf(exponent):
        value, certificate, multipliers = _linear(scaled, exponent)
    else:
        value, certificate, multipliers = _each_part(scaled, exponent, None if start is None else start * size)
    return Shared(value * weight, np.where(certificate <= SOLVED, certificate, np.inf), multipliers / size)


def _each_part(programme: Programme, p: float, start: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the results of `_dual_newton` for independent parts of the programmes, which are solved one by one.

    Each leg is a part: its muscles have no arms about joints of the other one.
    """
    acts = np.any(np.abs(programme.matrix) > NO_SHARE, axis=0)
    count, parts = connected_components(acts.astype(float) @ acts.T, directed=False)
    if count < 2:
        return _dual_newton(programme, p, start)
    value = np.clip(0.0, programme.low, programme.high)  # of unknowns in no equation
    certificate, multipliers = np.zeros(len(value)), np.zeros_like(programme.right)
    for part in range(count):
        rows = parts == part
        columns = np.any(acts[rows], axis=0)
        matrix, low, high = (
            programme.matrix[:, rows][:, :, columns],
            programme.low[:, columns],
            programme.high[:, columns],
        )
        own = Programme(matrix, programme.right[:, rows], low, high, programme.weight[columns])
        x, wrong, y = _dual_newton(own, p, None if start is None else start[:, rows])
        value[:, columns], multipliers[:, rows], certificate = x, y, np.maximum(certificate, wrong)
    return value, certificate, multipliers


def _dual_newton(
    programme: Programme, p: float, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return solutions (T, N), certificates (T,) and multipliers (T, K) for p > 1 and weights of 1."""
    frames, equations, _ = programme.matrix.shape
    y = np.zeros((frames, equations)) if start is None else start.copy()
    if p > 2 and start is None:
        # start from the solution for p = 2, with the derivative of the cost converted from 2 x to p x^(p - 1)
        x, _, _ = _dual_newton(programme, 2.0)
        cost = p * np.sign(x) * elementary.pow(np.abs(x), p - 1)
        y = least_norms(np.swapaxes(programme.matrix, 1, 2), cost, 1e-10)
    trace = np.sum(programme.matrix**2, axis=(1, 2)) * 0.5
    trace = np.where(trace > 0, trace, 1.0)
    left = np.arange(frames)
    for proximal in PROXIMAL if start is None else PROXIMAL[1:]:
        y[left] = _proximal_newton(programme.only(left), y[left], p, proximal * trace[left])
        x, _ = _unknowns(programme, y, p)
        residual = np.max(np.abs(_residual(programme, x)), axis=1, initial=0.0)
        left = np.flatnonzero(residual > REACHED)
        if not left.size:
            break
    y = _polished(programme, y, p, trace)
    x, _ = _unknowns(programme, y, p)
    return x, _certificate(programme, x, y, p), y


def _polished(programme: Programme, y: np.ndarray, p: float, trace: np.ndarray) -> np.ndarray:
    """Return the multipliers after a further Newton step, in frames in which this step reduces the residual."""
    x, slope = _unknowns(programme, y, p)
    before = _residual(programme, x)
    regular = 1e-14 * trace[:, None, None] * np.eye(y.shape[1])
    jacobian = products(programme.matrix * slope[:, None], np.swapaxes(programme.matrix, 1, 2)) + regular
    moved = y + least_norms(jacobian, before, 0.0)
    after = _residual(programme, _unknowns(programme, moved, p)[0])
    better = np.max(np.abs(after), axis=1, initial=0.0) < np.max(np.abs(before), axis=1, initial=0.0)
    return np.where(better[:, None], moved, y)


def _proximal_newton(programme: Programme, start: np.ndarray, p: float, proximal: np.ndarray) -> np.ndarray:
    """Return the multipliers (T, K) that maximise the dual function minus ``proximal |y - start|^2 / 2``."""
    y = start.copy()
    eye = np.eye(y.shape[1])
    left, own, near, own_start = np.arange(len(y)), programme, proximal, start
    here = _DualPoint.of(own, y, p, near, own_start)
    for _ in range(ITERATIONS):
        gradient = _residual(own, here.x) - near[:, None] * (here.y - own_start)
        jacobian = products(own.matrix * here.slope[:, None], np.swapaxes(own.matrix, 1, 2)) + near[:, None, None] * eye
        step = least_norms(jacobian, gradient, 0.0)
        rise, norm = np.sum(gradient * step, axis=1), np.max(np.abs(gradient), axis=1)
        rounding = ROUNDING * (here.cost + np.sum(np.abs(here.y * own.right), axis=1))
        size, there = 1.0, _DualPoint.of(own, here.y + step, p, near, own_start)
        waiting = np.flatnonzero(there.dual < here.dual + 1e-4 * size * rise - rounding)
        for _ in range(39):  # only the frames that wait for a shorter step are evaluated again
            if not waiting.size:
                break
            size *= 0.5
            moved = here.y[waiting] + size * step[waiting]
            shorter = _DualPoint.of(own.only(waiting), moved, p, near[waiting], own_start[waiting])
            there.put(waiting, shorter)
            waiting = waiting[shorter.dual < (here.dual + 1e-4 * size * rise - rounding)[waiting]]
        moves = np.ones(len(left), dtype=bool)
        moves[waiting] = False
        y[left[moves]] = there.y[moves]
        on = np.flatnonzero((norm > 0.1 * REACHED) & moves)
        if not on.size:
            break
        left, own, near, own_start, here = left[on], own.only(on), near[on], own_start[on], there.only(on)
    return y


@dataclass
class _DualPoint:
    """Multipliers y (T, K) of proximal problems, the unknowns x and their slopes (T, N), the cost (T,) of the unknowns,
    and the dual function (T,) with the proximal term.
    """

    y: np.ndarray
    x: np.ndarray
    slope: np.ndarray
    cost: np.ndarray
    dual: np.ndarray

    @classmethod
    def of(cls, programme: Programme, y: np.ndarray, p: float, proximal: np.ndarray, start: np.ndarray) -> _DualPoint:
        """Return the evaluation at multipliers; `proximal` (T,) and `start` (T, K) define the proximal term."""
        x, slope = _unknowns(programme, y, p)
        cost = np.sum(x * x if p == 2 else elementary.pow(np.abs(x), p), axis=1)
        dual = cost + np.sum(y * _residual(programme, x), axis=1)
        return cls(y, x, slope, cost, dual - 0.5 * proximal * np.sum((y - start) ** 2, axis=1))

    def only(self, rows: np.ndarray) -> _DualPoint:
        """Return the evaluation of a selection of frames."""
        return _DualPoint(self.y[rows], self.x[rows], self.slope[rows], self.cost[rows], self.dual[rows])

    def put(self, rows: np.ndarray, other: _DualPoint) -> None:
        """Replace the evaluations of a selection of frames."""
        for name in ("y", "x", "slope", "cost", "dual"):
            getattr(self, name)[rows] = getattr(other, name)


def _unknowns(programme: Programme, y: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the unknowns (T, N) that minimise the Lagrangian, and their derivatives with respect to g."""
    g = products(np.swapaxes(programme.matrix, 1, 2), y)
    if p == 2:
        x, slope = 0.5 * g, np.full_like(g, 0.5)
        free = (x > programme.low) & (x < programme.high)
    else:
        size = np.abs(g)
        x = np.sign(g) * elementary.pow(size / p, 1.0 / (p - 1.0))
        free = (x > programme.low) & (x < programme.high)
        slope = np.where(free, np.abs(x) / np.where(size > 0, size, 1.0) / (p - 1.0), 0.0)
        slope = np.maximum(slope, LEAST_SLOPE * np.max(slope, axis=1, initial=1e-300)[:, None])
    return np.clip(x, programme.low, programme.high), np.where(free, slope, 0.0)


def _residual(programme: Programme, x: np.ndarray) -> np.ndarray:
    return np.asarray(programme.right - products(programme.matrix, x))


def _certificate(programme: Programme, x: np.ndarray, y: np.ndarray, p: float) -> np.ndarray:
    """Return the largest violation (T,) of the optimality conditions, see `Shared`."""
    cost = p * np.sign(x) * elementary.pow(np.abs(x), p - 1)
    g = products(np.swapaxes(programme.matrix, 1, 2), y)
    slope = cost - g  # zero between the bounds, not negative at the lower bound, and not positive at the upper one
    slope = np.where((x <= programme.low) & (slope > 0), 0.0, slope)
    slope = np.where((x >= programme.high) & (slope < 0), 0.0, slope)
    largest = np.maximum(np.max(np.abs(cost), axis=1, initial=0.0), np.max(np.abs(g), axis=1, initial=0.0))
    wrong = np.max(np.abs(slope), axis=1, initial=0.0) / np.where(largest > 0, largest, 1.0)
    return np.asarray(np.maximum(wrong, np.max(np.abs(_residual(programme, x)), axis=1, initial=0.0)))


def _linear(programme: Programme, exponent: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return solutions (T, N), certificates (T,) and nan (T, K) for p = 1 or infinity and weights of 1.

    An unknown that may be negative is written as the difference of two unknowns that are not negative.
    """
    frames, _, count = programme.matrix.shape
    signed = np.flatnonzero(np.any(programme.low < 0, axis=0))
    matrix = np.concatenate([programme.matrix, -programme.matrix[:, :, signed]], axis=2)
    low = np.hstack([np.maximum(programme.low, 0.0), np.zeros((frames, len(signed)))])
    high = np.hstack([programme.high, -programme.low[:, signed]])
    solved = np.zeros(frames, dtype=bool)
    for row in range(frames):
        found = _optimal_face(matrix[row], programme.right[row], (low[row], high[row]), math.isinf(exponent))
        if found is not None:
            (low[row], high[row]), solved[row] = found, True
    face = Programme(matrix, programme.right, low, high, np.ones(matrix.shape[2]))
    split, certificate, _ = _dual_newton(face, 2.0)
    value = split[:, :count].copy()
    value[:, signed] -= split[:, count:]
    wrong = np.max(np.abs(_residual(programme, value)), axis=1, initial=0.0)
    return value, np.where(solved, np.maximum(certificate, wrong), np.inf), np.full_like(programme.right, np.nan)


def _optimal_face(
    matrix: np.ndarray, right: np.ndarray, bounds: tuple[np.ndarray, np.ndarray], is_largest: bool
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return bounds (N,) that define the set of all solutions of a linear programme; None if it has no solution.

    Parameters
    ----------
    matrix, right
        Equations of one frame, (K, N) and (K,).
    bounds
        Bounds (N,) of the unknowns, none of which may be negative.
    is_largest
        Whether the largest unknown, represented by an additional unknown, is minimised instead of the sum.
    """
    (low, high), count = bounds, len(bounds[0])
    more = {}
    if is_largest:
        matrix = np.hstack([matrix, np.zeros((len(matrix), 1))])
        more = {"A_ub": np.hstack([np.eye(count), -np.ones((count, 1))]), "b_ub": np.zeros(count)}
        low, high = np.append(low, 0.0), np.append(high, np.inf)
    cost = np.append(np.zeros(count), 1.0) if is_largest else np.ones(count)
    best = linprog(cost, A_eq=matrix, b_eq=right, bounds=np.column_stack([low, high]), options=TIGHT, **more)
    if best.status != 0:
        return None
    reduced = best.lower.marginals[:count] + best.upper.marginals[:count]
    least, most = low[:count].copy(), high[:count].copy()
    if is_largest:
        most = np.minimum(most, best.x[-1])
        reduced = reduced + best.ineqlin.marginals
    fixed = np.abs(reduced) > REDUCED_COST
    return np.where(fixed & (reduced < 0), most, least), np.where(fixed & (reduced > 0), least, most)


def smallest_supplement(programme: Programme) -> np.ndarray:
    """Return the smallest terms (T, K) that, added to the left sides ``matrix x``, give the programmes solutions.

    The sum of their magnitudes, relative to the sizes of the equations, is minimised.
    """
    found = np.zeros_like(programme.right)
    size = programme.size
    for row in range(len(found)):
        equations, unknowns = programme.matrix[row].shape
        eye = np.eye(equations)
        matrix = np.hstack([programme.matrix[row] / size[row][:, None], eye, -eye])
        bounds = [*zip(programme.low[row], programme.high[row], strict=True), *[(0.0, None)] * (2 * equations)]
        cost = np.append(np.zeros(unknowns), np.ones(2 * equations))
        best = linprog(cost, A_eq=matrix, b_eq=programme.right[row] / size[row], bounds=bounds, method="highs")
        parts = best.x[unknowns:]
        found[row] = (parts[:equations] - parts[equations:]) * size[row]
    return found
