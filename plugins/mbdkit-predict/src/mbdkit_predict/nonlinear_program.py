"""The nonlinear program of a prediction: its solution by IPOPT, early stops, and the second-order check."""

from __future__ import annotations

import ctypes
import io
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdkit_predict.point_hessian import PointHessian

MOST_ITERATIONS = 2000
"""Largest number of iterations of the optimizer on a mesh."""
PRECISION = 1e-10
"""Tolerance of the optimizer, to which it scales the conditions of optimality."""
SCALE = 100.0
"""Factor of the objective for the optimizer, by which its last barrier parameter has less effect: the error of a squat
due to it is 2e-11 instead of 2e-9."""
NEAR, BARRIER = 1e-5, 1e-5
"""Least distance from bounds, and barrier parameter, at the start on a finer mesh."""
FEASIBLE = 1e-6
"""Of two iterates with violations below this, that with the smaller objective is the better one."""
ACTIVE = 1e-6
"""Relative distance from a bound up to which it is active."""
ACCEPTABLE = 1e-8
"""Violation of the conditions of optimality up to which an optimizer that cannot reduce it further has succeeded."""
SUCCESSES = ("Solve_Succeeded", "Solved_To_Acceptable_Level")
ROUNDED = "Search_Direction_Becomes_Too_Small"
"""Reports of the optimizer."""

_SILENT: dict[str, Any] = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
_OPTIONS: dict[str, Any] = {
    **_SILENT, "show_eval_warnings": False, "calc_lam_x": True, "ipopt.tol": PRECISION,
    "ipopt.bound_relax_factor": 0.0, "ipopt.mumps_pivtol": 0.01,
}  # fmt: skip
"""Options of the optimizer.

`calc_lam_x` computes multipliers of unknowns with equal bounds too, which the optimizer takes for constants.
`mumps_pivtol` is the default of the linear solver itself. With that of the optimizer, 1e-6, the inertia of the matrix
is wrong on meshes of 100 intervals or more, and the problem is regularized without need.
"""
_PUSHES = "bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push"
_WARM: dict[str, object] = {
    "ipopt.warm_start_init_point": "yes", "ipopt.mu_init": BARRIER,
    **{f"ipopt.warm_start_{push}": NEAR for push in _PUSHES},
}  # fmt: skip
"""Options of a start near an optimum.

With adaptive barrier parameters, a walk leaves the neighbourhood of the optimum on the coarser mesh.
"""


class ProgramCondition(NamedTuple):
    """A condition: its name, its values, and their bounds; conditions of the user have a name with a colon.

    If there is a column of values for each of some collocation points, `points` are the indices of these.
    """

    name: str
    value: Any
    low: float = 0.0
    high: float = 0.0
    points: np.ndarray | None = None


@dataclass
class Stop:
    """Says when an optimization stops early: on Ctrl-C, or after a limit of wall time."""

    end: float = np.inf
    """Time at which it stops, as returned by `time.perf_counter` [s]."""
    interrupted: bool = False
    """Whether the user interrupted it."""

    @property
    def now(self) -> bool:
        """Whether to stop."""
        return self.interrupted or time.perf_counter() > self.end

    def interrupt(self) -> None:
        """Note that the user interrupts the optimization."""
        self.interrupted = True


@dataclass(frozen=True)
class Solution:
    """What the optimizer returned."""

    values: Mapping[str, np.ndarray]
    """Arrays of the unknowns by name."""
    objective: float
    status: str
    """Report of the optimizer."""
    iterations: int
    violations: Mapping[str, float]
    """Largest violation of each condition by name."""
    slopes: Mapping[str, np.ndarray]
    """Derivatives of the objective by name of unknown or condition: by a change of both bounds. Arrays of the shape of
    the unknown, or of the values of the condition."""
    gap: float
    """Bound of the error of the objective that is due to the tolerance of the optimizer: the sum of all products of
    multipliers with slacks, or with violations."""
    is_smooth: bool
    """Whether no bound of an unknown or a condition is active at some points only."""
    is_strict: bool
    """Whether the second-order condition holds: the Hessian of the Lagrangian is positive definite on the null space of
    the active conditions. The optimizer knows this from the inertia of its matrix (A. Waechter and L. T. Biegler,
    Mathematical Programming 106:25-57, 2006, section 3.1): it adds a multiple of the identity otherwise, which it did
    not in its last step."""

    @property
    def is_optimum(self) -> bool:
        """Whether the optimizer reports success."""
        return self.status in SUCCESSES


class NonlinearProgram:
    """A program for the optimizer.

    Parameters
    ----------
    unknowns
        MX symbols by name.
    bounds
        Lower and upper bounds of the unknowns, arrays of their shape.
    conditions
        All conditions.
    objective
        What is minimized.
    sizes
        Natural size of each row of unknowns, by which they are divided for the optimizer; 1 if it is not given.
    hessian
        The second derivatives; those of CasADi by default.

    Attributes
    ----------
    points
        `ProgramCondition.points` by name of the condition.
    """

    def __init__(
        self,
        unknowns: Mapping[str, ca.MX],
        bounds: Mapping[str, tuple[np.ndarray, np.ndarray]],
        conditions: Sequence[ProgramCondition],
        objective: ca.MX,
        sizes: Mapping[str, np.ndarray],
        hessian: PointHessian | None = None,
    ):
        self._names, self._shapes = list(unknowns), {name: bounds[name][0].shape for name in unknowns}
        self.points = {condition.name: condition.points for condition in conditions if condition.points is not None}
        self._conditions = [(condition.name, condition.value.numel()) for condition in conditions]
        self._sizes = np.concatenate(
            [np.resize(sizes.get(name, 1.0), unknown.numel()) for name, unknown in unknowns.items()]
        )
        self._low_x, self._high_x = (
            np.concatenate([_flat(bounds[name][k]) for name in unknowns]) / self._sizes for k in (0, 1)
        )
        self._low, self._high = (
            np.concatenate([np.broadcast_to(getattr(row, side), row.value.numel()) for row in conditions])
            for side in ("low", "high")
        )
        given = ca.vertcat(*(ca.vec(x) for x in unknowns.values()))
        values = [objective, ca.vertcat(*(ca.vec(condition.value) for condition in conditions))]
        x = ca.MX.sym("x", *given.shape)
        program = ca.Function("program", [given], values)
        self._functions: Any = dict(zip("xfg", [x, *program(ca.DM(self._sizes) * x)], strict=True))
        by_name = {condition.name: condition.value for condition in conditions}
        self._hessian = {} if hessian is None else {"hess_lag": hessian.whole(by_name, given, self._sizes)}

    def solve(
        self,
        guess: Mapping[str, np.ndarray],
        stop: Stop,
        most_iterations: int = MOST_ITERATIONS,
        slopes: Mapping[str, np.ndarray] | None = None,
    ) -> Solution:
        """Return the optimum near a guess; the best iterate if the optimizer does not reach it.

        With `slopes`, which have columns for all points, the guess is near an optimum.
        """
        watcher = _Watcher(len(self._low_x), self._low, self._high, stop)
        options: dict[str, Any] = {
            "ipopt.max_iter": most_iterations, "iteration_callback": watcher, "ipopt.obj_scaling_factor": SCALE,
            **({"ipopt.mu_strategy": "adaptive"} if slopes is None else _WARM), **self._hessian,
        }  # fmt: skip
        start = {"x0": np.concatenate([_flat(guess[name]) for name in self._names]) / self._sizes}
        if slopes is not None:
            rows = [slopes[name][:, self.points[name]] if name in self.points else slopes[name]
                    for name, _ in self._conditions]  # fmt: skip
            start["lam_g0"] = -np.concatenate([_flat(row) for row in rows])
            start["lam_x0"] = -np.concatenate([_flat(slopes[name]) for name in self._names]) * self._sizes
        with redirect_stderr(io.StringIO()), _one_thread():
            solver = ca.nlpsol("prediction", "ipopt", self._functions, {**_OPTIONS, **options})
            result: Any = solver(lbx=self._low_x, ubx=self._high_x, lbg=self._low, ubg=self._high, **start)
        report = solver.stats()
        status, x, g, objective = report["return_status"], result["x"], result["g"], result["f"]
        if status == ROUNDED and max(report["iterations"][name][-1] for name in ("inf_pr", "inf_du")) <= ACCEPTABLE:
            status = SUCCESSES[1]
        if status not in SUCCESSES and watcher.best is not None:
            _, x, g, objective = watcher.best
        x, g, lam_x, lam = (np.array(values).ravel() for values in (x, g, result["lam_x"], result["lam_g"]))
        violation = _beyond(g, self._low, self._high)
        rows = np.split(np.arange(len(g)), np.cumsum([size for _, size in self._conditions])[:-1])
        violations, slopes = dict[str, float](), self._apart(-lam_x / self._sizes)
        for (name, _), row in zip(self._conditions, rows, strict=True):
            violations[name] = max(violations.get(name, 0.0), float(violation[row].max(initial=0.0)))
            slopes[name] = -lam[row]
        of_points = [row for places in self._apart(np.arange(len(x))).values() if places.ndim > 1 for row in places]
        is_smooth = not any(
            _is_partly_active(value[row], low[row], high[row])
            for value, low, high, groups in (
                (x, self._low_x, self._high_x, of_points),
                (g, self._low, self._high, rows),
            )
            for row in groups
        )
        gap = _gap(lam_x, x, self._low_x, self._high_x) + _gap(lam, g, self._low, self._high)
        values = self._apart(self._sizes * x)
        is_strict = status in SUCCESSES and report["iterations"]["regularization_size"][-1] == 0.0
        counted = status, report["iter_count"]
        return Solution(values, float(objective), *counted, violations, slopes, gap, is_smooth, is_strict)

    def _apart(self, x: np.ndarray) -> dict[str, np.ndarray]:
        sizes = [int(np.prod(self._shapes[name])) for name in self._names]
        parts = np.split(x, np.cumsum(sizes)[:-1])
        return {
            name: part.reshape(self._shapes[name], order="F") for name, part in zip(self._names, parts, strict=True)
        }


class _Watcher(ca.Callback):
    """Is called by the optimizer after each iteration: keeps the best iterate, and stops it early.

    Attributes
    ----------
    best
        Violation and objective, by which iterates are ordered, unknowns, values of conditions, and objective.
    """

    def __init__(self, size: int, low: np.ndarray, high: np.ndarray, stop: Stop):
        super().__init__()
        self._sizes = {"x": size, "lam_x": size, "f": 1, "g": len(low), "lam_g": len(low)}
        self._bounds, self._stop = (low, high), stop
        self.best: tuple[tuple[float, float], Any, Any, float] | None = None
        self.construct("watcher", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, values: Any) -> list[int]:
        now = dict(zip(map(ca.nlpsol_out, range(len(values))), values, strict=True))
        g, f = np.array(now["g"]).ravel(), float(now["f"])
        order = max(float(_beyond(g, *self._bounds).max(initial=0.0)), FEASIBLE), f
        if np.all(np.isfinite(order)) and (self.best is None or order < self.best[0]):
            self.best = order, np.array(now["x"]), g, f
        return [int(self._stop.now)]


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let OpenBLAS of CasADi, which threadpoolctl does not know, use one thread: blocks of the linear solver are too
    small for several.
    """
    names = ("libcasadi-tp-openblas.so.0", "libcasadi-tp-openblas.dll")
    libraries = [ctypes.CDLL(str(file)) for name in names if (file := Path(ca.__file__).with_name(name)).exists()]
    before = [library.openblas_get_num_threads() for library in libraries]
    for library in libraries:
        library.openblas_set_num_threads(1)
    try:
        yield
    finally:
        for library, count in zip(libraries, before, strict=True):
            library.openblas_set_num_threads(count)


def solve_pose(program: Any, **given: Any) -> np.ndarray:
    """Return the unknowns (n,) that solve a small program ``{"x", "f", "g"}`` of SX."""
    with redirect_stderr(io.StringIO()):
        return np.array(ca.nlpsol("pose", "ipopt", program, _SILENT)(**given)["x"]).ravel()


def _flat(x: np.ndarray) -> np.ndarray:
    return np.asarray(x).ravel(order="F")


def _beyond(x: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.asarray(np.nan_to_num(np.maximum(np.maximum(low - x, x - high), 0.0), nan=np.inf))


def _gap(lam: np.ndarray, x: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Return the sum of the products of multipliers and distances from the bounds that they belong to."""
    distance = np.where(lam > 0.0, np.abs(high - x), np.abs(x - low))
    return float(np.abs(lam * np.where(np.isfinite(distance), distance, 0.0)).sum())


def _is_partly_active(x: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """Return whether values at several points are at their lower or upper bound at some of them only."""
    for bound in (low, high):
        bounded = np.isfinite(bound) & (low < high)
        near = abs(x - bound)[bounded] <= ACTIVE * np.maximum(1.0, abs(bound[bounded]))
        if near.any() and not near.all():
            return True
    return False


_INFEASIBLE = "infeasible", "no motion was found that satisfies all conditions"
STATUSES: Mapping[str, tuple[str, str]] = {
    "Infeasible_Problem_Detected": _INFEASIBLE,
    "Restoration_Failed": _INFEASIBLE,
    "Not_Enough_Degrees_Of_Freedom": ("infeasible", "there are more conditions than unknowns"),
    "Maximum_Iterations_Exceeded": ("iteration-limit", f"no optimum was found in {MOST_ITERATIONS} iterations"),
    "Diverging_Iterates": ("unbounded", "unknowns grow without limit; give bounds to what is free"),
    "Invalid_Number_Detected": ("not-solved", "an expression is not defined, or infinite, along the motion"),
    ROUNDED: ("not-solved", "the optimizer makes no progress, although conditions of optimality are violated"),
    "Error_In_Step_Computation": ("not-solved", "the linear equations of a step could not be solved"),
}
"""Code and sentence for each report of the optimizer that is no success."""
