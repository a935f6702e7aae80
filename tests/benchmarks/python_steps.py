"""What a method written in NumPy costs beside the compiled one, on the double pendulum."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from mbdkit import EquationsOfMotion, Step, StepMethod, StepState, Tolerances
from mbdkit.engine.consistent_start import workspace_at_start
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.start import start_method
from mbdkit.methods import rk4
from mbdkit.methods.kinds import ExplicitRungeKutta
from mbdkit.spec import load_spec
from tests.integrators.step_methods import RungeKutta

from .timing import duration, take_turns

REPEATS, STEPS = 7, 10_000


class _Standing(StepMethod):
    """Does nothing."""

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        return StepState(state.q, state.v)


class _StandingControlled(StepMethod):
    """Does nothing, in steps that its error estimate controls."""

    tolerances = Tolerances(1e-6, 1e-8, max_step=1e-3)

    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> Step:
        return Step(StepState(state.q, state.v), error=np.full(2 * equations.n, 1e-12))


def python_steps(console: Console) -> None:
    """Print the cost of a step in Python, and of each call to the equations."""
    at_start, _ = workspace_at_start(load_spec("double-pendulum").mechanism())

    def stepped(method: Any) -> Callable[[], float]:
        def run() -> float:
            table = Timetable(0.0, STEPS * 1e-3, step=1e-3, steps=STEPS, every=100)
            stepper = start_method(method, replace(at_start), table)
            begin = time.perf_counter()
            while not stepper.finished:
                assert stepper.failure is None
                stepper.advance()
            return (time.perf_counter() - begin) / STEPS

        return run

    p = EquationsOfMotion(at_start)
    q, v, z = p.q0.copy(), p.v0.copy(), p.z0
    a, lam = p.accelerations(0.0, q, v)

    def called(call: Callable[[], object]) -> Callable[[], float]:
        def run() -> float:
            begin = time.perf_counter()
            for _ in range(STEPS):
                call()
            return (time.perf_counter() - begin) / STEPS

        return run

    terms: Any = {"damping": 1e-3, "stiffness": 1e-6}
    matrix = p.iteration_matrix(0.0, q, v, a, lam, **terms)
    calls: dict[str, Callable[[], object]] = {
        "accelerations": lambda: p.accelerations(0.0, q, v),
        "derivatives": lambda: p.derivatives(0.0, q, v, z),
        "solve": lambda: p.solve(0.0, q, a, lam),
        "residual": lambda: p.residual(0.0, q, v, a, lam),
        "forces": lambda: p.forces(0.0, q, v),
        "constraint_forces": lambda: p.constraint_forces(0.0, q, lam),
        "constraints": lambda: p.constraints(0.0, q),
        "constraint_rates": lambda: p.constraint_rates(0.0, q, v),
        "gamma": lambda: p.gamma(0.0, q, v),
        "project_positions": lambda: p.project_positions(0.0, q),
        "project_velocities": lambda: p.project_velocities(0.0, q, v),
        "project": lambda: p.project(0.0, q, v),
        "solve_between": lambda: p.solve_between(0.0, q, a, 0.01, q, v, 0.01),
        "potential": lambda: p.potential(0.0, q),
        "constraint_jacobian": lambda: p.constraint_jacobian(0.0, q),
        "tangents": lambda: p.tangents(0.0, q, v, a, lam),
        "jacobian": lambda: p.jacobian(0.0, q, v, z),
        "iteration_matrix": lambda: p.iteration_matrix(0.0, q, v, a, lam, **terms),
        "solve with it": lambda: matrix.solve(a, lam),
    }
    contenders = {
        "step: rk4 in compiled code": stepped(ExplicitRungeKutta(rk4.tableau())),
        "step: a method in Python that does nothing": stepped(_Standing()),
        "step: the same with controlled steps": stepped(_StandingControlled()),
        "step: rk4 in NumPy, four evaluations": stepped(RungeKutta()),
        **{f"call: {name}": called(call) for name, call in calls.items()},
    }
    table = Table(title=f"Methods written in NumPy: double pendulum, medians of {REPEATS}")
    table.add_column("what")
    table.add_column("time", justify="right")
    for name, timing in take_turns(contenders, REPEATS).items():
        table.add_row(name, duration(timing.median))
    console.print(table)
