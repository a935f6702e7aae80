"""RK23 of SciPy: a solver of a library, which chooses its own steps."""

import numpy as np
from pydantic import BaseModel, Field
from scipy.integrate import RK23

import mbdkit


class Options(BaseModel):
    rtol: float = Field(1e-6, ge=2.3e-14, lt=1, description="Relative tolerance of the error of a step.")
    atol: float = Field(1e-8, gt=0, description="Absolute tolerance of the error of a step.")


class Library(mbdkit.ExternalMethod):
    def __init__(self, options: Options):
        self.given = options
        self.tolerances = mbdkit.Tolerances(options.rtol, options.atol)

    def open(self, equations, t, state, stop):
        self.cuts = equations.n, 2 * equations.n

        def rates(time, y):
            q, v, z = np.split(y, self.cuts)
            a, _, z_rates = equations.derivatives(time, q, v, z)
            return np.concatenate([v, a, z_rates])

        y, given = np.concatenate([state.q, state.v, state.z]), self.given
        self.solver = RK23(rates, t, y, stop, rtol=given.rtol, atol=given.atol, first_step=equations.first_step)

    def advance(self):
        message = self.solver.step()
        if self.solver.status == "failed":
            raise mbdkit.StepError("step-too-small", str(message).rstrip("."))
        self.inner, begin, h = self.solver.dense_output(), self.solver.t_old, self.solver.step_size

        def dense(theta, inner=self.inner):
            return tuple(np.split(inner(begin + theta * h), self.cuts))

        end, size = self.state(self.solver.y), float(self.solver.h_abs)
        return mbdkit.Step(end, dense=dense, next_step=size, time=float(self.solver.t))

    def cut(self, t):
        return self.state(self.inner(t))

    def state(self, y):
        q, v, z = np.split(y, self.cuts)
        return mbdkit.StepState(q, v, z=z)

    def save(self):
        return np.concatenate([[self.solver.t, self.solver.h_abs], self.solver.y, self.solver.f]).tobytes()

    def restore(self, stored):
        solver, numbers = self.solver, np.frombuffer(stored)
        (solver.t, solver.h_abs), (solver.y, solver.f) = numbers[:2], np.split(numbers[2:].copy(), 2)


@mbdkit.hookimpl
def mbdkit_integrators():
    claims = mbdkit.Claims(
        adaptive=True, states=True, dense_order=3, stabilizations=("none", "baumgarte", "projection")
    )
    return [
        mbdkit.IntegratorPlugin(
            "scipy-rk23", "RK23 of SciPy.", Options, create=Library, claims=lambda options: claims, dense_output=True
        )
    ]
