"""The race as tables, and as a mapping that JSON takes."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from rich.console import Console
from rich.table import Table

from tests.benchmarks.timing import duration

from .contender import OURS
from .measure import TARGETS, Curve
from .motions import Motion

GOALS = {1e-6: 5.0, 1e-9: 10.0}
"""How many times faster than the best of the others our best is to be, by error [m]."""

AGREES = 1e-4
"""An error that every contender must get below, or it solves another problem, or is slow [m]."""

PACKAGES = ("mbdkit", "exudyn", "mujoco", "casadi", "scipy", "scikit-sundae", "heyoka", "numpy", "numba")


def winner(
    curves: Sequence[Curve], target: float, *, ours: bool, with_forces: bool = False
) -> tuple[Curve, float] | None:
    """Return the fastest of ours, or of the others, at an error, with its seconds; None where none reaches it.

    If `with_forces`, only those are compared whose time includes all joint forces.
    """
    times = [
        (curve, seconds)
        for curve in curves
        if (curve.contender.code == OURS) == ours
        and (not with_forces or curve.contender.has_forces)
        and (seconds := curve.time_at(target)) is not None
    ]
    return min(times, key=lambda pair: pair[1]) if times else None


def show(console: Console, motion: Motion, curves: Sequence[Curve], missing: Sequence[str]) -> None:
    """Print times by error, the ratios, and what is missing or does not agree."""
    table = Table(title=f"{motion.title}: time of the steps against the largest error of a rod's centre at the end [m]")
    table.add_column("")
    for target in TARGETS:
        table.add_column(f"{target:.0e}", justify="right")
    best = {target: winner(curves, target, ours=True) for target in TARGETS}
    rival = {target: winner(curves, target, ours=False) for target in TARGETS}
    code = None
    for curve in curves:
        if code not in (None, curve.contender.code):
            table.add_section()
        code = curve.contender.code
        row = []
        for target in TARGETS:
            seconds = curve.time_at(target)
            first = any(found is not None and found[0] is curve for found in (best[target], rival[target]))
            row.append("-" if seconds is None else duration(seconds) + (" *" if first else "  "))
        table.add_row(curve.contender.name, *row)
    table.add_section()
    ratios = [ratio(curves, target) for target in TARGETS]
    table.add_row("best of the others / ours", *("" if r is None else f"{r:.2f}  " for r in ratios))
    ratios = [ratio(curves, target, with_forces=True) for target in TARGETS]
    table.add_row("best of the others / ours with joint forces", *("" if r is None else f"{r:.2f}  " for r in ratios))
    table.caption = (
        "* fastest of ours and of the others; least seconds of the processor of several turns, on a line between "
        f"measured neighbours; -: not reached by runs of up to about {motion.limit:g} s"
    )
    console.print(table)
    for target, goal in GOALS.items():
        console.print(verdict(curves, target, goal))
    if strange := [curve.contender.name for curve in curves if curve.time_at(AGREES) is None]:
        console.print(f"not at {AGREES:.0e} m within about {motion.limit:g} s: {', '.join(strange)}")
    if missing:
        console.print(f"not here: {', '.join(missing)}")


def ratio(curves: Sequence[Curve], target: float, *, with_forces: bool = False) -> float | None:
    """Return by what factor our best is faster than the best of the others, which need not compute joint forces."""
    ours = winner(curves, target, ours=True, with_forces=with_forces)
    others = winner(curves, target, ours=False)
    return None if ours is None or others is None else others[1] / ours[1]


def verdict(curves: Sequence[Curve], target: float, goal: float) -> str:
    """Return in a sentence who is first at an error, and whether the goal is met."""
    ours, others = winner(curves, target, ours=True), winner(curves, target, ours=False)
    if ours is None:
        return f"at {target:.0e} m: none of ours gets there"
    if others is None:
        return f"at {target:.0e} m: {ours[0].contender.name} {duration(ours[1])}; none of the others gets there"
    factor = others[1] / ours[1]
    judged = "met" if factor >= goal else "MISSED"
    return (
        f"at {target:.0e} m: {ours[0].contender.name} {duration(ours[1])}, {others[0].contender.name} "
        f"{duration(others[1])}: {factor:.1f} times faster; the goal of {goal:g} times is {judged}"
    )


def as_mapping(motion: Motion, curves: Sequence[Curve], missing: Sequence[str]) -> dict[str, Any]:
    """Return everything that was measured."""
    return {
        "title": motion.title,
        "missing": list(missing),
        "ratios": {f"{target:.0e}": ratio(curves, target) for target in TARGETS},
        "ratios_with_joint_forces": {f"{target:.0e}": ratio(curves, target, with_forces=True) for target in TARGETS},
        "contenders": [
            {
                "code": curve.contender.code,
                "method": curve.contender.method,
                "seconds_at": {f"{target:.0e}": curve.time_at(target) for target in TARGETS},
                "points": [
                    {
                        "setting": point.setting,
                        "error": point.error if point.error == point.error else None,
                        "cpu_s": point.cpu,
                        "wall_s": point.wall,
                        "whole_s": point.whole,
                    }
                    for point in curve.points
                ],
            }
            for curve in curves
        ],
    }


def machine() -> dict[str, Any]:
    """Return the machine, its load and the versions."""
    return {
        "platform": platform.platform(),
        "processors": os.cpu_count(),
        "load": [round(load, 2) for load in os.getloadavg()] if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        "versions": {name: found for name in PACKAGES if (found := _version(name))},
    }


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
