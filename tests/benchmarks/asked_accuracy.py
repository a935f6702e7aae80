"""`python -m tests.benchmarks.asked_accuracy [PROBLEM ...]`: cost of `accuracy`, against runs tuned by hand.

The cost is the number of evaluations of the right side, those of implicit methods counted twice (`IMPLICIT_WORK`). The
run tuned by hand is the cheapest of a grid of methods and settings that truly reaches the accuracy; finding it costs
nothing here. `run` compares pilots and all attempts, without the checks, with that run; `all` compares everything with
that run and its own check; `all/bare` compares everything with that run without a check, which then says nothing of its
error.
"""

from __future__ import annotations

import importlib
import math
import sys
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any
from unittest import mock

import numpy as np

import mbdkit
from mbdkit.accuracy import companion, pilot_run
from mbdkit.accuracy.pilot_run import run_pilot, work_of
from mbdkit.accuracy.position_measure import PositionMeasure
from mbdkit.run_preparation import build, make_method, timetable
from mbdkit.spec import load_spec
from mbdkit.stepping.interface import Guards
from mbdkit.stepping.start import start_method
from tests.witness.known_motions import Known, known_motions
from tests.witness.running import gauss

TEN = (
    "pendulum going round",
    "double pendulum, small",
    "triple pendulum",
    "driven double pendulum",
    "car axis",
    "four-bar",
    "slider-crank",
    "cart and pole",
    "stiff oscillator",
    "beam pendulum",
)
ASKED = (1e-3, 1e-6, 1e-9)

ADAPTIVE: dict[str, dict[str, Any]] = {
    "dopri5": {"name": "dopri5"},
    "dop853": {"name": "dop853"},
    "radau-iia 3": {"name": "radau-iia", "stages": 3},
    "radau-iia 5": {"name": "radau-iia", "stages": 5},
    "gauss 5 adaptive": gauss(5),
}
FIXED: dict[str, dict[str, Any]] = {
    "rk4": {"name": "rk4"},
    "dop853 fixed": {"name": "dop853"},
    "gauss 2": gauss(2),
    "gauss 3": gauss(3),
    "gauss 5": gauss(5),
}
TOLERANCES = [10.0 ** (-k / 2) for k in range(4, 26)]
STEPS = [2.0 ** (k / 2) for k in range(8, -9, -1)]
"""Times the step of the problem."""

MOST_STEPS = 20_000


@contextmanager
def counted() -> Iterator[dict[str, float]]:
    """Sum the work of all steppers that are started, by the module that starts them."""
    started: list[tuple[str, Any, Any]] = []
    work: dict[str, float] = defaultdict(float)

    def patch(module: Any) -> Any:
        def start(method: Any, *args: Any) -> Any:
            stepper = start_method(method, *args)
            started.append((module.__name__.rpartition(".")[2], method, stepper))
            return stepper

        return mock.patch.object(module, "start_method", start)

    simulation = importlib.import_module("mbdkit.simulation")
    with patch(simulation), patch(companion), patch(pilot_run):
        yield work
    for name, method, stepper in started:
        work[name] += work_of(method, stepper.counters.rhs_evaluations)


@dataclass(frozen=True)
class Tuned:
    """A run of the grid: its name, its spec, the true error, and its work."""

    name: str
    spec: dict[str, Any]
    error: float
    work: float


def grid(known: Known) -> list[Tuned]:
    """Return all runs of the grid that reach the end."""
    # angles of some witnesses are unwrapped, which needs closer times
    true = known.solve(np.linspace(0.0, known.end, 16 * pilot_run.SAMPLES + 1))[0][::16]
    found = []
    settings = [(name, {**method, "adaptive": True}, x) for name, method in ADAPTIVE.items() for x in TOLERANCES]
    settings += [(name, method, x * known.step) for name, method in FIXED.items() for x in STEPS]
    for name, method, x in settings:
        time: dict[str, Any] = {"end": known.end}
        if "adaptive" in method:
            method = {**method, "rtol": x, "atol": x}
        else:
            steps = pilot_run.SAMPLES * max(1, round(known.end / x / pilot_run.SAMPLES))
            time["step"] = known.end / steps
        plain = {"mbdkit": 1, "model": known.model, "integrator": method, "time": time}
        spec = load_spec(plain)
        workspace, _ = build(spec)
        pilot = run_pilot(spec, x, workspace, MOST_STEPS)
        if pilot.failure:
            continue
        error = float(np.max(PositionMeasure.of(spec, workspace).share(pilot.position - true)))
        work = pilot.work
        if "adaptive" in method:  # without the evaluations of dense output
            table = replace(timetable(spec, Guards()), every=2**53)
            stepper = start_method(make_method(spec), build(spec)[0], table)
            while not (stepper.finished or stepper.failure):
                stepper.advance()
            work = work_of(make_method(spec), stepper.counters.rhs_evaluations)
        found.append(Tuned(f"{name} {x:.2g}", plain, error, work))
    return found


def line(known: Known, asked: float, runs: list[Tuned]) -> tuple[str, bool, tuple[float, float, float]]:
    """Return a line of the table, whether the accuracy was reached, and the ratios of the cost."""
    with counted() as work:
        run = mbdkit.run({"mbdkit": 1, "model": known.model, "time": {"end": known.end}, "accuracy": asked})
    accuracy = run.accuracy
    assert accuracy is not None
    spec = load_spec(run.spec)
    measure = PositionMeasure.of(spec, build(spec)[0])
    true = float(np.max(measure.share(run.array("trajectory/position") - known.solve(run.time)[0])))
    reaching = [one for one in runs if one.error <= asked]
    best = min(reaching, key=lambda one: one.work) if reaching else None
    ratios = (math.nan, math.nan, math.nan)
    own, total = work["pilot_run"] + work["simulation"], sum(work.values())
    if best is not None:
        with counted() as checked:
            mbdkit.run({**best.spec, "check": True})
        ratios = own / best.work, total / sum(checked.values()), total / best.work
    chosen = f"{run.spec['integrator']['name']} {run.spec['integrator'].get('rtol') or run.spec['time']['step']:.2g}"
    text = (
        f"{known.name:<24} {asked:>6.0e} {true:>8.1e} {accuracy.reached:>8.1e} {run.verdict:<8} {chosen:<18} "
        f"{work['pilot_run']:>7.0f} {work['simulation']:>7.0f} {work['companion']:>8.0f}  "
        f"{best.name if best else 'none':<24} {best.work if best else math.nan:>7.0f} "
        f"{ratios[0]:>5.2f} {ratios[1]:>5.2f} {ratios[2]:>8.1f}"
    )
    return text, true <= asked, ratios


def main() -> None:
    """Print the table."""
    wanted = sys.argv[1:] or TEN
    print(
        f"{'problem':<24} {'asked':>6} {'true':>8} {'estimate':>8} {'verdict':<8} {'chosen':<18} {'pilots':>7} "
        f"{'run':>7} {'check':>8}  {'tuned by hand':<24} {'work':>7} {'run':>5} {'all':>5} {'all/bare':>8}"
    )
    reached, ratios = [], []
    for known in known_motions():
        if known.name not in wanted:
            continue
        runs = grid(known)
        for asked in ASKED:
            text, is_reached, of_line = line(known, asked, runs)
            print(text, flush=True)
            reached.append(is_reached)
            ratios.append(of_line)
    own, everything, bare = (np.array(column) for column in zip(*ratios, strict=True))
    print(f"reached {sum(reached)} of {len(reached)}")
    for name, column in (("run", own), ("all", everything), ("all/bare", bare)):
        print(f"{name:<8} median {np.nanmedian(column):.2f}, largest {np.nanmax(column):.2f}")


if __name__ == "__main__":
    main()
