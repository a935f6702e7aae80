"""Error against evaluations on two problems with published digits: methods of mbdkit, and public codes.

The codes are CVODE and IDA of SUNDIALS (``pip install scikit-sundae``), RADAU5 of Hairer and Wanner in Fortran (package
``r-cran-desolve`` of Debian) and those of SciPy. They integrate the equations of motion of mbdkit,
M a + Phi_q^T lam = Q: those of index 1 or 3, or of Gear, Gupta and Leimkuhler with v = q' + M^-1 Phi_q^T mu. An
*evaluation* is that of forces and constraints at one state, whichever code asks for it; all codes have the exact
Jacobians.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

import mbdkit
from mbdkit_paper.methods.problems import Problem, problems

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
PROBLEMS = ("andrews", "car-axis")
OF_BODY = re.compile(r"final\((\w+)\.(\w+)\)")
COLUMNS = ("x", "y", "angle", "vx", "vy", "angular_velocity")
MOST_STEPS = 5_000
UNTESTED = 1e9
"""Absolute tolerance of the multipliers of IDA, which leaves them out of its error test, as its guide recommends."""
OURS: dict[str, dict[str, Any]] = {
    "dop853, index-1, projected": {"integrator": {"name": "dop853", "adaptive": True}, "stabilization": "projection"},
    "gauss, 3 stages, index-1": {"integrator": {"name": "gauss", "stages": 3, "adaptive": True}},
    "radau-iia, 3 stages, ggl": {"integrator": {"name": "radau-iia", "adaptive": True}, "formulation": "ggl"},
    "radau-iia, 3 stages, index-3": {"integrator": {"name": "radau-iia", "adaptive": True}, "formulation": "index-3"},
    "radau-variable, ggl": {"integrator": {"name": "radau-variable"}, "formulation": "ggl"},
    "bdf, ggl": {"integrator": {"name": "bdf"}, "formulation": "ggl"},
    "adams, index-1": {"integrator": {"name": "adams"}},
    "phem56, index-2": {"integrator": {"name": "phem56", "adaptive": True}, "formulation": "index-2"},
}
RADAU5 = """
library(deSolve)
words <- commandArgs(trailingOnly = TRUE)
numbers <- as.numeric(words[-(1:2)])  # end, tolerance, numbers of variables of index 1, 2, 3
asked <- fifo(words[1], "wb", blocking = TRUE)
given <- fifo(words[2], "rb", blocking = TRUE)
n <- sum(numbers[3:5])
ask <- function(what, t, y, count) {
    writeBin(c(what, t, y), asked)
    readBin(given, "double", count)
}
y <- ask(0, 0, rep(0, n), n)
mass <- matrix(ask(1, 0, y, n * n), n, byrow = TRUE)
rates <- function(t, y, parms) list(ask(2, t, y, n))
jacobian <- function(t, y, parms) matrix(ask(3, t, y, n * n), n, byrow = TRUE)
out <- radau(y, c(0, numbers[1]), rates, NULL, nind = numbers[3:5], rtol = numbers[2], atol = numbers[2],
             jacfunc = jacobian, jactype = "fullusr", mass = mass, maxsteps = MOST_STEPS)
ask(if (nrow(out) == 2 && attr(out, "istate")[1] > 0) 4 else 5, 0, out[nrow(out), -1], 0)
"""
"""The program of R, which asks for values of the equations by one pipe and is given them by another."""


class Equations:
    """The equations of a problem as first-order systems, which count their evaluations and Jacobians."""

    def __init__(self, problem: Problem):
        self.p = mbdkit.EquationsOfMotion.of(problem.spec(problem.step).mechanism())
        self.n, self.m = self.p.n, self.p.m
        self.evaluations = self.jacobians = 0
        self.a, self.lam = self.p.accelerations(0.0, self.p.q0, self.p.v0)
        self.y = np.concatenate([self.p.q0, self.p.v0])

    def index_1(self, t: float, y: np.ndarray) -> np.ndarray:
        """Return the rates of (q, v)."""
        self.evaluations += 1
        q, v = np.split(y, 2)
        return np.concatenate([v, self.p.accelerations(t, q, v)[0]])

    def index_1_jacobian(self, t: float, y: np.ndarray) -> np.ndarray:
        """Return the derivatives of `index_1`."""
        self.jacobians += 1
        return self.p.jacobian(t, *np.split(y, 2), np.zeros(0))

    def constrained(self, t: float, y: np.ndarray, *, ggl: bool) -> np.ndarray:
        """Return the right-hand side of B y' = f(t, y) for y = (q, v, lam), or (q, v, lam, mu) with `ggl`."""
        self.evaluations += 1
        q, v, lam, mu = np.split(y, (self.n, 2 * self.n, 2 * self.n + self.m))
        force = -self.p.residual(t, q, v, np.zeros(self.n), lam)
        if not ggl:
            return np.concatenate([v, force, self.p.constraints(t, q)])
        drift = self.p.constraint_forces(t, q, mu) / self.p.mass
        return np.concatenate([v - drift, force, self.p.constraint_rates(t, q, v), self.p.constraints(t, q)])

    def constrained_jacobian(self, t: float, y: np.ndarray, *, ggl: bool) -> np.ndarray:
        """Return the derivatives of `constrained`, without those of the forces of mu, which is zero at the solution."""
        self.jacobians += 1
        n, m = self.n, self.m
        q, v, lam, _ = np.split(y, (n, 2 * n, 2 * n + m))
        tangents, rows = self.p.tangents(t, q, v, self.a, lam), self.p.constraint_jacobian(t, q).toarray()
        j = np.zeros((len(y), len(y)))
        j[:n, n : 2 * n] = np.eye(n)
        j[n : 2 * n, :n], j[n : 2 * n, n : 2 * n] = -tangents.stiffness.toarray(), -tangents.damping.toarray()
        j[n : 2 * n, 2 * n : 2 * n + m] = -rows.T
        j[-m:, :n] = rows
        if ggl:
            j[:n, -m:] = -rows.T / self.p.mass[:, None]
            j[2 * n : -m, :n], j[2 * n : -m, n : 2 * n] = -tangents.gamma_v.toarray() / 2, rows
        return j

    def start(self, *, ggl: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return y, its rates, and the diagonal of B."""
        none = np.zeros(self.m * (1 + ggl))
        y = np.concatenate([self.y, self.lam, none[self.m :]])
        return y, np.concatenate([self.p.v0, self.a, none]), np.concatenate([np.ones(self.n), self.p.mass, none])


def by_scipy(name: str) -> Callable[[Equations, float, float], np.ndarray]:
    """Return a code of SciPy on the equations of index 1."""

    def code(equations: Equations, end: float, tolerance: float) -> np.ndarray:
        exact = {} if name == "DOP853" else {"jac": equations.index_1_jacobian}
        made = solve_ivp(equations.index_1, (0.0, end), equations.y, name, rtol=tolerance, atol=tolerance, **exact)
        return made.y[:, -1] if made.success else np.full(len(equations.y), np.nan)

    return code


def by_cvode(family: str) -> Callable[[Equations, float, float], np.ndarray]:
    """Return CVODE on the equations of index 1."""

    def code(equations: Equations, end: float, tolerance: float) -> np.ndarray:
        from sksundae.cvode import CVODE

        def rates(t: float, y: np.ndarray, out: np.ndarray) -> None:
            out[:] = equations.index_1(t, y)

        def jacobian(t: float, y: np.ndarray, rate: np.ndarray, out: np.ndarray) -> None:
            out[:] = equations.index_1_jacobian(t, y)

        options = {"rtol": tolerance, "atol": tolerance, "max_num_steps": MOST_STEPS}
        made = CVODE(rates, jacfn=jacobian, method=family, **options).solve(np.array([0.0, end]), equations.y)
        return made.y[-1] if made.success else np.full(len(equations.y), np.nan)

    return code


def by_ida(*, ggl: bool) -> Callable[[Equations, float, float], np.ndarray]:
    """Return IDA on the equations with multipliers."""

    def code(equations: Equations, end: float, tolerance: float) -> np.ndarray:
        from sksundae.ida import IDA

        y, rate, mass = equations.start(ggl=ggl)

        def residual(t: float, y: np.ndarray, rate: np.ndarray, out: np.ndarray) -> None:
            out[:] = mass * rate - equations.constrained(t, y, ggl=ggl)

        def jacobian(t: float, y: np.ndarray, rate: np.ndarray, out: np.ndarray, c: float, matrix: np.ndarray) -> None:
            matrix[:] = np.diag(c * mass) - equations.constrained_jacobian(t, y, ggl=ggl)

        algebraic = np.flatnonzero(mass == 0)
        atol = np.where(mass == 0, UNTESTED, tolerance)
        options = {"rtol": tolerance, "atol": atol, "max_num_steps": MOST_STEPS, "algebraic_idx": algebraic}
        made = IDA(residual, jacfn=jacobian, **options).solve(np.array([0.0, end]), y, rate)
        return made.y[-1] if made.success else np.full(len(y), np.nan)

    return code


def by_radau5(*, ggl: bool) -> Callable[[Equations, float, float], np.ndarray]:
    """Return RADAU5 on the equations with multipliers."""

    def code(equations: Equations, end: float, tolerance: float) -> np.ndarray:
        n, m, (y, _, mass) = equations.n, equations.m, equations.start(ggl=ggl)
        indices = (2 * n, 2 * m, 0) if ggl else (n, n, m)
        answers: list[Callable[[float, np.ndarray], np.ndarray]] = [
            lambda t, y: equations.start(ggl=ggl)[0],
            lambda t, y: np.diag(mass),
            lambda t, y: equations.constrained(t, y, ggl=ggl),
            lambda t, y: equations.constrained_jacobian(t, y, ggl=ggl),
        ]
        with tempfile.TemporaryDirectory() as name:
            script, *pipes = (Path(name) / file for file in ("radau5.R", "asked", "given"))
            script.write_text(RADAU5.replace("MOST_STEPS", str(MOST_STEPS)), encoding="utf-8")
            for pipe in pipes:
                os.mkfifo(pipe)
            words = [str(word) for word in (script, *pipes, end, tolerance, *indices)]
            with subprocess.Popen(["Rscript", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as r:
                end_state = _serve(pipes, answers, len(y))
        return end_state if r.returncode == 0 else np.full(len(y), np.nan)

    return code


def _serve(pipes: list[Path], answers: list[Callable[[float, np.ndarray], np.ndarray]], n: int) -> np.ndarray:
    """Answer the questions of R until it passes its last state (n,), which is nan if the integration failed."""
    with pipes[0].open("rb") as asked, pipes[1].open("wb", buffering=0) as given:
        while len(data := asked.read(8 * (2 + n))) == 8 * (2 + n):
            what, t, *values = np.frombuffer(data)
            y = np.array(values)
            if what >= len(answers):
                return y if what == len(answers) else np.full(n, np.nan)
            given.write(np.ascontiguousarray(answers[int(what)](t, y)).tobytes())
    return np.full(n, np.nan)


def has_radau5() -> bool:
    """Return whether R and its package deSolve are installed."""
    command = ["Rscript", "-e", "library(deSolve)"]
    return bool(shutil.which("Rscript")) and not subprocess.run(command, capture_output=True, check=False).returncode


def codes() -> Iterator[tuple[str, Callable[[Equations, float, float], np.ndarray]]]:
    """Yield the public codes that are installed, by name."""
    for name in ("DOP853", "LSODA", "Radau", "BDF"):
        yield f"SciPy {name}, index-1", by_scipy(name)
    if importlib.util.find_spec("sksundae"):
        yield "CVODE Adams, index-1", by_cvode("Adams")
        yield "CVODE BDF, index-1", by_cvode("BDF")
        yield "IDA, ggl", by_ida(ggl=True)
        yield "IDA, index-3", by_ida(ggl=False)
    if has_radau5():
        yield "RADAU5, ggl", by_radau5(ggl=True)
        yield "RADAU5, index-3", by_radau5(ggl=False)


def error(problem: Problem, names: list[str], y: np.ndarray) -> float:
    """Return the largest error of the results of bodies at an end (q, v, ...), relative if they exceed 1."""
    n, found = 3 * len(names), []
    for quantity in problem.quantities.values():
        if match := OF_BODY.fullmatch(quantity.value):
            column = COLUMNS.index(match[2])
            place = 3 * names.index(match[1]) + column % 3 + n * (column > 2)
            found.append(abs(y[place] - quantity.reference) / max(1.0, abs(quantity.reference)))
    return max(found)


def rows(problem: Problem) -> Iterator[tuple[str, list[str]]]:
    """Yield the name of each method and code, and its error, evaluations and Jacobians for each tolerance."""
    names = list(problem.spec(problem.step).mechanism().bodies)

    def cell(y: np.ndarray, evaluations: int, jacobians: int) -> str:
        return f"{error(problem, names, y):.1e}, {evaluations:,}, {jacobians:,}"

    for label, keys in OURS.items():
        cells = []
        for tolerance in TOLERANCES:
            cells.append("not installed")
            with suppress(mbdkit.SpecError):
                integrator = keys["integrator"] | {"rtol": tolerance, "atol": tolerance}
                run = mbdkit.run(problem.spec(**keys | {"integrator": integrator, "output": {"every": 10**7}}))
                ends = [run.array(f"trajectory/{part}")[-1].ravel() for part in ("position", "velocity")]
                counts = [int(run.stats[key]) for key in ("rhs_evaluations", "jacobian_evaluations")]
                cells[-1] = cell(np.concatenate(ends), *counts) if run.status == "complete" else "failed"
        yield label, cells
    for label, code in codes():
        cells = []
        for tolerance in TOLERANCES:
            equations = Equations(problem)
            y = code(equations, problem.end, tolerance)
            if np.isnan(y).any():  # tighter tolerances are no easier
                cells += ["failed", *["-"] * (len(TOLERANCES) - len(cells) - 1)]
                break
            cells.append(cell(y, equations.evaluations, equations.jacobians))
        yield label, cells


def public_codes(console: Console) -> None:
    """Print error, evaluations and Jacobians of methods of mbdkit and of the public codes that are installed."""
    if not importlib.util.find_spec("sksundae"):
        console.print("CVODE and IDA are not installed: pip install scikit-sundae")
    if not has_radau5():
        console.print("RADAU5 is not installed: apt-get install r-cran-desolve")
    for name in PROBLEMS:
        problem = problems()[name]
        headings = [f"{tolerance:.0e}" for tolerance in TOLERANCES]
        table = Table("method or code", *headings, title=f"{problem.title}: error, evaluations, Jacobians by tolerance")
        for label, cells in rows(problem):
            table.add_row(label, *cells)
        console.print(table)
