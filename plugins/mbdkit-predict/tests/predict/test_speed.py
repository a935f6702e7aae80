"""Time of an iteration of the optimizer, beside another transcription in absolute angles, and of whole predictions."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import casadi as ca
import pytest

import mbdkit
from mbdkit_predict import nonlinear_program
from mbdkit_predict.predict_loading import load_predict_spec
from mbdkit_predict.predicted_run import transcribed
from mbdkit_predict.processes import Stop
from predict.chains import chain, program

INTERVALS, ROUNDS, ITERATIONS = 20, 2, 40
SLOWER, MANY, FEW = 1.3, 8, 4
"""Largest ratio of the times of an iteration for `MANY` rods or more. With fewer, 1 ms of an iteration are reports of
the best iterate. With more than `FEW` rods, there are several local optima.
"""


def timed(solve: Callable[[Any], float]) -> tuple[float, float, float, int]:
    """Return the objective, the processor times [s] of an iteration and of its evaluations, and the number of
    iterations, of a solution that calls a function like `casadi.nlpsol`.
    """
    record, nlpsol_of_casadi = dict[str, Any](), ca.nlpsol

    def nlpsol(*given: Any) -> Any:
        solver = nlpsol_of_casadi(*given)

        def call(**start: Any) -> Any:
            begin = time.process_time()
            result = solver(**start)
            record.update(seconds=time.process_time() - begin, **solver.stats())
            return result

        call.stats = solver.stats  # type: ignore[attr-defined]
        return call

    objective = solve(nlpsol)
    count = record["iter_count"]
    evaluations = sum(seconds for name, seconds in record.items() if name.startswith("t_proc_nlp"))
    return objective, record["seconds"] / count, evaluations / count, count


def ours(count: int, monkeypatch: pytest.MonkeyPatch) -> tuple[float, float, float, int]:
    problem = transcribed(load_predict_spec(chain(count)))
    guess = problem.guess()

    def solve(nlpsol: Any) -> float:
        with monkeypatch.context() as patch:
            patch.setattr(nonlinear_program.ca, "nlpsol", nlpsol)
            solution = problem.solved(guess, Stop(), ITERATIONS).solution
        assert solution is not None
        return solution.objective

    return timed(solve)


def by_angles(count: int, *, expand: bool) -> tuple[float, float, float, int]:
    functions, start = program(count, INTERVALS)
    own = {"ipopt.mu_strategy": "adaptive", "ipopt.max_iter": ITERATIONS, "expand": expand}
    options = {**nonlinear_program._OPTIONS, **own}

    def solve(nlpsol: Any) -> float:
        with nonlinear_program._one_thread():
            return float(nlpsol("angles", "ipopt", functions, options)(**start)["f"])

    return timed(solve)


@pytest.mark.benchmark
def test_an_iteration_beside_a_transcription_in_minimal_coordinates(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    names = "mbdkit", "angles, functions", "angles, expanded"
    with capsys.disabled():
        for count in (1, 2, 4, 8, 16):
            runs = [lambda n=count: ours(n, monkeypatch)]
            runs += [lambda n=count, expand=expand: by_angles(n, expand=expand) for expand in (False, True)]
            rows = [min((run() for _ in range(ROUNDS)), key=lambda row: row[1]) for run in runs]
            print(f"\n{count} rods, ms an iteration: evaluations + linear algebra = whole, and number of iterations")
            for name, (_, whole, part, steps) in zip(names, rows, strict=True):
                print(f"{name:<18} {1e3 * part:7.2f} + {1e3 * (whole - part):6.2f} = {1e3 * whole:7.2f} {steps:4}")
            if count <= FEW:
                assert rows[0][0] == pytest.approx(rows[1][0], rel=1e-7)
            if count >= MANY:
                assert rows[0][1] < SLOWER * min(rows[1][1], rows[2][1])


@pytest.mark.benchmark
def test_the_time_of_whole_predictions(capsys: pytest.CaptureFixture[str]) -> None:
    mbdkit.predict(chain(1))  # imports what predictions need
    for count, most in ((8, 1.5), (16, 5.0), (32, 25.0)):
        # the least squares of torques of long chains have many local optima, those of accelerations have one
        effort = " + ".join(f"integral(rod{k}.angular_acceleration**2)" for k in range(count))
        spec = chain(count) | {"minimize": effort}
        begin = time.perf_counter()
        run = mbdkit.predict(spec)
        seconds = time.perf_counter() - begin
        with capsys.disabled():
            processor = run.stats["cpu_s"] + run.stats["setup_s"]
            intervals = [number for number, _ in run.mesh]
            print(f"\n{count} rods: {seconds:.2f} s, {processor:.2f} s of the processor, {intervals} intervals", end="")
        assert run.objective == pytest.approx(12.0 * 0.3**2 * count, rel=1e-6)
        assert run.verdict == "good"
        assert seconds < most
