"""Generalized-alpha for mbdkit: an implicit method in fixed steps on the index-3 equations.

    M v' + Phi_q^T lam = Q(t, q, v),      Phi(t, q) = 0                                    at the end of every step

    q_1 = q_0 + h v_0 + h^2 (1/2 - beta) a_0 + h^2 beta a_1
    v_1 = v_0 + h (1 - gamma) a_0 + h gamma a_1
    (1 - alpha_m) a_1 + alpha_m a_0 = (1 - alpha_f) v'_1 + alpha_f v'_0

The auxiliary acceleration a approximates v' at a time that differs from that of q and v by (alpha_m - alpha_f) h. The
velocity constraints are violated by an amount of order h^2 in the steady state (Arnold and Bruls 2007). The method
starts in this steady state (Arnold, Bruls and Cardona 2015); otherwise the multipliers would converge only with order 1
until a transient has died out. It starts anew where the step size changes, which happens at most at the last step of a
run.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import BaseModel, ConfigDict, Field

import mbdkit
from mbdkit.plugin.seams import integrator_claims, integrator_method

if TYPE_CHECKING:
    import numpy as np

REFERENCES = tuple(Path(__file__).with_name("references.bib").read_text(encoding="utf-8").strip().split("\n\n"))
CONVERGED, STAGNANT = 4e-16, 1e-9


class GeneralizedAlphaOptions(BaseModel):
    """Options: the damping of the method, and a limit of its iterations."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", use_attribute_docstrings=True)

    rho_inf: Annotated[float, Field(ge=0, lt=1)] = 0.8
    """Spectral radius at infinite frequency: 0 damps the fastest oscillations within one step, values near 1 damp them
    hardly. The value 1 is excluded, because errors of the multipliers would accumulate.
    """
    max_iterations: Annotated[int, Field(ge=2, le=1000)] = 30
    """Largest number of Newton iterations in one step; a step that needs more has failed."""


@integrator_method
class GeneralizedAlpha(mbdkit.StepMethod):
    """The method with the coefficients of Chung and Hulbert, which are optimal for a given spectral radius at infinite
    frequency.
    """

    carries_multipliers = True

    def __init__(self, options: GeneralizedAlphaOptions):
        rho = options.rho_inf
        self.max_iterations = options.max_iterations
        self.alpha_m, self.alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
        self.gamma = 0.5 + self.alpha_f - self.alpha_m
        self.beta = 0.25 * (self.gamma + 0.5) ** 2

    def start_at(
        self, equations: mbdkit.EquationsOfMotion, t: float, q: np.ndarray, v: np.ndarray, h: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return velocities, accelerations, multipliers and auxiliary accelerations of the steady state near q and
        v.
        """
        a, lam = equations.accelerations(t, q, v)
        near = 1e-4 * h
        later, _ = equations.accelerations(t + near, q + near * v, v + near * a)
        earlier, _ = equations.accelerations(t - near, q - near * v, v - near * a)
        jerk, away = (later - earlier) / (2 * near), self.alpha_m - self.alpha_f
        lead = h**2 * (1 / 6 - away / 2 - self.beta) * jerk
        rows = equations.constraint_rates(t, q, v + lead) - equations.constraint_rates(t, q, v)
        return v + equations.solve(t, q, 0 * a, rows)[0], a, lam, a + away * h * jerk

    def step(
        self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, h: float
    ) -> mbdkit.StepState:
        """Take one step. Newton's method solves for the accelerations and multipliers at its end."""
        q, v = state.q, state.v
        if state.memory is not None and state.memory[0] == h:
            _, a, lam, aux = state.memory
        else:
            v = v if state.memory is None else equations.project_velocities(t, q, v)
            v, a, lam, aux = self.start_at(equations, t, q, v, h)
        q0 = q + h * v + h**2 * (0.5 - self.beta) * aux
        v0 = v + h * (1 - self.gamma) * aux
        known = (self.alpha_f * a - self.alpha_m * aux) / (1 - self.alpha_m)
        share = (1 - self.alpha_f) / (1 - self.alpha_m)
        end, per_v, per_q = t + h, h * self.gamma * share, h**2 * self.beta * share  # dv/da and dq/da
        before = float("inf")
        for _ in range(self.max_iterations):
            aux = known + share * a
            q, v = q0 + h**2 * self.beta * aux, v0 + h * self.gamma * aux
            matrix = equations.iteration_matrix(end, q, v, a, lam, damping=per_v, stiffness=per_q)
            missing = equations.residual(end, q, v, a, lam)
            da, dlam = matrix.solve(-missing, -equations.constraints(end, q) / per_q)
            a, lam = a + da, lam + dlam
            change = equations.relative_change(q, per_q * da)
            if change <= CONVERGED or before / 2 <= change < STAGNANT:
                aux = known + share * a
                q, v = q0 + h**2 * self.beta * aux, v0 + h * self.gamma * aux
                return mbdkit.StepState(q, v, multipliers=lam, memory=(h, a, lam, aux))
            before = change
        raise mbdkit.StepError(
            "newton-failed",
            f"the last of {self.max_iterations} Newton iterations still moved a body by {change:.1g} of its place",
        )


@integrator_claims
def claims(options: GeneralizedAlphaOptions) -> mbdkit.Claims:
    """Return the claims of the method."""
    return mbdkit.Claims(
        order=2,
        multiplier_order=2,
        drift="no drift of positions beyond round-off; velocity misalignment is of order 2 and does not grow",
        needs=("tangents",),
        formulations=("index-3",),
        stabilizations=("none", "projection"),
        conserves=("linear-momentum",),
        a_stable=True,
    )
