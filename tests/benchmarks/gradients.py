"""What a gradient by ten parameters costs, as a multiple of the run; differences of runs would cost twenty.

The run is that of the knee without its archive. The preparation, which is repeated for each parameter, does not depend
on the number of steps; the differentiated run grows with them as the run does.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rich.console import Console
from rich.table import Table

import mbdkit
from mbdkit.gradients.differentiated_run import differentiated_run
from mbdkit.gradients.gradient_parameters import resolved
from mbdkit.gradients.prepared_derivatives import prepared_derivatives
from mbdkit.simulation import simulate_arrays
from mbdkit.spec import load_spec

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


def gradients(console: Console) -> None:
    """Print the cost of gradients of the knee over 4 s."""
    table = Table(title="gradient of two measures of the knee by ten parameters, 4 s; median of the CPU time")
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
                "steps": timed(partial(differentiated_run, spec, seeds, with_nodes=False)),
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


def timed(work: Callable[[], object]) -> Callable[[], float]:
    """Return a function that does some work and returns the CPU time it took [s]."""

    def contender() -> float:
        begin = time.process_time()
        work()
        return time.process_time() - begin

    return contender
