"""Detects the events of a run after every step."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Any, Literal, cast

import numpy as np

from mbdkit.base.frozen import dataclass, field, replace
from mbdkit.engine.counters import Counters
from mbdkit.engine.stored_arrays import fill
from mbdkit.engine.workspace import Workspace
from mbdkit.events.crossing import ACCURACY, Crossing, UndefinedError, crossings, sign
from mbdkit.events.event_expression import CompiledExpression, RunExpression, places_of
from mbdkit.events.quantities import QuantityEvaluator
from mbdkit.events.sampling import INSIDE, refined
from mbdkit.events.screening import Screen
from mbdkit.integrators import interface
from mbdkit.integrators.interface import (
    SIMULTANEOUS,
    ConsecutiveSteps,
    Failure,
    Moment,
    Nodes,
    StepEvidence,
    Stepper,
    StepTaken,
    Stretch,
    closeness,
    joined,
)
from mbdkit.integrators.loop.steps_ahead import StepsAhead
from mbdkit.integrators.run.sampled_control import states_at_start
from mbdkit.integrators.run.splitting import Splitting

DIRECTIONS = {"any": (1, -1), "rising": (1,), "falling": (-1,)}

#: After a jump of the state, values of an expression below this share of its value before the jump, and of its median
#: in the next step, count as zero.
ZERO = 1e-12

#: After an event has set states, its expression is sampled at shares of the step that decrease by this factor.
#:
#: The next crossing is then found, however soon it follows.
CLOSER = 0.1


#: Largest number of steps that are taken at once, and that are taken one by one before several are taken at once again.
MOST_AHEAD, MOST_SINGLE = 256, 16


@dataclass(frozen=True)
class Watched:
    """An event to detect.

    - `name`: name of the event.
    - `when`: expression whose zero crossings are detected.
    - `direction`: direction of the crossings that count.
    - `action`: whether the run continues (``note``) or ends (``stop``) at a crossing.
    - `changes`: new values of first-order states set by a crossing, by name, as expressions of the state before the
      crossing.
    """

    name: str
    when: RunExpression
    direction: Literal["any", "rising", "falling"]
    action: Literal["note", "stop"]
    changes: Mapping[str, RunExpression] = field(default_factory=dict)


@dataclass(frozen=True)
class Found:
    """One crossing: name of the event, time [s], direction (1 or -1), positions and velocities (3 (B + 1),), and
    whether the expression jumps there from one sign to the other.
    """

    name: str
    time: float
    direction: int
    q: np.ndarray
    v: np.ndarray
    at_jump: bool = False

    def __str__(self) -> str:
        way = "upwards" if self.direction > 0 else "downwards"
        return f"'{self.name}' crossed zero {way} at t = {self.time:.10g} s"


def values_at_start(expressions: Mapping[str, RunExpression], workspace: Workspace) -> dict[str, float]:
    """Return the values of expressions at the start of a run; nan for undefined ones."""
    evaluator, compiled = _prepared(list(expressions.values()), workspace)
    q, v, z = (x[None] for x in (workspace.q0, workspace.v0, states_at_start(workspace)))
    values = evaluator.values([workspace.t0], q, v, z)[0]
    return {name: expression.value(values) for name, expression in zip(expressions, compiled, strict=True)}


def _prepared(
    expressions: Sequence[RunExpression], workspace: Workspace
) -> tuple[QuantityEvaluator, list[CompiledExpression]]:
    places = places_of(expressions)
    return QuantityEvaluator(workspace, list(places)), [expression.compiled(places) for expression in expressions]


class _Change:
    def __init__(self, event: Watched, workspace: Workspace):
        names = [state.name for state in workspace.mechanism.states]
        self._names, self._places = list(event.changes), [names.index(name) for name in event.changes]
        self._quantities, self._expressions = _prepared(list(event.changes.values()), workspace)
        self.undefined = ""

    def values(self, t: float, state: Moment) -> dict[int, float]:
        """Return the new values of first-order states by index, from the time [s] and the state before.

        If a value is not finite, `undefined` is the name of its state.
        """
        q, v, z = state
        values = self._quantities.values([t], q[None], v[None], z[None])[0]
        after = [expression.value(values) for expression in self._expressions]
        self.undefined = next((x for x, new in zip(self._names, after, strict=True) if not math.isfinite(new)), "")
        return dict(zip(self._places, after, strict=True))


@dataclass
class Lookahead:
    """The number of steps that are taken at once.

    It depends on earlier steps only, not on wall time, so that a run can be repeated to the bit.

    `steps`: number of steps that are taken next. `single`: number of steps that are taken one by one before. `pause`:
    the value of `single` after the next step that may contain an event.
    """

    steps: int = 8
    single: int = 0
    pause: int = 1

    def took(self, clear: int, taken: int) -> None:
        """Choose the next steps after `taken` steps, of which the first `clear` ones have no event."""
        if clear == taken > 0:
            self.steps, self.pause = min(2 * self.steps, MOST_AHEAD), 1
            return
        # further events may follow soon, and steps that are taken back should be a small part of all steps
        self.single = self.pause = 1 if clear else min(2 * self.pause, MOST_SINGLE)
        self.steps = max(1, clear)


class Watch:
    """Wraps a stepper to detect events, to end the run at an event with the action ``stop``, to set states at events,
    and to keep all steps.

    `stepper`: the stepper, started with ``Timetable.single``; if events set states, it must be a
    `mbdkit.integrators.run.splitting.Splitting`. `stopped`: crossing that ended the run, or None.
    """

    def __init__(self, stepper: Stepper, workspace: Workspace, events: Sequence[Watched]):
        self.stepper, self.events = stepper, events
        self._changes = [_Change(event, workspace) if event.changes else None for event in events]
        # Indices of events that cross zero where states are set before the next step, and whether they set some.
        self._fired: dict[int, bool] = {}
        self._to_set: dict[int, float] = {}  # these states by index; until then, the state is that before the event
        self._set_at = [-math.inf] * len(events)
        self._latest = -math.inf
        expressions = [event.when for event in events]
        self._quantities, self._expressions = _prepared(expressions, workspace)
        self._ahead = StepsAhead.of(stepper, INSIDE if events else ())
        self._screen = Screen(workspace, expressions, places_of(expressions)) if events and self._ahead else None
        self._pace = Lookahead()
        self._signs = [0] * len(events)
        self._recorded = workspace.t0
        self._found: list[Found] = []
        self._nodes: list[Nodes] = []
        self._steps: list[ConsecutiveSteps] = []
        self._parts: list[Stretch] = []
        self._failure: Failure | None = None
        self._values: list[float] | None = None
        self._sides = workspace.scratch.sides
        self._energy = np.zeros(2)
        self._ended: np.ndarray | None = None  # see `_side` at the end of the last step
        self._largest = [0.0] * len(events)
        self.stopped: Found | None = None
        self._worst_before = stepper.worst_pairs.copy()

    @property
    def counters(self) -> Counters:
        """Counters of steps and evaluations so far."""
        return self.stepper.counters

    @property
    def finished(self) -> bool:
        """Whether the run has reached its end time or an event that stops it."""
        return self.stepper.finished

    @property
    def failure(self) -> Failure | None:
        """Why the run stopped early, or None."""
        return self._failure or self.stepper.failure

    @property
    def worst_pairs(self) -> np.ndarray:
        """(P,) largest squared norm of Phi of each pair of rows so far; the part of a step after a stop is excluded."""
        return self.stepper.worst_pairs if self.stopped is None else self._worst_before

    @property
    def evidence(self) -> StepEvidence:
        """Quantities that the stepper has observed over its steps."""
        return self.stepper.evidence

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self.stepper.time

    def taken(self) -> list[Found]:
        """Return the crossings found since the last call, in order of time."""
        crossed, self._found = self._found, []
        return crossed

    def advance(self) -> Stretch:
        """Advance for about `STRETCH` seconds of wall time and return the rows to be recorded."""
        until = time.perf_counter() + interface.STRETCH
        parts: list[Stretch] = []
        self._parts = parts
        while True:
            part = self._several_steps()
            if len(part.time) or not parts:
                parts.append(part)
            is_over = self.finished or self.failure is not None or self.stepper.at_goal
            if is_over or time.perf_counter() > until:
                return joined(parts)

    def rows_before_error(self) -> Stretch | None:
        """See `Advancing.rows_before_error`."""
        return joined(self._parts) if self._parts else None

    def _several_steps(self) -> Stretch:
        """Advance by one step, or by several steps that certainly contain no event; return the rows."""
        ahead, pace = self._ahead, self._pace
        if ahead is None or pace.single > 0 or self._fired or not ahead.is_possible:
            pace.single = max(0, pace.single - 1)
            return self.step()
        states = ahead.take(min(pace.steps, ahead.most, self.stepper.steps_to_goal))
        ends = states.every(ahead.parts)
        taken = clear = len(ends.time) - 1
        if self._screen is not None and taken:
            clear = self._screen.clear_steps(states, self._signs, self._largest)
        part = ahead.keep(clear)
        if clear:
            self._steps.append(ConsecutiveSteps(*(x[: clear + 1] for x in ends)))
            self._values, self._ended = None, self._side(ends.v[clear], ends.z[clear])
        pace.took(clear, taken)
        return self._done(part)

    def step(self) -> Stretch:
        """Advance by one step, or by the part of it up to an event that sets states; return the rows."""
        if self._to_set:
            cast(Splitting, self.stepper).change(self._to_set)
            self._to_set = {}
        self._energy = cast(Splitting, self.stepper).energy.copy()
        self._worst_before[:] = self.stepper.worst_pairs
        stretch = self.stepper.advance()
        if self.stepper.last_step is not None:
            self._steps.append(self.stepper.last_step.ends)
        return self._done(self._look(stretch))

    def _done(self, part: Stretch) -> Stretch:
        self._nodes.append(self.stepper.taken_nodes())
        if len(part.time):
            self._recorded = float(part.time[-1])
        return part

    def last_state(self) -> Stretch:
        """Return the state reached as one row."""
        return self.stepper.last_state()

    def taken_nodes(self) -> Nodes:
        """Return the quadrature nodes of the steps since the last call; the part of a step after a stop is excluded."""
        nodes, self._nodes = self._nodes, []
        return Nodes.joined([*nodes, self.stepper.taken_nodes()])

    def taken_steps(self) -> list[ConsecutiveSteps]:
        """Return the steps since the last call; if an event has stopped the run, the last step ends at this event."""
        steps, self._steps = self._steps, []
        return steps

    def stored(self) -> dict[str, object]:
        """Return the state that is carried from step to step, as plain values for a checkpoint.

        All crossings must have been fetched by `taken`.
        """
        return {
            "signs": self._signs,
            "recorded": self._recorded,
            "values": self._values,
            "ended": self._ended,
            "largest": self._largest,
            "near": self._quantities.kept,
            "fired": [*self._fired.items()],
            "to_set": [*self._to_set.items()],
            "set_at": self._set_at,
            "latest": self._latest,
            "ahead": vars(self._pace),
        }

    def begin_again(self) -> None:
        """Forget that the run has ended and what it has not given yet; see `Stepper.begin_again`."""
        self.stopped = self._failure = None
        for kept in (self._found, self._nodes, self._steps):
            kept.clear()

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        if not len(state["signs"]) == len(state["largest"]) == len(self.events):
            raise ValueError("it has other events")
        self._signs = [int(sign) for sign in state["signs"]]
        self._recorded = float(state["recorded"])
        self._values = None if state["values"] is None else [float(value) for value in state["values"]]
        self._ended = state["ended"]
        self._largest = [float(value) for value in state["largest"]]
        fill(self._quantities.kept, state["near"])
        self._fired = {int(number): bool(sets) for number, sets in state["fired"]}
        self._to_set = {int(index): float(value) for index, value in state["to_set"]}
        self._set_at = [float(time) for time in state["set_at"]]
        self._latest = float(state["latest"])
        self._pace = Lookahead(**{name: int(number) for name, number in state["ahead"].items()})

    def _look(self, stretch: Stretch) -> Stretch:
        """Find the events of the last step; return its rows, up to an event that stops the run or sets states."""
        if (step := self.stepper.last_step) is None or not self.events:
            return stretch
        crossed: list[tuple[Crossing, int]] = []
        samples, before_jump = self._shown(step)
        signs, fired = [*self._signs], self._fired
        self._fired = {}
        accuracy = ACCURACY * max(1.0, abs(step.t1)) / (step.t1 - step.t0)
        for number, (event, shown) in enumerate(zip(self.events, samples, strict=True)):
            dense, exact = (self._scalar(number, state) for state in (self.stepper.inside, self.stepper.within))
            try:
                some, self._signs[number] = crossings(self._signs[number], shown, dense, exact, accuracy)
            except UndefinedError as error:
                where = f"has no finite value at t = {step.time(error.theta):.6g} s"
                self._failure = Failure("not-finite", f"the expression of event '{event.name}' {where}.")
                return stretch
            crossed += [(crossing, number) for crossing in some]
        counted = [(c, number) for c, number in crossed if c.direction in DIRECTIONS[self.events[number].direction]]
        acting = min((c.theta for c, number in counted if self._acts(number)), default=math.inf)
        near = closeness(step.t1) / (step.t1 - step.t0)
        acting = 0.0 if acting <= near else 1.0 if abs(acting - 1.0) <= near else acting  # no step is as short as that
        together = {number: c.direction for c, number in crossed if abs(c.theta - acting) <= near}
        for crossing, number in sorted(counted, key=lambda item: (min(item[0].theta, acting), self._stops(item[1]))):
            if crossing.theta > acting + near:
                continue
            self._latest = max(self._latest, step.time(min(crossing.theta, acting)))
            theta = min(crossing.theta, acting)
            state = self.stepper.within(theta) if theta or before_jump is None else before_jump
            at_jump = before_jump is not None and crossing.theta == 0.0 and samples[number][0][1] != 0.0
            record = Found(self.events[number].name, self._latest, crossing.direction, *state[:2], at_jump)
            self._found.append(record)
            if self._stops(number):
                self.stopped = record
                return self._cut(stretch, acting, before_jump)
        if acting == math.inf:
            return stretch
        values = self._values_of(acting, self.stepper.within)
        for number, before in enumerate(signs):
            value = self._expressions[number].value(values) if acting else samples[number][0][1]
            self._signs[number] = together.get(number, sign(value) or before)
        setting = [number for c, number in counted if number in together and self._changes[number] is not None]
        # an event that has crossed zero at this instant before does not cross again unless a jump changes its value
        self._fired = dict.fromkeys([*(fired if acting == 0.0 else ()), *together], False)
        return self._set(acting, list(dict.fromkeys(setting)))

    def _stops(self, number: int) -> bool:
        return self.events[number].action == "stop"

    def _acts(self, number: int) -> bool:
        return self._stops(number) or self._changes[number] is not None

    def _set(self, theta: float, setting: Sequence[int]) -> Stretch:
        """End the last step at the share `theta`, where the events with the indices `setting` set states before the
        next step; return the rows up to there.
        """
        begin = self.stepper.last_step
        assert begin is not None
        self._steps.pop()
        self.stepper.worst_pairs[:] = self._worst_before
        stretch, steps = cast(Splitting, self.stepper).split(theta)
        self._steps += [step.ends for step in steps]
        self._values = None
        if self.stepper.finished or self.stepper.failure is not None:
            self._fired.clear()
        else:
            state = steps[-1].between(1.0) if steps else begin.between(0.0)
            self._ended = self._side(*state[1:])
            for number in setting:
                self._fired[number] = True
                self._to_set |= self._change(number).values(self._latest, state)
        for number in setting:
            self._note_setting(number)
        return stretch

    def _change(self, number: int) -> _Change:
        change = self._changes[number]
        assert change is not None
        return change

    def _note_setting(self, number: int) -> None:
        change, t = self._change(number), self._latest
        since, self._set_at[number] = t - self._set_at[number], t
        what = f"event '{self.events[number].name}'"
        if change.undefined:
            state = change.undefined
            self._failure = Failure(
                "not-finite", f"the value of '{state}' that {what} sets is not finite at t = {t:.6g} s."
            )
        elif since < closeness(t):  # otherwise, ever shorter intervals would have no end
            self._failure = Failure(
                "zeno", f"{what} sets states again after less than {SIMULTANEOUS:.0g} s at t = {t:.10g} s; its "
                f"crossings would repeat without end."
            )  # fmt: skip

    def _side(self, v: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return values that differ at the two sides of a jump: velocities, first-order states, limits of motions."""
        return np.concatenate([v, z, self._sides])

    def _shown(self, step: StepTaken) -> tuple[list[list[tuple[float, float]]], Moment | None]:
        """Return, for each event, samples (position, value) of its scalar from the start to the end of a step, and
        the state before the jump after which the step begins, if there is one.
        """
        # Jumps: an impulse, a sample of a controller, an event that sets states, a discontinuity of a motion or load.
        before: list[float] = []  # quantities before a jump at the start of the step
        state: Moment | None = None
        ended = self._ended
        if ended is not None and (self._fired or not np.array_equal(ended, self._side(step.v0, step.z0))):
            v, z, _ = np.split(ended, np.cumsum([len(step.v0), len(step.z0)]))
            state = step.q0, v, z
            before = self._quantities.values([step.t0], step.q0[None], v[None], z[None])[0]
        if self._values is None or before:
            self._values = self._quantities.values([step.t0], step.q0[None], step.v0[None], step.z0[None])[0]
        states = [*(self.stepper.inside(theta) for theta in INSIDE), step.between(1.0)]
        q, v, z = (np.array([state[part] for state in states]) for part in range(3))
        rows = [self._values, *self._quantities.values([step.time(theta) for theta in (*INSIDE, 1.0)], q, v, z)]
        self._values, self._ended = rows[-1], self._side(step.v1, step.z1)
        points = list(zip((0.0, *INSIDE, 1.0), rows, strict=True))
        shown = []
        for number, (value, phases, breaks, is_product) in enumerate(self._expressions):
            sets = self._fired.get(number, False)
            close = self._close_points() if sets else []
            largest, every = self._largest[number], sorted([*points, *close])
            samples = refined(every, self._values_inside, value, phases, breaks, largest, is_product=is_product)
            if before:
                size = median([abs(x) for row in rows if math.isfinite(x := value(row))] or [0.0])
                samples[0] = 0.0, self._after_jump(number, value(before), samples[0][1], size, sets=sets)
            self._largest[number] = max(self._largest[number], *(abs(x) for _, x in samples if math.isfinite(x)), 0.0)
            shown.append(samples)
        return shown, state

    def _close_points(self) -> list[tuple[float, list[float]]]:
        """Return quantities at positions that approach the start of the last step."""
        step = self.stepper.last_step
        assert step is not None
        theta, points = CLOSER, []
        while theta * (step.t1 - step.t0) > CLOSER * closeness(step.t0):
            points.append((theta, self._values_of(theta, self.stepper.within)))
            theta *= CLOSER
        return points

    def _after_jump(self, number: int, before: float, value: float, size: float, *, sets: bool) -> float:
        """Return the scalar of an event right after a jump from its computed `value`.

        It is zero if it is zero up to rounding errors, and if the jump does not change it and is at a crossing of this
        event; it may then leave zero with the sign after that crossing. `before` is the value before the jump, and
        `size` a typical absolute value in the step after it. A change of sign due to states that the event itself
        `sets` is not a crossing.
        """
        is_zero = abs(value) <= ZERO * max(abs(before), size) or (number in self._fired and value == before)
        if sets:
            self._signs[number] = 0 if is_zero else sign(value)
        return 0.0 if is_zero else value

    def _values_inside(self, theta: float) -> list[float]:
        return self._values_of(theta, self.stepper.inside)

    def _values_of(self, theta: float, state: Callable[[float], Moment]) -> list[float]:
        step = self.stepper.last_step
        assert step is not None
        q, v, z = state(theta)
        return self._quantities.values([step.time(theta)], q[None], v[None], z[None])[0]

    def _scalar(self, number: int, state: Callable[[float], Moment]) -> Callable[[float], float]:
        return lambda theta: self._expressions[number].value(self._values_of(theta, state))

    def _cut(self, stretch: Stretch, theta: float, before_jump: Moment | None) -> Stretch:
        """End the run at the share `theta` of the last step; return the rows before, and the last one if missing."""
        begin, end = self._steps.pop().every(2), self.stepper.cut(theta)
        if before_jump is not None and theta == 0.0:
            q, v, z = (x[None] for x in before_jump)
            work, dissipated = self._energy[:, None]
            end = replace(end, q=q, v=v, z=z, work=work, dissipated=dissipated)
        if theta > 0.0:
            z = begin.z[:, :0] if end.z is None else end.z
            ends = zip(begin, (end.time, end.q, end.v, z), strict=True)
            self._steps.append(ConsecutiveSteps(*map(np.concatenate, ends)))
        kept = stretch.rows(stretch.time < end.time[0])
        if end.time[0] <= max([self._recorded, *kept.time]):
            return kept
        return joined([kept, end]) if len(kept.time) else end
