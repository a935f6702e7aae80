"""What predictions add to runs: the objective, its error, the meshes, controls and optimized numbers."""

from __future__ import annotations

import json
import math
from typing import Any

from mbdkit.base.plain_data import parse_path
from mbdkit.plugin import Run, RunError


def _recorded(run: Run, name: str) -> Any:
    if name not in run.provenance:
        raise RunError(f"the run has no {name}: it is no prediction")
    return run.provenance[name]


def objective(run: Run) -> float:
    """Return the smallest value of what is minimized, on the last mesh."""
    return float(_recorded(run, "objective"))


def objective_error(run: Run) -> float:
    """Return the change of the objective by the last refinement of the mesh; nan if no optimum was found on it."""
    return float(_recorded(run, "objective_error"))


def mesh(run: Run) -> list[tuple[int, float]]:
    """Return the number of intervals and the objective of each mesh."""
    return [(int(count), float(value)) for count, value in json.loads(_recorded(run, "mesh"))]


def parameters(run: Run) -> dict[str, float]:
    """Return the optimized numbers by their key path."""
    return {name: float(value) for name, value in json.loads(_recorded(run, "optimized")).items()}


def controls(run: Run) -> dict[str, Any]:
    """Return the controls by their key path; `value` (T,) of each is its history."""
    _recorded(run, "objective")
    return {name: run.states[_state_of(name)] for name in run.spec["controls"]}


def _state_of(control: str) -> str:
    kind, *path = parse_path(control)
    return str(path[0]) if kind == "states" and len(path) == 1 else control


def lines(run: Run) -> list[tuple[str, str]]:
    """Return the lines of the summary."""
    count, _ = mesh(run)[-1]
    value, error = objective(run), objective_error(run)
    of_optimum = f"{value:.10g} +- {error:.2g} on {count} intervals"
    of_iterate = f"{value:.10g} at the last iterate, which is no optimum"
    method = run.spec["collocation"]
    entries = [
        ("collocation", f"{method['method']}, {method['points']} points in each of {count} intervals"),
        ("objective", of_iterate if math.isnan(error) else of_optimum),
    ]
    return entries + [(name, f"{value:.6g}") for name, value in parameters(run).items()]
