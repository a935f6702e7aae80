"""Time at equal error of a swinging flexible rod: beams of mbdkit and of Exudyn, one core, in turns.

The error is the largest distance of the tip from its place at several times: of the mesh and of the steps together, and
at several times because they may cancel at one. For each bound, each code has the mesh, method and number of steps with
which it was fastest in a first trial of all of them.

Exudyn has beams of the same theory (`ObjectBeamGeometricallyExact2D`, order two) and cables (`ObjectANCFCable2D`, order
four), which have neither shear nor rotary inertia: their error is the distance from their own limit. Its explicit
solvers are not among them: with the option that eliminates the constraints of the pin, errors are of order one in the
mesh.
"""

from __future__ import annotations

import functools
import importlib.util
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from rich.console import Console
from rich.table import Table

import mbdkit
from mbdkit.base.errors import RunError
from tests.witness.extrapolation import limit
from tests.witness.swinging_rod import exudyn_cable, exudyn_rod, rod

from .timing import duration, take_turns

END, TIMES = 2.0, 8
"""End [s], and at how many times the error is measured."""

BOUNDS = (1e-2, 1e-3, 1e-4, 1e-5)  # m
REPEATS = 9
STEPS = tuple(40 * 2**k for k in range(7))
EXUDYN_STEPS = tuple(40 * 2**k for k in range(9))
"""More of them, for a method of order two."""

METHODS: dict[str, dict[str, Any]] = {
    "gauss-2": {"name": "gauss", "stages": 2},
    "gauss-3": {"name": "gauss", "stages": 3},
    "radau-iia-3": {"name": "radau-iia", "stages": 3},
    "rk4": {"name": "rk4"},
}
Kind = Literal["two-node", "corrected", "three-node"]
MESHES: dict[Kind, tuple[int, ...]] = {
    "two-node": (4, 8, 16, 32, 64, 128),
    "corrected": (2, 3, 4, 6, 8, 12, 16, 24, 32),
    "three-node": (2, 3, 4, 6, 8, 12, 16),
}
EXUDYN_RODS = {"beams": exudyn_rod, "cables": exudyn_cable}
EXUDYN_SETTINGS: dict[str, dict[str, Any]] = {
    "sparse": {"sparse": True, "loose": 1e2},
    "sparse, loose": {"sparse": True, "loose": 1e4},
    "dense": {"sparse": False, "loose": 1e2},
}
"""Of the trapezoidal rule: matrices, and tolerances of Newton's method, Exudyn's own ones or 100 times larger."""
EXUDYN_MESHES = (2, 4, 8, 16, 32, 64, 128)
MOST_DENSE = 16
"""Elements up to which Exudyn's dense matrices are tried."""

Outcome = tuple[float, np.ndarray]
"""Seconds of the steps, and where the tip is after equal parts of the time, (parts, 2)."""


@dataclass(frozen=True)
class Choice:
    """A mesh, a method and a number of steps, how they are named, and what a trial has shown."""

    label: str
    go: Callable[[int], Outcome]
    """What runs it, and returns the tip at that many times."""
    seconds: float
    error: float


def beside_exudyn(console: Console) -> None:
    """Print how long both codes take for given errors."""
    exact = limit([_ours("three-node", n, METHODS["gauss-3"], 4000, TIMES)[1] for n in (8, 16, 32)], 4)
    groups = {f"mbdkit, {kind}": list(_tried(_our_choices(kind), exact)) for kind in MESHES}
    if importlib.util.find_spec("exudyn"):
        groups["Exudyn, beams"] = list(_tried(_their_choices("beams"), exact))
        without_shear = limit([_theirs("cables", 32, steps, "sparse", TIMES)[1] for steps in (2560, 5120, 10240)], 2)
        groups["Exudyn, cables"] = list(_tried(_their_choices("cables"), without_shear))
        apart = float(np.max(np.linalg.norm(without_shear - exact, axis=1)))
        console.print(f"The limit of cables is up to {apart:.1e} m from that of beams")
    else:
        console.print("Exudyn is not installed; its columns are left out")
    table = Table(title=f"A swinging flexible rod over {END:g} s, median of {REPEATS} in turns")
    for heading in (
        "error of the tip [m]",
        *groups,
        *(["fastest Exudyn / mbdkit"] if len(groups) > len(MESHES) else []),
    ):
        table.add_column(heading, justify="right")
    for bound in BOUNDS:
        best = {name: _fastest(choices, bound) for name, choices in groups.items()}
        tasks = {name: functools.partial(_seconds, one) for name, one in best.items() if one is not None}
        found = {name: timing.median for name, timing in take_turns(tasks, REPEATS).items()}
        row = [f"{bound:.0e}"]
        for name, one in best.items():
            row.append("-" if one is None else f"{duration(found[name])} ({one.label}, {one.error:.0e})")
        ours = min(seconds for name, seconds in found.items() if name.startswith("mbdkit"))
        theirs = [seconds for name, seconds in found.items() if name.startswith("Exudyn")]
        table.add_row(*row, *([f"{min(theirs) / ours:.2g}"] if theirs else []))
    table.caption = "In brackets: elements, method, steps, and the error; only steps are timed"
    console.print(table)


def _ours(kind: Kind, elements: int, integrator: dict[str, Any], steps: int, parts: int) -> Outcome:
    nodes: Literal[2, 3] = 3 if kind == "three-node" else 2
    run = mbdkit.run(
        rod(elements, nodes, corrected=kind == "corrected"),
        integrator=integrator,
        time={"steps": steps, "step": END / steps},
        output={"every": steps // parts, "quantities": []},
    )
    run.check()
    return float(run.stats["cpu_s"]), np.asarray(run[f"rod.{elements * (nodes - 1)}"].position[1:])


def _theirs(kind: str, elements: int, steps: int, how: str, parts: int) -> Outcome:
    beam, seconds, tips = EXUDYN_RODS[kind](elements), 0.0, []
    for part in range(parts):
        start, end = END * part / parts, END * (part + 1) / parts
        seconds += beam.run(start, end, steps // parts, clock=time.process_time, **EXUDYN_SETTINGS[how])
        tips.append(beam.place(-1))
    return seconds, np.array(tips)


Named = tuple[str, Callable[[int], Outcome]]


def _our_choices(kind: Kind) -> Iterator[Named]:
    for elements in MESHES[kind]:
        for name, integrator in METHODS.items():
            for steps in STEPS:
                yield f"{elements}, {name}, {steps}", functools.partial(_ours, kind, elements, integrator, steps)


def _their_choices(kind: str) -> Iterator[Named]:
    for elements in EXUDYN_MESHES:
        for how, settings in EXUDYN_SETTINGS.items():
            if settings["sparse"] or elements <= MOST_DENSE:
                for steps in EXUDYN_STEPS:
                    yield f"{elements}, {how}, {steps}", functools.partial(_theirs, kind, elements, steps, how)


def _tried(choices: Iterator[Named], exact: np.ndarray) -> Iterator[Choice]:
    for label, go in choices:
        try:
            seconds, tips = go(TIMES)
        except RunError:  # steps too long for the waves in this mesh
            continue
        error = float(np.max(np.linalg.norm(tips - exact, axis=1)))
        if error < BOUNDS[0]:
            yield Choice(label, go, seconds, error)


def _fastest(choices: list[Choice], bound: float) -> Choice | None:
    good = [one for one in choices if one.error <= bound]
    return min(good, key=lambda one: one.seconds) if good else None


def _seconds(choice: Choice) -> float:
    return choice.go(1)[0]
