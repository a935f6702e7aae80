"""Methods written in NumPy, right ones and wrong ones, and a way to run them without installing anything."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from pydantic import BaseModel

import mbdkit
from mbdkit import StepMethod, StepState
from mbdkit.registry.catalogue import Registry
from mbdkit.registry.manager import load_registry
from mbdkit.runs.simulation import simulate
from mbdkit.spec.run_spec import spec_type


class NoOptions(BaseModel):
    """Nothing to choose."""


class RungeKutta(StepMethod):
    """The classical method of order 4, as one would write it down."""

    def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
        q, v = state.q, state.v
        a1, _ = equations.accelerations(t, q, v)
        v2 = v + h / 2 * a1
        a2, _ = equations.accelerations(t + h / 2, q + h / 2 * v, v2)
        v3 = v + h / 2 * a2
        a3, _ = equations.accelerations(t + h / 2, q + h / 2 * v2, v3)
        v4 = v + h * a3
        a4, _ = equations.accelerations(t + h, q + h * v3, v4)
        return state.moved(h / 6 * (v + 2 * v2 + 2 * v3 + v4), h / 6 * (a1 + 2 * a2 + 2 * a3 + a4))


class Remembering(RungeKutta):
    """The same with multipliers of its own, that count its steps, and a memory."""

    carries_multipliers = True

    def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
        number = 1 if state.memory is None else state.memory + 1
        new = super().step(equations, t, state, h)
        return StepState(new.q, new.v, multipliers=np.full(equations.m, float(number)), memory=number)


class Failing(RungeKutta):
    """Takes some steps, and then does what a test wants."""

    def __init__(self, after: int, then: Callable[[Any, StepState], Any]):
        self.left, self.then = after, then

    def step(self, equations: Any, t: float, state: StepState, h: float) -> StepState:
        if self.left == 0:
            answer: StepState = self.then(equations, state)
            return answer
        self.left -= 1
        return super().step(equations, t, state, h)


def offering(method: Any, *, dense_output: bool = False, **claims: Any) -> Registry:
    """Return what is installed, and one integrator more, ``acme:mine``, that is the given method."""

    @mbdkit.hookimpl
    def mbdkit_integrators() -> Any:
        promised = mbdkit.Claims(**{"order": 4} | claims)
        code = {"options": NoOptions, "create": lambda options: method, "claims": lambda options: promised}
        return [mbdkit.IntegratorPlugin(name="mine", summary="A method under test", dense_output=dense_output, **code)]

    ours = [ep for ep in importlib.metadata.entry_points(group="mbdkit") if ep.dist and ep.dist.name == "mbdkit"]
    module = SimpleNamespace(mbdkit_integrators=mbdkit_integrators)
    dist = SimpleNamespace(name="acme", version="1.0")
    mine: Any = SimpleNamespace(name="mine", value="acme", dist=dist, load=lambda: module)
    return load_registry([*ours, mine])


def run_with(method: Any, model: Any, time: dict[str, Any], **sections: Any) -> mbdkit.Run:
    """Run a model (mapping or mechanism) with a method that is not installed, whatever its end."""
    if isinstance(model, mbdkit.Mechanism):
        model = model.to_spec()
    claims = {"formulations": (sections["formulation"],)} if "formulation" in sections else {}
    spec = spec_type(offering(method, **claims))
    return simulate(spec(mbdkit=1, model=model, integrator={"name": "mine"}, time=time, **sections))
