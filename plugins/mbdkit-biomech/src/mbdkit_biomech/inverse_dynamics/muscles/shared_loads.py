"""How muscles share loads: the convex programme of recruitment, solved for all frames at once.

In each frame, ``sum of |x / weight|^p`` is minimised subject to ``matrix x = right`` and bounds of x. For p > 1, the
dual problem is solved. Its unknowns are the multipliers y of the K equations; K is small. Each component of x follows
from the same component of ``g = matrix^T y`` and is clipped to its bounds, so that ``matrix x(y) = right`` is a system
of K equations for y. The Jacobian, ``matrix diag(dx/dg) matrix^T``, is symmetric. Newton's method for the concave dual
function solves the system to rounding errors; for p = 2 the system is piecewise linear, and the iteration ends once the
right bounds are active. An inequality ``matrix x >= right`` is an equation whose multiplier must not be negative:
multipliers that would fall below 0 become 0, and the others are computed for this (D. P. Bertsekas, SIAM J. Control
Optim. 20:221-246, 1982). The Jacobian is regularised in proportion to the residual (D.-H. Li et al., Comput. Optim.
Appl. 28:131-147, 2004). All frames are advanced at once, each with its own length of the step. Frames that need too
many steps, such as those with saturated muscles or with targets that are almost reached, are solved again: for p > 2 by
an interior-point method for unknowns and multipliers together, for p = 2, where bounds may leave a single point, by the
method of multipliers: a proximal term is reduced from problem to problem, each of which starts from the multipliers of
the previous one.

For p = 1, and for p = infinity, where the largest ``|x / weight|`` is minimised, HiGHS solves linear programmes. If
there are several solutions, the one with the smallest sum of squares is chosen. The multipliers of one solution
determine the set of all solutions: unknowns whose reduced costs do not vanish are at the same bounds in all of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.optimize import linprog
from scipy.sparse.csgraph import connected_components

from mbdkit.base import elementary
from mbdkit.engine.linear_systems import least_norms, products
from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme, near_optimum, slope_of_cost

Triple: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]

#: Largest numbers of evaluations in the first attempt, and in each further one; 5 to 15 are usual.
FIRST_STEPS, STEPS = 25, 200
#: Proximal terms of the successive problems for p = 2, relative to half the trace of the product of the matrix and its
#: transpose.
PROXIMAL = (1e-2, 1e-4, 1e-6, 1e-8, 0.0)
#: Regularisation of the Jacobian, likewise, for a residual of 1, and its lower bound.
REGULAR, ROUNDING = 1e-8, 1e-15
#: A step is too long if the derivative of the dual function along it has the other sign at its end, and more than this
#: share of its size at the beginning.
#:
#: Unlike the function, its derivative is not disturbed by rounding errors near the solution (W. W. Hager and H. Zhang,
#: SIAM J. Optim. 16:170-192, 2005).
OVERSHOOT = 0.25
#: Residual of the equations, relative to their size, after which a last step reaches rounding errors.
ENDED = 1e-10
REACHED = 1e-13  #: Certificate (see `Shared`) above which a frame is solved again.
#: Residual below which the iteration also ends if a step does not halve it: the rest are rounding errors.
NEARLY = 1e-9
#: Certificate below which a solution for p > 2 is refined by steps of unknowns and multipliers together, and their
#: number; two reached rounding errors in all frames of a walk with EMG.
NEAR, REFINEMENTS = 1e-2, 4
#: A frame counts as solved if its certificate (see `Shared`) is at most this; otherwise, it counts as a frame without
#: solution.
SOLVED = 1e-9
#: Unknowns are at the same bound in all solutions of a linear programme if the magnitude of their reduced cost exceeds
#: this; the costs in the programme are 1.
REDUCED_COST = 1e-7
TIGHT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}  #: Options of HiGHS.
#: Largest coefficient, relative to the size of an equation, of an unknown that does not act in it.
NO_SHARE = 1e-11
#: Lower bound of the derivatives dx/dg for p > 2, relative to the largest one; smaller values are raised to this bound.
#:
#: At x = 0, where the derivative is infinite, it is computed as 0, and then raised to the bound.
LEAST_SLOPE = 1e-12


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
        programme.lowest,
    )
    if exponent == 1 or math.isinf(exponent):
        value, certificate, multipliers = _linear(scaled, exponent)
    else:
        value, certificate, multipliers = _each_part(scaled, exponent, None if start is None else start * size)
    return Shared(value * weight, np.where(certificate <= SOLVED, certificate, np.inf), multipliers / size)


def _each_part(programme: Programme, p: float, start: np.ndarray | None) -> Triple:
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
        rows = np.flatnonzero(parts == part)
        columns = np.flatnonzero(np.any(acts[rows], axis=0))
        own = Programme(  # arrays are contiguous
            programme.matrix.take(rows, 1).take(columns, 2),
            programme.right.take(rows, 1),
            programme.low.take(columns, 1),
            programme.high.take(columns, 1),
            programme.weight[columns],
            programme.lowest.take(rows, 1),
        )
        x, wrong, y = _dual_newton(own, p, None if start is None else start.take(rows, 1))
        value[:, columns], multipliers[:, rows], certificate = x, y, np.maximum(certificate, wrong)
    return value, certificate, multipliers


@np.errstate(all="ignore")  # programmes without solution diverge
def _dual_newton(programme: Programme, p: float, start: np.ndarray | None = None) -> Triple:
    """Return solutions (T, N), certificates (T,) and multipliers (T, K) for p > 1 and weights of 1."""
    begin = np.zeros_like(programme.right) if start is None else start
    if p > 2 and start is None:
        # start from the solution for p = 2, with the derivative of the cost converted from 2 x to p x^(p - 1)
        x, _, _ = _dual_newton(programme, 2.0)
        begin = least_norms(np.swapaxes(programme.matrix, 1, 2), slope_of_cost(x, p), 1e-10)
    y = _newton(programme, begin, p, 0.0, FIRST_STEPS)
    x = _unknowns(programme, y, p)[0]
    certificate = _certificate(programme, x, y, p)
    near = begin.copy()
    for is_first in (True, False):
        if not (left := np.flatnonzero(certificate > REACHED)).size:
            break
        own, again = programme.only(left), near[left]
        if p > 2 and is_first:
            point = near_optimum(own, x[left], again, p)
        else:  # for p > 2, from where the interior-point method has ended
            for proximal in PROXIMAL if p == 2 else (0.0,):
                again = _newton(own, again, p, proximal, STEPS)
            point = _unknowns(own, again, p)[0], again
        (other, again), wrong = point, _certificate(own, *point, p)
        near[left], better = again, wrong < certificate[left]
        rows = left[better]
        x[rows], certificate[rows], y[rows] = other[better], wrong[better], again[better]
        if p == 2:
            break
    return x, certificate, y


def _newton(programme: Programme, start: np.ndarray, p: float, proximal: float, steps: int) -> np.ndarray:
    """Return multipliers (T, K) that maximise the dual function minus ``proximal |y - start|^2 / 2``."""
    y, residual = start.copy(), np.full(len(start), np.inf)
    trace = np.sum(programme.matrix**2, axis=(1, 2)) * 0.5
    trace, eye = np.where(trace > 0, trace, 1.0)[:, None], np.eye(start.shape[1])
    left, own, center, base = np.arange(len(y)), programme, start, start
    step, size, rise = np.zeros_like(start), np.ones((len(y), 1)), np.zeros((len(y), 1))
    for _ in range(steps):
        there = np.maximum(base + size * step, own.lowest)
        x, slope = _unknowns(own, there, p)
        gradient = own.residual(x) - proximal * trace * (there - center)
        along = np.sum(gradient * step, axis=1, keepdims=True)
        held = (there <= own.lowest) & (gradient <= 0)
        norm = np.max(np.where(held, 0.0, np.abs(gradient)), axis=1, keepdims=True)
        jacobian = products(own.matrix * slope[:, None], np.swapaxes(own.matrix, 1, 2))
        jacobian += ((proximal + REGULAR * norm + ROUNDING) * trace)[..., None] * eye
        newton = _best_step(jacobian, gradient, held, own.lowest - there)
        moves, before = along >= -OVERSHOOT * rise, residual[left, None]
        ended = (norm <= max(ENDED, 0.01 * proximal)) | ((norm < NEARLY) & (norm > 0.5 * before))
        better = np.flatnonzero(moves & (norm < before))
        y[left[better]], residual[left[better]] = (there + ended * newton)[better], norm[better, 0]
        if not (on := np.flatnonzero(~(moves & ended))).size:
            break
        shorter = np.clip(rise / np.where(along < rise, rise - along, 1.0), 0.1, 0.5)
        size, base = np.where(moves, 1.0, size * shorter)[on], np.where(moves, there, base)[on]
        step = np.where(moves, newton, step)[on]
        rise = np.where(moves, np.sum(gradient * newton, axis=1, keepdims=True), rise)[on]
        if len(on) < len(left):
            left, own, trace, center = left[on], own.only(on), trace[on], center[on]
    return y


def _best_step(jacobian: np.ndarray, gradient: np.ndarray, held: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Return steps d (T, K) that maximise ``gradient d - d jacobian d / 2``; components `held` are zero, and those that
    would then be below their bounds `most` are at them.
    """
    eye = np.eye(gradient.shape[1])
    step = least_norms(np.where(held[:, :, None] | held[:, None], eye, jacobian), np.where(held, 0.0, gradient), 0.0)
    if (rows := np.flatnonzero(np.any(step < most, axis=1))).size:
        below, jacobian = held[rows] | (step < most)[rows], jacobian[rows]
        fixed = np.where(below, most[rows], 0.0)
        right = np.where(below, fixed, gradient[rows] - products(jacobian, fixed))
        step[rows] = least_norms(np.where(below[:, :, None] | below[:, None], eye, jacobian), right, 0.0)
    return step


def _unknowns(programme: Programme, y: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the unknowns (T, N) that minimise the Lagrangian, and their derivatives with respect to g."""
    g = products(y[:, None], programme.matrix)[:, 0]
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


def _violation(programme: Programme, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the largest residual (T,) of equations, and of inequalities that do not hold or have a multiplier."""
    residual = programme.residual(x)
    holds = (y <= programme.lowest) & (residual <= 0)
    return np.asarray(np.max(np.where(holds, 0.0, np.abs(residual)), axis=1, initial=0.0))


def _certificate(programme: Programme, x: np.ndarray, y: np.ndarray, p: float) -> np.ndarray:
    """Return the largest violation (T,) of the optimality conditions, see `Shared`."""
    cost = slope_of_cost(x, p)
    g = products(np.swapaxes(programme.matrix, 1, 2), y)
    slope = cost - g  # zero between the bounds, not negative at the lower bound, and not positive at the upper one
    slope = np.where((x <= programme.low) & (slope > 0), 0.0, slope)
    slope = np.where((x >= programme.high) & (slope < 0), 0.0, slope)
    largest = np.maximum(np.max(np.abs(cost), axis=1, initial=0.0), np.max(np.abs(g), axis=1, initial=0.0))
    wrong = np.max(np.abs(slope), axis=1, initial=0.0) / np.where(largest > 0, largest, 1.0)
    return np.asarray(np.maximum(wrong, _violation(programme, x, y)))


def _linear(programme: Programme, exponent: float) -> Triple:
    """Return solutions (T, N), certificates (T,) and nan (T, K) for p = 1 or infinity and weights of 1.

    An unknown that may be negative is written as the difference of two unknowns that are not negative.
    """
    frames, _, count = programme.matrix.shape
    signed = np.flatnonzero(np.any(programme.low < 0, axis=0))
    matrix = np.concatenate([programme.matrix, -programme.matrix[:, :, signed]], axis=2)
    low = np.hstack([np.maximum(programme.low, 0.0), np.zeros((frames, len(signed)))])
    high = np.hstack([programme.high, -programme.low[:, signed]])
    solved, lowest = np.zeros(frames, dtype=bool), programme.lowest.copy()
    whole = Programme(matrix, programme.right, low, high, np.ones(matrix.shape[2]), lowest)
    for row in range(frames):
        if (result := _optimal_face(whole, row, is_largest=math.isinf(exponent))) is not None:
            (low[row], high[row], lowest[row]), solved[row] = result, True
    split, certificate, _ = _dual_newton(whole, 2.0)
    value = split[:, :count].copy()
    value[:, signed] -= split[:, count:]
    wrong = np.maximum(certificate, _violation(programme, value, np.zeros_like(programme.right)))
    return value, np.where(solved, wrong, np.inf), np.full_like(programme.right, np.nan)


def _optimal_face(programme: Programme, row: int, *, is_largest: bool) -> Triple | None:
    """Return bounds (N,) and lowest multipliers (K,) that define the set of all solutions of a linear programme, whose
    unknowns are not negative; None if it has no solution.

    Parameters
    ----------
    row
        Index of the frame.
    is_largest
        Whether the largest unknown, represented by an additional unknown, is minimised instead of the sum.
    """
    matrix, right, low, high = programme.matrix[row], programme.right[row], programme.low[row], programme.high[row]
    is_equal, count = np.isinf(programme.lowest[row]), len(low)
    less, most = -matrix[~is_equal], -right[~is_equal]
    if is_largest:
        matrix, less = (np.hstack([one, np.zeros((len(one), 1))]) for one in (matrix, less))
        less = np.vstack([less, np.hstack([np.eye(count), -np.ones((count, 1))])])
        low, high, most = np.append(low, 0.0), np.append(high, np.inf), np.append(most, np.zeros(count))
    cost = np.append(np.zeros(count), 1.0) if is_largest else np.ones(count)
    bounds = np.column_stack([low, high])
    best = linprog(cost, less, most, matrix[is_equal], right[is_equal], bounds, options=TIGHT)
    if best.status != 0:
        return None
    reduced = best.lower.marginals[:count] + best.upper.marginals[:count]
    lowest, most = programme.lowest[row].copy(), high[:count].copy()
    acts = best.ineqlin.marginals[: len(lowest) - np.sum(is_equal)] < -REDUCED_COST
    lowest[np.flatnonzero(~is_equal)[acts]] = -np.inf
    if is_largest:
        most = np.minimum(most, best.x[-1])
        reduced = reduced + best.ineqlin.marginals[-count:]
    fixed = np.abs(reduced) > REDUCED_COST
    least = low[:count]
    return np.where(fixed & (reduced < 0), most, least), np.where(fixed & (reduced > 0), least, most), lowest


def impossible(programme: Programme) -> np.ndarray:
    """Return which frames (T,) have no unknowns between their bounds that satisfy the equations.

    Multipliers y of the diverging problem for p = 2 prove it: ``y matrix x`` stays below ``y right`` for all of them.
    """
    y = share_loads(programme, 2.0).multipliers
    g = products(np.swapaxes(programme.matrix, 1, 2), y)
    bound = np.where(g > 0, programme.high, programme.low)
    most = np.sum(np.where(g == 0, 0.0, g * np.where(g == 0, 0.0, bound)), axis=1)
    return np.asarray(np.sum(y * programme.right, axis=1) > most + 1e-9 * np.abs(most))


def smallest_supplement(programme: Programme) -> np.ndarray:
    """Return the smallest terms (T, K) that, added to the left sides ``matrix x``, give the programmes solutions.

    The sum of their magnitudes, relative to the sizes of the equations, is minimised.
    """
    values = np.zeros_like(programme.right)
    size = programme.size
    for row in range(len(values)):
        equations, unknowns = programme.matrix[row].shape
        eye = np.eye(equations)
        matrix = np.hstack([programme.matrix[row] / size[row][:, None], eye, -eye])
        bounds = [*zip(programme.low[row], programme.high[row], strict=True), *[(0.0, None)] * (2 * equations)]
        cost = np.append(np.zeros(unknowns), np.ones(2 * equations))
        best = linprog(cost, A_eq=matrix, b_eq=programme.right[row] / size[row], bounds=bounds, method="highs")
        parts = best.x[unknowns:]
        values[row] = (parts[:equations] - parts[equations:]) * size[row]
    return values
