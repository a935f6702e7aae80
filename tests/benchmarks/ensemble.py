"""Many double pendulums at once: mbdkit in lanes and one by one, C with lanes, MuJoCo's `rollout`, CasADi's `map`.

The members are released from rest at different angles. Time is that of the stepping alone, per step and member; every
contender uses as many threads as stated. "At equal error" repeats the comparison with the step that each contender
needs for an end of rod 2 within 1e-6 m, released from the horizontal.
"""

from __future__ import annotations

import functools
import importlib.util
import math
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from mbdkit.archive.finished_run import FinishedRun
from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Timetable
from mbdkit.integrators.lane_stepper import LaneStepper, PivotsAtStart, VariedStarts
from mbdkit.integrators.start import start_method
from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta
from mbdkit.runs.preparation import build, make_method
from mbdkit.runs.simulation import simulate_arrays
from mbdkit.spec import RunSpec
from mbdkit_studies.compute.batch import simulate_batch
from tests.witness.double_pendulum import HORIZONTAL

from .contenders import END, MUJOCO, G, end_of
from .timing import take_turns
from .whole_ensembles import whole_ensembles

STEPS = 2000
REPEATS = 9
MEMBERS = 64
"""Members of an ensemble, for those who take many at once."""
TARGET = 1e-6
AT_TARGET = " at equal error"

Outcome = tuple[float, float]
"""Seconds per member, and the error of the member that is released from the horizontal [m]."""
Contender = Callable[[int], Outcome]
"""Takes this number of steps."""
METHODS: dict[str, dict[str, Any]] = {
    "rk4": {"name": "rk4"},
    "rk-gill": {"name": "rk-gill"},
    "gauss-2": {"name": "gauss", "stages": 2},
}
"""Integrators of mbdkit by the name of their contenders."""


def spec(method: str, angles: tuple[float, float], steps: int = STEPS) -> RunSpec:
    """Return the spec of a member."""
    model = {"name": "double-pendulum", "angles": list(angles)}
    return RunSpec(mbdkit=1, model=model, integrator=METHODS[method], time={"end": END, "step": END / steps})


def table_of(steps: int) -> Timetable:
    """Return a timetable that records the start and the end only."""
    return Timetable(0.0, END, step=END / steps, steps=steps, every=steps)


@functools.cache
def members(method: str) -> tuple[list[Workspace], ExplicitRungeKutta | ImplicitRungeKutta]:
    """Return as many pendulums as there are lanes, at their starts; the first is horizontal."""
    specs = [spec(method, (0.1 * i, -0.05 * i)) for i in range(WIDTH)]
    chosen = make_method(specs[0])
    assert isinstance(chosen, ExplicitRungeKutta | ImplicitRungeKutta)
    return [build(one)[0] for one in specs], chosen


def miss_of(angle1: float, angle2: float) -> float:
    """Return the distance [m] of the end of rod 2 from the reference digits, released from the horizontal."""
    x, y = end_of(angle1, angle2)
    reference = HORIZONTAL.ends[HORIZONTAL.at(END), 1]
    return float(np.hypot(x - reference[0], y - reference[1]))


def by_lanes(method: str, steps: int) -> Outcome:
    """Take the steps in lanes, in one thread."""
    starts, chosen = members(method)
    tables = [table_of(steps)] * WIDTH
    pivots = [PivotsAtStart().of(chosen, *one) for one in zip(starts, tables, strict=True)]
    stepper = LaneStepper(chosen, starts[0], 2, pivots[0])
    begin = time.perf_counter()
    results = stepper.advance(VariedStarts.of_starts(starts, pivots), tables)
    taken = time.perf_counter() - begin
    return taken / WIDTH, miss_of(float(results.q[0, -1, 2]), float(results.q[0, -1, 5]))


def one_by_one(method: str, steps: int) -> Outcome:
    """Take the steps of one run by the driver of single runs."""
    alone = spec(method, (0.0, 0.0), steps)
    workspace, _ = build(alone)
    stepper = start_method(make_method(alone), workspace, table_of(steps))
    begin = time.perf_counter()
    while not stepper.finished:
        last = stepper.advance()
        assert stepper.failure is None
    taken = time.perf_counter() - begin
    return taken, miss_of(float(last.q[-1, 2]), float(last.q[-1, 5]))


def compiled(folder: Path, name: str) -> Path | None:
    """Return a compiled C program of this folder; None where there is no gcc."""
    compiler = shutil.which("gcc")
    if compiler is None:
        return None
    flags = ["-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-D_GNU_SOURCE", f"-DW={WIDTH}"]
    if WIDTH == 8:
        flags.append("-mprefer-vector-width=512")
    program = folder / name
    source = Path(__file__).with_name(f"{name}.c")
    subprocess.run([compiler, *flags, "-o", str(program), str(source), "-lm"], check=True)
    return program


def by_c(program: Path, steps: int) -> Outcome:
    """Take the steps in C, whose error is that of mbdkit's RK-Gill."""
    text = subprocess.run([program, "2", str(steps)], check=True, capture_output=True, text=True).stdout
    if found := re.search(r"us/step/member ([\d.]+)", text):
        return float(found[1]) * 1e-6 * steps, math.nan
    found = re.search(r"([\d.]+) ms", text)
    assert found is not None
    return float(found[1]) * 1e-3, math.nan


def by_mujoco(steps: int, threads: int) -> Outcome:
    """Take the steps by MuJoCo's RK4 with `rollout`, which stores the states of all steps."""
    import mujoco
    from mujoco import rollout

    model = mujoco.MjModel.from_xml_string(MUJOCO.format(step=END / steps, inertia=1.0 / 12.0))
    data = [mujoco.MjData(model) for _ in range(threads)]
    starts = np.zeros((MEMBERS, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    first = np.zeros(starts.shape[1])
    mujoco.mj_getState(model, data[0], first, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    starts[:] = first
    starts[:, 1] = 0.05 * np.arange(MEMBERS)
    begin = time.perf_counter()
    states, _ = rollout.rollout(model, data, starts, nstep=steps)
    taken = time.perf_counter() - begin
    return taken / MEMBERS, miss_of(float(states[0, -1, 1]), float(states[0, -1, 1] + states[0, -1, 2]))


def by_casadi(steps: int, threads: int) -> Outcome:
    """Take the steps by RK4 on the two angles, as a CasADi function that is mapped over threads."""
    run = casadi_rk4(steps).map(MEMBERS, "thread", threads) if threads > 1 else casadi_rk4(steps).map(MEMBERS)
    starts = np.zeros((4, MEMBERS))
    starts[0] = 0.05 * np.arange(MEMBERS)
    begin = time.perf_counter()
    ends = np.array(run(starts))
    taken = time.perf_counter() - begin
    return taken / MEMBERS, miss_of(float(ends[0, 0]), float(ends[1, 0]))


@functools.cache
def casadi_rk4(steps: int) -> Any:
    """Return a CasADi function of the state (two angles, two rates) that takes all steps."""
    import casadi

    x = casadi.SX.sym("x", 4)
    coupling, sine = 0.5 * casadi.cos(x[0] - x[1]), 0.5 * casadi.sin(x[0] - x[1])
    first = -1.5 * G * casadi.cos(x[0]) - sine * x[3] ** 2
    second = -0.5 * G * casadi.cos(x[1]) + sine * x[2] ** 2
    determinant = 4.0 / 9.0 - coupling**2
    push = casadi.vertcat(first / 3.0 - coupling * second, second * 4.0 / 3.0 - coupling * first) / determinant
    rate = casadi.Function("rate", [x], [casadi.vertcat(x[2:], push)])
    h = END / steps
    k1 = rate(x)
    k2 = rate(x + 0.5 * h * k1)
    k3 = rate(x + 0.5 * h * k2)
    k4 = rate(x + h * k3)
    return casadi.Function("step", [x], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)]).fold(steps)


def contenders(folder: Path) -> dict[str, Contender]:
    """Return what is timed, by name."""
    found: dict[str, Contender] = {}
    for method in METHODS:
        found[f"mbdkit {method}, {WIDTH} lanes"] = functools.partial(by_lanes, method)
        found[f"mbdkit {method}, one by one"] = functools.partial(one_by_one, method)
    if lanes := compiled(folder, "chain_lanes"):
        found[f"C rk-gill, {WIDTH} lanes"] = functools.partial(by_c, lanes)
    if alone := compiled(folder, "chain_limit"):
        found["C rk-gill, one by one"] = functools.partial(by_c, alone)
    for threads in (1, 2):
        if importlib.util.find_spec("mujoco"):
            found[f"MuJoCo rk4, rollout, {threads} threads"] = functools.partial(by_mujoco, threads=threads)
        if importlib.util.find_spec("casadi"):
            found[f"CasADi rk4, map, {threads} threads"] = functools.partial(by_casadi, threads=threads)
    return found


def steps_for(contender: Contender, target: float) -> int:
    """Return a number of steps for which the error is at most `target`, and hardly less; all are of order four."""
    steps = STEPS
    for _ in range(8):
        miss = contender(steps)[1]
        if miss <= target <= 1.2 * miss:
            break
        steps = max(10, math.ceil(steps * (1.1 * miss / target) ** 0.25))
    return steps


def ensemble(console: Console) -> None:
    """Print the time per step and member of ensembles of double pendulums, and per member at equal error."""
    with tempfile.TemporaryDirectory() as folder:
        found = contenders(Path(folder))
        needed = {name: steps_for(one, TARGET) for name, one in found.items() if not name.startswith("C ")}
        for name in found:
            needed.setdefault(name, needed["mbdkit rk-gill, one by one"])
        misses = {name: one(needed[name])[1] for name, one in found.items()}
        tasks: dict[str, Callable[[], float]] = {}
        for name, one in found.items():
            tasks[name] = functools.partial(_seconds, one, STEPS)
            tasks[f"{name}{AT_TARGET}"] = functools.partial(_seconds, one, needed[name])
        timings = take_turns(tasks, REPEATS)
    table = Table(title=f"Ensembles of double pendulums, {END:g} s: medians of {REPEATS}, taking turns")
    table.add_column("contender")
    for heading in (
        "us a step and member", "steps a second", "of rk4 lanes",
        f"steps to {TARGET:.0e} m", "error [m]", "us a member", "of rk4 lanes",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    best = f"mbdkit rk4, {WIDTH} lanes"
    for name in sorted(found, key=lambda name: timings[name].median):
        taken, equal = timings[name].median, timings[f"{name}{AT_TARGET}"].median
        table.add_row(
            name, f"{taken / STEPS * 1e6:.4f}", f"{STEPS / taken:.3g}", f"{taken / timings[best].median:.2f}",
            str(needed[name]), f"{misses[name]:.1e}", f"{equal * 1e6:.1f}",
            f"{equal / timings[f'{best}{AT_TARGET}'].median:.2f}",
        )  # fmt: skip
    console.print(table)
    _adaptive(console)
    _two_threads(console)
    whole_ensembles(console)


def _seconds(contender: Contender, steps: int) -> float:
    return contender(steps)[0]


def _adaptive(console: Console) -> None:
    """Print the time of runs with adaptive steps in lanes and one by one: steps, recorded values and their hash."""
    table = Table(title=f"Adaptive steps, {MEMBERS} double pendulums, {END:g} s: medians of {REPEATS}")
    table.add_column("method")
    for heading in ("relative tolerance", "steps a run", "ms a run in lanes", "ms a run one by one", "ratio"):
        table.add_column(heading, justify="right")
    angles = np.random.default_rng(1).uniform(-1.0, 1.0, (MEMBERS, 2))
    cases = [("dop853", 1e-6), ("dop853", 1e-9), ("dop853", 1e-12), ("radau-iia", 1e-8), ("gauss", 1e-8)]
    for name, tolerance in cases:
        integrator = {"name": name, "adaptive": True, "rtol": tolerance}
        models = [{"name": "double-pendulum", "angles": pair.tolist()} for pair in angles]
        specs = [RunSpec(mbdkit=1, model=one, integrator=integrator, time={"end": END}) for one in models]

        def in_lanes(specs: list[RunSpec] = specs) -> float:
            return _stepping(simulate_batch(specs))

        def one_by_one(specs: list[RunSpec] = specs) -> float:
            return _stepping(map(simulate_arrays, specs))

        assert in_lanes() > 0.0 < one_by_one()  # loads what is compiled
        timings = take_turns({"lanes": in_lanes, "single": one_by_one}, REPEATS)
        lanes, single = timings["lanes"].median, timings["single"].median
        steps = np.mean([simulate_arrays(one).stats["steps"] for one in specs])
        numbers = f"{1e3 * lanes:.3f}", f"{1e3 * single:.3f}", f"{single / lanes:.2f}"
        table.add_row(name, f"{tolerance:.0e}", f"{steps:.0f}", *numbers)
    console.print(table)


def _stepping(runs: Iterable[object]) -> float:
    """Return the mean time of the steps of runs, with what is recorded of them [s]."""
    times = [run.stats["wall_s"] for run in runs if isinstance(run, FinishedRun)]
    assert len(times) == MEMBERS
    return float(np.mean(times))


def _two_threads(console: Console) -> None:
    """Print the steps a second of rk4 in lanes in one thread and in two, each with its own lanes."""
    rounds = 100
    starts, chosen = members("rk4")
    steppers = [LaneStepper(chosen, starts[0], 2) for _ in range(2)]

    def work(stepper: LaneStepper) -> None:
        for _ in range(rounds):
            stepper.advance(VariedStarts.of_starts(starts), [table_of(STEPS)] * WIDTH)

    for threads in (1, 2):
        with ThreadPoolExecutor(threads) as pool:
            begin = time.perf_counter()
            list(pool.map(work, steppers[:threads]))
            taken = time.perf_counter() - begin
        rate = threads * rounds * STEPS * WIDTH / taken
        console.print(f"rk4 in {WIDTH} lanes, {threads} thread{'s' * (threads > 1)}: {rate:.3g} steps a second")
