"""Detects the events of a run after every step."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from mbdkit.engine.counters import Counters
from mbdkit.engine.stored_arrays import fill
from mbdkit.engine.workspace import Workspace
from mbdkit.events.crossing import ACCURACY, Crossing, UndefinedError, crossings
from mbdkit.events.event_expression import CompiledExpression, RunExpression
from mbdkit.events.quantities import QuantityEvaluator
from mbdkit.events.sampling import INSIDE, refined
from mbdkit.stepping import interface
from mbdkit.stepping.interface import Failure, Moment, Nodes, StepEvidence, Stepper, StepTaken, Stretch, joined
from mbdkit.stepping.sampled_control import states_at_start

DIRECTIONS = {"any": (1, -1), "rising": (1,), "falling": (-1,)}


@dataclass(frozen=True)
class Watched:
    """An event to detect.

    Parameters
    ----------
    when
        Expression whose zero crossings are detected.
    direction
        Direction of the crossings that count.
    action
        Whether the run continues (``note``) or ends (``stop``) at a crossing.
    """

    name: str
    when: RunExpression
    direction: Literal["any", "rising", "falling"]
    action: Literal["note", "stop"]


@dataclass(frozen=True)
class Found:
    """One crossing: name of the event, time [s], direction (1 or -1), and positions and velocities (3 (B + 1),)."""

    name: str
    time: float
    direction: int
    q: np.ndarray
    v: np.ndarray

    def __str__(self) -> str:
        way = "upwards" if self.direction > 0 else "downwards"
        return f"'{self.name}' crossed zero {way} at t = {self.time:.10g} s"


def values_at_start(expressions: Mapping[str, RunExpression], workspace: Workspace) -> dict[str, float]:
    """Return the values of expressions at the start of a run; nan for undefined ones."""
    evaluator, compiled = _prepared(list(expressions.values()), workspace)
    values = evaluator.values([workspace.t0], workspace.q0[None], workspace.v0[None], states_at_start(workspace)[None])[
        0
    ]
    return {name: one.value(values) for name, one in zip(expressions, compiled, strict=True)}


def _prepared(
    expressions: Sequence[RunExpression], workspace: Workspace
) -> tuple[QuantityEvaluator, list[CompiledExpression]]:
    """Return an evaluator of the quantities of all expressions, and the expressions as functions of its values."""
    quantities = list(dict.fromkeys(quantity for expression in expressions for quantity in expression.quantities))
    places = {quantity: index for index, quantity in enumerate(quantities, start=1)}
    return QuantityEvaluator(workspace, quantities), [expression.compiled(places) for expression in expressions]


class Watch:
    """Wraps a stepper to detect events, to end the run at an event with the action ``stop``, and to keep all steps.

    Parameters
    ----------
    stepper
        The stepper, started with ``Timetable.single``.

    Attributes
    ----------
    stopped
        Crossing that ended the run, or None.
    """

    def __init__(self, stepper: Stepper, workspace: Workspace, events: Sequence[Watched]):
        self.stepper, self.events = stepper, events
        self._quantities, self._expressions = _prepared([event.when for event in events], workspace)
        self._signs = [0] * len(events)
        self._recorded = workspace.t0
        self._found: list[Found] = []
        self._nodes: list[Nodes] = []
        self._steps: list[StepTaken] = []
        self._raised: Exception | None = None
        self._failure: Failure | None = None
        self._values: list[float] | None = None
        self._ended: np.ndarray | None = None  # velocities at the end of the last step
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
        """(P,) largest squared norm of Phi of each pair of rows so far; excludes the part of a step after a stop."""
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
        found, self._found = self._found, []
        return found

    def advance(self) -> Stretch:
        """Advance for about `STRETCH` seconds of wall time and return the rows to be recorded.

        If the method raises an exception after some steps, their rows are returned first and the next call raises it.
        """
        if self._raised is not None:
            raise self._raised
        until = time.perf_counter() + interface.STRETCH
        parts: list[Stretch] = []
        while True:
            self._worst_before[:] = self.stepper.worst_pairs
            try:
                stretch = self.stepper.advance()
                if self.stepper.last_step is not None:
                    self._steps.append(self.stepper.last_step)
                part = self._look(stretch)
            except Exception as error:
                if not parts:
                    raise
                self._raised = error
                break
            self._nodes.append(self.stepper.taken_nodes())
            if len(part.time):
                self._recorded = float(part.time[-1])
            if len(part.time) or not parts:
                parts.append(part)
            if self.finished or self.failure is not None or time.perf_counter() > until:
                break
        return joined(parts)

    def last_state(self) -> Stretch:
        """Return the state reached as one row."""
        return self.stepper.last_state()

    def taken_nodes(self) -> Nodes:
        """Return the quadrature nodes of the steps since the last call; excludes the part of a step after a stop."""
        taken, self._nodes = self._nodes, []
        return Nodes.joined([*taken, self.stepper.taken_nodes()])

    def taken_steps(self) -> list[StepTaken]:
        """Return the steps since the last call; the last one ends at the event that stops the run."""
        steps, self._steps = self._steps, []
        return steps

    def stored(self) -> dict[str, Any]:
        """Return the state that is kept between steps, as plain values for a checkpoint; all crossings must have been
        fetched.
        """
        return {
            "signs": self._signs,
            "recorded": self._recorded,
            "values": self._values,
            "ended": self._ended,
            "largest": self._largest,
            "near": self._quantities.kept,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a checkpoint; raise ValueError if its values do not fit."""
        if not len(state["signs"]) == len(state["largest"]) == len(self.events):
            raise ValueError("it has other events")
        self._signs = [int(sign) for sign in state["signs"]]
        self._recorded = float(state["recorded"])
        self._values = None if state["values"] is None else [float(value) for value in state["values"]]
        self._ended = state["ended"]
        self._largest = [float(value) for value in state["largest"]]
        fill(self._quantities.kept, state["near"])

    def _look(self, stretch: Stretch) -> Stretch:
        """Find the events of the last step; return its rows, truncated at an event that stops the run."""
        step = self.stepper.last_step
        if step is None or not self.events:
            return stretch
        found: list[tuple[Crossing, Watched]] = []
        for number, (event, shown) in enumerate(zip(self.events, self._shown(step), strict=True)):
            dense, exact = (self._scalar(number, state) for state in (self.stepper.inside, self.stepper.within))
            accuracy = ACCURACY * max(1.0, abs(step.t1)) / (step.t1 - step.t0)
            try:
                places, self._signs[number] = crossings(self._signs[number], shown, dense, exact, accuracy)
            except UndefinedError as error:
                where = f"has no finite value at t = {step.time(error.theta):.6g} s"
                self._failure = Failure("not-finite", f"the expression of event '{event.name}' {where}.")
                return stretch
            found += [(place, event) for place in places if place.direction in DIRECTIONS[event.direction]]
        for place, event in sorted(found, key=lambda item: (item[0].theta, item[1].action == "stop")):
            one = Found(event.name, step.time(place.theta), place.direction, *self.stepper.within(place.theta)[:2])
            self._found.append(one)
            if event.action == "stop":
                self.stopped = one
                return self._cut(stretch, place.theta)
        return stretch

    def _shown(self, step: StepTaken) -> list[list[tuple[float, float]]]:
        """Return, for each event, samples (position, value) of its scalar from the start to the end of a step."""
        begin = np.concatenate([step.v0, step.z0])
        if self._values is None or self._ended is None or not np.array_equal(self._ended, begin):
            # at the start, after an impulse, or after a sample of a controller
            self._values = self._quantities.values([step.t0], step.q0[None], step.v0[None], step.z0[None])[0]
        states = [*(self.stepper.inside(theta) for theta in INSIDE), step.between(1.0)]
        q, v, z = (np.array([state[part] for state in states]) for part in range(3))
        rows = [self._values, *self._quantities.values([step.time(theta) for theta in (*INSIDE, 1.0)], q, v, z)]
        self._values, self._ended = rows[-1], np.concatenate([step.v1, step.z1])
        points = list(zip((0.0, *INSIDE, 1.0), rows, strict=True))
        shown = []
        for number, (value, phases, breaks) in enumerate(self._expressions):
            samples = refined(points, self._values_inside, value, phases, breaks, self._largest[number])
            self._largest[number] = max(self._largest[number], *(abs(x) for _, x in samples if math.isfinite(x)), 0.0)
            shown.append(samples)
        return shown

    def _values_inside(self, theta: float) -> list[float]:
        """Return the quantities at a position in the last step, by dense output."""
        return self._values_of(theta, self.stepper.inside)

    def _values_of(self, theta: float, state: Callable[[float], Moment]) -> list[float]:
        step = self.stepper.last_step
        assert step is not None
        q, v, z = state(theta)
        return self._quantities.values([step.time(theta)], q[None], v[None], z[None])[0]

    def _scalar(self, number: int, state: Callable[[float], Moment]) -> Callable[[float], float]:
        """Return the scalar of an event as a function of the position in the last step, with states from `state`."""
        return lambda theta: self._expressions[number].value(self._values_of(theta, state))

    def _cut(self, stretch: Stretch, theta: float) -> Stretch:
        """End the run at `theta`; return the rows before it and the final row, unless that is recorded already."""
        step, end = self._steps.pop(), self.stepper.cut(theta)
        if theta > 0.0:
            self._steps.append(replace(step, t1=float(end.time[0]), q1=end.q[0], v1=end.v[0]))
        kept = stretch.rows(stretch.time < end.time[0])
        if end.time[0] <= max([self._recorded, *kept.time]):
            return kept
        return joined([kept, end]) if len(kept.time) else end
