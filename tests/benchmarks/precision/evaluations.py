"""Evaluations of the equations of motion that high-order methods need for an error of 1e-12 m.

Counted on the right sides of `Rods`, so that the implementations do not matter: DOP853 of SciPy, variable-order Adams
methods (VODE, up to order 12), and extrapolation of Gragg's modified midpoint rule with adaptive steps (Hairer,
Norsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.9). The series of `taylor` are not evaluations:
their time is divided by that of an evaluation in `dop853` of the same formulation.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import ode, solve_ivp

from .contender import TOLERANCES, Contender
from .motions import MOTIONS, Motion
from .ours import IN_JOINTS, ours
from .rods import Array

TARGET = 1e-12  # m
TURNS = 9
Counted = Callable[[Motion, float], tuple[int, Array]]
"""From a motion and a tolerance to the number of evaluations and the centres at the end."""


def evaluations(console: Console) -> None:
    """Print for each motion how many evaluations each method needs for an error of 1e-12 m."""
    for motion in MOTIONS:
        table = Table("method", "tolerance", "error [m]", "evaluations", title=motion.title)
        each = 0.0  # seconds of an evaluation in dop853, the first of these methods
        for contender in (one for one in ours(motion)[0] if one.method in IN_JOINTS):
            tolerance, error, count = _finest(motion, _ours(contender))
            seconds = min(contender.run(tolerance).cpu for _ in range(TURNS))
            each = each or seconds / count
            is_series = contender.method.startswith("taylor")
            work = f"{count} series, as {seconds / each:.0f} evaluations" if is_series else str(count)
            table.add_row(contender.name, f"{tolerance:.0e}", f"{error:.1e}", work)
        for name, run in METHODS.items():
            tolerance, error, count = _finest(motion, run)
            table.add_row(name, f"{tolerance:.0e}", f"{error:.1e}", str(count))
        console.print(table)


def _finest(motion: Motion, run: Counted) -> tuple[float, float, int]:
    """Return tolerance, error and evaluations of the coarsest tolerance that reaches the target, or of the best one."""
    best: tuple[float, float, int] | None = None
    for tolerance in TOLERANCES[8:]:
        count, centres = run(motion, tolerance)
        error = motion.miss(centres)
        if best is None or error < best[1]:
            best = tolerance, error, count
        if error <= TARGET:
            break
    assert best is not None
    return best


def _ours(contender: Contender) -> Counted:
    def run(motion: Motion, tolerance: float) -> tuple[int, Array]:
        outcome = contender.run(tolerance)
        return outcome.evaluations, outcome.centres

    return run


def _counted(motion: Motion) -> tuple[Callable[[float, Array], Array], list[int]]:
    rates, calls = motion.rods.right_side(), [0]

    def counted(time: float, state: Array) -> Array:
        calls[0] += 1
        return np.asarray(rates(time, state))

    return counted, calls


def _centres(motion: Motion, state: Array) -> Array:
    return motion.rods.centres(state[: motion.rods.count])


def _dop853(motion: Motion, tolerance: float) -> tuple[int, Array]:
    rates, calls = _counted(motion)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the finest tolerances are raised
        found = solve_ivp(rates, (0.0, motion.end), motion.start, method="DOP853", rtol=tolerance, atol=tolerance)
    return calls[0], _centres(motion, found.y[:, -1])


def _adams(motion: Motion, tolerance: float) -> tuple[int, Array]:
    rates, calls = _counted(motion)
    solver = ode(rates).set_integrator("vode", method="adams", rtol=tolerance, atol=tolerance, nsteps=1_000_000)
    solver.set_initial_value(motion.start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        state = solver.integrate(motion.end)
    return calls[0], _centres(motion, state if solver.successful() else np.full_like(state, np.nan))


def _extrapolation(order: int, motion: Motion, tolerance: float) -> tuple[int, Array]:
    """Extrapolate the modified midpoint rule with 2, 4, 6, ... substeps in adaptive steps."""
    rates, calls = _counted(motion)
    rows, time, state, step = order // 2, 0.0, motion.start.astype(float), 0.01 * motion.end
    with np.errstate(all="ignore"):
        while time < motion.end:
            step = min(step, motion.end - time)
            first = rates(time, state)
            table: list[Array] = []
            for j in range(rows):
                row = [_midpoint(rates, time, state, first, step, 2 * j + 2)]
                for k in range(j):
                    row.append(row[k] + (row[k] - table[k]) / (((j + 1) / (j - k)) ** 2 - 1.0))
                table = row
            new, gap = table[-1], np.abs(table[-1] - table[-2])
            scale = tolerance * (1.0 + np.maximum(np.abs(state), np.abs(new)))
            error = float(np.sqrt(np.mean((gap / scale) ** 2)))
            if error <= 1.0:
                time, state = time + step, new
            factor = 0.9 * error ** (-1.0 / (order - 1)) if error > 0.0 else 3.0
            step *= min(3.0, max(0.2, factor)) if np.isfinite(factor) else 0.2
    return calls[0], _centres(motion, state)


def _midpoint(rates: Any, time: float, state: Array, first: Array, step: float, count: int) -> Array:
    """Return Gragg's modified midpoint rule after `count` (even) substeps, without the smoothing step."""
    h = step / count
    before, now = state, state + h * first
    for i in range(1, count):
        before, now = now, before + 2 * h * rates(time + i * h, now)
    return now


METHODS: dict[str, Counted] = {
    "SciPy DOP853": _dop853,
    "VODE Adams": _adams,
    **{f"extrapolation, order {order}": functools.partial(_extrapolation, order) for order in (8, 10, 12, 14, 16)},
}
