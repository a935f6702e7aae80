"""How time grows with the number of bodies: chains, trees, ladders and nets, and the same ladders in Exudyn.

Times are those of the processor, so that other work on the machine counts little; everything runs in one thread. The
factors of chains, trees and ladders have as many blocks per body at any size. Those of nets fill up: a grid of n nodes
takes n^1.5 products at best (A. George, SIAM J. Numer. Anal. 10 (1973) 345-363). So does nested dissection.
"""

from __future__ import annotations

import functools
import importlib.util
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import mbdkit
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.spec import RunSpec, load_spec
from mbdkit_report import Caption, dress, new_figure, save
from mbdkit_report.figures.palette import FAINT, PALETTE
from mbdkit_report.plot.style import legend

from . import frames
from .exudyn_model import by_exudyn
from .timing import duration, take_turns

FAMILIES = {"chain": frames.chain, "tree": frames.tree, "ladder": frames.ladder, "net": frames.net}
EVALUATIONS = {10: 8000, 30: 2400, 100: 800, 300: 280, 1000: 120, 3000: 80}
"""Number of bodies that is aimed at, and how many evaluations a timing of RK-Gill has."""

LADDER_STEPS = {10: 2000, 30: 700, 100: 300, 300: 150, 1000: 100, 3000: 100}
"""Number of bodies that is aimed at, and how many steps a timing on ladders has."""

METHODS: dict[str, dict[str, Any]] = {"rk-gill": {"name": "rk-gill"}, "gauss-2": {"name": "gauss", "stages": 2}}
STAGES = 4
REPEATS = 9
STEP = 0.001  # s
FITTED = 100
"""Bodies from which on the slope is fitted."""

SAME = (0.05, 0.00025, 1e-6)
"""The motion that both codes must agree on: end [s], step [s], largest difference in any coordinate [m or rad]."""

Points = dict[int, float]
"""Seconds, or how many of something, by number of bodies."""


def scale(console: Console, output: Path | None = None) -> None:
    """Print how the times of preparing a run and of an evaluation grow in every family, and that of a step on ladders
    beside Exudyn's.

    Parameters
    ----------
    console
        Where to.
    output
        Picture of all curves to write, if any.
    """
    _show(console, "Products of 2 x 2 blocks in a factorization, per body, as counted", _products(), unit=1.0)
    for name, integrator in METHODS.items():
        title = f"Time of a run of {name} before its first step and after its last, per body [us]"
        _show(console, title, _preparations(integrator), unit=1e-6)
    evaluations = _evaluations()
    title = f"One evaluation of RK-Gill per body [ns], least of {REPEATS}, families taking turns"
    _show(console, title, evaluations, unit=1e-9)
    steps, apart = _ladder_steps()
    _show_steps(console, steps, apart)
    if output is not None:
        _draw(evaluations, steps, output)
        console.print(f"the plot is in {output}")


def slope(points: Points) -> float:
    """Return the exponent of growth, fitted to the logarithms of what has `FITTED` bodies or more."""
    bodies = np.array([count for count in points if count >= 0.9 * FITTED])
    return float(np.polyfit(np.log(bodies), np.log([points[count] for count in bodies]), 1)[0])


def timed_spec(mechanism: mbdkit.Mechanism, integrator: dict[str, Any], steps: int, step: float = STEP) -> RunSpec:
    """Return a run of as many steps that records its ends only."""
    return load_spec(
        mechanism,
        integrator=integrator,
        time={"steps": steps, "step": step},
        output={"every": steps, "quantities": []},
    )


def stepping(spec: RunSpec) -> float:
    """Return the processor's seconds from the first step to the last."""
    run = mbdkit.run(spec)
    run.check()
    return float(run.stats["cpu_s"])


def _products() -> dict[str, Points]:
    """Return how many blocks the factorization of every family multiplies: what its time comes to without memory."""
    found: dict[str, Points] = {name: {} for name in FAMILIES}
    for name, family in FAMILIES.items():
        for aim in EVALUATIONS:
            mechanism = family(aim)
            columns = [len(below) for below in compile_mechanism(mechanism).below]
            found[name][len(mechanism.bodies)] = sum(length * (length + 3) / 2 for length in columns)
    return found


def _preparations(integrator: dict[str, Any]) -> dict[str, Points]:
    """Return the processor's seconds of a whole run without its steps in every family, least of three."""

    def once(spec: RunSpec) -> float:
        begin = time.process_time()
        return -stepping(spec) + time.process_time() - begin

    found: dict[str, Points] = {name: {} for name in FAMILIES}
    for name, family in FAMILIES.items():
        once(timed_spec(family(10), integrator, 1))
        for aim in EVALUATIONS:
            mechanism = family(aim)
            spec = timed_spec(mechanism, integrator, 1)
            found[name][len(mechanism.bodies)] = min(once(spec) for _ in range(3))
    return found


def _evaluations() -> dict[str, Points]:
    """Return the seconds of one evaluation of RK-Gill in every family: the least of several, families taking turns."""
    found: dict[str, Points] = {name: {} for name in FAMILIES}
    for aim, evaluations in EVALUATIONS.items():
        tasks, bodies = {}, {}
        for name, family in FAMILIES.items():
            mechanism = family(aim)
            bodies[name] = len(mechanism.bodies)
            spec = timed_spec(mechanism, {"name": "rk-gill"}, evaluations // STAGES)
            tasks[name] = functools.partial(stepping, spec)
        for name, timing in take_turns(tasks, REPEATS).items():
            found[name][bodies[name]] = timing.least / evaluations
    return found


def _ladder_steps() -> tuple[dict[str, Points], dict[int, float]]:
    """Return the seconds of one step on ladders by each method, and how far Exudyn's motion is from ours."""
    exudyn = importlib.util.find_spec("exudyn") is not None
    found: dict[str, Points] = {name: {} for name in [*METHODS, *(["Exudyn"] if exudyn else [])]}
    apart: dict[int, float] = {}
    for aim, steps in LADDER_STEPS.items():
        mechanism = frames.ladder(aim)
        bodies = len(mechanism.bodies)
        tasks: dict[str, Callable[[], float]] = {
            name: functools.partial(stepping, timed_spec(mechanism, integrator, steps))
            for name, integrator in METHODS.items()
        }
        if exudyn:
            apart[bodies] = _same_motion(mechanism)
            tasks["Exudyn"] = functools.partial(_exudyn_stepping, mechanism, steps)
        for name, timing in take_turns(tasks, REPEATS).items():
            found[name][bodies] = timing.least / steps
    return found, apart


def _exudyn_stepping(mechanism: mbdkit.Mechanism, steps: int) -> float:
    return by_exudyn(mechanism, steps, steps * STEP, sparse=True, clock=time.process_time)[0]


def _same_motion(mechanism: mbdkit.Mechanism) -> float:
    """Return how far Exudyn's end is from ours; raise RuntimeError where that is more than its order of two allows."""
    end, step, allowed = SAME
    steps = round(end / step)
    run = mbdkit.run(timed_spec(mechanism, {"name": "gauss", "stages": 2}, steps, step))
    run.check()
    ours = np.array([[*run[name].position[-1], run[name].angle[-1]] for name in run.bodies])
    theirs = by_exudyn(mechanism, steps, end, sparse=True)[1]
    difference = float(np.max(np.abs(ours - theirs)))
    if not difference <= allowed:
        raise RuntimeError(f"{len(mechanism.bodies)} bodies: the two codes differ by {difference:.1e} after {end} s")
    return difference


def _show(console: Console, title: str, found: dict[str, Points], unit: float) -> None:
    table = Table(title=title)
    table.add_column("family")
    for aim in EVALUATIONS:
        table.add_column(f"n ~ {aim}", justify="right")
    table.add_column(f"slope from {FITTED} bodies", justify="right")
    for name, points in found.items():
        cells = [f"{amount / bodies / unit:.3g}" for bodies, amount in points.items()]
        table.add_row(name, *cells, f"{slope(points):.2f}")
    console.print(table)


def _show_steps(console: Console, found: dict[str, Points], apart: dict[int, float]) -> None:
    table = Table(title=f"One step of {STEP} s on a ladder, least of {REPEATS}, taking turns")
    for heading in ("bodies", *found, "Exudyn / gauss-2", "Exudyn / rk-gill", "apart [m]"):
        table.add_column(heading, justify="right")
    for bodies in found["gauss-2"]:
        row = [str(bodies), *(duration(points[bodies]) for points in found.values())]
        theirs = found.get("Exudyn", {}).get(bodies)
        if theirs is not None:
            row += [f"{theirs / found[name][bodies]:.1f}" for name in ("gauss-2", "rk-gill")]
            row.append(f"{apart[bodies]:.0e}")
        table.add_row(*row)
    table.add_row("slope", *(f"{slope(points):.2f}" for points in found.values()))
    if apart:
        table.caption = (
            "Exudyn: trapezoidal rule, index-2 constraints, sparse; apart: largest difference of any coordinate from "
            f"gauss-2 after {SAME[0]} s at h = {SAME[1]} s"
        )
    console.print(table)


def _draw(evaluations: dict[str, Points], steps: dict[str, Points], output: Path) -> None:
    """Write the picture: evaluations of all families, and steps on ladders."""
    figure = new_figure(
        Caption("Time against the number of bodies", "rods pinned together, from 10 to 3000; one core"), 7.2, 5.0
    )
    axes = dress(figure.add_subplot(), "bodies", "time")
    axes.set(xscale="log", yscale="log")
    handles, labels = [], []
    looks = dict(zip(evaluations, PALETTE, strict=False))
    for name, points in evaluations.items():
        handles += axes.plot(*_xy(points), color=looks[name], marker="o", markersize=4, linewidth=1.6)
        labels.append(f"{name}: evaluation, slope {slope(points):.2f}")
    for (name, points), style in zip(steps.items(), ("", "--", ":"), strict=False):
        if style:  # a step of RK-Gill is four of the evaluations above
            handles += axes.plot(*_xy(points), color=looks["ladder"], linestyle=style, marker="s", markersize=3.5)
            labels.append(f"ladder: step of {name}, slope {slope(points):.2f}")
    bodies, seconds = _xy(evaluations["chain"])
    handles += axes.plot(bodies, seconds[0] * bodies / bodies[0] * 0.4, color=FAINT, linewidth=0.8)
    labels.append("slope 1")
    ticks = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1]
    axes.set_yticks(ticks, [duration(tick) for tick in ticks])
    axes.set_xticks(list(EVALUATIONS), [str(aim) for aim in EVALUATIONS])
    axes.minorticks_off()
    legend(axes, handles, labels)
    save(figure, output)


def _xy(points: Points) -> tuple[np.ndarray, np.ndarray]:
    return np.array(list(points), dtype=float), np.array(list(points.values()))
