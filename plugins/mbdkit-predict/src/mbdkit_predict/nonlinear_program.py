"""The nonlinear program of a prediction: its solution by IPOPT, early stops, and the second-order check."""

from __future__ import annotations

import ctypes
import io
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from mbdkit_predict.point_hessian import PointHessian, PointJacobian
from mbdkit_predict.processes import Stop

MOST_ITERATIONS = 2000  #: Largest number of iterations of the optimizer on a mesh.
PRECISION = 1e-10  #: Tolerance of the optimizer, to which it scales the conditions of optimality.
#: Factor of the objective, relative to its natural size, for the optimizer. Its last barrier parameter then has less
#: effect: the error of a squat due to it is 2e-11 instead of 2e-9.
SCALE = 100.0
#: Shift of inverse iterations for directions without curvature, and the largest curvature, or rate of a condition, that
#: counts as zero, relative to what it is the sum of.
SHIFT, FLAT = 1e-11, 1e-7
NEAR, BARRIER = 1e-5, 1e-5  #: Least distance from bounds, and barrier parameter, at the start on a finer mesh.
#: Of two iterates with violations below this, that with the smaller objective is the better one.
FEASIBLE = 1e-6
ACTIVE = 1e-6  #: Relative distance from a bound up to which it is active.
#: Violation of the conditions of optimality up to which an optimizer that cannot reduce it further has succeeded.
ACCEPTABLE = 1e-8
SUCCESSES = ("Solve_Succeeded", "Solved_To_Acceptable_Level")
STOPPED, LIMITED, DIVERGING = "User_Requested_Stop", "Maximum_Iterations_Exceeded", "Diverging_Iterates"
REPORTING = 0.1  #: Least time between two reports of iterates [s].
ROUNDED = "Search_Direction_Becomes_Too_Small"  #: Reports of the optimizer.

_SILENT: dict[str, Any] = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
#: Options of the optimizer.
#:
#: `calc_lam_x` computes multipliers of unknowns with equal bounds too, which the optimizer takes for constants. With
#: the `mumps_pivtol` of the optimizer, 1e-6, the inertia of the matrix is wrong on meshes of 100 intervals or more, and
#: the problem is regularized without need. The iterative scaling of rows and columns, `mumps_scaling`, lets the solver
#: keep its order of pivots: with its own choice, the factorization for a chain of 8 rods takes four times as long.
_OPTIONS: dict[str, Any] = {
    **_SILENT, "show_eval_warnings": False, "calc_lam_x": True, "ipopt.tol": PRECISION,
    "ipopt.bound_relax_factor": 0.0, "ipopt.mumps_pivtol": 1e-3, "ipopt.mumps_scaling": 7,
}  # fmt: skip
_PUSHES = "bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push"
#: Options of a start near an optimum.
#:
#: With adaptive barrier parameters, a walk leaves the neighbourhood of the optimum on the coarser mesh.
_WARM: dict[str, object] = {
    "ipopt.warm_start_init_point": "yes", "ipopt.mu_init": BARRIER,
    **{f"ipopt.warm_start_{push}": NEAR for push in _PUSHES},
}  # fmt: skip


_Iterate = tuple[np.ndarray, np.ndarray, float]  #: Unknowns, values of conditions, and objective.


class ProgramCondition(NamedTuple):
    """A condition: its name, its values, and their bounds; conditions of the user have a name with a colon.

    If there is a column of values for each of some collocation points, `points` are the indices of these.
    """

    name: str
    value: Any
    low: float = 0.0
    high: float = 0.0
    points: np.ndarray | None = None


@dataclass(frozen=True)
class Solution:
    """What the optimizer returned."""

    values: Mapping[str, np.ndarray]  #: Arrays of the unknowns by name.
    objective: float
    violations: Mapping[str, float]  #: Largest violation of each condition by name.
    status: str = STOPPED  #: Report of the optimizer.
    iterations: int = 0
    #: Derivatives of the objective by name of unknown or condition: by a change of both bounds. Arrays of the shape of
    #: the unknown, or of the values of the condition.
    slopes: Mapping[str, np.ndarray] = field(default_factory=dict)
    #: Bound of the error of the objective that is due to the tolerance of the optimizer: the sum of all products of
    #: multipliers with slacks, or with violations.
    gap: float = np.nan
    is_smooth: bool = False  #: Whether no bound of an unknown or a condition is active at some points only.
    #: Whether the second-order condition holds: the Hessian of the Lagrangian is positive definite on the null space of
    #: the active conditions. The optimizer knows this from the inertia of its matrix (A. Waechter and L. T. Biegler,
    #: Mathematical Programming 106:25-57, 2006, section 3.1): it adds a multiple of the identity otherwise, which it
    #: did not in its last step. Without any step, it is not known.
    is_strict: bool = False
    #: Changes of unknowns by name, divided by their sizes, for which the curvature of the Lagrangian is zero while all
    #: active conditions hold, if there are any. The inertia above does not show them, because the matrix of the
    #: optimizer contains barrier terms. They are computed on meshes without a coarser one.
    undetermined: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def is_optimum(self) -> bool:
        """Whether the optimizer reports success."""
        return self.status in SUCCESSES

    @property
    def is_unbounded(self) -> bool:
        """Whether unknowns grow without limit."""
        return self.status == DIVERGING


#: Number of collocation points of an interval above which `mumps_pivot_order` is QAMD, 6: with 7 points, it takes 0.6
#: to 0.8 of the time of the order that the solver chooses, 7; with 3 points, 1.2 times as long.
FEW = 3


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
    jacobian, hessian
        The first and second derivatives; those of CasADi by default.
    size
        Natural size of the objective.
    dense
        Number of collocation points of an interval, whose unknowns depend on each other.

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
        jacobian: PointJacobian | None = None,
        hessian: PointHessian | None = None,
        size: float = 1.0,
        dense: int = 1,
    ):
        self._own = {"ipopt.obj_scaling_factor": SCALE / size, "ipopt.mumps_pivot_order": 6 if dense > FEW else 7}
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
        # two functions, so that derivatives of the objective are not propagated through the conditions
        self._program = [ca.Function("program", [given], [value]) for value in values]
        at = ca.DM(self._sizes) * x
        self._functions: Any = {"x": x} | {name: own(at) for name, own in zip("fg", self._program, strict=True)}
        by_name = {condition.name: condition.value for condition in conditions}
        self._derivatives = {} if hessian is None else {"hess_lag": hessian.whole(by_name, given, self._sizes)}
        self._derivatives |= {} if jacobian is None else {"jac_g": jacobian.whole(given, self._sizes)}

    def solve(
        self,
        guess: Mapping[str, np.ndarray],
        stop: Stop,
        report: Callable[[Solution], None],
        most_iterations: int = MOST_ITERATIONS,
        slopes: Mapping[str, np.ndarray] | None = None,
    ) -> Solution:
        """Return the optimum near a guess; the best iterate if the optimizer does not reach it.

        With `slopes`, which have columns for all points, the guess is near an optimum. `report` is called with the best
        iterates in between.
        """
        first = np.concatenate([_flat(guess[name]) for name in self._names])
        watcher = _Watcher(len(self._low_x), self._low, self._high, stop, lambda best: report(self._iterate(*best)))
        watcher.note(first / self._sizes, *(own(first) for own in self._program[::-1]))
        options: dict[str, Any] = {
            "ipopt.max_iter": most_iterations, "iteration_callback": watcher, **self._own,
            **({"ipopt.mu_strategy": "adaptive"} if slopes is None else _WARM), **self._derivatives,
        }  # fmt: skip
        start = {"x0": first / self._sizes}
        if slopes is not None:
            rows = [slopes[name][:, self.points[name]] if name in self.points else slopes[name]
                    for name, _ in self._conditions]  # fmt: skip
            start["lam_g0"] = -np.concatenate([_flat(row) for row in rows])
            start["lam_x0"] = -np.concatenate([_flat(slopes[name]) for name in self._names]) * self._sizes
        with redirect_stderr(io.StringIO()), _one_thread():
            solver = ca.nlpsol("prediction", "ipopt", self._functions, {**_OPTIONS, **options})
            result: Any = solver(lbx=self._low_x, ubx=self._high_x, lbg=self._low, ubg=self._high, **start)
        found = solver.stats()
        status, count = found["return_status"], found["iter_count"]
        if status == ROUNDED and max(found["iterations"][name][-1] for name in ("inf_pr", "inf_du")) <= ACCEPTABLE:
            status = SUCCESSES[1]
        if status not in SUCCESSES and watcher.best is not None:
            return replace(self._iterate(*watcher.best), status=status, iterations=count)
        x, g, lam_x, lam = (np.array(result[name]).ravel() for name in ("x", "g", "lam_x", "lam_g"))
        slopes = self._apart(-lam_x / self._sizes) | {name: -lam[row] for name, row in self._rows()}
        of_points = [row for places in self._apart(np.arange(len(x))).values() if places.ndim > 1 for row in places]
        is_smooth = not any(
            _is_partly_active(value[row], low[row], high[row])
            for value, low, high, groups in (
                (x, self._low_x, self._high_x, of_points),
                (g, self._low, self._high, [row for _, row in self._rows()]),
            )
            for row in groups
        )
        gap = _gap(lam_x, x, self._low_x, self._high_x) + _gap(lam, g, self._low, self._high)
        free = None
        if start.keys().isdisjoint({"lam_g0"}) and status in SUCCESSES and np.any(lam):  # zero without a step
            free = self._flat_direction(solver, x, g, lam)
        is_strict = status in SUCCESSES and count > 0 and found["iterations"]["regularization_size"][-1] == 0.0
        solution = self._iterate(x, g, float(result["f"]))
        return replace(
            solution, status=status, iterations=count, slopes=slopes, gap=gap, is_smooth=is_smooth, is_strict=is_strict,
            undetermined={} if free is None else self._apart(free),
        )  # fmt: skip

    def _flat_direction(self, solver: Any, x: np.ndarray, g: np.ndarray, lam: np.ndarray) -> np.ndarray | None:
        """Return the direction with the least curvature of the Lagrangian on the null space of the active conditions,
        without barrier terms, by inverse iteration; None if it is curved or, but for single points, empty.
        """
        upper = solver.get_function("nlp_hess_l")(x, [], 1.0, lam).sparse()
        slopes = solver.get_function("nlp_jac_g")(x, [])[1].sparse()
        hessian = upper + sparse.triu(upper, 1).T
        inside = [np.minimum(value - low, high - value) > ACTIVE * np.maximum(1.0, abs(value))
                  for value, low, high in ((x, self._low_x, self._high_x), (g, self._low, self._high))]  # fmt: skip
        free, held = np.flatnonzero(inside[0]), np.flatnonzero(~inside[1])
        curvature, jacobian = hessian[free][:, free], slopes[held][:, free]
        shift = SHIFT * (abs(curvature).max() or 1.0)
        eye = [shift * sparse.eye(len(free)), -SHIFT * sparse.eye(len(held))]
        try:
            factors = splu(sparse.bmat([[curvature + eye[0], jacobian.T], [jacobian, eye[1]]], "csc"))
        except RuntimeError:  # exactly singular
            return None
        way = np.random.default_rng(0).standard_normal(len(free))
        for _ in range(3):
            way = factors.solve(np.concatenate([way, np.zeros(len(held))]))[: len(free)]
            way /= np.linalg.norm(way) or 1.0
        size = FLAT * (abs(way) @ abs(curvature) @ abs(way)) + np.finfo(float).eps * abs(curvature).max()
        is_feasible = abs(jacobian @ way).max(initial=0.0) <= FLAT * abs(jacobian).max()
        if not (way.any() and is_feasible and abs(way @ curvature @ way) <= size):
            return None
        whole = np.zeros(len(x))
        whole[free] = way
        return whole

    def _iterate(self, x: np.ndarray, g: np.ndarray, objective: float) -> Solution:
        violation, violations = _beyond(g, self._low, self._high), dict[str, float]()
        for name, row in self._rows():
            violations[name] = max(violations.get(name, 0.0), float(violation[row].max(initial=0.0)))
        return Solution(self._apart(self._sizes * x), objective, violations)

    def _rows(self) -> list[tuple[str, np.ndarray]]:
        rows = np.split(np.arange(len(self._low)), np.cumsum([size for _, size in self._conditions])[:-1])
        return [(name, row) for (name, _), row in zip(self._conditions, rows, strict=True)]

    def _apart(self, x: np.ndarray) -> dict[str, np.ndarray]:
        parts = np.split(x, np.cumsum([int(np.prod(self._shapes[name])) for name in self._names])[:-1])
        return {
            name: part.reshape(self._shapes[name], order="F") for name, part in zip(self._names, parts, strict=True)
        }


class _Watcher(ca.Callback):
    """Is called by the optimizer after each iteration: keeps and reports the best iterate, and stops it early.

    Attributes
    ----------
    best
        Unknowns, values of conditions, and objective.
    """

    def __init__(self, size: int, low: np.ndarray, high: np.ndarray, stop: Stop, report: Callable[[_Iterate], None]):
        super().__init__()
        self._sizes = {"x": size, "lam_x": size, "f": 1, "g": len(low), "lam_g": len(low)}
        self._bounds, self._stop, self._report, self._reported = (low, high), stop, report, -np.inf
        self.best: _Iterate | None = None
        self._order, self._is_new = (np.inf, np.inf), False
        self.construct("watcher", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, values: Any) -> list[int]:
        now = dict(zip(map(ca.nlpsol_out, range(len(values))), values, strict=True))
        self.note(now["x"], now["g"], now["f"])
        return [int(self._stop.now)]

    def note(self, x: Any, g: Any, objective: Any) -> None:
        """Take an iterate if it is better than those before: has smaller violations, or a smaller objective."""
        g, f = np.array(g).ravel(), float(objective)
        order = max(float(_beyond(g, *self._bounds).max(initial=0.0)), FEASIBLE), f
        if np.all(np.isfinite(order)) and order < self._order:
            self._order, self.best, self._is_new = order, (np.array(x).ravel(), g, f), True
        if self.best is not None and self._is_new and time.perf_counter() - self._reported > REPORTING:
            self._report(self.best)
            self._reported, self._is_new = time.perf_counter(), False


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
#: Code and sentence for each report of the optimizer that is no success.
STATUSES: Mapping[str, tuple[str, str]] = {
    "Infeasible_Problem_Detected": _INFEASIBLE,
    "Restoration_Failed": _INFEASIBLE,
    "Not_Enough_Degrees_Of_Freedom": ("infeasible", "there are more conditions than unknowns"),
    LIMITED: ("iteration-limit", f"no optimum was found in {MOST_ITERATIONS} iterations"),
    DIVERGING: ("unbounded", "unknowns grow without limit; give bounds to what is free"),
    "Invalid_Number_Detected": ("not-solved", "an expression is not defined, or infinite, along the motion"),
    ROUNDED: ("not-solved", "the optimizer makes no progress, although conditions of optimality are violated"),
    STOPPED: ("not-solved", "the process of the optimizer ended, perhaps because the memory is too small"),
    "Error_In_Step_Computation": ("not-solved", "the linear equations of a step could not be solved"),
}
