"""What a gradient with respect to ten parameters costs, as a multiple of the run; differences of runs would cost
twenty.

The run is that of the knee without its archive. The preparation, which is repeated for each parameter, does not depend
on the number of steps; the differentiated run grows with them as the run does. Beside it stand CasADi's forward
sensitivities of the same collocation, of the double pendulum in the same coordinates, in ten directions of its start.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rich.console import Console
from rich.table import Table

import mbdkit
from mbdkit.runs.simulation import simulate_arrays
from mbdkit.spec import load_spec
from mbdkit_gradients.differentiated_run import Needs, differentiated_run
from mbdkit_gradients.gradient_parameters import resolved
from mbdkit_gradients.prepared_derivatives import prepared_derivatives

from .timing import duration, take_turns

PARAMETERS = tuple(
    f"model.{key}"
    for key in (
        "springs.support.stiffness", "springs.support.damping", "springs.support.free_length", "body_mass", "height",
        "flexion", "rod_mass", "damping", "gravity.1", "pitches.tibial",
    )
)  # fmt: skip
MEASURES = ("max(abs(joints.A.force))", "final(energy.kinetic)")
METHODS: tuple[tuple[dict[str, Any], float], ...] = (
    ({"name": "gauss", "stages": 3}, 1e-3),
    ({"name": "radau-iia", "stages": 3}, 1e-3),
    ({"name": "gauss", "stages": 2}, 1e-3),
    ({"name": "rk4"}, 5e-4),
)
REPEATS = 5
PENDULUM = tuple(f"model.{key}.{i}" for key in ("lengths", "masses", "angles", "rates", "gravity") for i in range(2))
STAGES, STEP, STEPS = 3, 1e-3, 4000


def gradients(console: Console) -> None:
    """Print the cost of gradients of the knee over 4 s."""
    table = Table(title="gradient of two measures of the knee in ten parameters, 4 s; median of the CPU time")
    for column in ("method", "step", "run", "preparation", "differentiated run", "gradient", "with check"):
        table.add_column(column)
    for integrator, step in METHODS:
        spec = load_spec("knee", (), integrator=integrator, time={"end": 4.0, "step": step})
        chosen = resolved(spec, PARAMETERS)
        seeds = prepared_derivatives(spec, chosen).seeds
        found = take_turns(
            {
                "run": timed(partial(simulate_arrays, spec)),
                "preparation": timed(partial(prepared_derivatives, spec, chosen)),
                "steps": timed(partial(differentiated_run, spec, seeds, Needs())),
                "gradient": timed(partial(mbdkit.gradient, spec, MEASURES, PARAMETERS, check=False)),
                "checked": timed(partial(mbdkit.gradient, spec, MEASURES, PARAMETERS)),
            },
            REPEATS,
        )
        run = found["run"].median
        names = ("preparation", "steps", "gradient", "checked")
        multiples = (f"{duration(found[name].median)} ({found[name].median / run:.1f} runs)" for name in names)
        stages = f"-{integrator['stages']}" if "stages" in integrator else ""
        table.add_row(f"{integrator['name']}{stages}", f"{step:g} s", duration(run), *multiples)
    console.print(table)
    beside_casadi(console)


def beside_casadi(console: Console) -> None:
    """Print what ten sensitivities of the double pendulum cost, beside those of CasADi if that is installed."""
    integrator, time = {"name": "gauss", "stages": STAGES}, {"end": STEP * STEPS, "step": STEP}
    spec = load_spec({"mbdkit": 1, "model": {"name": "double-pendulum"}, "integrator": integrator, "time": time})
    seeds = prepared_derivatives(spec, resolved(spec, PENDULUM)).seeds
    contenders = {
        "mbdkit": timed(partial(simulate_arrays, spec)),
        "mbdkit, differentiated": timed(partial(differentiated_run, spec, seeds, Needs())),
    }
    try:
        run, forward = casadi_sensitivities()
    except ImportError:
        console.print("CasADi is not installed, so that its sensitivities are not beside those of mbdkit")
    else:
        contenders |= {"CasADi": timed(run), "CasADi, differentiated": timed(forward)}
    found = take_turns(contenders, REPEATS)
    table = Table(title=f"double pendulum, gauss-{STAGES}, {STEPS} steps, ten directions; median of the CPU time")
    for column in ("code", "run", "differentiated run"):
        table.add_column(column)
    for name in [one for one in contenders if "," not in one]:
        run_time, whole = found[name].median, found[f"{name}, differentiated"].median
        table.add_row(name, duration(run_time), f"{duration(whole)} ({whole / run_time:.1f} runs)")
    console.print(table)


def casadi_sensitivities() -> tuple[Callable[[], object], Callable[[], object]]:
    """Return CasADi's run of the same collocation, and the run with ten forward sensitivities.

    CasADi differentiates its Newton iteration by the implicit function theorem. Both evaluate the steps one after
    another in its virtual machine; a just-in-time compiler is not used.
    """
    import casadi

    from tests.witness.casadi_gauss import RodChain

    chain = RodChain(2)
    q, v = chain.start(0.0)
    step, unknowns = chain.step(STAGES), 5 * chain.count * STAGES
    start = casadi.vertcat(q, v, casadi.DM.zeros(unknowns))
    x = casadi.MX.sym("x", 12 + unknowns)
    run = casadi.Function("once", [x], [casadi.vertcat(*step(x[:6], x[6:12], x[12:], STEP))]).fold(STEPS)
    forward, directions = run.forward(len(PENDULUM)), casadi.DM.eye(12 + unknowns)[:, : len(PENDULUM)]

    def both() -> None:
        forward(start, run(start), directions)

    return partial(run, start), both


def timed(work: Callable[[], object]) -> Callable[[], float]:
    """Return a function that does some work and returns the CPU time it took [s]."""

    def contender() -> float:
        begin = time.process_time()
        work()
        return time.process_time() - begin

    return contender
