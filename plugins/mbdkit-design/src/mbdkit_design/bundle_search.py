"""Minimum of goals and limits with kinks, such as maxima over time, by a bundle of linearizations in a trust region.

At a kink the slope depends on the side, and a search along one gradient stops there although the goal falls along the
kink. A bundle method keeps the linearizations of all nearby points; their maximum models the kink. Each step minimises
this model within a trust region, which is a linear program (H. Schramm, J. Zowe, A version of the bundle idea for
minimizing a nonsmooth function, SIAM J. Optim. 2 (1992) 121-152). Limits enter by their linearizations in the same way,
with an exact penalty on their largest violation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, linprog

from mbdkit.engine.linear_systems import product
from mbdkit_design.design_spec import FEASIBLE
from mbdkit_design.problem import FAILED, Problem

#: Cost that is added for a violation of a limit by its whole size; 1 is the cost at the start of the design.
PENALTY = 100.0
WIDE = 0.1  #: First radius of the trust region of a search, as a share of the bounds.
#: First radius of the trust region if the search begins where another search ended, as a share of the bounds.
NEAR = 1e-3
NEGLIGIBLE = 1e-5  #: Largest radius of the trust region at which a search ends, as a share of the bounds.
#: The end of another search counts as a smooth minimum if the model decreases by at most this share of the cost per
#: radius. The cost is that at this end, but at least a tenth of the cost at the start of the design.
FLAT = 1e-2
#: A smaller decrease of the model, relative to the largest change of the cost in the trust region, counts as zero,
#: because the linear program is solved to 1e-7.
SOLVED = 1e-6

#: Derivatives at neighbouring points that differ by more than this share of the largest derivative indicate a kink.
JUMP = 0.1

LEAST = "no linearization of a nearby point leads to a lower cost"
#: Messages at the end of a search: at a local minimum, and where derivatives disagree with the values.
STUCK = "no nearby point has the lower cost that the derivatives promise"


@dataclass(frozen=True)
class Linearization:
    """Cost and margins of a problem at a point (n,), with their derivatives (n,) and (m, n).

    The margins are the distances from the m limits (see `Problem.margins`), plus half of the violation that counts as
    zero.
    """

    point: np.ndarray
    cost: float
    slope: np.ndarray
    margins: np.ndarray
    margin_slopes: np.ndarray

    @classmethod
    def of(cls, problem: Problem, x: np.ndarray) -> Linearization:
        """Linearize a problem at a point (n,)."""
        return cls(x, problem.cost(x), problem.slope(x), problem.margins(x) + FEASIBLE / 2, problem.margin_slopes(x))

    @property
    def merit(self) -> float:
        """Cost with the penalty on the largest violation of a limit."""
        return self.cost - PENALTY * float(np.min(self.margins, initial=0.0))

    @property
    def is_feasible(self) -> bool:
        """Whether all limits are satisfied."""
        return bool(np.min(self.margins, initial=0.0) >= -FEASIBLE / 2)

    def at(self, center: Linearization) -> tuple[float, np.ndarray]:
        """Return the linearized cost and margins (m,) at the point of `center`.

        A linearized cost above the cost at that point, and linearized margins below the margins there, are replaced by
        the values there. They occur if the functions are not convex.
        """
        step = center.point - self.point
        cost, margins = self.cost + product(self.slope, step), self.margins + product(self.margin_slopes, step)
        return min(float(cost), center.cost), np.maximum(margins, center.margins)


def bundle_search(
    problem: Problem, start: np.ndarray, *, radius: float = WIDE, tolerance: float, most: int
) -> OptimizeResult:
    """Search for the minimum cost of a problem from a start (n,) by a bundle method.

    Parameters
    ----------
    radius
        First radius of the trust region, as a share of the bounds.
    tolerance
        Decrease of the model, relative to the cost, below which the trust region is reduced or the search ends.
    most
        Largest number of linearizations.

    Returns
    -------
    OptimizeResult
        ``x`` (n,), ``message``, ``success``, ``linearizations``, and ``is_least``: whether the linearizations near the
        end show that the end is a local minimum.
    """
    best = Linearization.of(problem, start)
    bundle, count = [best], 1
    message, is_least = "the bundle method reached its limit of iterations", False
    while count < most:
        step, decrease = _model_step(best, bundle, radius)
        if decrease <= tolerance * abs(best.cost):
            if radius <= NEGLIGIBLE:
                is_least = _is_flat(best, bundle, NEGLIGIBLE)
                message = LEAST if is_least else STUCK
                break
            # a smaller region excludes distant points, which mislead if the cost is not convex
            radius = max(0.1 * radius, NEGLIGIBLE)
            continue
        trial = Linearization.of(problem, np.clip(best.point + step, 0.0, 1.0))
        count += 1
        if trial.cost >= FAILED:
            radius *= 0.25
            continue
        bundle.append(trial)
        share, size = (best.merit - trial.merit) / decrease, float(np.max(np.abs(step)))
        if best.is_feasible and not trial.is_feasible:  # the merit may be lower there if a limit has no slope
            share = 0.0
        if share > 0.7:
            radius = max(radius, 2.0 * size)
        elif share < 0.1:
            radius = min(0.7 * radius, max(2.0 * size, 0.1 * radius))
        if share > 0.0:
            best = trial
    return OptimizeResult(x=best.point, message=message, success=is_least, is_least=is_least, linearizations=bundle)


def _is_flat(center: Linearization, bundle: list[Linearization], radius: float) -> bool:
    """Return whether the model hardly decreases within a radius of a point; see `FLAT`."""
    return _model_step(center, bundle, radius)[1] <= FLAT * radius * max(abs(center.cost), 0.1)


def beyond_kink(problem: Problem, ended: OptimizeResult, tolerance: float, most: int) -> OptimizeResult:
    """Continue a search along gradients by a bundle method if it ended at a kink; otherwise, return `ended` unchanged.

    Parameters
    ----------
    ended
        Result of the search along gradients.
    tolerance, most
        See `bundle_search`.
    """
    end = np.clip(ended.x, 0.0, 1.0)
    at_end = Linearization.of(problem, end)
    if at_end.cost >= FAILED or _is_flat(at_end, [at_end], NEAR):
        return ended
    result = bundle_search(problem, end, radius=NEAR, tolerance=tolerance, most=most)
    if not any(_slopes_jump(at_end, linearization) for linearization in result.linearizations):
        return ended  # no kink; the model may decrease for another reason, such as a limit without a slope
    result.message = f"{str(ended.message).rstrip('.')} at a kink; from there, {result.message}"
    return result


def _slopes_jump(linearization: Linearization, other: Linearization) -> bool:
    """Return whether two neighbouring points have such different derivatives that there is a kink between them."""
    if np.max(np.abs(linearization.point - other.point)) > 2 * NEAR:
        return False
    here, there = (np.vstack([x.slope, x.margin_slopes]) for x in (linearization, other))
    return bool(np.max(np.abs(here - there)) > JUMP * np.max(np.abs(here)))


def _model_step(center: Linearization, bundle: list[Linearization], radius: float) -> tuple[np.ndarray, float]:
    """Return the step (n,) that minimises the model of the merit in a box, and the decrease of the model. The model
    consists of the linearizations near the center.

    Both are zero if the decrease is within the accuracy of the linear program.

    The unknowns of the linear program are the step relative to the radius, and the changes of cost and violation
    relative to the largest change of the cost in the box, because its solver has absolute tolerances.
    """
    n, near = len(center.point), [one for one in bundle if np.max(np.abs(one.point - center.point)) <= 4 * radius]
    if not (size := radius * max(float(np.max(np.abs(element.slope))) for element in near)):
        return np.zeros(n), 0.0
    rows, limits = [], []
    for linearization in near:
        cost, margins = linearization.at(center)
        rows.append([*(radius / size * linearization.slope), -1.0, 0.0])  # change z of the cost: cost + slope d <= z
        limits.append((center.cost - cost) / size)
        for margin, slope in zip(margins, linearization.margin_slopes, strict=True):
            rows.append([*(-radius / size * slope), 0.0, -1.0])  # violation s: -(margin + slope d) <= s
            limits.append(margin / size)
    low, high = np.maximum(-1.0, -center.point / radius), np.minimum(1.0, (1.0 - center.point) / radius)
    box = [*zip(low, high, strict=True), (None, None), (0.0, None)]
    solved = linprog([*np.zeros(n), 1.0, PENALTY], np.array(rows), np.array(limits), bounds=box)
    violation = -float(np.min(center.margins, initial=0.0))
    decrease = PENALTY * violation - size * float(solved.fun) if solved.success else 0.0
    return (radius * solved.x[:n], decrease) if decrease > SOLVED * size else (np.zeros(n), 0.0)
