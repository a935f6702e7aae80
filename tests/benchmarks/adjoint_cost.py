"""What the compiled part of an adjoint gradient costs, as a multiple of the steps of the run.

Compared are the same compiled steps: those of a run that records nothing but its start and end; those that keep what
the way back needs; and the way back itself. The processor time of the calls of machine code is added up, and the least
of several repetitions counts. Beside them stands CasADi's adjoint of two rods in their angles.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from rich.console import Console
from rich.table import Table

from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.runs.preparation import RunSetup, make_method
from mbdkit.spec import load_spec
from mbdkit_gradients.adjoint_gradient import AdjointRun
from mbdkit_gradients.backward_sweep import BackwardSweep
from mbdkit_gradients.differentiated_expressions import expressions_of
from mbdkit_gradients.differentiated_run import Needs
from mbdkit_gradients.gradient_parameters import resolved
from mbdkit_gradients.measured_derivatives import needs_of
from mbdkit_gradients.prepared_derivatives import prepared_derivatives

from .gradients import timed

MEASURE = "final(energy.kinetic)"
RK4, GAUSS = {"name": "rk4"}, {"name": "gauss", "stages": 2}
CHAIN = ("model.mass",), ("model.mass", "model.length")
KNEE = ("model.rod_mass",), ("model.body_mass", "model.height")
#: Name, model, number of steps, size of the steps by method [s], and parameters; the second ones move points of joints.
CASES: tuple[tuple[str, dict[str, Any], int, tuple[float, float], tuple[tuple[str, ...], ...]], ...] = (
    *(
        (
            f"{n} rods",
            {"name": "n-pendulum", "n": n, "mass": 1.0, "length": 1.0, "angle": -0.5},
            steps,
            (1e-3,) * 2,
            CHAIN,
        )
        for n, steps in ((2, 4000), (20, 600), (200, 60))
    ),
    ("four-bar knee", {"name": "four-bar-knee"}, 2000, (5e-4, 1e-4), KNEE),
)
REPEATS = 15


@contextmanager
def compiled_time(spent: list[float]) -> Iterator[None]:
    """Add the processor time of all compiled steps, forward and back, to ``spent[0]`` [s]."""
    places = (CompiledStepper, "drive"), (BackwardSweep, "_call")
    originals = [getattr(owner, name) for owner, name in places]

    def timed(work: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            begin = time.thread_time()
            found = work(*arguments)
            spent[0] += time.thread_time() - begin
            return found

        return call

    for (owner, name), original in zip(places, originals, strict=True):
        setattr(owner, name, timed(original))
    try:
        yield
    finally:
        for (owner, name), original in zip(places, originals, strict=True):
            setattr(owner, name, original)


def times_of(
    model: dict[str, Any], method: dict[str, Any], steps: int, step: float, names: tuple[str, ...]
) -> tuple[float, ...]:
    """Return the least times [s] of steps that record nothing, of steps that are kept, and of the way back."""
    sections = {"integrator": method, "time": {"end": steps * step, "step": step}, "output": {"every": steps}}
    spec = load_spec({"mbdkit": 1, "model": model, **sections})
    seeds = prepared_derivatives(spec, resolved(spec, names)).seeds
    expressions = expressions_of(spec, {MEASURE: (MEASURE, "")})
    need = needs_of(expressions[MEASURE])
    setup, spent, rows = RunSetup.of(spec, method=make_method(spec)), [0.0], []

    def since(before: float) -> float:
        return spent[0] - before

    with compiled_time(spent):
        for _ in range(REPEATS):
            stepper: Any = setup.stepper()
            before = spent[0]
            while not stepper.finished:
                stepper.advance()
            forward, before = since(before), spent[0]
            run = AdjointRun(spec, seeds, Needs(need.nodes, need.ends))
            kept, before = since(before), spent[0]
            run.measures(expressions)
            rows.append((forward, kept, since(before)))
    return tuple(map(min, zip(*rows, strict=True)))


def adjoint_cost(console: Console) -> None:
    """Print the times of steps that are kept, and of the way back, as multiples of those that record nothing."""
    table = Table(title=f"adjoint of {MEASURE}: compiled steps as multiples of a run that records nothing")
    for column in ("case", "method", "parameters", "a step", "kept", "back", "together"):
        table.add_column(column)
    for name, model, steps, sizes, parameters in CASES:
        for method, step in zip((RK4, GAUSS), sizes, strict=True):
            for names in parameters:
                forward, kept, back = times_of(model, method, steps, step, names)
                shares = (f"{x / forward:.2f}" for x in (kept, back, kept + back))
                short = ", ".join(one.removeprefix("model.") for one in names)
                table.add_row(name, str(method["name"]), short, f"{forward / steps * 1e6:.2f} us", *shares)
    with suppress(ImportError):
        forward, whole = casadi_times(CASES[0][2], CASES[0][3][0])
        cost = f"{forward / CASES[0][2] * 1e6:.2f} us", "", "", f"{whole / forward:.2f}"
        table.add_row("2 rods, CasADi", "rk4", "mass, start", *cost)
    console.print(table)


def casadi_times(steps: int, step: float) -> tuple[float, float]:
    """Return the times [s] of the steps of two rods in their angles, and of these with their adjoint, by CasADi.

    Its virtual machine evaluates the steps one after another; a just-in-time compiler is not used.
    """
    import casadi

    x = casadi.SX.sym("x", 5)  # angles and rates of rods of 1 m, and their mass
    rates = two_rods(x)
    k1 = rates(x)
    k2 = rates(x + step / 2 * k1)
    k3 = rates(x + step / 2 * k2)
    once = casadi.Function("once", [x], [x + step / 6 * (k1 + 2 * k2 + 2 * k3 + rates(x + step * k3))])
    run = once.fold(steps)
    start = [-0.5, -0.5, 0.0, 0.0, 1.0]
    back = partial(run.reverse(1), start, run(start), [0.0, 0.0, 1.0, 0.0, 0.0])
    forward, whole = (min(timed(work)() for _ in range(REPEATS)) for work in (partial(run, start), back))
    return forward, whole


def two_rods(x: Any) -> Any:
    """Return CasADi's function of the rates of angles and rates `x` of two rods; see `casadi_times`."""
    import casadi

    first, second, mass = x[0], x[1], x[4]
    turn, g = first - second, 9.81
    inertia = mass * casadi.vertcat(
        casadi.horzcat(4 / 3, casadi.cos(turn) / 2), casadi.horzcat(casadi.cos(turn) / 2, 1 / 3)
    )
    moment_1 = -(x[3] ** 2) * casadi.sin(turn) / 2 - 1.5 * g * casadi.cos(first)
    moment_2 = x[2] ** 2 * casadi.sin(turn) / 2 - g / 2 * casadi.cos(second)
    a = casadi.solve(inertia, mass * casadi.vertcat(moment_1, moment_2))
    return casadi.Function("rates", [x], [casadi.vertcat(x[2], x[3], a, 0)])
