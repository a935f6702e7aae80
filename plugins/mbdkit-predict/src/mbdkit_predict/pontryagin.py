"""Pontryagin's minimum principle as a judge of solutions.

At every time, the controls of an optimum make the Hamiltonian least among all controls that are admissible there, not
only among those nearby (L. S. Pontryagin et al., The Mathematical Theory of Optimal Processes, 1962). Other controls
during a short time change the objective by this time multiplied by the difference of the Hamiltonian,

    H(u) = w . integrands - nu . (equations of motion) + lambda . rates,

with the derivatives w of the objective by its integrals, the multipliers nu of the equations of motion, which are
linear in accelerations and reactions, and the costates lambda of first-order states. Conditions along the path that
contain controls restrict these; those of the state alone are part of the costates.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdkit_predict.point_functions import ARGUMENTS, PointFunctions
from mbdkit_predict.transcription import Mesh, Transcription

SAMPLES, SECTIONS = 33, 25  #: Values of each control that are tried, and iterations by which the best is improved.
STARTS, SWEEPS = 4, 3  #: Starts of controls that depend on each other, and how often each control is improved.
GOLDEN = 0.5 * (3.0 - 5.0**0.5)
WIDE = 4.0  #: Range of controls without bounds, in multiples of their sizes.
SLACK = 1e-7  #: By how much other controls may exceed conditions, relative to the bounds.


class MinimumPrinciple(NamedTuple):
    """How far a solution is from the minimum principle."""

    #: (N s,) By how much the Hamiltonian at each collocation point is above its minimum.
    excess: np.ndarray
    controls: np.ndarray  #: (U, N s) Controls of the minimum.
    gain: float  #: The integral of the excess: the first-order change of the objective by the controls of the minimum.
    time: float  #: When the excess is largest [s].
    starts: int  #: Starts of the search for the minimum; 0 if it is exact.


def minimum_principle(method: Transcription, mesh: Mesh) -> MinimumPrinciple | None:
    """Return how far a solution is from the minimum principle.

    None if an integrand, or a condition with controls, contains accelerations or reactions, which change with these.
    """
    functions = _functions_of(method, method.functions)
    if functions is None:
        return None
    whole, second, of_controls, is_separate = functions
    chosen, count, forces = method.free_controls, len(mesh.times), len(method.system.q0)
    values, quadrature = mesh.values, np.kron(mesh.values["duration"] @ mesh.grid.lengths, method.b)
    integrals = np.array(method.functions.integrands.map(count)(*_arguments(method, mesh))) @ quadrature
    by_integrals, by_motion, by_rates = method.multipliers(mesh, integrals)
    known = [*_arguments(method, mesh), np.tile(by_integrals[:, None], count), by_motion[:forces], by_rates]
    limits = np.array([np.tile(side[:, None], count) for side in method.limits["u"][:2]])
    size = WIDE * np.maximum(method.control_sizes, np.ptp(values["u"], axis=1))[:, None]
    low, high = np.where(np.isfinite(limits), limits, values["u"] + np.array([-1.0, 1.0])[:, None, None] * size)

    def at(u: np.ndarray) -> np.ndarray:
        each = u.shape[1] // count
        columns = [np.repeat(x, each, axis=1) if x.shape[1] == count else x for x in known]
        columns[5] = u
        height, *rows = np.array(whole.map(u.shape[1])(*columns))
        for row, k in zip(rows, of_controls, strict=True):
            least, most = method.bounds_of_path(mesh, k)
            room = SLACK * (1.0 + abs(row).max(initial=0.0))
            height = np.where((row < least - room) | (row > most + room), np.inf, height)
        return np.asarray(np.nan_to_num(height, nan=np.inf, posinf=np.inf))

    own, best = at(values["u"]), values["u"].copy()
    starts = 0
    if second is not None:
        bend, slopes = np.split(np.array(second.map(count)(*known)), 2)
        u, below, above = values["u"][chosen], low[chosen], high[chosen]
        inner = np.clip(u - slopes / np.where(bend > 0.0, bend, np.inf), below, above)
        candidates = np.array([below, above, inner, u])
        heights = slopes * (candidates - u) + 0.5 * bend * (candidates - u) ** 2
        best[chosen] = np.take_along_axis(candidates, heights.argmin(axis=0)[None], axis=0)[0]
    else:
        starts = 1 if is_separate else STARTS
        random, least = np.random.default_rng(0), own.copy()
        for start in range(starts):
            u = values["u"].copy()
            if start:
                u[chosen] = (low + (high - low) * random.random(low.shape))[chosen]
            for _ in range(1 if is_separate else SWEEPS):
                for j in chosen:
                    u = _improved(at, u, j, low[j], high[j])
            height = at(u)
            best, least = np.where(height < least, u, best), np.minimum(height, least)
    excess = np.maximum(own - at(best), 0.0)
    return MinimumPrinciple(excess, best, float(excess @ quadrature), float(mesh.times[excess.argmax()]), starts)


@lru_cache(maxsize=4)
def _functions_of(
    method: Transcription, functions: PointFunctions
) -> tuple[ca.Function, ca.Function | None, list[int], bool] | None:
    """Return functions of the arguments of a point, and of w, nu and lambda: the Hamiltonian with the conditions that
    contain controls; its second and first derivatives by each control, if it is a sum of parabolas of these; the
    indices of the conditions; and whether each control has terms of its own. None as in `minimum_principle`.
    """
    system, chosen = method.system, method.free_controls
    given = [*(system.symbols[name] for name in ARGUMENTS), system.p, system.t,
             ca.SX.sym("mu", len(system.constraint_names)), ca.SX.sym("sides", len(method.sides))]  # fmt: skip
    closed, _, rates, integrands, balance, path = functions.stage.call(given)
    u, changing = system.u[chosen], ca.vertcat(system.a, system.lam)
    of_controls = [row for row in range(path.numel()) if chosen and ca.depends_on(path[row], u)]
    conditions = ca.vertcat(*(path[row] for row in of_controls))
    with_controls = ca.vertcat(integrands, conditions, rates)
    if not chosen or ca.depends_on(closed, u) or any(
        x.numel() and ca.depends_on(with_controls, x) for x in (system.a, system.lam)
    ) or (changing.numel() and any(ca.which_depends(balance, changing, 2, True))):  # fmt: skip
        return None
    multipliers = [ca.SX.sym("multiplier", x.numel()) for x in (integrands, balance, rates)]
    terms = [ca.dot(x, y) for x, y in zip(multipliers, (integrands, -balance, rates), strict=True)]
    hamiltonian, arguments = ca.sum1(ca.vertcat(*terms)), [*given, *multipliers]
    slope = ca.gradient(hamiltonian, system.u)[chosen]
    hessian = ca.jacobian(slope, system.u)[:, chosen]
    is_separate, second = hessian.nnz() == 0 or hessian.sparsity().is_diag(), None
    if is_separate and not of_controls and not ca.depends_on(hessian, system.u):
        second = ca.Function("second", arguments, [ca.vertcat(ca.densify(ca.diag(hessian)), slope)])
    whole = ca.Function("hamiltonian", arguments, [ca.vertcat(hamiltonian, conditions)])
    return whole, second, of_controls, is_separate


def _arguments(method: Transcription, mesh: Mesh) -> list[np.ndarray]:
    """Return the arguments of `PointFunctions.stage` at all collocation points."""
    count, x = len(mesh.times), mesh.values
    own, p = [x[name] for name in ARGUMENTS], np.tile(x["p"][:, None], count)
    return [*own, p, mesh.times[None], x["mu"], method.sides_at(mesh.grid, len(method.c))]


def _improved(
    at: Callable[[np.ndarray], np.ndarray], u: np.ndarray, j: int, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Return controls (U, K) of which one has the values of the least Hamiltonian between its bounds (K,)."""
    count = u.shape[1]
    shares = np.linspace(0.0, 1.0, SAMPLES)
    values = np.concatenate([low[:, None] + (high - low)[:, None] * shares, u[j][:, None]], axis=1)
    many = np.repeat(u, SAMPLES + 1, axis=1)
    many[j] = values.ravel()
    centre = values[np.arange(count), at(many).reshape(count, -1).argmin(axis=1)]
    width = (high - low) / (SAMPLES - 1)
    first, last = np.maximum(centre - width, low), np.minimum(centre + width, high)

    def with_value(x: np.ndarray) -> np.ndarray:
        changed = u.copy()
        changed[j] = x
        return changed

    for _ in range(SECTIONS):
        left, right = first + GOLDEN * (last - first), last - GOLDEN * (last - first)
        falls = at(with_value(left)) > at(with_value(right))
        first, last = np.where(falls, left, first), np.where(falls, last, right)
    candidates = np.array([u[j], centre, 0.5 * (first + last)])
    heights = np.array([at(with_value(x)) for x in candidates])
    return with_value(candidates[heights.argmin(axis=0), np.arange(count)])
