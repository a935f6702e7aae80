"""Adams-Bashforth-Moulton methods of order 1 to 12 for mbdkit, in variable steps: predict, evaluate, correct, evaluate.

With y = (q, v, z), they integrate y' = f(t, y), the index-1 equations. The predictor of order k integrates the
polynomial through the last k derivatives, the corrector of order k + 1 that through these and the derivative at the
predicted end (local extrapolation). The difference of the correctors of orders k and k + 1 estimates the error of the
former.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

import mbdkit
from mbdkit.plugin.methods import lagrange
from mbdkit.plugin.seams import integrator_claims, integrator_method
from mbdkit_multistep.control import MultistepOptions, choice, norm, scale

REFERENCES = tuple(Path(__file__).with_name("adams.bib").read_text(encoding="utf-8").strip().split("\n\n"))
#: Gauss-Legendre quadrature on [0, 1], exact for the polynomials of all orders.
NODES, WEIGHTS = ((1 + x) / 2 if i == 0 else x / 2 for i, x in enumerate(np.polynomial.legendre.leggauss(8)))


class AdamsOptions(MultistepOptions):
    """Adams-Bashforth-Moulton methods of variable order."""

    max_order: Annotated[int, Field(ge=1, le=12)] = 12
    """Highest order of the predictor; that of the corrector is higher by 1."""


def integral(times: np.ndarray, t: float, h: float) -> np.ndarray:
    """Return the (K,) weights of values at `times` in the integral of their polynomial from `t` to ``t + h``."""
    weights: np.ndarray = h * WEIGHTS @ lagrange(times, t + h * NODES)
    return weights


@integrator_method
class Adams(mbdkit.StepMethod):
    """The methods.

    Their memory is (order of the next step, steps until the order may change, times, derivatives at these times), the
    present ones first.
    """

    error_order = 1.0

    def __init__(self, options: AdamsOptions):
        self.tolerances: mbdkit.Tolerances = options.tolerances()
        self.max_order = options.max_order

    def begin(self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, why: str) -> Any:
        """Forget the history, unless a projection has moved the last point by no more than the error of the step."""
        if why != "projection" or state.memory is None:
            return None
        order, wait, times, past = state.memory
        return order, wait, times, np.vstack([derivative(equations, t, state.q, state.v, state.z), past[1:]])

    def step(self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, h: float) -> mbdkit.Step:
        """Take one step."""
        cuts = equations.n, 2 * equations.n
        y = np.concatenate([state.q, state.v, state.z])
        if state.memory is None:
            order, wait, times, past = 1, 2, np.array([t]), derivative(equations, t, state.q, state.v, state.z)[None]
        else:
            order, wait, times, past = state.memory
        predicted = y + integral(times[:order], t, h) @ past[:order]
        here = np.append(t + h, times), np.vstack([derivative(equations, t + h, *np.split(predicted, cuts)), past])
        points = range(max(order - 1, 1), min(order + 2, self.max_order + 1, len(times) + 1) + 1)
        moves = {j: integral(here[0][:j], t, h) @ here[1][:j] for j in points}
        dy = moves[order + 1]
        scales = scale(self.tolerances, equations, y, y + dy)
        errors = {j: norm(moves[j + 1] - moves[j], scales) for j in points if j + 1 in moves}
        chosen = choice(errors, order, wait, h)

        def dense(theta: float) -> tuple[np.ndarray, ...]:
            """Return (q, v, z) of the integral of the polynomial of the corrector."""
            inside = integral(here[0][: order + 1], t, theta * h) @ here[1][: order + 1]
            return tuple(np.split(y + inside, cuts))

        new = state.moved(*np.split(dy, cuts))
        if chosen.accepted:
            last = derivative(equations, t + h, new.q, new.v, new.z)
            count = self.max_order + 1
            memory = chosen.order, chosen.wait, here[0][:count], np.vstack([last, past])[:count]
            new = state.moved(*np.split(dy, cuts), memory=memory)
        return mbdkit.Step(
            new, dense=dense, next_step=chosen.size, next_order=float(chosen.order), accepted=chosen.accepted
        )


def derivative(
    equations: mbdkit.EquationsOfMotion, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """Return the derivative of y = (q, v, z)."""
    a, _, rates = equations.derivatives(t, q, v, z)
    return np.concatenate([v, a, rates])


@integrator_claims
def claims(options: AdamsOptions) -> mbdkit.Claims:
    """Return the claims of the methods."""
    return mbdkit.Claims(
        adaptive=True,
        variable_order=options.max_order > 1,
        drift="constraints hold at acceleration level only: drift follows the tolerance and grows with time",
        needs=("accelerations",),
        stabilizations=("none", "baumgarte", "projection"),
        states=True,
        dense_order=2,
        conserves=("linear-momentum",),
    )
