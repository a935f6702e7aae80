"""Backward differentiation formulas of order 1 to 5 for mbdkit, with variable steps, on equations of index 1 and 2.

With y = (q, v, z), the formula of order k equates y' at the end of a step with the derivative of the polynomial through
y there and at the last k points, whatever their distances (variable coefficients): y = known + b y'. The end satisfies

    M a + Phi_q^T lam = Q(t, q, v, z),    z' = rates(t, q, v, z),    v = known + b a,    q = known + b (v - w)

and Phi_q v + Phi_t = 0 (index-2) or Phi_q a = gamma (index-1) with w = 0, or Phi_q v + Phi_t = 0 and Phi = 0 (ggl) with
w = M^-1 Phi_q^T mu, so that q is the point of the constraints nearest to known + b v in the mass metric. The difference
from the polynomial through the last k + 1 points, times the size of the step over the time since the first of them,
estimates the error (Brayton, Gustavson and Hachtel 1972).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

import mbdkit
from mbdkit.plugin.methods import lagrange
from mbdkit.plugin.seams import integrator_claims, integrator_method
from mbdkit_multistep.control import MultistepOptions, choice, norm, scale

REFERENCES = tuple(Path(__file__).with_name("bdf.bib").read_text(encoding="utf-8").strip().split("\n\n"))
#: Largest error of the iteration over the tolerance, largest change over the tolerance at which an iteration that does
#: not converge any more has reached rounding, and number of iterations; chosen.
ACCURACY, IDLE, MOST_ITERATIONS = 0.01, 1.0, 10
#: Of each formulation, `gamma_v` over b and `residual_q` over b^2 in `EquationsOfMotion.iteration_matrix`, and the
#: power of b by which changes of accelerations change the constraints.
TANGENTS = {"index-1": (-1.0, 1.0, 0), "index-2": (-0.5, 0.0, 1), "ggl": (-0.5, 0.0, 1)}


class BdfOptions(MultistepOptions):
    """Backward differentiation formulas of variable order."""

    max_order: Annotated[int, Field(ge=1, le=5)] = 5
    """Highest order. Formulas of order 1 and 2 are A-stable; those of order 3 to 5 amplify weakly damped oscillations
    whose frequency is high for the step."""


@integrator_method
class Bdf(mbdkit.StepMethod):
    """The formulas.

    Their memory is (order of the next step, steps until the order may change, times, (q, v, z, lam) at these times),
    the present ones first.
    """

    carries_multipliers = True
    error_order = 1.0

    def __init__(self, options: BdfOptions):
        self.tolerances: mbdkit.Tolerances = options.tolerances()
        self.max_order = options.max_order

    def step(self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, h: float) -> mbdkit.Step:
        """Take one step."""
        n, y, is_first = equations.n, np.concatenate([state.q, state.v, state.z]), state.memory is None
        if state.memory is None:  # a point on the tangent at the start serves the predictor of order 1 only
            a, lam, rates = equations.derivatives(t, state.q, state.v, state.z)
            back = y - h * np.concatenate([state.v, a, rates])
            order, wait, times = 1, 2, np.array([t, t - h])
            past = np.array([np.append(y, lam), np.append(back, lam)])
        else:
            order, wait, times, past = state.memory
            past = np.vstack([np.append(y, past[0, len(y) :]), past[1:]])  # a projection has moved the last point
        end = np.array([t + h])
        predictions = {
            k: lagrange(times[: k + 1], end)[0] @ past[: k + 1]
            for k in range(max(order - 1, 1), min(order + 1, self.max_order, len(times) - 1) + 1)
        }
        nodes = np.append(end, times[:order])
        weights = end_derivative(nodes)
        b, known = 1 / weights[0], -(weights[1:] / weights[0]) @ past[:order, : len(y)]
        scales = scale(self.tolerances, equations, y, predictions[order][: len(y)])
        new, lam = self.solve(equations, t + h, known, b, predictions[order], scales)
        gaps = {k: h / (t + h - times[k]) * (new - x[: len(y)]) for k, x in predictions.items()}
        chosen = choice({k: norm(gap, scales) for k, gap in gaps.items()}, order, wait, h)
        inside = np.vstack([new, past[:order, : len(y)]])
        kept = 1 if is_first else self.max_order + 1
        points = np.append(end, times[:kept]), np.vstack([np.append(new, lam), past[:kept]])

        def dense(theta: float) -> tuple[np.ndarray, ...]:
            """Return (q, v, z) of the polynomial of the formula."""
            return tuple(np.split(lagrange(nodes, np.array([t + theta * h]))[0] @ inside, (n, 2 * n)))

        q, v, z = np.split(new, (n, 2 * n))
        end_state = mbdkit.StepState(q, v, lam, (chosen.order, chosen.wait, *points), z=z)
        return mbdkit.Step(
            end_state, dense=dense, next_step=chosen.size, next_order=float(chosen.order), accepted=chosen.accepted
        )

    def solve(
        self,
        equations: mbdkit.EquationsOfMotion,
        t: float,
        known: np.ndarray,
        b: float,
        predicted: np.ndarray,
        scales: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return y and the multipliers at `t` with ``y = known + b y'``, by simplified Newton from `predicted`."""
        n, formulation = equations.n, equations.formulation
        cuts, (gamma, of_q, power) = (n, 2 * n), TANGENTS[formulation]
        known_q, known_v, known_z = np.split(known, cuts)
        q, v, z, lam = np.split(predicted, (*cuts, len(known)))
        a, rates = (v - known_v) / b, (z - known_z) / b
        matrix = equations.iteration_matrix(
            t, q, v, a, lam, z, damping=b, stiffness=b * b, gamma_v=gamma * b, residual_q=of_q * b * b
        )
        change = np.inf
        for iteration in range(MOST_ITERATIONS):
            q = known_q + b * v
            if formulation == "ggl":
                q = equations.project_positions(t, q)
            if formulation == "index-1":
                still = equations.constraint_rates(t, q, 0 * a) + equations.gamma(t, q, v)
                rows = equations.constraint_rates(t, q, a) - still
            else:
                rows = equations.constraint_rates(t, q, v)
            of_rates = equations.rates(t, q, v, z) - rates
            equations.hold(z)
            force = equations.residual(t, q, v, a, lam)
            da, dlam, dr = matrix.solve(-force, -rows / b**power, of_rates)
            a, lam, rates = a + da, lam + dlam, rates + dr
            v, z = known_v + b * a, known_z + b * rates
            before, change = change, norm(np.concatenate([b * b * da, b * da, b * dr]), scales)
            theta = change / before
            is_solved = theta * change <= (1 - theta) * ACCURACY if iteration else change <= 1e-2 * ACCURACY
            if is_solved or (theta >= 0.5 and change <= IDLE):
                q = known_q + b * v
                if formulation == "ggl":
                    q = equations.project_positions(t, q)
                if formulation != "index-1":  # removes what the iteration has left
                    v = equations.project_velocities(t, q, v)
                return np.concatenate([q, v, z]), lam
            if iteration > 1 and not theta < 1:
                break
        raise mbdkit.StepError("newton-failed", f"the equations were not solved in {iteration + 1} iterations")


def end_derivative(times: np.ndarray) -> np.ndarray:
    """Return the (K,) weights of values at `times` in the derivative of their polynomial at the first of them."""
    gaps = times[1:] - times[0]
    own = np.eye(len(gaps), dtype=bool)
    ratios = np.where(own, 1.0, gaps) / np.where(own, 1.0, gaps - gaps[:, None])
    others = np.prod(ratios, axis=1) / gaps
    return np.append(-np.sum(others), others)


@integrator_claims
def claims(options: BdfOptions) -> mbdkit.Claims:
    """Return the claims of the formulas."""
    return mbdkit.Claims(
        adaptive=True,
        variable_order=options.max_order > 1,
        drift="none with ggl; with index-2 and index-1, drift follows the tolerance and grows with time",
        constraints_hold=("position", "velocity"),
        needs=("tangents",),
        formulations=("ggl", "index-2", "index-1"),
        stabilizations=("none", "baumgarte", "projection"),
        states=True,
        dense_order=1,
        conserves=("linear-momentum",),
        a_stable=options.max_order <= 2,
        l_stable=options.max_order <= 2,
    )
