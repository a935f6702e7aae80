"""`python -m tests.benchmarks.asked_accuracy [PROBLEM ...]`: cost of `accuracy`, against runs tuned by hand.

The cost is the number of evaluations of the right side, those of implicit methods counted twice (`IMPLICIT_WORK`). The
run tuned by hand is the cheapest of a grid of methods and settings that truly reaches the accuracy; finding it costs
nothing here, and nothing tells its error. `steps` compares pilots and all attempts with that run, `all` adds companions
of the check, and `+obs` the accelerations that the check evaluates between steps. `wall` compares the wall time of the
whole calls, in which setting up the mechanism and writing the rows weigh most in runs as short as these.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any
from unittest import mock

import numpy as np

import mbdkit
from mbdkit.engine.observed_states import StateObserver
from mbdkit.integrators.start import start_method
from mbdkit.runs import preparation, recorded_states, step_interpolation
from mbdkit.runs.accuracy import companion, pilot_run
from mbdkit.runs.accuracy.pilot_run import SampledPilot, work_of
from mbdkit.runs.accuracy.position_measure import PositionMeasure
from mbdkit.runs.preparation import build, make_method, timetable
from mbdkit.spec import load_spec
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
def observed(work: dict[str, float]) -> Iterator[None]:
    """Add the states that the check evaluates; those that the recorder evaluates are the same in every run."""

    class Counting(StateObserver):
        def observe(self, times: Any, *args: Any, **named: Any) -> Any:
            work["states"] += len(times)
            return super().observe(times, *args, **named)

    with ExitStack() as stack:
        for module in (recorded_states, step_interpolation):
            stack.enter_context(mock.patch.object(module, "StateObserver", Counting))
        yield


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

    with patch(preparation), patch(companion), patch(pilot_run), observed(work):
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
        pilot = SampledPilot(spec, x, workspace, MOST_STEPS)
        if pilot.failure:
            continue
        error = float(np.max(PositionMeasure.of(spec, workspace).share(pilot.position - true)))
        work = pilot.work
        if "adaptive" in method:  # without the evaluations of dense output
            table = replace(timetable(spec, None), every=2**53)
            stepper = start_method(make_method(spec), build(spec)[0], table)
            while not (stepper.finished or stepper.failure):
                stepper.advance()
            work = work_of(make_method(spec), stepper.counters.rhs_evaluations)
        found.append(Tuned(f"{name} {x:.2g}", plain, error, work))
    return found


Ratios = tuple[float, float, float, float]


def line(known: Known, asked: float, runs: list[Tuned]) -> tuple[str, bool, Ratios]:
    """Return a line of the table, whether the accuracy was reached, and the ratios of the cost."""
    given = {"mbdkit": 1, "model": known.model, "time": {"end": known.end}, "accuracy": asked}
    with counted() as work:
        run = mbdkit.run(given)
    accuracy = run.accuracy
    assert accuracy is not None
    spec = load_spec(run.spec)
    measure = PositionMeasure.of(spec, build(spec)[0])
    true = float(np.max(measure.share(run.array("trajectory/position") - known.solve(run.time)[0])))
    best = min((one for one in runs if one.error <= asked), key=lambda one: one.work)
    steps = work["pilot_run"] + work["preparation"]
    total = steps + work["companion"]
    wall = fastest(given) / fastest(best.spec)
    ratios = steps / best.work, total / best.work, (total + work["states"]) / best.work, wall
    chosen = f"{run.spec['integrator']['name']} {run.spec['integrator'].get('rtol') or run.spec['time']['step']:.2g}"
    text = (
        f"{known.name:<24} {asked:>6.0e} {true:>8.1e} {accuracy.reached:>8.1e} {run.verdict:<8} {chosen:<18} "
        f"{steps:>7.0f} {work['companion']:>8.0f} {work['states']:>7.0f}  {best.name:<22} {best.work:>7.0f} "
        f"{ratios[0]:>6.2f} {ratios[1]:>6.2f} {ratios[2]:>6.2f} {ratios[3]:>6.2f}"
    )
    return text, true <= asked, ratios


def fastest(spec: dict[str, Any]) -> float:
    """Return the least wall time of three runs [s]."""
    times = []
    for _ in range(3):
        begin = perf_counter()
        mbdkit.run(spec)
        times.append(perf_counter() - begin)
    return min(times)


def main() -> None:
    """Print the table."""
    wanted = sys.argv[1:] or TEN
    print(
        f"{'problem':<24} {'asked':>6} {'true':>8} {'estimate':>8} {'verdict':<8} {'chosen':<18} {'steps':>7} "
        f"{'check':>8} {'states':>7}  {'tuned by hand':<22} {'work':>7} {'steps':>6} {'all':>6} {'+obs':>6} {'wall':>6}"
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
    print(f"reached {sum(reached)} of {len(reached)}")
    names = ("steps", "all", "all and observed states", "wall time")
    for name, values in zip(names, zip(*ratios, strict=True), strict=True):
        column = np.array(values)
        print(
            f"{name:<24} median {np.median(column):.2f}, largest {np.max(column):.2f}, at most 3 in "
            f"{np.sum(column <= 3)} of {len(column)}"
        )


if __name__ == "__main__":
    main()
