"""How time grows with the nodes of a beam: steps of an explicit and of an implicit method on cantilevers; and Exudyn.

Times are those of the processor, least of several runs.
"""

from __future__ import annotations

import functools
from typing import Any

from rich.console import Console
from rich.table import Table

import mbdkit

from .beams_beside_exudyn import beside_exudyn
from .scale import slope, stepping, timed_spec
from .timing import duration, take_turns

STEPS = {30: 600, 100: 200, 300: 60, 1000: 20}
"""Number of nodes, and how many steps a timing has."""

METHODS: dict[str, dict[str, Any]] = {"rk4": {"name": "rk4"}, "gauss-2": {"name": "gauss", "stages": 2}}
STAGES = 4
REPEATS = 5
STEP = 1e-5  # s


def cantilever(nodes: int) -> mbdkit.Mechanism:
    """Return a cantilever under its weight, of as many nodes, so soft that all its motions are slow beside a step."""
    m = mbdkit.Mechanism()
    stiffness = {"axial": 100.0, "shear": 50.0, "bending": 0.1}
    m.beam("link", a=(0, 0), b=(1, 0), elements=nodes - 1, stiffness=stiffness, mass_per_length=1.0)
    m.weld("clamp", m.ground, "link.0", at=(0, 0))
    return m


def beams(console: Console) -> None:
    """Print the time of a step by the number of nodes, of an evaluation per element, and of a run by its error."""
    found: dict[str, dict[int, float]] = {name: {} for name in METHODS}
    for nodes, steps in STEPS.items():
        m = cantilever(nodes)
        tasks = {
            name: functools.partial(stepping, timed_spec(m, integrator, steps, STEP))
            for name, integrator in METHODS.items()
        }
        for name, timing in take_turns(tasks, REPEATS).items():
            found[name][nodes] = timing.least / steps
    table = Table(title=f"One step on a cantilever of two-node elements, least of {REPEATS}")
    for heading in ("nodes", *METHODS, "rk4, per element and evaluation"):
        table.add_column(heading, justify="right")
    for nodes in STEPS:
        explicit = found["rk4"][nodes]
        times = [duration(points[nodes]) for points in found.values()]
        table.add_row(str(nodes), *times, duration(explicit / STAGES / (nodes - 1)))
    table.add_row("slope", *(f"{slope(points):.2f}" for points in found.values()), "")
    console.print(table)
    beside_exudyn(console)
