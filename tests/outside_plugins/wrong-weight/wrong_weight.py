"""The three-eighths rule of Kutta, which claims its order 4. One digit of a weight is wrong: 0.376 instead of 0.375."""

import numpy as np
from pydantic import BaseModel

import mbdkit

A = ([], [1 / 3], [-1 / 3, 1], [1, -1, 1])
WEIGHTS, NODES = np.array([0.125, 0.376, 0.375, 0.125]), (0, 1 / 3, 2 / 3, 1)


class Options(BaseModel):
    pass


class ThreeEighths(mbdkit.StepMethod):
    def step(self, equations, t, state, h):
        y, cuts = np.concatenate([state.q, state.v]), (equations.n,)
        k = np.zeros((4, len(y)))
        for i in range(4):
            q, v = np.split(y + h * (A[i] @ k[:i]), cuts)
            k[i] = np.concatenate([v, equations.accelerations(t + NODES[i] * h, q, v)[0]])
        return state.moved(*np.split(h * (WEIGHTS @ k), cuts))


@mbdkit.hookimpl
def mbdkit_integrators():
    return [
        mbdkit.IntegratorPlugin(
            "three-eighths",
            "The three-eighths rule: explicit, order 4.",
            Options,
            create=lambda options: ThreeEighths(),
            claims=lambda options: mbdkit.Claims(order=4, stages=4),
        )
    ]
