"""A run with derivatives of its recorded states, and of what is computed from them, by parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.jit.bundle import PinnedBundle
from mbdkit.engine.jit.dual_arrays import Duals
from mbdkit.engine.jit.dual_types import DIRECTIONS
from mbdkit.engine.kernels.dual_observe import observe_duals
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.observed_states import StateObserver
from mbdkit.errors import RunError, SpecError, StepError
from mbdkit.events.event_expression import RunExpression
from mbdkit.events.watch import Found, Watch, Watched
from mbdkit.gradients.differentiated_expressions import of_event, slopes_of
from mbdkit.gradients.differentiated_states import States, series_of
from mbdkit.gradients.parameter_differences import CENTRAL, weights
from mbdkit.methods.kinds import Method
from mbdkit.run_preparation import build, guards, make_method, size_at_start, timetable
from mbdkit.spec import RunSpec
from mbdkit.stepping.differentiated_stepper import DifferentiatedStepper, NoDerivativeError
from mbdkit.stepping.dual_run import NO_SEEDS, Seeds, constants, dual_states
from mbdkit.stepping.interface import Stretch, joined
from mbdkit.stepping.start import require_derivatives, start_differentiated, start_method


@dataclass(frozen=True)
class Event:
    """A crossing of an event: its name and time [s], the expression, and whether it ends the run."""

    name: str
    time: float
    expression: RunExpression
    stops: bool


@dataclass(frozen=True)
class Crossing:
    """A crossing of an event: its name, its time [s], and the derivatives (K,) of the time."""

    name: str
    time: float
    slope: np.ndarray


@dataclass(frozen=True)
class DifferentiatedRun:
    """The states of a run with derivatives.

    Parameters
    ----------
    rows
        Recorded states; the last one moves with the end of the run.
    nodes
        Stages of the steps, as nodes of integrals over time; None: integrals are those of the rows.
    end
        (K,) derivatives of the time at which the run ends; not zero if an event ends it.
    crossings
        Events in order of time.
    sizes
        Sizes of the steps [s]; None of fixed steps.
    """

    rows: States
    nodes: States | None
    end: np.ndarray
    crossings: tuple[Crossing, ...]
    sizes: Sequence[float] | None


def differentiated_run(
    spec: RunSpec, seeds: Seeds, *, with_nodes: bool, sizes: Sequence[float] | None = None
) -> DifferentiatedRun:
    """Run a spec, and differentiate it by parameters.

    Parameters
    ----------
    seeds
        Derivatives of the prepared run by the parameters.
    with_nodes
        Whether the stages of the steps are kept as nodes of integrals.
    sizes
        Sizes of steps [s] to take in place of those that step-size control would choose.

    Raises
    ------
    SpecError
        If runs of this spec cannot be differentiated.
    RunError
        If the run stops early.
    """
    refuse(spec, make_method(spec))
    firsts = range(0, max(seeds.count, 1), DIRECTIONS)
    parts = [_pass(spec, seeds.only(slice(first, first + DIRECTIONS)), with_nodes, sizes) for first in firsts]
    if len(parts) == 1:
        return parts[0]
    crossings = (
        Crossing(same[0].name, same[0].time, np.concatenate([one.slope for one in same]))
        for same in zip(*(one.crossings for one in parts), strict=True)
    )
    return DifferentiatedRun(
        joined_states([one.rows for one in parts]),
        joined_states([one.nodes for one in parts if one.nodes is not None]) if parts[0].nodes is not None else None,
        np.concatenate([one.end for one in parts]),
        tuple(crossings),
        parts[0].sizes,
    )


def plain_run(spec: RunSpec) -> DifferentiatedRun:
    """Run a spec without events, and return its recorded states, without derivatives and nodes; raise RunError."""
    method = make_method(spec)
    workspace, _ = build(spec)
    stepper = start_method(method, workspace, timetable(spec, guards(spec, size_at_start(spec, workspace))))
    none = np.zeros(1)
    stretches = [
        Stretch(np.array([workspace.t0]), workspace.q0[None], workspace.v0[None], none, none, np.zeros((1, 6)))
    ]
    while not (stepper.finished or stepper.failure):
        stretches.append(stepper.advance())
    if stepper.failure:
        raise RunError(f"{stepper.failure.code}: {stepper.failure.sentence}")
    rows = joined(stretches)
    workspace.clamp_motions(-np.inf, np.inf)
    observer = StateObserver(workspace.with_own_pivots())
    observed = observer.arrays(len(rows.time))
    q, v = np.ascontiguousarray(rows.q), np.ascontiguousarray(rows.v)
    if observer.observe(rows.time, q, v, observed) is not None:
        raise RunError("a recorded state has no unique accelerations")
    energy = np.stack([rows.work, rows.dissipated], axis=-1)
    q, v, energy, *values = (x[..., None] for x in (q, v, energy, *observed))
    states = States(workspace, rows.time, None, q, v, energy, Observed(*values), np.zeros_like(energy))
    return DifferentiatedRun(states, None, np.zeros(0), (), None)


def refuse(spec: RunSpec, method: Method) -> None:
    """Raise SpecError if runs of a spec with a method have no derivatives."""
    try:
        require_derivatives(method, spec.formulation, spec.stabilized)
    except NoDerivativeError as error:
        message = f"{spec.integrator_item.id} has no derivatives by parameters here: {error}"
        raise SpecError(message, key="integrator") from None
    if spec.is_to_be_chosen:
        raise SpecError("a gradient needs a method and a step; it does not choose them", key="accuracy")
    if spec.output.interval is not None:
        raise SpecError(
            "states recorded by `interval` have no derivatives; record every k-th step by `every`",
            key="output.interval",
        )


def _pass(spec: RunSpec, seeds: Seeds, with_nodes: bool, sizes: Sequence[float] | None) -> DifferentiatedRun:
    """Run a spec with the derivatives by up to `DIRECTIONS` parameters."""
    method = make_method(spec)
    workspace, _ = build(spec)
    table = timetable(spec, guards(spec, size_at_start(spec, workspace)))
    if table.impacts:
        raise SpecError("runs with impacts of drivers have no derivatives", key="impacts")
    events = events_of(spec, sizes) if spec.events else []
    try:
        stepper = start_differentiated(method, workspace, table, seeds, with_nodes=with_nodes, sizes=sizes)
    except SingularSystemError as error:
        name = workspace.mechanism.unknown_name(error.index)
        raise RunError(f"the stage equations are singular at the start, near {name}") from None
    try:
        return _Pass(spec, stepper, seeds).run(events)
    except StepError as error:
        raise RunError(str(error)) from None


class _Pass:
    """One differentiated run.

    Parameters
    ----------
    stepper
        The run at its start.
    """

    def __init__(self, spec: RunSpec, stepper: DifferentiatedStepper, seeds: Seeds):
        assert stepper.steps is not None
        self.spec, self.stepper, self.seeds, self.width = spec, stepper, seeds, 1 + seeds.count
        self.workspace, self.steps = stepper.workspace, stepper.steps

    def run(self, events: Sequence[Event]) -> DifferentiatedRun:
        """Take all steps, and return the states with their derivatives."""
        stepper, times = self.stepper, [np.array([self.workspace.t0])]
        waiting, at_events = list(events), []
        last: tuple[float, np.ndarray, np.ndarray, np.ndarray] | None = None
        while not (stepper.finished or stepper.failure):
            stretch = stepper.advance()
            step = stepper.last_step
            while waiting and step is not None and last is None and waiting[0].time <= step.t1:
                event = waiting.pop(0)
                theta = min(1.0, (event.time - step.t0) / (step.t1 - step.t0))
                if event.stops:
                    last = stepper.cut_with_derivatives(theta)
                    at_events.append(last[1:3])
                else:
                    at_events.append(stepper.derivatives_within(theta))
            times.append(stretch.time if last is None else stretch.time[stretch.time < last[0]])
        if stepper.failure:
            told = f"{stepper.failure.code}: {stepper.failure.sentence}"
            raise RunError(f"a run that stops early has no gradient: {told}")
        return self._observed(np.concatenate(times), last, events, at_events)

    def _observed(
        self,
        time: np.ndarray,
        last: tuple[float, np.ndarray, np.ndarray, np.ndarray] | None,
        events: Sequence[Event],
        at_events: Sequence[tuple[np.ndarray, np.ndarray]],
    ) -> DifferentiatedRun:
        """Return recorded states, nodes if they are kept, and states at events, with what is computed from them."""
        workspace = self.workspace
        q0, v0 = (constants(x, self.seeds.get(name))[None] for name, x in (("q", workspace.q0), ("v", workspace.v0)))
        q, v, energy = self.steps.recorded(len(time) - 1)
        q, v = np.concatenate([q0, q]), np.concatenate([v0, v])
        energy = np.concatenate([np.zeros((1, *energy.shape[1:])), energy])
        workspace.clamp_motions(-np.inf, np.inf)
        crossings = [self._crossing(event, *state) for event, state in zip(events, at_events, strict=False)]
        moved = np.zeros(self.width - 1)
        if last is not None:  # the end moves with the parameters
            moved = crossings[-1].slope
            time = np.append(time, last[0])
            q, v, energy = (
                np.concatenate([x, end[None]])
                for x, end in zip((q, v, energy), self._moving_end(last, moved), strict=True)
            )
        rows = self.evaluated(time, None, q, v, energy)
        nodes = self.evaluated(*self.steps.nodes(), None) if self.steps.run.nodes[0] else None
        sizes = self.stepper.sizes_taken if self.stepper.controlled else None
        return DifferentiatedRun(rows, nodes, moved, tuple(crossings), sizes)

    def _moving_end(
        self, last: tuple[float, np.ndarray, np.ndarray, np.ndarray], moved: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Return positions, velocities and energies of the last state with derivatives along a change of its time."""
        t, q, v, energy = last
        state = self.evaluated(np.array([t]), None, q[None], v[None], None)
        ends = q.copy(), v.copy(), energy.copy()
        for end, rate in zip(ends, (v[:, 0], state.observed.acc[0, :, 0], state.power[0, :, 0]), strict=True):
            end[:, 1 : self.width] += np.outer(rate, moved)
        return ends

    def _crossing(self, event: Event, q: np.ndarray, v: np.ndarray) -> Crossing:
        """Return the time of an event and its derivatives, ``-g_p / g_t`` for the expression g that crosses zero."""
        here = self.evaluated(np.array([event.time]), None, q[None], v[None], None)
        slopes = slopes_of(event.expression.program, self.seeds, of_event(event.name))
        value = series_of(event.expression, here, slopes)
        acc = here.observed.acc[0, :, 0]
        unit = self.spec.time.step or 1e-3
        offsets = unit * np.array(CENTRAL) / 32.0
        moved_q, moved_v = (constants(x[:, 0] + offsets[:, None] * rate) for x, rate in ((q, v[:, 0]), (v, acc)))
        around = self.evaluated(event.time + offsets, None, moved_q, moved_v, None)
        differences = series_of(event.expression, around, slopes).value - value.value[0]
        rate = float(np.dot(weights(CENTRAL), differences)) / (unit / 32.0)
        with np.errstate(all="ignore"):
            return Crossing(event.name, event.time, -value.slope[:, 0] / rate)

    def evaluated(
        self, time: np.ndarray, weight: np.ndarray | None, q: np.ndarray, v: np.ndarray, energy: np.ndarray | None
    ) -> States:
        """Return states with what is computed from them."""
        self.steps.take_up_solver()
        states = dual_states(self.steps.run, self.workspace, time, q.view(Duals), v.view(Duals))
        done = 0
        renewed = -1
        while done < len(time):
            part = slice(done, None)
            rest = states._replace(
                solver=self.steps.run.solver, time=states.time[part], q=states.q[part], v=states.v[part],
                observed=states.observed.rows(part), power=states.power[part],
            )  # fmt: skip
            pinned = PinnedBundle(rest)
            status, row = observe_duals(pinned.address)
            done += int(row)
            if status != OK:
                self._use_other_pivots(float(time[done]), is_last_try=renewed == done)
                renewed = done
        some = slice(self.width)
        observed = Observed(*(np.asarray(x[..., some]) for x in states.observed))
        return States(
            self.workspace, time, weight, np.asarray(q[..., some]), np.asarray(v[..., some]),
            None if energy is None else np.asarray(energy[..., some]), observed, np.asarray(states.power[..., some]),
        )  # fmt: skip

    def _use_other_pivots(self, t: float, *, is_last_try: bool) -> None:
        """Choose pivots for the state that could not be evaluated; raise RunError if there are none."""
        try:
            if is_last_try or not self.workspace.is_finite(tangents=False):
                raise SingularSystemError
            self.workspace.use_pivots()
        except SingularSystemError:
            raise RunError(f"the accelerations at t = {t:.6g} s have no derivatives") from None
        self.steps.take_up_solver()


def events_of(spec: RunSpec, sizes: Sequence[float] | None) -> list[Event]:
    """Run a spec, in steps of given `sizes` if any, and return its events in order of time.

    Raises
    ------
    RunError
        If the run stops early.
    """
    workspace, _ = build(spec)
    method = make_method(spec)
    table = timetable(spec, guards(spec, size_at_start(spec, workspace)))
    watched = [
        Watched(name, expression, spec.events[name].direction, spec.events[name].action)
        for name, expression in spec.watched().items()
    ]
    stepper = (
        start_method(method, workspace, table)
        if sizes is None
        else start_differentiated(method, workspace, table, NO_SEEDS, with_nodes=False, sizes=sizes)
    )
    watch = Watch(stepper, workspace, watched)
    crossings: list[Found] = []
    while not (watch.finished or watch.failure):
        watch.advance()
        crossings += watch.taken()
    if watch.failure:
        raise RunError(f"a run that stops early has no gradient: {watch.failure.code}: {watch.failure.sentence}")
    expressions = spec.watched()
    stops = [one is crossings[-1] and watch.stopped is not None for one in crossings]
    return [Event(one.name, one.time, expressions[one.name], end) for one, end in zip(crossings, stops, strict=True)]


def joined_states(parts: Sequence[States]) -> States:
    """Return the same states with the derivatives of several passes."""

    def together(arrays: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate([arrays[0], *(x[..., 1:] for x in arrays[1:])], axis=-1)

    first = parts[0]
    energy = None if first.energy is None else together([one.energy for one in parts if one.energy is not None])
    return States(
        first.workspace, first.time, first.weight,
        together([one.q for one in parts]), together([one.v for one in parts]), energy,
        Observed(*(together(x) for x in zip(*(one.observed for one in parts), strict=True))),
        together([one.power for one in parts]),
        {name: together([one.actuators[name] for one in parts]) for name in first.actuators},
    )  # fmt: skip
