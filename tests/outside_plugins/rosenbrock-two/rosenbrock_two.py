"""ROS2 of Verwer, Spee, Blom and Hundsdorfer (1999): two stages with one matrix, order 2, L-stable."""

import numpy as np
from pydantic import BaseModel

import mbdkit

GAMMA = 1 - 2**-0.5


class Options(BaseModel):
    pass


class Ros2(mbdkit.StepMethod):
    def step(self, equations, t, state, h):
        cuts = equations.n, 2 * equations.n

        def f(time, y):
            q, v, z = np.split(y, cuts)
            a, _, rates = equations.derivatives(time, q, v, z)
            return np.concatenate([v, a, rates])

        y = np.concatenate([state.q, state.v, state.z])
        a_t, _, z_t = equations.time_derivative(t, state.q, state.v, state.z)
        f_t = h * GAMMA * np.concatenate([np.zeros(equations.n), a_t, z_t])
        matrix = np.eye(len(y)) - h * GAMMA * equations.jacobian(t, state.q, state.v, state.z)
        k1 = np.linalg.solve(matrix, f(t, y) + f_t)
        k2 = np.linalg.solve(matrix, f(t + h, y + h * k1) - 2 * k1 - f_t)
        return state.moved(*np.split(h * (1.5 * k1 + 0.5 * k2), cuts))


@mbdkit.hookimpl
def mbdkit_integrators():
    return [
        mbdkit.IntegratorPlugin(
            "ros2",
            "ROS2: linearly implicit, order 2, L-stable.",
            Options,
            create=lambda options: Ros2(),
            claims=lambda options: mbdkit.Claims(
                order=2, states=True, a_stable=True, l_stable=True, needs=("accelerations", "tangents")
            ),
        )
    ]
