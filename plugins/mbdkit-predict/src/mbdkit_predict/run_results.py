"""What predictions add to runs: the objective, its error, the meshes, controls, optimized numbers and sensitivities."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from mbdkit.base.plain_data import parse_path
from mbdkit.plugin import Run, RunError

SAME = 1e-4
"""Optima on the first mesh whose relative difference is below this count as one."""


class Gain(NamedTuple):
    """Difference of two optima."""

    value: float
    """Objective of the other motion, minus that of this one."""
    error: float
    """Sum of the errors of both objectives."""
    share: float
    """The value as a share of the magnitude of the objective of the other motion."""


def _recorded(run: Run, name: str) -> Any:
    """Return what a prediction recorded: a number, or plain data."""
    if name not in run.provenance:
        raise RunError(f"the run has no {name}: it is no prediction")
    value = run.provenance[name]
    return json.loads(value) if isinstance(value, str) else value


def objective(run: Run) -> float:
    """Return the smallest value of what is minimized, on the last mesh."""
    return float(_recorded(run, "objective"))


def objective_error(run: Run) -> float:
    """Return the estimated error of the objective; nan if no optimum was found."""
    return float(_recorded(run, "objective_error"))


def mesh(run: Run) -> list[tuple[int | tuple[int, ...], float]]:
    """Return the number of intervals, of each phase if there are several, and the objective of each mesh."""
    meshes = _recorded(run, "mesh")
    return [(tuple(count) if isinstance(count, list) else int(count), float(value)) for count, value in meshes]


def parameters(run: Run) -> dict[str, float]:
    """Return the optimized numbers by their key path."""
    return {name: float(value) for name, value in _recorded(run, "optimized").items()}


def controls(run: Run) -> dict[str, Any]:
    """Return the controls by their key path; `value` (T,) of each is its history."""
    _recorded(run, "objective")
    return {name: run.states[_state_of(name)] for name in run.spec["controls"]}


def sensitivities(run: Run) -> dict[str, float]:
    """Return derivatives of the optimum from the multipliers: by the key paths in `sensitivities`, by fixed durations,
    and by the values of conditions at the start and the end, such as ``final: block.x``.
    """
    return dict(_recorded(run, "sensitivities"))


def starts(run: Run) -> list[float]:
    """Return the objective on the first mesh from each first guess; nan where no optimum was found."""
    return [math.nan if value is None else float(value) for value in _recorded(run, "starts")]


def forward_run(run: Run) -> dict[str, float]:
    """Return how a run with the controls, by another method, differs from the motion, as a share of its range.

    ``end`` and ``largest`` are the differences at the end and at most; ``of_intervals`` is the sum of those of all
    intervals, each of which starts on the motion. They are nan if there is no optimum, or the run stopped.
    """
    return dict(_recorded(run, "forward_run"))


def gain(run: Run) -> Callable[..., Gain]:
    """Return the function of another prediction that returns the gain of this one; see `Gain`.

    Without an argument, the other one is that of `compare` in the spec.
    """

    def of(other: Run | None = None) -> Gain:
        if other is not None:
            there, its_error = objective(other), objective_error(other)
        else:
            there, its_error = (float(_recorded(run, f"compared_{name}")) for name in ("objective", "error"))
        value = there - objective(run)
        return Gain(value, its_error + objective_error(run), value / abs(there) if there else math.nan)

    return of


def _state_of(control: str) -> str:
    kind, *path = parse_path(control)
    return str(path[0]) if kind == "states" and len(path) == 1 else control


def lines(run: Run) -> list[tuple[str, str]]:
    """Return the lines of the summary."""
    count, _ = mesh(run)[-1]
    value, error = objective(run), objective_error(run)
    counts = " + ".join(map(str, count)) if isinstance(count, tuple) else str(count)
    of_optimum = f"{value:.10g} +- {'unknown' if math.isnan(error) else f'{error:.2g}'} on {counts} intervals"
    of_iterate = f"{value:.10g} at the best iterate, which is no optimum"
    method, forward = run.spec["collocation"], forward_run(run)
    entries = [
        ("collocation", f"{method['method']}, {method['points']} points in each of {counts} intervals"),
        ("objective", of_optimum if any(map(math.isfinite, starts(run))) else of_iterate),
    ]
    if len(starts(run)) > 1:
        entries.append(("starts", _of_starts(starts(run))))
    entries += [(name, f"{value:.6g}") for name, value in parameters(run).items()]
    entries += [
        (f"d/d {name}", f"{sensitivities(run)[name]:.6g}, derivative of the objective")
        for name in run.spec.get("sensitivities", ())
        if name in sensitivities(run)
    ]
    if "compared_objective" in run.provenance:
        found = gain(run)()
        share = f"{100 * found.share:.4g} % of the motion that is compared"
        entries.append(("gain", f"{found.value:.6g} +- {found.error:.2g}, {share}"))
    if not math.isnan(forward["end"]):
        at_end, most = (f"{forward[name]:.1e}" for name in ("end", "largest"))
        entries.append(("forward run", f"differs by {at_end} of the range of the motion at the end, {most} at most"))
    return entries


def _of_starts(values: list[float]) -> str:
    """Return where several starts ended, on the first mesh."""
    groups, none = counted(values), sum(map(math.isnan, values))
    ended = [f"{count} at {value:.6g}" for value, count in groups] + [f"{none} without an optimum"] * bool(none)
    return f"of {len(values)}, {', '.join(ended)}"


def counted(starts: Sequence[float]) -> list[tuple[float, int]]:
    """Return the different optima of several starts, the smallest one first, and how many ended there."""
    groups: list[tuple[float, int]] = []
    for value in sorted(value for value in starts if math.isfinite(value)):
        if groups and value - groups[-1][0] <= SAME * abs(value) + 1e-9:
            groups[-1] = groups[-1][0], groups[-1][1] + 1
        else:
            groups.append((value, 1))
    return groups
