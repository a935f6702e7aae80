"""A stepper that advances a run together with the derivatives of its states with respect to parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from mbdkit.base.errors import RunError, StepError
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.force_laws import law_for_duals
from mbdkit.engine.kernels.bundle_types import STATE, kept
from mbdkit.engine.kernels.dual_observe import DualStates, describe_duals, observe_duals
from mbdkit.engine.kernels.dual_system import new_dual_solver
from mbdkit.engine.kernels.system import DIVERGED, NOT_FINITE, OK
from mbdkit.engine.kernels.table_rows import LAW_ROW
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.native.number_arrays import Duals
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.duals.differentiated_laws import DifferentiatedLaws, DifferentiatedSampler
from mbdkit.integrators.duals.dual_loop import drive_explicit_duals
from mbdkit.integrators.duals.dual_run import DualRun, Seeds, constants, dual_states, new_dual_run
from mbdkit.integrators.interface import Moment, StepTaken, Timetable
from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.integrators.loop.steps_to_switches import AT_ZERO, ROUNDINGS
from mbdkit.integrators.loop.switches import switch_bundle, switching_functions, switching_laws
from mbdkit.integrators.run.run_state import PROJECTIONS
from mbdkit.integrators.run.step_control import Control
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit.integrators.stages.explicit import CompiledExplicit

#: Reasons why the derivatives of a step are unknown, by status of the kernel.
_CAUSES = {DIVERGED: "the iteration for the derivatives does not converge", NOT_FINITE: "a number overflows"}

#: Fields of `DualRun` that store stages as quadrature nodes of time integrals.
NODES = ("node_time", "node_weight", "node_q", "node_v")

ANY_ERROR = 1e30  #: Factor applied to the error tolerances, so large that every step is accepted.

#: Distances of ends of steps before and after a time at which a force switches, as shares of the shorter step beside.
#:
#: Stages of explicit methods, whose errors are of a low order, stay on one side in steps that approach it gradually.
BEFORE_SWITCH, AFTER_SWITCH = (3e-2, 1e-3, 1e-9), 1e-9
#: Share of a step of given size that counts as round-off of its end.
ROUNDED = 1e-6


def dual_laws(workspace: Workspace) -> np.ndarray:
    """Return the laws of a mechanism compiled for dual numbers, in the form of ``Topology.laws``.

    Raises
    ------
    mbdkit.base.errors.PluginError
        If a law cannot be compiled for dual numbers.
    """
    laws = workspace.mechanism.topology.laws.copy()
    for row, (name, law) in enumerate(workspace.mechanism.laws):
        for_duals = law_for_duals(law, name)
        laws[row, LAW_ROW.address], laws[row, LAW_ROW.program] = for_duals.address, for_duals.program
    return laws


def _states(rows: Any) -> tuple[np.ndarray, ...]:
    """Return times (T,) and states of rows, without their derivatives."""
    z = np.zeros((len(rows.time), 0)) if rows.z is None else rows.z
    return (rows.time, *(np.asarray(x) if x.ndim == 2 else np.asarray(x)[..., 0] for x in (rows.q, rows.v, z)))


class GivenDuals:
    """States whose motion and multipliers are given, with the derivatives of all that follows from them.

    `seeds`: derivatives of the mechanism with respect to parameters.
    """

    def __init__(self, workspace: Workspace, seeds: Seeds):
        self._workspace = workspace
        self._run: DualRun = new_dual_run(workspace, seeds, dual_laws(workspace), 0, 0)

    def states(
        self,
        time: np.ndarray,
        motion: Iterable[tuple[np.ndarray, np.ndarray]],
        multipliers: tuple[np.ndarray, np.ndarray | None],
    ) -> DualStates:
        """Return the states at T times.

        `motion`: positions, velocities and accelerations (T, 3 (B + 1)), each with its derivatives (T, 3 (B + 1), K).
        `multipliers`: those of all rows (T, P, 2), and their derivatives (T, P, 2, K), None for zero.
        """
        q, v, a = (constants(*one) for one in motion)
        states = dual_states(self._run, self._workspace, time, q, v)
        states.observed.acc[...], states.observed.lam[...] = a, constants(*multipliers)
        pinned = PinnedBundle(states)
        describe_duals(pinned.address)
        return states


class DifferentiatedSteps:
    """The derivatives of the steps of a compiled method, one step at a time.

    Parameters
    ----------
    method
        The method of the run.
    workspace
        The mechanism and its start.
    seeds
        Derivatives of mechanism and start with respect to parameters.
    rows, nodes
        Initial sizes of the buffers: numbers of recorded states after the start, and of stored stages.

    Attributes
    ----------
    laws
        The laws of first-order states and controllers.
    """

    def __init__(self, method: CompiledMethod, workspace: Workspace, seeds: Seeds, rows: int, nodes: int):
        self.method, self.workspace = method, workspace
        self.run: DualRun = new_dual_run(workspace, seeds, dual_laws(workspace), rows, nodes)
        self._pinned = PinnedBundle(self.run)
        self.laws = DifferentiatedLaws(workspace.mechanism, np.asarray(self.run.w.law_values))
        self._row_z: list[np.ndarray] = []
        self._solver = workspace.solver
        assert method.duals is not None
        self._duals = method.duals()(method)

    def step(self, run_state: int, step: tuple[float, float], row: int, *, projected: bool) -> None:
        """Differentiate a step that the run has taken, and record the state at its end.

        Parameters
        ----------
        run_state
            Address of the state of the run.
        step
            Start and size of the step [s].
        row
            Index at which the state at the end is recorded; -1 if it is not recorded.
        projected
            Whether the run has projected the state at the end onto the constraints.

        Raises
        ------
        StepError
            If the derivatives of the step cannot be computed.
        """
        t, _ = step
        self.take_up_solver()
        self._make_room(row)
        self.run.projected[0] = projected
        status = self._duals.step(self._pinned.address, run_state, step, row)
        if status != OK:
            raise self._failed(status, t)
        if row >= 0:
            del self._row_z[row:]
            self._row_z.append(np.array(self.run.z))

    @property
    def can_drive(self) -> bool:
        """Whether `drive` can take the steps."""
        return isinstance(self.method, CompiledExplicit) and not len(self.run.z) and not self.run.nodes[0]

    def drive(self, stepper: CompiledStepper, plan: PinnedBundle, budget: int, recorded: int) -> tuple[int, int]:
        """Let a run attempt up to `budget` fixed steps of a plan in compiled code, and differentiate each of them.

        `recorded` is the number of states that have been recorded. Returns the status and the number of rows written.

        Raises
        ------
        StepError
            If the derivatives of a step cannot be computed.
        """
        self.take_up_solver()
        c, method = stepper.run_state, stepper.method
        rows = int(c.first_row[0])
        self._make_room(recorded + len(c.row_time) - rows)
        status, after, failed = drive_explicit_duals(
            stepper.pinned_state.address, method.pinned.address, method.attempt.address, plan.address, budget,
            self._pinned.address, self._duals.pinned.address, recorded,
        )  # fmt: skip
        if failed != OK:
            raise self._failed(int(failed), float(c.progress.tried_begin[0]))
        self._row_z += [np.array(self.run.z)] * (int(after) - rows)
        return int(status), int(after) - rows

    @staticmethod
    def _failed(status: int, t: float) -> StepError:
        why = _CAUSES.get(status, "the system of its equations is singular")
        return StepError(
            "newton-failed",
            f"the step from t = {t:.6g} s cannot be differentiated with respect to parameters: {why}; "
            "a smaller time.step may help",
        )

    def take_up_solver(self) -> None:
        """Use the current solver of the workspace in further steps."""
        if self.workspace.solver is self._solver:
            return
        self._solver = self.workspace.solver
        numbers = self.run.solver.numbers._replace(solver=self._solver)
        self._renew(solver=new_dual_solver(numbers, self.run.solver.row_index))

    def _renew(self, **fields: Any) -> None:
        self.run = self.run._replace(**fields)
        self._pinned.replace(self.run)

    def _make_room(self, row: int) -> None:
        """Enlarge the buffers of recorded states and of nodes if the next step needs that."""
        run = self.run
        if row >= len(run.row_q):
            self._enlarge(("row_q", "row_v", "row_energy"), row + 1)
        used = int(run.nodes[1])
        if run.nodes[0] and used + self._duals.stages > len(run.node_time):
            self._enlarge(NODES, used + self._duals.stages)

    def _enlarge(self, names: tuple[str, ...], rows: int) -> None:
        self._renew(**{name: _enlarged(getattr(self.run, name), rows) for name in names})

    @property
    def memory(self) -> tuple[np.ndarray, ...]:
        """Arrays of the previous step that the next step reads."""
        return (*kept(self.run, STATE).values(), *kept(self._duals.pinned.bundle, STATE).values())

    @contextmanager
    def last_nodes_kept(self) -> Iterator[None]:
        """Context in which a step may be repeated: the quadrature nodes of the last step, which the repetition
        overwrites, are restored on exit.
        """
        end = int(self.run.nodes[1])
        some = slice(max(0, end - self._duals.stages), end)
        before = [np.copy(getattr(self.run, name)[some]) for name in NODES]
        yield
        for name, values in zip(NODES, before, strict=True):
            getattr(self.run, name)[some] = values

    def use_states(self, z: np.ndarray) -> None:
        """Use first-order states (Z, 1 + K) with their derivatives in later evaluations."""
        state, place = self.workspace.mechanism.topology.state_places.T
        np.asarray(self.run.w.law_values)[place] = z[state]

    def observe(self, time: np.ndarray, q: np.ndarray, v: np.ndarray) -> DualStates:
        """Return the states at T times, with accelerations, reactions, forces, energies and powers.

        `q`, `v`: (T, 3 (B + 1), 1 + K) positions and velocities with their derivatives. Raises RunError if the
        accelerations of a state are not unique.
        """
        states = dual_states(self.run, self.workspace, time, q.view(Duals), v.view(Duals))
        done = 0
        renewed = -1
        while done < len(time):
            part = slice(done, None)
            rest = states._replace(
                solver=self.run.solver, time=states.time[part], q=states.q[part], v=states.v[part],
                observed=states.observed.rows(part), power=states.power[part],
            )  # fmt: skip
            pinned = PinnedBundle(rest)
            status, row = observe_duals(pinned.address)
            done += int(row)
            if status != OK:
                self._use_other_pivots(float(time[done]), is_last_try=renewed == done)
                renewed = done
        return states

    def _use_other_pivots(self, t: float, *, is_last_try: bool) -> None:
        """Choose pivots for a state that could not be evaluated; raise RunError if there are none, or in a last try."""
        try:
            if is_last_try or not self.workspace.is_finite(tangents=False):
                raise SingularSystemError
            self.workspace.use_pivots()
        except SingularSystemError:
            raise RunError(f"the accelerations at t = {t:.6g} s have no derivatives") from None
        self.take_up_solver()

    def recorded(self, count: int) -> tuple[np.ndarray, ...]:
        """Return positions, velocities, first-order states and energies of the first `count` recorded states after the
        start, with their derivatives.
        """
        run = self.run
        q, v, energy = (np.asarray(x[:count]) for x in (run.row_q, run.row_v, run.row_energy))
        return q, v, np.array(self._row_z[:count]).reshape(count, *np.asarray(run.z).shape), energy

    def nodes(self) -> tuple[np.ndarray, ...]:
        """Return times, weights, positions and velocities of the stored stages."""
        run, some = self.run, slice(int(self.run.nodes[1]))
        return run.node_time[some], run.node_weight[some], np.asarray(run.node_q[some]), np.asarray(run.node_v[some])


class DifferentiatedStepper(CompiledStepper):
    """Runs a compiled method with fixed or controlled step size, and differentiates every step.

    Parameters
    ----------
    method, workspace, timetable, control
        See `CompiledStepper`.
    seeds
        Derivatives of mechanism and start with respect to parameters.
    with_nodes
        Whether stages are stored as quadrature nodes.
    sizes
        Sizes of the steps [s], if given; the error estimate then rejects no step. Ignored without step-size control.
    are_limits
        Whether `sizes` are only the largest ones.
    """

    can_take_back: ClassVar[bool] = False

    def __init__(
        self,
        method: CompiledMethod,
        workspace: Workspace,
        timetable: Timetable,
        control: Control | None,
        seeds: Seeds,
        *,
        with_nodes: bool,
        sizes: Sequence[float] | None = None,
        are_limits: bool = False,
    ):
        self._steps: DifferentiatedSteps | None = None  # until the run has its start
        self.recorded = 0
        self.sizes_taken: list[float] = []
        self.given_sizes, self._are_limits = sizes if control is not None else None, are_limits
        if control is not None and self.given_sizes is not None and not are_limits:
            control = replace(control, scale=ANY_ERROR)
        super().__init__(method, workspace, timetable, control)
        given = np.array(self.given_sizes or ())
        self._ends = timetable.start + np.cumsum(given)
        self._near_ends = self._ends - np.maximum(ROUNDED * given, ROUNDINGS * abs(timetable.end))
        known = timetable.steps // timetable.every + 2 if timetable.step is not None else 64
        rows = known + len(self.run_state.row_time)  # room for as many as one stretch may record after the last
        self._steps = DifferentiatedSteps(method, workspace, seeds, rows, int(with_nodes))
        self._dual_sampler = DifferentiatedSampler(self.steps, self.sampler)
        self._dual_sampler.passed(timetable.start, self.run_state.z)
        self.z0 = np.copy(self.steps.run.z)

    @staticmethod
    def sizes_across_switches(mechanism: CompiledMechanism, begin: Callable[[], Any]) -> list[float] | None:
        """Return the sizes of the steps of a run that a function begins, with tiny steps across the times at which laws
        switch; None if all forces of the mechanism are smooth, or if the run fails.

        Controlled steps end just behind such a time (`mbdkit.integrators.loop.steps_to_switches`). A stage at the end
        of the step would have the derivatives of the other side. Compliant contacts, whose steps end where shapes begin
        or cease to touch, have the same derivatives on both sides.
        """
        number = switching_laws(mechanism)[1]
        if not (number or mechanism.treatments):
            return None
        stepper = begin()
        ends, values = [stepper.workspace.t0], [np.full((1, number), np.inf)]
        while not (stepper.finished or stepper.failure):
            rows = stepper.advance()
            ends += rows.time.tolist()
            values.append(switching_functions(stepper.workspace, stepper.switches, *_states(rows)))
        time, near, ends = np.array(ends), np.abs(np.concatenate(values)), ends[:1]
        size = np.diff(time)
        for k in range(1, len(time)):
            is_zero = k < len(size) and np.any(near[k] < AT_ZERO * np.minimum(near[k - 1], near[k + 1]))
            shares = [-share for share in BEFORE_SWITCH] + [AFTER_SWITCH] if is_zero else [0.0]
            ends += [float(time[k] + share * np.min(size[k - 1 : k + 1])) for share in shares]
        return None if stepper.failure else np.diff(ends).tolist()

    @staticmethod
    def forces_that_switch(workspace: Workspace, rows: Any) -> list[str]:
        """Return the names of the forces whose switching functions change their sign between recorded states."""
        pinned = switch_bundle(workspace, float(np.ptp(rows.time)))
        if pinned is None:
            return []
        is_positive, laws = switching_functions(workspace, pinned, *_states(rows)) > 0.0, pinned.bundle.laws
        changes = np.logical_or.reduceat(np.any(is_positive[1:] != is_positive[:-1], axis=0), laws[:, 2])
        return [workspace.mechanism.laws[law][0] for law in laws[changes, 0]]

    @property
    def steps(self) -> DifferentiatedSteps:
        """The derivatives of the steps."""
        assert self._steps is not None
        return self._steps

    def _memory(self) -> tuple[np.ndarray, ...]:
        own = () if self._steps is None else self.steps.memory
        return (*super()._memory(), *own)

    def begin_after_stop(self) -> None:
        """See `CompiledStepper.begin_after_stop`: the values that controllers hold have derivatives too."""
        super().begin_after_stop()
        progress = self.run_state.progress
        if self._steps is not None and progress.after_stop[0] and not progress.pending[0]:
            self._dual_sampler.passed(self.timetable.stops[int(progress.passed[0]) - 1], self.run_state.z)

    def _retake(self, step: StepTaken, theta: float) -> bool:
        recorded, taken, sizes = self.recorded, self.sizes_taken, self.given_sizes
        self.sizes_taken, self.given_sizes = [], None
        done = super()._retake(step, theta)
        # the end of a repeated step is not recorded
        self.recorded, self.sizes_taken, self.given_sizes = recorded, taken, sizes
        return done

    def _given_size(self, time: float) -> float:
        """Return the size of the step from a time on, up to the end of a step of a given size [s].

        The rest of a step that ended before, where a force switches, is one step.
        """
        number = int(np.searchsorted(self._near_ends, time, side="right"))
        return float(self._ends[number]) - time if number < len(self._ends) else float(np.diff(self._ends)[-1])

    def within(self, theta: float) -> Moment:
        """See `Stepper.within`."""
        with self.steps.last_nodes_kept():
            return super().within(theta)

    def derivatives_within(self, theta: float) -> Moment:
        """Return the state with its derivatives at the share `theta` of the last step.

        Raises
        ------
        StepError
            If the shortened step fails.
        """
        step, steps = self.last_step, self.steps
        assert step is not None
        after = [np.copy(x) for x in self._memory()]
        with steps.last_nodes_kept():
            done = theta >= 1.0 or self._retake(step, theta)
        q, v, z = (np.copy(x) for x in (steps.run.q, steps.run.v, steps.run.z))
        self._recall(after)
        self.count()
        if not done:
            raise StepError("newton-failed", f"the step from t = {step.t0:.6g} s cannot be shortened")
        return q, v, z

    def cut_with_derivatives(self, theta: float) -> tuple[float, Moment, np.ndarray]:
        """End the run at the share `theta` of the last step; return time, state and energies there.

        Raises
        ------
        StepError
            If the shortened step fails.
        """
        self.cut(theta)
        steps = self.steps
        if not np.array_equal(steps.run.q[:, 0], self.run_state.q):
            raise StepError("newton-failed", f"the step to t = {self.time:.6g} s cannot be shortened")
        run = steps.run
        return self.time, (np.copy(run.q), np.copy(run.v), np.copy(run.z)), np.copy(run.energy)

    def drive(self, plan: PinnedBundle, budget: int, path: int = 0) -> tuple[int, int]:
        """Attempt up to `budget` steps of a plan, one after another, and differentiate those that are accepted."""
        if self._steps is None or budget <= 0:
            return super().drive(plan, budget, path)
        if not self.controlled and self.steps.can_drive:
            status, written = self.steps.drive(self, plan, budget, self.recorded)
            self.recorded += written
            return status, written
        c = self.run_state
        progress, rows, limit = (
            c.progress,
            (c.row_time, c.row_q, c.row_v, c.row_energy, c.row_interval),
            len(c.row_time),
        )
        count = 0
        while True:
            before, projections = int(progress.accepted[0]), int(c.counts[PROJECTIONS])
            if self.given_sizes is not None and progress.retrying[0] == 0:
                size, most = self._given_size(float(progress.time[0])), progress.next_size[0]
                progress.next_size[0] = min(size, most) if self._are_limits else size
            status, written = super().drive(plan, 1, path)
            if int(progress.accepted[0]) > before:
                step = float(progress.tried_begin[0]), float(progress.last_size[0])
                self.sizes_taken.append(step[1])
                self.steps.step(
                    self.pinned_state.address,
                    step,
                    self.recorded if written else -1,
                    projected=int(c.counts[PROJECTIONS]) > projections,
                )
            if written:
                self.recorded += 1
                count += 1
                if count > 1:  # the step loop writes each row at index 0, so the first recorded state has to be saved
                    for x in rows:
                        x[count - 1] = x[0]
                else:
                    first = [np.copy(x[0]) for x in rows]
            budget -= 1
            if status != OK or budget <= 0 or count >= limit or progress.time[0] >= self.timetable.end:
                break
        if count > 1:
            for x, row in zip(rows, first, strict=True):
                x[0] = row
        return status, count


def _enlarged(x: Any, rows: int) -> object:
    """Return a copy of an array with room for at least `rows` rows."""
    larger = np.zeros((max(rows, 2 * len(x)), *x.shape[1:])).view(type(x))
    larger[: len(x)] = x
    return larger
