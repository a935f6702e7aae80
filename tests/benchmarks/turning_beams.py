"""Implicit steps in which a stiff beam turns: how far it may turn, and the time that longer steps save."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

import mbdkit
from mbdkit.spec import load_spec

from .timing import duration

TURNS = (0.015, 0.03, 0.06, 0.1, 0.2, 0.3)
"""Angles of a step [rad]."""
OMEGA, TURNED = 6.0, 12.0
"""Speed [rad/s], and the angle of a run [rad]."""
REPEATS = 5

METHODS: dict[str, tuple[dict[str, Any], str]] = {
    f"{name} {stages}, {formulation}": ({"name": name, "stages": stages}, formulation)
    for name, stages, formulation in (
        ("radau-iia", 2, "index-1"), ("radau-iia", 3, "index-1"), ("radau-iia", 5, "index-1"),
        ("radau-iia", 3, "index-2"), ("radau-iia", 3, "index-3"), ("radau-iia", 3, "ggl"),
        ("gauss", 2, "index-1"), ("gauss", 3, "index-1"), ("gauss", 4, "index-1"),
    )
}  # fmt: skip


def blade(elements: dict[str, Any], integrator: dict[str, Any], formulation: str, turn: float) -> mbdkit.Run:
    """Turn the blade of the example `spin-up-beam` at constant speed, without strain at the start."""
    spec = load_spec("spin-up-beam").model_dump(mode="json")
    spec["model"]["joints"]["motor"]["motion"] = f"{OMEGA}*t"
    spec["model"]["beams"]["blade"].update(elements, angular_velocity=OMEGA)
    time = {"end": TURNED / OMEGA, "step": turn / OMEGA}
    return mbdkit.run(load_spec(spec, integrator=integrator, formulation=formulation, time=time, output={"every": 1}))


def _cell(runs: list[mbdkit.Run]) -> str:
    """Return iterations per step and time per radian, or how far the blade turned until the run failed."""
    run = runs[0]
    if run.status != "complete":
        return f"fails at {OMEGA * float(run.time[-1]):.2g} rad"
    iterations = run.stats["newton_iterations"] / run.stats["accepted"]
    return f"{iterations:.1f}, {duration(min(float(each.stats['wall_s']) for each in runs) / TURNED)}"


def turning(console: Console) -> None:
    """Print iterations per step and time per radian of a turning blade by method and by the angle of a step."""
    for title, elements in (
        ("8 two-node elements", {"elements": 8, "nodes": 2}),
        ("16 corrected elements", {"elements": 16, "nodes": 2, "corrected": True}),
        ("10 three-node elements", {"elements": 10, "nodes": 3}),
    ):
        table = Table(title=f"{title}: iterations per step, and least time of {REPEATS} runs per radian")
        table.add_column("method")
        for turn in TURNS:
            table.add_column(f"{turn:g} rad", justify="right")
        for name, (integrator, formulation) in METHODS.items():
            cells = []
            for turn in TURNS:
                first = blade(elements, integrator, formulation, turn)
                again = REPEATS - 1 if first.status == "complete" else 0
                cells.append(_cell([first, *(blade(elements, integrator, formulation, turn) for _ in range(again))]))
            table.add_row(name, *cells)
        console.print(table)
