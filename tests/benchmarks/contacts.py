"""Contacts beside MuJoCo: time a step, and time for a given error, of all treatments on the same mechanisms.

Each contender is run with several steps or tolerances. Times are processor times of the steps, in turns within one
process; errors are those of the positions of all bodies at the end. MuJoCo's contacts are soft: `default` has its
default parameters, and `stiff` the smallest time constant that is stable, in proportion to the step. Its boxes have
four corners at a face instead of two.
"""

from __future__ import annotations

import contextlib
import io
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import brentq

import mbdkit

from .contact_cases import CASES, Case, positions
from .contact_studies import discs, sit_downs
from .mujoco_model import mujoco_model
from .timing import duration, take_turns

STEPS = (1e-2, 1e-3, 1e-4)
TOLERANCES = (1e-3, 1e-5, 1e-7)
TARGETS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-9)
REPEATS = 5
"""Repeated runs in turns of contenders that take at most `SHORT` [s]; others run once."""
SHORT = 0.5
LIMIT, QUICK = 8.0, 2.0
"""Time after which a run is stopped, and predicted time above which it is left out [s], without and with --quick."""
PROFILED = 0.1
"""Duration of the runs of which --profile counts the calls [s]."""
TOO_LONG = "wall-time"
"""Why a run stopped that takes longer."""
QUIET_STEPS, QUIET_TIME = 50000, 0.05
"""Largest number of steps between events, and time of a run [s] that suffices instead."""


@dataclass(frozen=True)
class Outcome:
    """A run: processor time of its steps [s], their number (with rejected ones), positions at the end [m], and why it
    stopped before it.
    """

    seconds: float
    steps: int
    end: np.ndarray
    stopped: str = ""


@dataclass(frozen=True)
class Contender:
    """A way to integrate a case.

    Attributes
    ----------
    run
        Function of a case, a setting, and the longest time [s], that returns the outcome.
    settings
        Its steps [s] or tolerances.
    """

    run: Callable[[Case, float, float], Outcome]
    settings: tuple[float, ...] = STEPS


@dataclass(frozen=True)
class Point:
    """A contender with one setting: time a step and a simulated second [s], error [m], and why its run stopped."""

    step: float
    second: float
    error: float
    stopped: str


def _spec(
    case: Case, integrator: dict[str, Any], treatment: str | None, times: dict[str, Any], limit: float
) -> dict[str, Any]:
    """Return the run spec of a case; without contacts if `treatment` is None."""
    return {
        "mbdkit": 1,
        "limits": {"wall_time": limit},
        "model": case.model if treatment else {**case.model, "contacts": {}},
        **({"contact": {"treatment": treatment}} if treatment else {}),
        "integrator": integrator,
        "time": times,
        "output": {"every": 10**7, "quantities": []},
    }


def _timed(case: Case, spec: dict[str, Any]) -> Outcome:
    run = mbdkit.run(spec)
    steps = int(run.stats["steps"]) + int(run.stats["rejected"])
    stopped = "" if run.status == "complete" else run.status_reason.partition(":")[0]
    return Outcome(float(run.stats["cpu_s"]), steps, positions(run, case.model), stopped)


def _contender_spec(
    treatment: str, integrator: dict[str, Any], case: Case, setting: float, limit: float
) -> dict[str, Any]:
    if integrator.get("adaptive"):
        return _spec(case, integrator | {"rtol": setting, "atol": 1e-2 * setting}, treatment, {"end": case.end}, limit)
    return _spec(case, integrator, treatment, {"end": case.end, "step": setting}, limit)


def _ours(treatment: str, integrator: dict[str, Any]) -> Contender:
    """Return a treatment with an integrator of mbdkit; with `adaptive`, settings are relative tolerances."""
    return Contender(
        lambda case, setting, limit: _timed(case, _contender_spec(treatment, integrator, case, setting, limit)),
        TOLERANCES if integrator.get("adaptive") else STEPS,
    )


def damping_ratio(restitution: float) -> float:
    """Return the damping ratio of a spring-damper that pushes but does not pull, at which it has this restitution.

    T. Schwager and T. Poeschel, Granular Matter 9:465-469, 2007; 1, the default of MuJoCo, for a restitution of 0.
    """

    def excess(ratio: float) -> float:
        root = math.sqrt(1.0 - ratio**2)
        angle = math.pi - math.atan2(2.0 * ratio * root, 1.0 - 2.0 * ratio**2)
        return math.exp(-ratio / root * angle) - restitution

    return float(brentq(excess, 1e-9, 1.0 - 1e-9)) if restitution else 1.0


def _mujoco(integrator: str, stiff: bool) -> Contender:
    """Return MuJoCo with an integrator; the loop over the steps is in C."""
    import mujoco

    def run(case: Case, step: float, limit: float) -> Outcome:
        ratio = damping_ratio(max(contact.get("restitution", 0.0) for contact in case.model["contacts"].values()))
        constant = 2.0 * step if ratio == 1.0 else 3.0 * step / ratio
        softness = ((constant, ratio), (0.99, 0.999, 0.001)) if stiff else ((0.02, ratio), (0.9, 0.95, 0.001))
        model, data = mujoco_model(case.model, step, integrator, *softness)
        mujoco.set_mju_user_warning(lambda text: None)  # the default writes a file
        steps = round(case.end / step)
        begin = time.process_time()
        mujoco.mj_step(model, data, nstep=steps)
        seconds = time.process_time() - begin
        mujoco.mj_kinematics(model, data)
        end = np.array([data.body(name).xpos[[0, 2]] for name in case.model["bodies"]])
        bad = (mujoco.mjtWarning.mjWARN_BADQACC, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQPOS)
        return Outcome(seconds, steps, end, "unstable" if any(data.warning[kind].number for kind in bad) else "")

    return Contender(run)


TREATMENTS: dict[str, tuple[str, dict[str, Any]]] = {
    "time-stepping moreau-jean": ("time-stepping", {"name": "moreau-jean"}),
    "time-stepping nonsmooth-g-alpha": ("time-stepping", {"name": "nonsmooth-generalized-alpha"}),
    "event-driven dopri5": ("event-driven", {"name": "dopri5"}),
    "event-driven gauss-2": ("event-driven", {"name": "gauss", "stages": 2}),
    "compliant dopri5 adaptive": ("compliant", {"name": "dopri5", "adaptive": True}),
    "compliant radau-iia-2": ("compliant", {"name": "radau-iia", "stages": 2}),
}
YARDSTICK = "MuJoCo implicitfast default"


def _contenders() -> dict[str, Contender]:
    """Return all contenders by name; the names of mbdkit's are those of `TREATMENTS`."""
    return {
        **{
            f"MuJoCo {integrator} {'stiff' if stiff else 'default'}": _mujoco(integrator, stiff)
            for integrator in ("implicitfast", "Euler")
            for stiff in (False, True)
        },
        **{name: _ours(*treatment) for name, treatment in TREATMENTS.items()},
    }


def _measured(case: Case, limit: float) -> dict[str, list[Point]]:
    """Return the points of every contender, by its settings, without those whose run would take more than `limit`."""
    contenders = _contenders()
    points: dict[str, list[Point]] = {name: [] for name in contenders}
    reference = case.reference() if case.reference else math.nan
    predicted = dict.fromkeys(points, 0.0)
    for place in range(len(STEPS)):

        def outcome(name: str, place: int = place) -> Outcome:
            return contenders[name].run(case, contenders[name].settings[place], limit)

        outcomes = {name: outcome(name) for name in points if predicted[name] <= limit}
        tasks = {
            name: (lambda name=name, outcome=outcome: outcome(name).seconds)
            for name, first in outcomes.items()
            if first.seconds <= SHORT
        }
        timings = {name: timing.median for name, timing in take_turns(tasks, REPEATS).items()}
        for name, first in outcomes.items():
            seconds = timings.get(name, first.seconds)
            predicted[name] = seconds * (10.0 if contenders[name].settings is STEPS else 3.0)
            error = math.inf if first.stopped else float(np.max(np.abs(first.end - reference)))
            points[name].append(Point(seconds / max(first.steps, 1), seconds / case.end, error, first.stopped))
    return points


def _over_no_contact(case: Case, treatment: str, integrator: dict[str, Any], limit: float) -> float:
    """Return the time a step while no contact changes, over that of the same steps without contacts; nan if stopped.

    The time that a run takes to begin and to end is that of a run with a tenth of the steps, extrapolated.
    """

    def outcome(treatment: str | None, steps: int) -> Outcome:
        times = {"end": case.quiet * steps / most, "step": case.quiet / most}
        return _timed(case, _spec(case, integrator, treatment, times, limit))

    most = 50
    while (first := outcome(treatment, most)).seconds < QUIET_TIME and most < QUIET_STEPS:
        most *= 10
    if first.stopped:
        return math.nan
    tasks = {
        f"{kind} {steps}": (lambda kind=kind, steps=steps: outcome(kind, steps).seconds)
        for kind in (treatment, None)
        for steps in (most, most // 10)
    }
    times = take_turns(tasks, REPEATS if first.seconds <= SHORT else 1)
    long, short, long_without, short_without = (timing.median for timing in times.values())
    return (long - short) / (long_without - short_without)


def _between_events(case: Case, limit: float) -> dict[str, float]:
    """Return the ratios of event-driven and compliant contenders with fixed steps; {} if contacts change at once."""
    return {
        name: _over_no_contact(case, treatment, {k: v for k, v in integrator.items() if k != "adaptive"}, limit)
        for name, (treatment, integrator) in TREATMENTS.items()
        if treatment != "time-stepping" and case.quiet
    }


def _show_case(
    console: Console, name: str, case: Case, points: dict[str, list[Point]], ratios: dict[str, float]
) -> None:
    table = Table(title=f"{name}: {case.title}, {case.end:g} s")
    table.add_column("contender")
    for heading in ("a step", "/ MuJoCo", "/ no contact"):
        table.add_column(heading, justify="right")
    for step, tolerance in zip(STEPS, TOLERANCES, strict=True):
        table.add_column(f"step {step:g} s\nor rtol {tolerance:g}", justify="right")
    for contender, line in points.items():
        middle = line[:2][-1].step
        errors = [f", {point.error:.1e}" if case.reference else "" for point in line]
        cells = [point.stopped or duration(point.second) + error for point, error in zip(line, errors, strict=True)]
        over = f"{middle / points[YARDSTICK][1].step:.3g}"
        table.add_row(
            contender, duration(middle), over, f"{ratios[contender]:.3g}" if contender in ratios else "", *cells
        )
    error = f", and largest error of the positions at the end [m] against {case.witness}" if case.witness else ""
    table.caption = (
        "A step: processor time of a step of 1 ms or with rtol 1e-5, or of the last setting that was run. / MuJoCo: "
        f"over that of {YARDSTICK}. / no contact: time of equal steps while no contact changes, over that of the same "
        f"integrator on the mechanism without contacts. Last columns: processor time of a simulated second{error}, or "
        "why the run stopped; empty if it would take too long."
    )
    console.print(table)


def _least(points: dict[str, list[Point]], target: float) -> tuple[float, str]:
    """Return the least time a simulated second [s] and its contender, if this and all finer settings meet the error."""
    met = []
    for name, line in points.items():
        ended = [point for point in line if point.stopped != TOO_LONG]
        errors = [point.error for point in ended]
        met += [(point.second, name) for i, point in enumerate(ended) if max(errors[i:]) <= target]
    return min(met, default=(math.inf, ""))


def _show_summary(console: Console, points: dict[str, dict[str, list[Point]]]) -> None:
    table = Table(title="Least processor time of a simulated second at equal error of the positions at the end")
    for heading in ("case", "program", *(f"{target:g} m" for target in TARGETS)):
        table.add_column(heading)
    for name, by_contender in points.items():
        times = []
        for program, is_ours in (("mbdkit", True), ("MuJoCo", False)):
            lines = {key: line for key, line in by_contender.items() if (key in TREATMENTS) is is_ours}
            best = [_least(lines, target) for target in TARGETS]
            times.append([seconds for seconds, _ in best])
            cells = [f"{duration(s)}\n{by}" if by else "not reached" for s, by in best]
            table.add_row(name if is_ours else "", program, *cells)
        ratios = [f"{a / b:.3g}" if math.isfinite(a) and math.isfinite(b) else "" for a, b in zip(*times, strict=True)]
        table.add_row("", "ratio", *ratios, end_section=True)
    table.caption = "A setting counts if it and all finer ones meet the error."
    console.print(table)


def _calls(spec: dict[str, Any]) -> tuple[int, int, int]:
    """Return the calls of Python functions and of built-in ones in a run, and its steps."""
    counts = {"call": 0, "c_call": 0}

    def count(frame: Any, event: str, argument: Any) -> None:
        if event in counts:
            counts[event] += 1

    mbdkit.run(spec)
    sys.setprofile(count)
    try:
        run = mbdkit.run(spec)
    finally:
        sys.setprofile(None)
    return counts["call"], counts["c_call"], int(run.stats["steps"]) + int(run.stats["rejected"])


def _show_profile(console: Console, names: list[str]) -> None:
    table = Table(title="Calls of Python a step, without those of the beginning and the end of a run")
    for heading in ("case", "contender", "Python functions a step", "built-in functions a step"):
        table.add_column(heading)
    for name in names:
        case = CASES[name]()
        for contender, (treatment, integrator) in TREATMENTS.items():
            spec = _contender_spec(treatment, integrator, case, 1e-5 if integrator.get("adaptive") else 1e-3, 1e3)
            half, whole = (_calls(spec | {"time": {**spec["time"], "end": end}}) for end in (PROFILED / 2, PROFILED))
            steps = whole[2] - half[2]
            calls = [f"{(b - a) / steps:.3g}" if steps else "stopped" for a, b in zip(half[:2], whole[:2], strict=True)]
            table.add_row(name, contender, *calls)
    table.caption = (
        f"Difference of runs of {PROFILED / 2:g} s and {PROFILED:g} s, steps 1 ms or rtol 1e-5, no rows between."
    )
    console.print(table)


NAMES = (*CASES, "sit-downs")


def contacts(console: Console, only: str | None = None, quick: bool = False, profile: bool = False) -> None:
    """Print the tables of one case or all, or with `profile` the numbers of calls of Python instead."""
    with contextlib.redirect_stderr(io.StringIO()):  # warnings of runs
        _show(console, only, quick, profile)


def _show(console: Console, only: str | None, quick: bool, profile: bool) -> None:
    names = [name for name in NAMES if only in (None, name)]
    cases = [name for name in names if name in CASES]
    if profile:
        _show_profile(console, cases)
        return
    points = {}
    for name in cases:
        case = CASES[name]()
        limit = QUICK if quick else LIMIT
        measured = _measured(case, limit)
        _show_case(console, name, case, measured, _between_events(case, limit))
        if case.reference:
            points[name] = measured
    if points:
        _show_summary(console, points)
    if "pit" in names:
        discs(console, 0.1 if quick else 0.3)
    if "sit-downs" in names:
        sit_downs(console, quick)
