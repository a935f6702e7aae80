"""A run with derivatives of its recorded states, and of quantities computed from these, with respect to parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from mbdkit.base.errors import RunError, SpecError, StepError
from mbdkit.base.plain_data import path_text, quoted
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.native.arithmetic import DIRECTIONS
from mbdkit.events.event_expression import RunExpression
from mbdkit.integrators.duals.differentiated_stepper import DifferentiatedStepper
from mbdkit.integrators.duals.dual_run import NO_SEEDS, Seeds, constants
from mbdkit.integrators.interface import Moment, Stepper
from mbdkit.integrators.start import compiled_method
from mbdkit.methods.kinds import Method
from mbdkit.runs.preparation import RunSetup, make_method
from mbdkit.runs.watched_events import watch_events
from mbdkit.spec.run_spec import RunSpec
from mbdkit_gradients.differentiated_expressions import slopes_of
from mbdkit_gradients.differentiated_motion import DifferentiatedMotion
from mbdkit_gradients.differentiated_states import (
    DifferentiatedStates,
    StateEvaluator,
    joined_states,
    nearby,
    one_after_another,
    rate_of,
    series_of,
)
from mbdkit_gradients.law_corners import doubts_of_kinds, with_sides, with_unknown_corners
from mbdkit_gradients.sided_stepper import SidedStepper, sides_of, use_sides


@dataclass(frozen=True)
class PassedEvent:
    """A crossing of an event: name and expression of the event, time [s], whether the event ends the run, and whether
    its expression jumps there from one sign to the other.
    """

    name: str
    time: float
    expression: RunExpression
    stops: bool
    at_jump: bool


@dataclass(frozen=True)
class DifferentiatedCrossing:
    """A crossing of an event: name of the event, time [s], and derivatives (K,) of the time."""

    name: str
    time: float
    slope: np.ndarray


@dataclass(frozen=True)
class Needs:
    """Data that measures need in addition to the recorded states of a run.

    Attributes
    ----------
    nodes, ends
        Whether stages of the steps are stored as nodes of integrals, and whether the states at the ends of all steps
        are stored.
    """

    nodes: bool = False
    ends: bool = False


@dataclass(frozen=True)
class DifferentiatedRun:
    """The states of a run with derivatives.

    Parameters
    ----------
    rows
        Recorded states. The derivatives of the last state include the effect of the change of its time, the end of the
        run.
    nodes
        Stages of the steps, as nodes of integrals over time; None if integrals use the recorded states.
    end
        (K,) derivatives of the time at which the run ends; zero unless an event ends the run.
    crossings
        Events in order of time.
    sizes
        Sizes of the steps [s]; None for fixed steps.
    motions
        The motion between the ends of the steps, for up to `DIRECTIONS` parameters each; empty if it is not needed.
    is_split
        Whether steps end at discontinuities of force laws, unlike those of an ordinary run.
    doubts
        Warnings about force laws that may have discontinuities inside steps.
    """

    rows: DifferentiatedStates
    nodes: DifferentiatedStates | None
    end: np.ndarray
    crossings: tuple[DifferentiatedCrossing, ...]
    sizes: Sequence[float] | None
    motions: tuple[DifferentiatedMotion, ...] = ()
    is_split: bool = False
    doubts: tuple[str, ...] = ()


def differentiated_run(
    spec: RunSpec, seeds: Seeds, needs: Needs, *, sizes: Sequence[float] | None = None
) -> DifferentiatedRun:
    """Run a spec, and differentiate it with respect to parameters.

    Parameters
    ----------
    seeds
        Derivatives of the prepared run with respect to the parameters.
    needs
        Data that the measures need in addition to the recorded states.
    sizes
        Sizes of steps [s], in place of those that step-size control would choose.

    Raises
    ------
    SpecError
        If runs of this spec cannot be differentiated.
    RunError
        If the run stops early.
    """
    refuse(spec, make_method(spec))
    firsts = range(0, max(seeds.count, 1), DIRECTIONS)
    parts = [_pass(spec, seeds.only(slice(first, first + DIRECTIONS)), needs, sizes) for first in firsts]
    if len(parts) == 1:
        return parts[0]
    crossings = (
        DifferentiatedCrossing(same[0].name, same[0].time, np.concatenate([one.slope for one in same]))
        for same in zip(*(part.crossings for part in parts), strict=True)
    )
    nodes = [part.nodes for part in parts if part.nodes is not None]
    return replace(
        parts[0],
        rows=joined_states([part.rows for part in parts]),
        nodes=joined_states(nodes) if nodes else None,
        end=np.concatenate([part.end for part in parts]),
        crossings=tuple(crossings),
        motions=tuple(motion for part in parts for motion in part.motions),
    )


def refuse(spec: RunSpec, method: Method) -> None:
    """Raise SpecError if runs of a spec with this method cannot be differentiated."""
    if why := _why_no_derivatives(method, spec):
        message = f"{spec.integrator_item.id} has no derivatives with respect to parameters here: {why}"
        raise SpecError(message, key="integrator")
    if spec.settings():
        raise SpecError("runs in which events set states have no derivatives", key="events")
    for name, controller in spec.mechanism().controllers.items():
        if controller.python is not None:
            key = f"model.controllers.{quoted(name)}.python"
            raise SpecError("the function of a controller in Python has no derivatives", key=key)
    if spec.is_to_be_chosen:
        raise SpecError("gradients are not available with `accuracy`; give an integrator and a step", key="accuracy")
    if spec.output.interval is not None:
        message = "gradients are not available with `interval`; use `every` to record every k-th step"
        raise SpecError(message, key="output.interval")


def _why_no_derivatives(method: Method, spec: RunSpec) -> str:
    """Return why the steps of the method of a spec cannot be differentiated; empty if they can."""
    if not method.traits.has_derivatives:
        return (
            "only steps of explicit Runge-Kutta methods and of collocation methods (gauss, radau-iia) have derivatives"
        )
    if spec.formulated.coordinates == "joint" and not method.traits.is_explicit:
        return "with joint-coordinates, only steps of explicit Runge-Kutta methods have derivatives"
    if spec.stabilized.symmetric:
        return "symmetric projections are not differentiated; use `stabilization: projection` or none"
    return ""


def _pass(spec: RunSpec, seeds: Seeds, needs: Needs, sizes: Sequence[float] | None) -> DifferentiatedRun:
    """Run a spec with the derivatives with respect to up to `DIRECTIONS` parameters."""
    events = events_of(spec, sizes) if spec.events else []
    stepper = differentiated_stepper(spec, seeds, needs, sizes)
    try:
        return _Pass(spec, stepper, seeds, needs).run(events)
    except StepError as error:
        raise RunError(str(error)) from None


def differentiated_stepper(
    spec: RunSpec,
    seeds: Seeds,
    needs: Needs,
    sizes: Sequence[float] | None,
    setup: RunSetup | None = None,
    **changes: Any,
) -> DifferentiatedStepper | SidedStepper:
    """Return a run at its start.

    Steps end at discontinuities of force laws.

    Parameters
    ----------
    setup
        The setup of the spec; made by default.
    **changes
        Fields of the timetable, such as ``every``.
    """
    setup = setup or RunSetup.of(spec)
    method, workspace = setup.method, setup.workspace
    workspace.mechanism.refuse_kinds("gradients")
    if needs != Needs():
        workspace.mechanism.refuse_states("the gradient of an extremum, of an integral or of a value at a time")
    table = setup.timetable()
    table = replace(table, **{"single": table.single or needs.ends, **changes})
    if table.impacts:
        raise SpecError("runs with impacts of drivers have no derivatives", key="impacts")
    sided = with_sides(workspace.mechanism)
    every = replace(table, every=1)
    if sided is None and sizes is None and method.traits.tolerances is not None:
        sizes = DifferentiatedStepper.sizes_across_switches(workspace.mechanism, partial(setup.stepper, every))
    try:
        mechanism = workspace.mechanism if sided is None else sided.mechanism
        own = workspace if sided is None and sizes is None else replace(workspace, mechanism=mechanism)
        compiled, control = compiled_method(method, own)
        more: dict[str, Any] = {"control": control, "with_nodes": needs.nodes, "sizes": sizes}
        if sided is None:
            return DifferentiatedStepper(compiled, own, table, seeds=seeds, **more)
        if control is not None and sizes is None:
            most = np.diff(_ends(setup.stepper(every))).tolist() or None
            limited: dict[str, Any] = {"control": control, "with_nodes": False, "sizes": most, "are_limits": True}
            first = SidedStepper(compiled_method(method, own)[0], own, every, NO_SEEDS, sided.conditions, **limited)
            more["sizes"] = np.diff(_ends(first)).tolist() or None
        return SidedStepper(compiled, own, table, sided.seeds(seeds), sided.conditions, **more)
    except SingularSystemError as error:
        name = workspace.mechanism.unknown_name(error.index)
        raise RunError(f"the stage equations are singular at the start, near {name}") from None


def _ends(stepper: Any) -> list[float]:
    """Take all steps of a run, as far as it goes; return the times of their ends, and of the start, without corners."""
    time = [stepper.workspace.t0]
    while not (stepper.finished or stepper.failure):
        rows = stepper.advance().time
        if getattr(stepper, "reached", None) is None:
            time.extend(rows.tolist())
    return time


@dataclass(frozen=True)
class _AtEvent:
    """The state at an event, with derivatives, and on which sides of discontinuities force laws are evaluated."""

    state: Moment
    sides: np.ndarray | None


class _Pass:
    """One differentiated run.

    Parameters
    ----------
    stepper
        The run at its start.
    """

    def __init__(self, spec: RunSpec, stepper: DifferentiatedStepper, seeds: Seeds, needs: Needs):
        self.spec, self.stepper, self.seeds, self.width = spec, stepper, seeds, 1 + seeds.count
        self.workspace, self.steps = stepper.workspace, stepper.steps
        self._sided = stepper if isinstance(stepper, SidedStepper) else None
        self._evaluator = StateEvaluator(self.steps, seeds.count)
        self.motion: DifferentiatedMotion | None = None
        if needs.ends:
            stiff = make_method(spec).traits.suits_stiff
            self.motion = DifferentiatedMotion(stepper, self._evaluator, uses_accelerations=not stiff)

    def run(self, events: Sequence[PassedEvent]) -> DifferentiatedRun:
        """Take all steps, and return the states with their derivatives."""
        stepper, times = self.stepper, [np.array([self.workspace.t0])]
        waiting, at_events = list(events), []
        last: tuple[float, Moment, np.ndarray] | None = None
        while not (stepper.finished or stepper.failure):
            stretch = stepper.advance()
            step, sides = stepper.last_step, sides_of(stepper)
            while waiting and step is not None and last is None and waiting[0].time <= step.t1:
                event = waiting.pop(0)
                theta = min(1.0, (event.time - step.t0) / (step.t1 - step.t0))
                if event.stops:
                    last = stepper.cut_with_derivatives(theta)
                    at_events.append(_AtEvent(last[1], sides))
                else:
                    at_events.append(_AtEvent(stepper.derivatives_within(theta), sides))
            times.append(stretch.time if last is None else stretch.time[stretch.time < last[0]])
            if self.motion is not None and last is None:
                self.motion.add()
            elif self.motion is not None and last is not None:
                self.motion.end_at(last[0], *last[1][:2])
        if stepper.failure:
            text = f"{stepper.failure.code}: {stepper.failure.sentence}"
            raise RunError(f"a run that stops early has no gradient: {text}")
        return self._observed(np.concatenate(times), last, events, at_events)

    def _observed(
        self,
        time: np.ndarray,
        last: tuple[float, Moment, np.ndarray] | None,
        events: Sequence[PassedEvent],
        at_events: Sequence[_AtEvent],
    ) -> DifferentiatedRun:
        """Return recorded states, nodes (if stored) and states at events, with the quantities computed from them."""
        workspace = self.workspace
        q0, v0 = (constants(x, self.seeds.get(name))[None] for name, x in (("q", workspace.q0), ("v", workspace.v0)))
        q, v, z, energy = self.steps.recorded(len(time) - 1)
        q, v, z = (np.concatenate([x0, x]) for x0, x in ((q0, q), (v0, v), (self.stepper.z0[None], z)))
        energy = np.concatenate([np.zeros((1, *energy.shape[1:])), energy])
        workspace.clamp_motions(-np.inf, np.inf)
        crossings = [self._crossing(event, at) for event, at in zip(events, at_events, strict=False)]
        moved = np.zeros(self.width - 1)
        if last is not None:  # the time of the end depends on the parameters
            moved = crossings[-1].slope
            time = np.append(time, last[0])
            q, v, z, energy = (
                np.concatenate([x, end[None]])
                for x, end in zip((q, v, z, energy), self._moving_end(last, moved), strict=True)
            )
        history = [] if self._sided is None else self._sided.history
        seen = self.stepper.timetable.before(time)
        rows = self._evaluated([(one.rows + 1, one.sides) for one in history], seen, q, v, z, None, energy)
        if last is not None:
            self._add_explicit_rates(rows, moved)
        rows = replace(rows, time=time)
        nodes = self._nodes([(one.nodes, one.sides) for one in history]) if self.steps.run.nodes[0] else None
        sizes = (self.stepper.given_sizes or self.stepper.sizes_taken) if self.stepper.controlled else None
        motions = () if self.motion is None else (self.motion,)
        doubts = doubts_of_laws(self.workspace.mechanism)
        return DifferentiatedRun(rows, nodes, moved, tuple(crossings), sizes, motions, self._sided is not None, doubts)

    def _nodes(self, history: Sequence[tuple[int, np.ndarray]]) -> DifferentiatedStates:
        """Return the nodes of integrals over time.

        An integral consists of parts that meet at discontinuities, whose times depend on the parameters. Two nodes of
        weight zero at each discontinuity add this dependence to the derivatives.
        """
        time, weight, q, v = self.steps.nodes()
        state = q, v, np.zeros((len(time), 0, q.shape[-1]))  # runs with first-order states have no nodes
        fixed = np.column_stack([weight, np.zeros((len(weight), self.width - 1))])
        parts = [self._evaluated(history, time, *state, fixed, None)]
        for one in [] if self._sided is None else self._sided.corners:
            moved = np.array([[0.0, *one.slope]])
            parts += [replace(one.before, weight=moved), replace(one.after, weight=-moved)]
        return one_after_another(parts)

    def _evaluated(
        self, history: Sequence[tuple[int, np.ndarray]], time: np.ndarray, *arrays: np.ndarray | None
    ) -> DifferentiatedStates:
        """Return states with the quantities computed from them, using the sides of force laws that were valid at each
        state.

        The `arrays` are positions, velocities, first-order states, weights and energies.
        """
        if not history:
            return self._evaluator.states(time, *arrays)  # type: ignore[arg-type]
        begins = [0, *(begin for begin, _ in history[1:])]
        parts = []
        for begin, end, (_, sides) in zip(begins, [*begins[1:], len(time)], history, strict=True):
            if end > begin:
                use_sides(self.stepper, sides)
                part = slice(begin, end)
                some = (None if x is None else x[part] for x in arrays)
                parts.append(self._evaluator.states(time[part], *some))  # type: ignore[arg-type]
        return one_after_another(parts)

    def _moving_end(self, last: tuple[float, Moment, np.ndarray], moved: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the last state with derivatives that include the effect of the change of its time.

        The result consists of positions, velocities, first-order states and energies.
        """
        t, (q, v, z), energy = last
        state = self._evaluator.states(np.array([t]), q[None], v[None], z[None])
        ends, observed = (q.copy(), v.copy(), z.copy(), energy.copy()), state.observed
        rates = v[:, 0], observed.acc[0, :, 0], observed.state_rates[0, :, 0], state.power[0, :, 0]
        for end, rate in zip(ends, rates, strict=True):
            end[:, 1 : self.width] += np.outer(rate, moved)
        return ends

    def _add_explicit_rates(self, rows: DifferentiatedStates, moved: np.ndarray) -> None:
        """Add the effect of functions of time, such as motions and loads, on the last state, whose time changes."""
        offsets, distance = nearby(self.spec.time.step or 1e-3)
        held = (np.repeat(constants(x[-1:, ..., 0]), len(offsets), axis=0) for x in (rows.q, rows.v, rows.z))
        around = self._evaluator.states(rows.time[-1] + offsets, *held).observed
        for x, near in zip(rows.observed, around, strict=True):
            x[-1, ..., 1 : self.width] += np.multiply.outer(rate_of(near[..., 0], x[-1, ..., 0], distance), moved)

    def _crossing(self, event: PassedEvent, at: _AtEvent) -> DifferentiatedCrossing:
        """Return the time of an event and its derivatives.

        They are ``-g_p / g_t``, where the expression g crosses zero, g_p are its derivatives with respect to the
        parameters, and g_t is its rate.
        """
        key = path_text(("events", event.name, "when"))
        if event.at_jump:
            message = "the time of this event has no derivative: its expression jumps there from one sign to the other"
            raise SpecError(message, key=key)
        use_sides(self.stepper, at.sides)
        here = self._evaluator.states(np.array([event.time]), *(x[None] for x in at.state))
        slopes = slopes_of(event.expression.program, self.seeds, f"events.{event.name}")
        try:
            value = series_of(event.expression, here, slopes)
        except SpecError as error:
            raise SpecError(f"the time of this event has no derivative: {error.message}", key=key) from None
        around, distance = self._evaluator.around(here, self.spec.time.step or 1e-3)
        rate = rate_of(series_of(event.expression, around, slopes).value, float(value.value[0]), distance)
        with np.errstate(all="ignore"):
            return DifferentiatedCrossing(event.name, event.time, -value.slope[:, 0] / rate)


def doubts_of_laws(mechanism: CompiledMechanism) -> tuple[str, ...]:
    """Return warnings about force laws that may have discontinuities inside steps."""
    unknown = (
        f"the law of the force '{name}' is a function, so its discontinuities are not known. If the run passes "
        f"one, the derivatives lack its contribution; write the law as a SymPy expression"
        for name in with_unknown_corners(mechanism)
    )
    return (*unknown, *doubts_of_kinds(mechanism))


def events_of(spec: RunSpec, sizes: Sequence[float] | None) -> list[PassedEvent]:
    """Run a spec and return its events in order of time; `sizes`, if given, are the sizes of the steps [s].

    Raises
    ------
    RunError
        If the run stops early.
    """
    stepper: Stepper
    setup = RunSetup.of(spec)
    workspace = setup.workspace
    if sizes is None and with_sides(workspace.mechanism) is None:
        stepper = setup.stepper()
    else:
        stepper = differentiated_stepper(spec, NO_SEEDS, Needs(), sizes)
        workspace = stepper.workspace
    watch = watch_events(spec, workspace, stepper)
    crossings = []
    while not (watch.finished or watch.failure):
        watch.advance()
        crossings += watch.taken()
    if watch.failure:
        raise RunError(f"a run that stops early has no gradient: {watch.failure.code}: {watch.failure.sentence}")
    expressions = spec.watched()
    stops = [crossing is crossings[-1] and watch.stopped is not None for crossing in crossings]
    return [
        PassedEvent(one.name, one.time, expressions[one.name], end, one.at_jump)
        for one, end in zip(crossings, stops, strict=True)
    ]
