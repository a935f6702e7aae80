"""SciPy's adaptive solvers, applied to the first-order form y = (q, v) of the index-1 equations.

If loads, drivers or dampers are present, work and dissipated energy [J] are two additional components of y, so that
they are integrated with the weights of the method. First-order states z follow. Solvers that use a Jacobian get the
exact Jacobian of the accelerations; with first-order states, they estimate it by differences. Events are located on the
solvers' dense output, whose order can be lower than that of the steps.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.counters import Counters
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.kernels.observe import baumgarte_at, first_order_rates, note_all, tangents_at
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.kernels.vectors import BEYOND
from mbdkit.engine.singularity import describe_nearness
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.impulse import DriverImpulse, impulse
from mbdkit.integrators.interface import (
    SAME_TIME,
    STRETCH,
    Failure,
    KeptNodes,
    Moment,
    Nodes,
    StepEvidence,
    StepTaken,
    Stretch,
    Timetable,
)
from mbdkit.integrators.sampled_control import Sampler, states_at_start
from mbdkit.integrators.splitting import Change, margin_of_stops
from mbdkit.integrators.step_control import unit_of_length
from mbdkit.integrators.step_watch import StepWatch

if TYPE_CHECKING:
    from mbdkit.methods.kinds import SciPySolver

_RADAU_FIRST_NODE = (4 - 6**0.5) / 10

Row = tuple[float, np.ndarray, np.ndarray, float]
"""A state to be recorded: time [s], y, statistics of the interval since the last row (6,), and the largest Baumgarte
term in this interval.
"""


class _StoppedError(Exception):
    """The right-hand side cannot be evaluated, for the reason in `failure`."""

    def __init__(self, failure: Failure):
        super().__init__(failure.sentence)
        self.failure = failure


class SciPyStepper:
    """Integrates with an `OdeSolver` of SciPy over a timetable; implements `mbdkit.integrators.interface.Stepper`."""

    def __init__(self, method: SciPySolver, workspace: Workspace, timetable: Timetable):
        import scipy.integrate

        self.workspace, self.timetable = workspace, timetable
        self.counters = Counters()
        self.finished = False
        self.failure: Failure | None = None
        self.time = timetable.start
        pairs = len(workspace.mechanism.topology.pairs)
        self.worst_pairs = np.zeros(pairs)
        self.has_power = workspace.mechanism.has_power
        self.n3 = 3 * len(workspace.mechanism.bodies)
        self._acc = np.zeros((3, workspace.mechanism.size))
        self._lam = np.zeros((pairs, 2))
        self._times: list[float] = []
        self._finite = True
        self._first_z = 2 * self.n3 + 2 * self.has_power
        z0 = states_at_start(workspace)
        y0 = np.concatenate([workspace.q0[: self.n3], workspace.v0[: self.n3], np.zeros(2 * self.has_power), z0])
        self.sampler = Sampler(workspace)
        self.sampler.passed(workspace.t0, workspace.q0, workspace.v0, workspace.mechanism.initial_states)
        solver = getattr(scipy.integrate, method.solver) if isinstance(method.solver, str) else method.solver
        options: dict[str, Any] = {"rtol": method.rtol, "atol": self._absolute(method)}
        if method.max_step is not None:
            options["max_step"] = method.max_step
        if method.needs_jacobian and not len(z0):
            options["jac"] = self.jacobian
        if timetable.step is not None:
            options["first_step"] = min(timetable.step, timetable.end - timetable.start)
        self._new_solver, self._options = solver, options
        self._passed = 0  # number of stops passed
        self._stopped = False
        self.impacts: list[DriverImpulse] = []
        self._watch = StepWatch(workspace, timetable.guards, self.worst_pairs, "tighter tolerances may help")
        self.solver: Any = None
        self.y = y0
        workspace.clamp_motions(*timetable.sides(0))
        self._start_solver(timetable.start)
        self._since = np.zeros(6)  # since the last row: steps, -, last size, iterations, most iterations, rejected
        self._stabilized = workspace.stabilization.kind == "baumgarte"
        self._pull = 0.0  # largest Baumgarte term since the last row
        self._next = 1
        self.last_step: StepTaken | None = None
        self._dense: Any = None
        self._y0 = y0
        self._row_times: list[float] = []
        self._effort_so_far, self._row_before = self._since.copy(), 1
        self._nodes = KeptNodes(workspace.mechanism.size, workspace.scratch.sides)

    @property
    def evidence(self) -> StepEvidence:
        """See `Advancing.evidence`."""
        return self._watch.evidence(self.impacts)

    def _absolute(self, method: SciPySolver) -> Any:
        """Return the absolute tolerance: a number, or one for each component of y; see `unit_of_length`."""
        length = unit_of_length(method.by_size, self.workspace.mechanism)
        if length == 1.0:
            return method.atol
        bodies = np.tile([length, length, 1.0], 2 * self.n3 // 3)
        states = np.ones(len(self.workspace.mechanism.states))
        return method.atol * np.concatenate([bodies, np.full(2 * self.has_power, length * length), states])

    def _start_solver(self, t: float) -> None:
        """Start the solver from `t` to the next stop, or to the end."""
        table = self.timetable
        end = table.stops[self._passed] if self._passed < len(table.stops) else table.end
        if "first_step" in self._options:
            self._options["first_step"] = min(self._options["first_step"], end - t)
        self._finite = True
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                self.solver = self._new_solver(self.rates, t, self.y, end, **self._options)
        except _StoppedError as stop:
            self.failure = stop.failure
        except (ValueError, np.linalg.LinAlgError):
            if self._finite:
                raise
        if not self._finite:  # with rates that are not finite, some solvers choose NaN as the first step and never end
            self.failure = self._overflow(t)
        self._options.pop("first_step", None)  # `first_step` applies at the start of the run only

    def _restart(self) -> bool:
        """Restart the solver after a stop, and apply the impulse if there is one; return whether that succeeded."""
        table = self.timetable
        stop = table.stops[self._passed]
        self.workspace.clamp_motions(*table.sides(self._passed + 1))
        if stop in table.impacts:
            try:
                impact, v = impulse(self.workspace, stop, *self._state(self.y), stop)
            except StepError as error:
                self.failure = Failure(error.code, f"{error} at the impulse of a driver at t = {stop:.6g} s.")
                return False
            self.impacts.append(impact)
            self._watch.forget_energy()
            self.y = self.y.copy()
            self.y[self.n3 : 2 * self.n3] = v[: self.n3]
            if self.has_power:
                self.y[2 * self.n3] += impact.energy
        if stop in table.samples:
            self.y = self.y.copy()
            self.y[self._first_z :] = self.sampler.passed(stop, *self._state(self.y), self.y[self._first_z :])
        self._passed += 1
        self._stopped = False
        self._start_solver(stop)
        return self.failure is None

    def rates(self, t: float, y: np.ndarray) -> np.ndarray:
        """Return dy/dt, nan if it is not finite; raises `_StoppedError` if the mechanism is singular."""
        self.counters.rhs_evaluations += 1
        self.counters.factorizations += 1
        self._times.append(t)
        without = slice(2 * self.n3, 2 * self.n3 + 2)
        full = np.ascontiguousarray(y if self.has_power else np.insert(y, without.start, [0.0, 0.0]))
        out = np.empty(len(full))

        def solve() -> int:
            return int(first_order_rates(self._engine, self.has_power, float(t), full, self._acc, self._lam, out))

        if not self._is_solved(t, y, solve):
            out[:] = np.nan
        self._finite = self._finite and bool(np.all(np.isfinite(out)))
        return out if self.has_power else np.delete(out, without)

    @property
    def _engine(self) -> int:
        """Address of the mechanism with the current solver; it changes when new pivots are chosen."""
        return self.workspace.stepping_engine

    def _is_solved(self, t: float, y: np.ndarray, solve: Callable[[], int]) -> bool:
        """Solve the index-1 system at a state; return whether its numbers are finite.

        Raises
        ------
        _StoppedError
            If the system is singular.
        """
        workspace = self.workspace
        try:
            status = workspace.retry_with_new_pivots(solve)
            if status != OK and workspace.is_finite(tangents=False):
                raise SingularSystemError(workspace.failed_unknown)
        except SingularSystemError as error:
            name = workspace.mechanism.unknown_name(error.index)
            where = f"the system of equations is singular at {name} at t = {t:.6g} s"
            raise _StoppedError(Failure("singular", f"{where}{self._nearness(t, y)}.")) from None
        return status == OK

    def jacobian(self, t: float, y: np.ndarray) -> np.ndarray:
        """Return the Jacobian of `rates` with respect to y, exact in q and v; the rows and columns of the two energies
        are zero.
        """
        self.counters.jacobian_evaluations += 1
        n3, workspace = self.n3, self.workspace
        q, v = self._state(y)
        if not self._is_solved(t, y, lambda: tangents_at(self._engine, float(t), q, v, self._acc[2], self._lam)):
            self._finite = False
            return np.full((len(y), len(y)), np.nan)
        self.counters.factorizations += 2  # the solution above, and the matrix of all its derivatives below
        n, terms = workspace.unknowns, workspace.terms
        values = workspace.scratch.source[terms.source]
        sign = np.array([1.0, 1.0, -1.0, 1.0])[terms.factor]
        parts = np.zeros((3, n, n))  # KKT matrix; derivatives of the residual with respect to v and to q
        np.add.at(parts, (np.array([0, 1, 1, 2])[terms.factor], terms.row, terms.column), sign * values)
        right = -np.concatenate([parts[2][:, :n3], parts[1][:, :n3]], axis=1)
        out = np.zeros((len(y), len(y)))
        out[:n3, n3 : 2 * n3] = np.eye(n3)
        out[n3 : 2 * n3, : 2 * n3] = np.linalg.solve(parts[0], right)[:n3]
        self._finite = self._finite and bool(np.all(np.isfinite(out)))
        return out

    def advance(self) -> Stretch:
        """See `Stepper.advance`."""
        rows: list[Row] = []
        until = time.perf_counter() + STRETCH
        table = self.timetable
        self.last_step = None
        while self.failure is None and not self.finished and time.perf_counter() < until:
            if self.counters.steps >= table.max_steps:
                self.failure = Failure("max-steps", f"stopped after limits.max_steps = {table.max_steps} steps.")
                break
            if self._stopped and not self._restart():
                break
            t0, y0 = self.time, self.y
            if not self._step():
                break
            dense = self._dense_output(t0, y0) if table.nodes else None
            if dense is not None:
                self._keep_nodes(t0, self.time, dense)
            if not table.single:
                rows += self._due()
                continue
            z = y0[self._first_z :], self.y[self._first_z :]
            self.last_step = StepTaken(t0, self.time, *self._state(y0), *self._state(self.y), *z)
            self._dense, self._y0, self._effort_so_far = dense, y0, self._since.copy()
            self._row_before = self._next
            rows = self._due()
            self._row_times = [row[0] for row in rows]
            break
        return self._stretch(rows)

    def inside(self, theta: float) -> Moment:
        """See `Stepper.inside`."""
        y = self._interpolated(theta)
        return *self._state(y), y[self._first_z :]

    within = inside
    """SciPy's solvers cannot repeat a step with another size, so dense output is used."""

    def cut(self, theta: float) -> Stretch:
        """See `Stepper.cut`."""
        assert self.last_step is not None
        if self.timetable.nodes:
            self._nodes.drop_last()
            if theta > 0.0:
                self._keep_nodes(self.last_step.t0, self.last_step.time(theta), self._dense)
        self.y, self.time = self._interpolated(theta), self.last_step.time(theta)
        if theta > 0.0 and not any(t < self.time for t in self._row_times):
            self._since = self._effort_so_far
            self._since[2] = self.time - self.last_step.t0
        self.finished, self.failure = True, None
        return self.last_state()

    def split(self, theta: float, change: Change) -> tuple[Stretch, list[StepTaken]]:
        """See `mbdkit.integrators.splitting.Splitting.split`. The new end of the step is taken from dense output."""
        step = self.last_step
        assert step is not None
        t, close = step.time(theta), SAME_TIME * margin_of_stops(self.timetable)
        if t - step.t0 <= close:
            t, y = step.t0, self._y0
        elif step.t1 - t <= close:
            t, y = step.t1, self.y
        else:
            y = self._interpolated(theta)
        if self._dense is None:
            self._dense = self._dense_output(step.t0, self._y0)
        if t < step.t1:
            self.finished = self._stopped = False
        if self.timetable.nodes:
            self._nodes.drop_last()
            if t > step.t0:
                self._keep_nodes(step.t0, t, self._dense)
        self.y, self.time, self._next, self._since = y.copy(), t, self._row_before, self._effort_so_far.copy()
        rows = self._due() if t > step.t0 else []
        end = *self._state(y), y[self._first_z :].copy()
        taken = [replace(step, t1=t, q1=end[0], v1=end[1], z1=end[2])] if t > step.t0 else []
        self.last_step = taken[0] if taken else None
        if not self.finished:
            self.y[self._first_z :] = change(t, end)
            self._watch.forget_energy()
            if not self._stopped:
                self._start_solver(t)
        return self._stretch(rows), taken

    def _interpolated(self, theta: float) -> np.ndarray:
        """Return y at the fraction `theta` of the last step, by dense output or the cubic through both ends."""
        step = self.last_step
        assert step is not None
        if theta in (0.0, 1.0):
            return self.y if theta else self._y0
        if self._dense is None:
            self._dense = self._dense_output(step.t0, self._y0)
        return np.asarray(self._dense(step.time(theta)))

    def _dense_output(self, t0: float, y0: np.ndarray) -> Callable[[float], np.ndarray]:
        """Return y as a function of time in the last step, from `y0`, by dense output or the cubic through its ends."""
        try:
            dense: Callable[[float], np.ndarray] = self.solver.dense_output()
        except (NotImplementedError, _StoppedError):
            # Some solvers have no dense output, and the additional stages that DOP853 needs for it may be at a singular
            # position.
            step, y1 = StepTaken(t0, self.time, *self._state(y0), *self._state(self.y)), self.y

            def dense(t: float) -> np.ndarray:
                theta = (t - step.t0) / (step.t1 - step.t0)
                q, v = step.hermite(theta)
                energies = y0[2 * self.n3 :] + theta * (y1 - y0)[2 * self.n3 :]
                return np.concatenate([q[: self.n3], v[: self.n3], energies])

        return dense

    def _keep_nodes(self, t0: float, t1: float, dense: Callable[[float], np.ndarray]) -> None:
        """Store quadrature nodes of integrals from `t0` to `t1` in the last step."""
        self._nodes.keep(t0, t1, lambda theta: self._state(dense(t0 + theta * (t1 - t0))))

    def taken_nodes(self) -> Nodes:
        """See `Stepper.taken_nodes`."""
        return self._nodes.taken()

    def _state(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return with_ground(y[: self.n3]), with_ground(y[self.n3 : 2 * self.n3])

    def _step(self) -> bool:
        """Take one step of the solver; return whether it succeeded."""
        solver, before = self.solver, self.solver.t
        self._times.clear()
        self._finite = True
        self.workspace.scratch.faulty[0] = -1  # a message should name only a force law that fails in this step
        lu = solver.nlu
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                message = solver.step()
        except _StoppedError as stop:
            self.failure = stop.failure
            return False
        except (ValueError, np.linalg.LinAlgError):
            if self._finite:
                raise
            self.failure = self._overflow(before)  # SciPy's linear algebra raises this for numbers that are not finite
            return False
        self.counters.factorizations += solver.nlu - lu
        if solver.status == "failed":
            if not self._finite:
                self.failure = self._overflow(before)
            else:
                where = f"at t = {before:.6g} s: {message}".rstrip(".")
                self.failure = Failure("step-too-small", f"{where}{self._nearness(before, self.y)}.")
            return False
        if solver.t == before:  # LSODA would otherwise continue forever with steps below the round-off of the time
            where = f"at t = {before:.6g} s: the step is below the rounding error of the time"
            self.failure = Failure("step-too-small", f"{where}{self._nearness(before, self.y)}.")
            return False
        if not np.all(np.abs(solver.y) < BEYOND):
            self.failure = self._overflow(before)
            return False
        iterations, attempts = self._effort(before)
        self.counters.steps += 1
        self.counters.accepted += 1
        self.counters.rejected += attempts - 1
        self.counters.newton_iterations += iterations
        self._since += (1, 0, 0, iterations, 0, attempts - 1)
        self._since[2] = solver.t - before
        self._since[4] = max(self._since[4], iterations)
        old = self.y
        self.time, self.y = float(solver.t), solver.y.copy()
        self._stopped = solver.status == "finished" and self._passed < len(self.timetable.stops)
        self.finished = solver.status == "finished" and not self._stopped
        if self._stopped:  # a row at a stop shows the left-hand limit
            self.time = self.timetable.sides(self._passed)[1]
        if self.finished:
            self.time = self.timetable.end
        note_all(self.workspace.engine, np.array([self.time]), self._state(self.y)[0][None], self.worst_pairs)
        if self._stabilized:
            self._pull = max(self._pull, baumgarte_at(self._engine, self.time, *self._state(self.y)))
        self.failure = self._watched(before, old)
        return True

    def _watched(self, begin: float, old: np.ndarray) -> Failure | None:
        """Apply the guards to the step from time `begin` and state `old`; return why the run has to stop, or None."""
        n3, y = self.n3, self.y
        energies = slice(2 * n3, 2 * n3 + 2)
        gain = y[energies] - old[energies] if self.has_power else np.zeros(2)
        return self._watch.step((begin, self.time), old[:n3], old[n3 : 2 * n3], y[:n3], y[n3 : 2 * n3], gain)

    def _nearness(self, t: float, y: np.ndarray) -> str:
        """Return a clause stating that a state is nearly singular; empty if it is not."""
        near = describe_nearness(self.workspace, t, self._state(y)[0])
        return near and f"; {near}"

    def _overflow(self, t: float) -> Failure:
        if unusable := self.workspace.unusable():
            return Failure(self.workspace.cause, f"{unusable} after t = {t:.6g} s.")
        return Failure("not-finite", f"numbers overflowed after t = {t:.6g} s; tighter tolerances may help.")

    def _effort(self, t: float) -> tuple[int, int]:
        """Return the numbers of Newton iterations and attempts in the last step, from the times of its evaluations."""
        times = self._times
        stages = getattr(self.solver, "n_stages", None)
        if stages:
            return 0, max(1, round(len(times) / stages))
        if type(self.solver).__name__ == "Radau":
            sizes: list[float] = []
            i = 0
            while i + 2 < len(times):
                h = times[i + 2] - t
                if h > 0 and abs(times[i] - t - _RADAU_FIRST_NODE * h) < 1e-6 * h:
                    sizes.append(h)
                    i += 3
                else:
                    i += 1
            return len(sizes), max(1, len(set(sizes)))
        return 0, max(1, len({x for x in times if x != t}))

    def _due(self) -> list[Row]:
        """Return the rows to be recorded after the last step."""
        rows: list[Row] = []
        table = self.timetable
        if table.interval is None:
            if self.counters.steps % table.every == 0 or self.finished:
                rows.append(self._row(self.time, self.y))
            return rows
        dense = None
        begins_at_impact = self._passed > 0 and table.stops[self._passed - 1] in table.impacts
        # A row at a stop with an impact shows the right-hand limit.
        earliest = table.sides(self._passed)[0] if begins_at_impact else -math.inf
        inner = math.ceil((table.end - table.start) / table.interval - 1e-9)  # the end is always recorded
        while self._next < inner and (at := table.start + self._next * table.interval) <= self.time:
            if dense is None:
                dense = self.solver.dense_output()
            shown = max(at, earliest)
            rows.append(self._row(shown, np.asarray(dense(shown))))
            self._next += 1
        if self.finished:
            rows.append(self._row(self.time, self.y))
        return rows

    def _row(self, t: float, y: np.ndarray) -> Row:
        row = t, y, np.array([t, *self._since[[0, 2, 3, 4, 5]]]), self._pull
        self._since[:], self._pull = 0.0, 0.0
        return row

    def _stretch(self, rows: list[Row]) -> Stretch:
        n3, count = self.n3, len(rows)
        q, v = np.zeros((2, count, self.workspace.mechanism.size))
        work, lost = np.zeros((2, count))
        for i, (_, y, _, _) in enumerate(rows):
            q[i, :n3], v[i, :n3] = y[:n3], y[n3 : 2 * n3]
            if self.has_power:
                work[i], lost[i] = y[2 * n3 : self._first_z]
        intervals = np.array([effort for _, _, effort, _ in rows]).reshape(-1, 6)
        pulls = np.array([(0.0, 0.0, 0.0, pull) for *_, pull in rows]).reshape(-1, 4)
        times = np.array([t for t, *_ in rows])
        z = np.array([y[self._first_z :] for _, y, *_ in rows]).reshape(count, len(self.y) - self._first_z)
        return Stretch(times, q, v, work, lost, intervals, corrections=pulls if self._stabilized else None, z=z)

    def last_state(self) -> Stretch:
        """See `Stepper.last_state`."""
        return self._stretch([self._row(self.time, self.y)])
