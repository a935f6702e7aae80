"""The symplectic method of Euler: kick and drift, or drift and kick."""

from typing import Literal

from pydantic import BaseModel, Field

import mbdkit


class Options(BaseModel):
    first: Literal["kick", "drift"] = Field("kick", description="Whether velocities or positions are advanced first.")


class SymplecticEuler(mbdkit.StepMethod):
    def __init__(self, options: Options):
        self.first = options.first

    def step(self, equations, t, state, h):
        if self.first == "kick":
            a, _ = equations.accelerations(t, state.q, state.v)
            return state.moved(h * (state.v + h * a), h * a)
        a, _ = equations.accelerations(t + h, state.q + h * state.v, state.v)
        return state.moved(h * state.v, h * a)


@mbdkit.hookimpl
def mbdkit_integrators():
    return [
        mbdkit.IntegratorPlugin(
            "kick-drift",
            "Symplectic Euler: explicit, order 1.",
            Options,
            create=SymplecticEuler,
            claims=lambda options: mbdkit.Claims(order=1, symplectic=True),
        )
    ]
