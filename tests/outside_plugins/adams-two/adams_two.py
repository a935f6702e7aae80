"""The method of Adams and Bashforth with two steps, whose ratio may change."""

import numpy as np
from pydantic import BaseModel

import mbdkit


class Options(BaseModel):
    pass


class AdamsBashforth(mbdkit.StepMethod):
    """Its memory is (size of the last step, derivative at its start); the first step is one of Heun."""

    def begin(self, equations, t, state, why):
        return state.memory if why == "projection" else None

    def step(self, equations, t, state, h):
        def f(time, y):
            q, v, z = np.split(y, cuts)
            a, _, rates = equations.derivatives(time, q, v, z)
            return np.concatenate([v, a, rates])

        y, cuts = np.concatenate([state.q, state.v, state.z]), (equations.n, 2 * equations.n)
        now = f(t, y)
        if state.memory is None:
            dy = h / 2 * (now + f(t + h, y + h * now))
        else:
            last, before = state.memory
            dy = h * (now + h / (2 * last) * (now - before))
        return mbdkit.Step(state.moved(*np.split(dy, cuts), memory=(h, now)))


@mbdkit.hookimpl
def mbdkit_integrators():
    return [
        mbdkit.IntegratorPlugin(
            "ab2",
            "Adams-Bashforth: explicit, two steps, order 2.",
            Options,
            create=lambda options: AdamsBashforth(),
            claims=lambda options: mbdkit.Claims(
                order=2, states=True, stabilizations=("none", "baumgarte", "projection")
            ),
        )
    ]
