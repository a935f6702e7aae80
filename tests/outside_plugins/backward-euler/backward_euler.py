"""The implicit method of Euler on the equations of Gear, Gupta and Leimkuhler, with multipliers of its own."""

import numpy as np
from pydantic import BaseModel, Field

import mbdkit


class Options(BaseModel):
    max_iterations: int = Field(50, ge=2, le=1000, description="Largest number of Newton iterations in one step.")


class BackwardEuler(mbdkit.StepMethod):
    carries_multipliers = True

    def __init__(self, options: Options):
        self.max_iterations = options.max_iterations

    def step(self, equations, t, state, h):
        a, lam, rates = equations.derivatives(t, state.q, state.v, state.z)
        lam, before, t = lam if state.multipliers is None else state.multipliers, np.inf, t + h
        for _ in range(self.max_iterations):
            v, z = state.v + h * a, state.z + h * rates
            q = equations.project_positions(t, state.q + h * v)
            matrix = equations.iteration_matrix(t, q, v, a, lam, z, damping=h, stiffness=h * h, gamma_v=-h / 2)
            force, rows = equations.residual(t, q, v, a, lam), equations.constraint_rates(t, q, v)
            da, dlam, dr = matrix.solve(-force, -rows / h, equations.rates(t, q, v, z) - rates)
            change = equations.relative_change(np.maximum(np.abs(v), np.abs(state.v)), h * da)
            change = float(np.max(np.abs(h * dr) / np.maximum(1, np.abs(z)), initial=change))
            a, lam, rates = a + da, lam + dlam, rates + dr
            if change <= 4e-16 or before / 2 <= change < 1e-9:
                v = state.v + h * a
                q = equations.project_positions(t, state.q + h * v)
                return mbdkit.StepState(q, v, lam, z=state.z + h * rates)
            before = change
        raise mbdkit.StepError("newton-failed", f"no solution in {self.max_iterations} iterations")


@mbdkit.hookimpl
def mbdkit_integrators():
    claims = mbdkit.Claims(
        order=1,
        multiplier_order=1,
        constraints_hold=("position", "velocity"),
        needs=("tangents", "accelerations"),
        formulations=("ggl",),
        stabilizations=("none", "projection"),
        states=True,
        a_stable=True,
        l_stable=True,
    )
    return [
        mbdkit.IntegratorPlugin(
            "backward-euler",
            "Implicit Euler on the GGL equations: order 1, L-stable.",
            Options,
            create=BackwardEuler,
            claims=lambda options: claims,
        )
    ]
