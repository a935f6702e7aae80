"""Two methods in Python, and runs with them."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.integrate

import mbdkit
from mbdkit import EquationsOfMotion, ExternalMethod, Step, StepMethod, StepState, Tolerances
from mbdkit.runs.simulation import simulate
from mbdkit.spec.run_spec import spec_type
from tests.integrators.step_methods import offering


class Pair(StepMethod):
    """The pair of Bogacki and Shampine, orders 3 and 2, with the last stage as memory and a cubic as dense output."""

    error_order = 2

    def __init__(self, rtol: float | None = 1e-6):
        self.tolerances = None if rtol is None else Tolerances(rtol, rtol)

    @staticmethod
    def rates(p: EquationsOfMotion, t: float, y: np.ndarray) -> np.ndarray:
        q, v, z = np.split(y, [p.n, 2 * p.n])
        a, _, rates = p.derivatives(t, q, v, z)
        return np.concatenate([v, a, rates])

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: str) -> Any:
        return {"k": self.rates(equations, t, np.concatenate([state.q, state.v, state.z])), "why": why}

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        y, k1 = np.concatenate([state.q, state.v, state.z]), state.memory["k"]
        k2 = self.rates(equations, t + h / 2, y + h / 2 * k1)
        k3 = self.rates(equations, t + 3 * h / 4, y + 3 * h / 4 * k2)
        dy = h / 9 * (2 * k1 + 3 * k2 + 4 * k3)
        k4 = self.rates(equations, t + h, y + dy)
        error = h * (-5 / 72 * k1 + k2 / 12 + k3 / 9 - k4 / 8)
        parts = [equations.n, 2 * equations.n]

        def dense(theta: float) -> tuple[np.ndarray, ...]:
            line = (1 - theta) * y + theta * (y + dy)
            bend = (1 - 2 * theta) * dy + (theta - 1) * h * k1 + theta * h * k4
            return tuple(np.split(line + theta * (theta - 1) * bend, parts))

        new = state.moved(*np.split(dy, parts), memory={"k": k4, "why": state.memory["why"]})
        return Step(new, error, dense)


class Rk45(ExternalMethod):
    """SciPy's RK45, a step at a time, whose state is its last rates and its next step."""

    tolerances = Tolerances(1e-8, 1e-8)

    def open(self, equations: EquationsOfMotion, t: float, state: StepState, stop: float) -> None:
        self.p, self.y = equations, np.concatenate([state.q, state.v, state.z])
        given = {"rtol": 1e-8, "atol": 1e-8, "first_step": equations.first_step}
        self.solver = scipy.integrate.RK45(lambda t, y: Pair.rates(equations, t, y), t, self.y, stop, **given)

    def advance(self) -> Step:
        self.solver.step()
        inner, n = self.solver.dense_output(), self.p.n
        t0, h = self.solver.t_old, self.solver.t - self.solver.t_old
        q, v, z = np.split(self.solver.y, [n, 2 * n])

        def dense(theta: float) -> tuple[np.ndarray, ...]:
            assert self.solver.t_old == t0, "the library has taken another step or was opened again"
            return tuple(np.split(inner(t0 + theta * h), [n, 2 * n]))

        return Step(
            StepState(q, v, z=z),
            dense=dense,
            next_step=float(self.solver.h_abs),
            time=float(self.solver.t),
        )

    def save(self) -> bytes:
        return np.concatenate([[self.solver.h_abs], self.solver.f]).tobytes()

    def restore(self, stored: bytes) -> None:
        self.solver.h_abs, *self.solver.f = np.frombuffer(stored).copy()
        self.solver.f = np.array(self.solver.f)


def run_with(method: Any, model: Any, time: dict[str, Any], **sections: Any) -> mbdkit.Run:
    """Run a model with a method that integrates states, whatever its end."""
    claims = {"states": True} if method.tolerances is None else {"states": True, "adaptive": True, "order": None}
    if not isinstance(method, StepMethod):
        claims["stabilizations"] = ("none", "baumgarte", "projection")
    registry = offering(method, dense_output=True, **claims)
    model = model.to_spec() if isinstance(model, mbdkit.Mechanism) else model
    data = {"mbdkit": 1, "model": model, "integrator": {"name": "mine"}, "time": time, **sections}
    return simulate(spec_type(registry)(**data))
