"""Direct collocation of optimal control: a motion becomes the solution of a nonlinear program.

The unknowns are the positions, velocities, accelerations, multipliers, first-order states and controls at the
collocation points of all intervals, the state at the start, the duration and the parameters. Both the constraints and
their rates are zero at every point; multipliers mu make this possible (C. W. Gear, B. Leimkuhler and G. K. Gupta,
Journal of Computational and Applied Mathematics 12-13:77-90, 1985):

    q' = v + Phi_q^T mu,      v' = a,      M a + Phi_q^T lam = Q,      Phi = 0,      Phi_q v + Phi_t = 0
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from contextlib import redirect_stderr
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.methods import gauss, radau_iia
from mbdkit_predict.casadi_system import CasadiSystem
from mbdkit_predict.elastic_fibers import ElasticFibers
from mbdkit_predict.objective import INTEGRAL, Objective
from mbdkit_predict.predict_spec import Duration, PredictSpec, bounds_of
from mbdkit_predict.symbolic_mechanism import SymbolicMechanism

OF_STATE = ("a", "lam", "u")
"""Symbols that are not known at the start and the end of a motion, only at collocation points."""
MOST_ITERATIONS = 2000
"""Largest number of iterations of the optimizer on a mesh."""
PRECISION = 1e-10
"""Tolerance of the optimizer, to which it scales the conditions of optimality."""


@dataclass(frozen=True)
class Mesh:
    """A solution at the collocation points of a mesh.

    Attributes
    ----------
    intervals
        Number of intervals N.
    values
        Arrays of the unknowns by name: ``q``, ``v``, ``a``, ``lam``, ``mu``, ``z``, ``u`` have a column for each of the
        N s points; ``start`` (2 n + Z,) is the state at the start, ``nodes`` are those at the ends of intervals, if
        these are no points; ``duration`` and ``p``.
    objective
        Value of the objective.
    status
        What the optimizer reports.
    iterations
        Number of its iterations, on this mesh and those before.
    violated
        Name of the condition with the largest violation, and the violation.
    """

    intervals: int
    values: Mapping[str, np.ndarray]
    objective: float
    status: str
    iterations: int
    violated: tuple[str, float] = ("", 0.0)


class _Condition(NamedTuple):
    """A condition: its name, its values, and their bounds."""

    name: str
    value: ca.MX
    low: float = 0.0
    high: float = 0.0


class Transcription:
    """The optimal control problem of a spec, for any mesh.

    Parameters
    ----------
    spec
        The spec.
    symbolic
        Its mechanism with symbols.
    objective
        What is minimized.
    """

    def __init__(self, spec: PredictSpec, symbolic: SymbolicMechanism, objective: Objective):
        self.spec, self.objective = spec, objective
        self.system: CasadiSystem = symbolic.system()
        self.states = symbolic.states
        method = radau_iia if spec.collocation.method == "radau" else gauss
        self.a, self.b, self.c = method.tableau(spec.collocation.points).floats()
        self.fibers = ElasticFibers(spec.chosen, self.system)
        self.has_nodes = spec.collocation.method == "gauss"
        self._initial = self._conditions("initial", bounds_of(spec.initial))
        self._final = self._conditions("final", bounds_of(spec.final))
        self._periodic = self._conditions("periodic", dict.fromkeys(spec.periodic, (0.0, 0.0)))
        self._path: list[tuple[str, ca.SX, float, float]] = []
        self._limits: list[tuple[str, int, float, float]] = []
        self._add_path()
        self._is_free = self._free_states()
        self._stage = self._stage_function()

    def _add_path(self) -> None:
        """Add the conditions along the path; those of one coordinate, velocity or state are bounds of unknowns."""
        unknowns = {
            x.element_hash(): (name, i) for name in "qvz" for i, x in enumerate(ca.vertsplit(self.system.symbols[name]))
        }
        for name, condition in self.spec.subject_to.items():
            expression = self._expression(condition.value, f"subject_to.{name}.value")
            low, high = (
                -np.inf if condition.min is None else condition.min,
                np.inf if condition.max is None else condition.max,
            )
            if expression.is_symbolic() and (unknown := unknowns.get(expression.element_hash())):
                self._limits.append((*unknown, low, high))
            else:
                self._path.append((name, expression, low, high))

    def _free_states(self) -> np.ndarray:
        """Return whether each first-order state (Z,) is in a condition on the start, so that it is free."""
        conditions = [x for x, _, _ in (*self._initial.values(), *self._periodic.values())]
        free = [any(ca.depends_on(x, state) for x in conditions) for state in _elements(self.system.z)]
        return np.array(free, dtype=bool)

    def points(self, intervals: int) -> np.ndarray:
        """Return the collocation points (N s,) as shares of the duration."""
        shares = (np.repeat(np.arange(intervals), len(self.c)) + np.tile(self.c, intervals)) / intervals
        return np.asarray(shares)

    def integrated(self, rates: np.ndarray, duration: float) -> np.ndarray:
        """Return the integrals of rates (K, N s) at the collocation points, from 0 at the start on, and at the end of
        the motion if it is no such point.
        """
        parts = rates.reshape(len(rates), -1, len(self.c))
        h = duration / parts.shape[1]
        whole = np.cumsum(h * parts @ self.b, axis=1)
        begins = whole - h * parts @ self.b
        within = begins[:, :, None] + h * parts @ self.a.T
        return np.column_stack([np.zeros(len(rates)), within.reshape(len(rates), -1), *[whole[:, -1]] * self.has_nodes])

    def guess(self) -> Mesh:
        """Return the first guess: positions on straight lines from a start to an end that satisfy their conditions."""
        system, spec = self.system, self.spec
        start = self._nearest(system.q0, self._initial, 0.0)
        duration = self._duration()
        points = self.points(spec.collocation.intervals)
        q = start[:, None] + (self._nearest(start, self._final, duration[2]) - start)[:, None] * points
        count, m = len(points), len(system.constraint_names)
        z = np.repeat(system.z0[:, None], count, axis=1)
        z[self.fibers.states] = self.fibers.guess(q, system.p0)
        u = [self._start_of(spec.control(name), x) for name, x in zip(system.control_names, system.u0, strict=True)]
        optimized = [(*spec.optimized[name].bounds, spec.optimized[name].start) for name in system.parameter_names]
        p = [self._start_of(limits, x) for limits, x in zip(optimized, system.p0, strict=True)]
        values = {
            "duration": np.array([duration[2]]),
            "p": np.array(p),
            "start": np.concatenate([start, 0.0 * start, z[:, 0]]),
            "q": q,
            "v": 0.0 * q,
            "a": 0.0 * q,
            "lam": np.zeros((m, count)),
            "mu": np.zeros((m, count)),
            "z": z,
            "u": np.repeat(np.array(u)[:, None], count, axis=1),
        }
        return Mesh(spec.collocation.intervals, self._with_nodes(values, spec.collocation.intervals), np.nan, "", 0)

    def refined(self, mesh: Mesh) -> Mesh:
        """Return a guess on a mesh of twice as many intervals, by linear interpolation."""
        before, count = self.points(mesh.intervals), 2 * mesh.intervals
        after, values = self.points(count), dict(mesh.values)
        for name in ("q", "v", "a", "lam", "mu", "z", "u"):
            rows = mesh.values[name]
            values[name] = np.array([np.interp(after, before, row) for row in rows]).reshape(len(rows), len(after))
        return Mesh(count, self._with_nodes(values, count), mesh.objective, "", mesh.iterations)

    def solved(self, guess: Mesh) -> Mesh:
        """Return the optimum on the mesh of a guess."""
        unknowns, conditions, bounds, objective = self._program(guess.intervals)
        options: dict[str, Any] = {
            "print_time": False, "show_eval_warnings": False, "expand": True, "ipopt.print_level": 0, "ipopt.sb": "yes",
            "ipopt.tol": PRECISION, "ipopt.max_iter": MOST_ITERATIONS, "ipopt.bound_relax_factor": 0.0,
        }  # fmt: skip
        given = ca.vertcat(*(ca.vec(x) for x in unknowns.values()))
        values = [objective, ca.vertcat(*(ca.vec(condition.value) for condition in conditions))]
        sizes = np.concatenate([self._size(name, bounds[name]).ravel(order="F") for name in unknowns])
        x = ca.MX.sym("x", *given.shape)
        program = dict(zip("xfg", [x, *ca.Function("program", [given], values)(ca.DM(sizes) * x)], strict=True))
        low, high = (
            np.concatenate(
                [np.broadcast_to(getattr(condition, side), condition.value.numel()) for condition in conditions]
            )
            for side in ("low", "high")
        )
        solver, result = _solution(
            ("prediction", program, options),
            x0=np.concatenate([guess.values[name].ravel(order="F") for name in unknowns]) / sizes,
            lbx=np.concatenate([bounds[name][0].ravel(order="F") for name in unknowns]) / sizes,
            ubx=np.concatenate([bounds[name][1].ravel(order="F") for name in unknowns]) / sizes,
            lbg=low,
            ubg=high,
        )
        solution, found, begin = sizes * np.array(result["x"]).ravel(), {}, 0
        for name in unknowns:
            shape = guess.values[name].shape
            size = int(np.prod(shape))
            found[name] = solution[begin : begin + size].reshape(shape, order="F")
            begin += size
        report, g = solver.stats(), np.array(result["g"]).ravel()
        names = np.repeat(
            [condition.name for condition in conditions], [condition.value.numel() for condition in conditions]
        )
        beyond = np.nan_to_num(np.maximum(np.maximum(low - g, g - high), 0.0), nan=np.inf)
        worst = str(names[np.argmax(beyond)]), float(beyond.max())
        iterations = guess.iterations + report["iter_count"]
        return Mesh(guess.intervals, found, float(result["f"]), report["return_status"], iterations, worst)

    def _stage_function(self) -> ca.Function:
        """Return the function of a collocation point: conditions, q', z', integrands, and path."""
        system, m = self.system, len(self.system.constraint_names)
        mu = ca.SX.sym("mu", m)
        given = list(system.symbols.values())
        position, velocity, _ = system.constraints(*given)
        turn = ca.mtimes(ca.jacobian(position, system.q).T, mu) if m else 0.0
        integrands = [x for kind, x in self.objective.functionals if kind == INTEGRAL]
        zero = ca.vertcat(system.residual(*given), position, velocity, system.equilibrium(*given))
        results = [
            zero, system.v + turn, system.rates(*given), ca.vertcat(ca.SX(0, 1), *integrands),
            ca.vertcat(ca.SX(0, 1), *(condition[1] for condition in self._path)),
        ]  # fmt: skip
        return ca.Function("point", [*given, mu], ca.cse(results))

    def _program(self, count: int) -> tuple[dict[str, ca.MX], list[_Condition], dict[str, Any], ca.MX]:
        """Return unknowns, conditions with their bounds, bounds of unknowns, and the objective, for N = `count`."""
        system, s = self.system, len(self.c)
        total = count * s
        bounds = self._bounds(total, count)
        x = {name: ca.MX.sym(name, *lower.shape) for name, (lower, _) in bounds.items()}
        h = x["duration"] / count
        times = x["duration"] * ca.DM(self.points(count)).T
        point = self._stage.map(total)
        zero, position_rates, rates, integrands, path = point(
            x["q"], x["v"], x["a"], x["lam"], x["z"], x["u"], ca.repmat(x["p"], 1, total), times, x["mu"]
        )
        states, slopes = ca.vertcat(x["q"], x["v"], x["z"]), ca.vertcat(position_rates, x["a"], rates)
        ends = x["nodes"] if self.has_nodes else states[:, s - 1 :: s]
        begins = ca.horzcat(x["start"], ends[:, :-1])
        each = ca.DM.eye(count)
        collocated = states - ca.mtimes(begins, ca.kron(each, ca.DM.ones(1, s)))
        conditions = [
            _Condition("the equations of motion", zero),
            _Condition("the collocation", collocated - h * ca.mtimes(slopes, ca.kron(each, ca.DM(self.a.T)))),
        ]
        if self.has_nodes:
            whole = h * ca.mtimes(slopes, ca.kron(each, ca.DM(self.b)))
            conditions.append(_Condition("the collocation", ends - begins - whole))
        start, end = x["start"], ends[:, -1]
        if len(system.constraint_names):
            rows: Any = ca.vertcat(*system.constraints(*system.symbols.values())[:2])
            closed = self._at_node(rows)
            conditions.append(_Condition("the joints at the start", closed(start, x["p"], 0.0)))
            if self.has_nodes:
                conditions.append(_Condition("the joints at the end", closed(end, x["p"], x["duration"])))
        at_rest = [x for x, k in zip(self.fibers.at_rest, self.fibers.states, strict=True) if not self._is_free[k]]
        if at_rest:
            balance = self._at_node(ca.vertcat(*at_rest))
            conditions.append(_Condition("the equilibrium of fibres at the start", balance(start, x["p"], 0.0)))
        for key, sides, at, t in (
            ("initial", self._initial, start, 0.0), ("final", self._final, end, x["duration"])
        ):  # fmt: skip
            for text, (expression, low, high) in sides.items():
                conditions.append(_Condition(f"{key}: {text}", self._at_node(expression)(at, x["p"], t), low, high))
        for text, (expression, _, _) in self._periodic.items():
            value = self._at_node(expression)
            change = value(end, x["p"], x["duration"]) - value(start, x["p"], 0.0)
            conditions.append(_Condition(f"periodic: {text}", change))
        for k, (name, _, low, high) in enumerate(self._path):
            conditions.append(_Condition(f"subject_to: {name}", path[k, :], low, high))
        integrals = iter(ca.vertsplit(h * ca.mtimes(integrands, ca.DM(np.tile(self.b, count)))))
        functionals = [
            next(integrals) if kind == INTEGRAL else self._at_node(expression)(end, x["p"], x["duration"])
            for kind, expression in self.objective.functionals
        ]
        objective = self.objective.value(ca.vertcat(ca.MX(0, 1), *functionals), x["duration"])
        return x, conditions, bounds, objective

    def _bounds(self, total: int, count: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the bounds of the unknowns."""
        system, spec = self.system, self.spec
        n, m, z = len(system.q0), len(system.constraint_names), len(system.z0)
        shortest, longest, _ = self._duration()
        sizes = {"q": n, "v": n, "a": n, "lam": m, "mu": m, "z": z}
        free = {name: np.full((size, total), np.inf) for name, size in sizes.items()}
        is_free = self._is_free.copy()
        is_free[self.fibers.states] = True
        start = np.concatenate([np.full(2 * n, np.inf), np.where(is_free, np.inf, 0.0)])
        at = np.concatenate([np.zeros(2 * n), np.where(is_free, 0.0, system.z0)])
        bounds = {
            "duration": (np.array([shortest]), np.array([longest])),
            "p": tuple(np.array([spec.optimized[name].bounds for name in system.parameter_names]).reshape(-1, 2).T),
            "start": (at - start, at + start),
            **{name: (-limit, limit) for name, limit in free.items()},
            "u": tuple(
                np.repeat(side[:, None], total, axis=1)
                for side in np.array([spec.control(name)[:2] for name in system.control_names]).reshape(-1, 2).T
            ),
        }
        for name, i, low, high in self._limits:
            bounds[name][0][i], bounds[name][1][i] = low, high
            row = i + {"q": 0, "v": n, "z": 2 * n}[name]
            if start[row]:  # not fixed
                bounds["start"][0][row], bounds["start"][1][row] = low, high
        if self.has_nodes:
            bounds["nodes"] = (np.full((2 * n + z, count), -np.inf), np.full((2 * n + z, count), np.inf))
        return bounds

    def _size(self, name: str, bounds: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Return the natural sizes of unknowns, by which they are divided for the optimizer.

        It regularizes indefinite problems by absolute numbers; without sizes, a squat takes 395 iterations, not 24.
        Sizes of controls and parameters are their largest bounds, that of multipliers is the weight of all bodies.
        """
        low, high = bounds
        sizes = np.ones(low.shape)
        if name in ("u", "p"):
            largest = np.maximum(abs(low), abs(high))
            return np.where(np.isfinite(largest) & (largest > 0.0), largest, sizes)
        if name == "lam":
            mechanism = self.spec.mechanism()
            weight = sum(body.mass for body in mechanism.bodies.values()) * float(np.hypot(*mechanism.gravity))
            return sizes * (weight or 1.0)
        return sizes

    def _duration(self) -> tuple[float, float, float]:
        """Return the bounds of the duration, and its first guess [s]."""
        given = self.spec.duration
        if isinstance(given, Duration):
            least, most = given.bounds
            return least, most, 0.5 * (least + most) if given.start is None else given.start
        return given, given, given

    @staticmethod
    def _start_of(limits: tuple[float, float, float | None], present: float) -> float:
        low, high, start = limits
        return float(np.clip(present if start is None else start, low, high))

    def _with_nodes(self, values: dict[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
        if self.has_nodes:
            states = np.vstack([values[name] for name in "qvz"])
            values["nodes"] = states[:, len(self.c) - 1 :: len(self.c)].copy()
        return values

    def _expression(self, text: str, key: str) -> ca.SX:
        try:
            return self.system.expression(self.spec.with_states(text))
        except SpecError as error:
            raise SpecError(error.message, key=key) from None

    def _conditions(self, key: str, bounds: Mapping[str, tuple[float, float]]) -> dict[str, tuple[ca.SX, float, float]]:
        """Return conditions on the state at the start or at the end."""
        conditions = {}
        for text, (low, high) in bounds.items():
            expression = self._expression(text, key)
            self._check_at_node(expression, text, key)
            conditions[text] = expression, low, high
        return conditions

    def _check_at_node(self, expression: ca.SX, text: str, key: str) -> None:
        unknown = [self.system.symbols[name] for name in OF_STATE]
        if any(x.numel() and ca.depends_on(expression, x) for x in unknown):
            raise SpecError(
                f"'{text}' depends on accelerations, reactions or controls, which are not known at the start and the "
                "end of the motion; use positions, velocities and states",
                key=key,
            )

    def _at_node(self, expression: ca.SX) -> ca.Function:
        """Return an expression as a function of the state (2 n + Z,), the parameters and the time."""
        system = self.system
        state = ca.vertcat(system.q, system.v, system.z)
        unknown = {name: ca.SX.zeros(*system.symbols[name].shape) for name in OF_STATE}
        plain = ca.substitute([expression], [system.symbols[name] for name in unknown], list(unknown.values()))
        return ca.Function("node", [state, system.p, system.t], plain)

    def _nearest(self, q: np.ndarray, conditions: Mapping[str, tuple[ca.SX, float, float]], t: float) -> np.ndarray:
        """Return the positions nearest to `q` that satisfy the constraints, and conditions that are of positions only.

        Returns `q` if there are none.
        """
        system = self.system
        others = [system.symbols[name] for name in ("v", "z") if system.symbols[name].numel()]
        wanted = [
            condition for condition in conditions.values() if not any(ca.depends_on(condition[0], x) for x in others)
        ]
        rows: Any = ca.vertcat(system.constraints(*system.symbols.values())[0], *(condition[0] for condition in wanted))
        fixed: Any = [*(x for name, x in system.symbols.items() if name not in ("q", "p", "t")), system.p, system.t]
        values: Any = [*(ca.DM.zeros(*x.shape) for x in fixed[:-2]), system.p0, t]
        closed = ca.substitute([rows], fixed, [ca.DM(value) for value in values])[0]
        m = len(system.constraint_names)
        problem: Any = {"x": system.q, "f": ca.sumsqr(system.q - q), "g": closed}
        options: Any = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
        _, pose = _solution(
            ("pose", problem, options),
            x0=q,
            lbg=[0.0] * m + [condition[1] for condition in wanted],
            ubg=[0.0] * m + [condition[2] for condition in wanted],
        )
        return np.array(pose["x"]).ravel()


def _elements(vector: ca.SX) -> list[ca.SX]:
    return ca.vertsplit(vector) if vector.numel() else []


def _solution(problem: tuple[str, Any, Any], **given: Any) -> tuple[ca.Function, Any]:
    """Return the optimizer of a problem (name, functions, options), and its solution.

    CasADi prints warnings, for instance about more conditions than unknowns, whose sense is in its status, and takes an
    interrupt by the user for a failure of the optimizer.
    """
    name, functions, options = problem
    with redirect_stderr(io.StringIO()):
        solver = ca.nlpsol(name, "ipopt", functions, options)
        solution = solver(**given)
    if solver.stats()["return_status"] in INTERRUPTED:
        raise KeyboardInterrupt
    return solver, solution


def statuses() -> Mapping[str, tuple[str, str]]:
    """Return code and sentence for each report of the optimizer that is no success."""
    infeasible = "infeasible", "no motion was found that satisfies all conditions"
    return {
        "Infeasible_Problem_Detected": infeasible,
        "Restoration_Failed": infeasible,
        "Not_Enough_Degrees_Of_Freedom": ("infeasible", "there are more conditions than unknowns"),
        "Maximum_Iterations_Exceeded": ("iteration-limit", f"no optimum was found in {MOST_ITERATIONS} iterations"),
        "Diverging_Iterates": ("unbounded", "unknowns grow without limit; give bounds to what is free"),
    }


INTERRUPTED = ("NonIpopt_Exception_Thrown", "User_Requested_Stop")
"""Reports of the optimizer if the user interrupts it."""

SUCCESSES = ("Solve_Succeeded", "Solved_To_Acceptable_Level")
