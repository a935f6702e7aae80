"""Heun's method of order 2, whose steps are controlled by the difference from Euler's."""

import numpy as np
from pydantic import BaseModel, Field

import mbdkit


class Options(BaseModel):
    rtol: float = Field(1e-5, gt=0, lt=1, description="Relative tolerance of the error of a step.")
    atol: float = Field(1e-7, gt=0, description="Absolute tolerance of the error of a step.")


class HeunEuler(mbdkit.StepMethod):
    error_order = 1.0

    def __init__(self, options: Options):
        self.tolerances = mbdkit.Tolerances(options.rtol, options.atol)

    def begin(self, equations, t, state, why):
        return None  # the derivative at the end of the last step is not that at this start

    def step(self, equations, t, state, h):
        cuts = equations.n, 2 * equations.n

        def f(time, y):
            q, v, z = np.split(y, cuts)
            a, _, rates = equations.derivatives(time, q, v, z)
            return np.concatenate([v, a, rates])

        y = np.concatenate([state.q, state.v, state.z])
        k1 = f(t, y) if state.memory is None else state.memory
        k2 = f(t + h, y + h * k1)
        dy = h / 2 * (k1 + k2)
        k3 = f(t + h, y + dy)

        def dense(theta):
            inner = (1 - theta) * (h * k1 - dy) - theta * (h * k3 - dy)
            return tuple(np.split(y + theta * (dy + (1 - theta) * inner), cuts))

        return mbdkit.Step(state.moved(*np.split(dy, cuts), memory=k3), error=h / 2 * (k2 - k1), dense=dense)


@mbdkit.hookimpl
def mbdkit_integrators():
    return [
        mbdkit.IntegratorPlugin(
            "heun-euler",
            "Heun's method with controlled steps: explicit, order 2(1).",
            Options,
            create=HeunEuler,
            claims=lambda options: mbdkit.Claims(adaptive=True, states=True, dense_order=2),
            dense_output=True,
        )
    ]
