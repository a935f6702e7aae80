"""Measures for adjoint gradients: the derivatives of a measure with respect to the states from which it is computed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.acting import ANGLE
from mbdkit.engine.kernels.applied_forces import PATHWAYS
from mbdkit.engine.kernels.table_rows import JOINT, LAW_ROW, SPRING
from mbdkit.engine.native.calls import HAS_POTENTIAL
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.measures.reductions import Functional
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.quantity import Quantity
from mbdkit.quantities.states import States
from mbdkit.runs.continuous_motion import Peak
from mbdkit_gradients.derived_values import DerivedValue
from mbdkit_gradients.differentiated_run import DifferentiatedCrossing, PassedEvent
from mbdkit_gradients.differentiated_states import rate_of
from mbdkit_gradients.measured_derivatives import DerivedMeasure, MeasureEvaluation


class NotByAdjointError(Exception):
    """The adjoint does not give this gradient, for the reason that the message states as a clause."""


class Bars:
    """Derivatives of a measure with respect to T states of a part of the motion, and to what follows from them.

    `part`: number of the part of the motion; -1 for the end of the run, -2 - k for the stages of window k. See
    `mbdkit_gradients.kernels.adjoint.Given` for the other arrays.
    """

    def __init__(self, part: int, states: States, mechanism: CompiledMechanism):
        self.part, self.states, self.mechanism = part, states, mechanism
        top, count = mechanism.topology, len(states.time)
        self.q, self.v, self.acc = (np.zeros((count, mechanism.size)) for _ in range(3))
        self.reactions = np.zeros((count, len(top.pairs), 3))
        self.forces = np.zeros((count, len(top.springs), 4))
        self.kinetic, self.gravity = np.zeros(count), np.zeros(count)
        self.multipliers = np.zeros((count, len(top.pairs), 2))
        self.markers = np.zeros((count, *top.marker_points.shape))

    def rows(self, some: slice) -> Bars:
        """Return the derivatives with respect to some of the states."""
        whole, states = self.states, self.states
        states = States(
            whole.mechanism, whole.time[some], whole.q[some], whole.v[some], lambda: whole.observed.rows(some)
        )
        found = Bars(self.part, states, self.mechanism)
        for name in ("q", "v", "acc", "reactions", "forces", "kinetic", "gravity", "multipliers", "markers"):
            setattr(found, name, getattr(self, name)[some])
        return found

    def add(self, quantity: Quantity, given: np.ndarray) -> None:
        """Add derivatives (C, T) with respect to the components of a quantity; raise NotByAdjointError if unknown."""
        kind, array, part = quantity.kind, quantity.recorded.array.name, quantity.recorded.part
        top, names = self.mechanism.topology, archive_names(self.mechanism)
        of = cast("int", quantity.of.index(quantity.name, names)) if quantity.of.axis else 0  # only beams have slices
        own = np.zeros((len(self.states.time), 3))
        own[:, slice(0, 2) if part is None and len(given) == 2 else 0 if part is None else part] = (
            given.T if len(given) > 1 else given[0]
        )
        if kind == "bodies" and array in ("position", "velocity", "acceleration"):
            {"position": self.q, "velocity": self.v, "acceleration": self.acc}[array][:, 3 * of : 3 * of + 3] += own
        elif kind == "joints" and array in ("reaction_force", "reaction_torque"):
            columns = [0, 1] if array == "reaction_force" else [2]
            for pair in self.mechanism.joint_pairs[of]:
                self.reactions[:, pair, columns] += own[:, : len(columns)]
        elif kind == "joints" and array == "angle" and top.joints[of, JOINT.kind] == ANGLE:
            self.q[:, 3 * top.joints[of, JOINT.second] + 2] += given[0]
            self.q[:, 3 * top.joints[of, JOINT.first] + 2] -= given[0]
        elif kind == "joints" and array == "friction":
            if of in (joints := list(self.mechanism.friction)):
                sign = 1.0 if self.mechanism.joint_units[of] == "rad" else -1.0  # as in `States.friction`
                self.add_force(self.mechanism.first_friction + joints.index(of), "value", sign * given[0])
        elif kind == "forces" and array in ("length", "rate", "value", "power", "potential"):
            self.add_force(of, array, given[0])
        elif kind == "energy" and array in ("kinetic", "potential", "total"):
            if array != "potential":
                self.kinetic += given[0]
            if array != "kinetic":
                self.gravity += given[0]
                for k in np.flatnonzero(top.springs[:, SPRING.segments]):
                    law = top.springs[k, SPRING.law]
                    if law < 0 or top.laws[law, LAW_ROW.claims] & HAS_POTENTIAL:
                        self.forces[:, k, 3] += given[0]
        elif kind == "markers":
            self._add_marker(of, array, own[:, :2])
        else:
            raise NotByAdjointError(f"the measures contain {quantity}")

    def add_force(self, of: int, array: str, given: np.ndarray) -> None:
        """Add derivatives (T,) with respect to a quantity of a force element."""
        top, values = self.mechanism.topology, self.states.observed.forces[:, of]
        leaders = np.flatnonzero((top.force_place[: len(top.springs)] == of) & (top.springs[:, SPRING.segments] > 0))
        if len(leaders) != 1:
            raise NotByAdjointError(f"the measures contain a quantity of the load '{self.mechanism.forces[of].name}'")
        k = leaders[0]
        sign = -1.0 if top.springs[k, SPRING.pathway] == PATHWAYS["relative_angle"] else 1.0
        if array == "power":  # the negative product of tension and rate
            self.forces[:, k, 1] -= given * sign * values[:, 2]
            self.forces[:, k, 2] -= given * values[:, 1]
        else:
            column = ("length", "rate", "value", "potential").index(array)
            self.forces[:, k, column] += given * (sign if array == "value" else 1.0)

    def _add_marker(self, of: int, array: str, given: np.ndarray) -> None:
        top, n = self.mechanism.topology, 3 * self.mechanism.topology.markers[of]
        angle, spin = self.states.q[:, n + 2], self.states.v[:, n + 2]
        cos, sin = np.cos(angle), np.sin(angle)
        px, py = top.marker_points[of]
        x, y = cos * px - sin * py, sin * px + cos * py
        gx, gy = given.T
        if array == "velocity":
            self.v[:, n] += gx
            self.v[:, n + 1] += gy
            self.v[:, n + 2] += gy * x - gx * y
            gx, gy = spin * gy, -spin * gx  # derivatives with respect to the arm (x, y)
        else:
            self.q[:, n] += gx
            self.q[:, n + 1] += gy
        self.q[:, n + 2] += gy * x - gx * y
        self.markers[:, of] += np.stack([cos * gx + sin * gy, cos * gy - sin * gx], axis=-1)


class Columns:
    """Where derivatives with respect to the components of quantities are among other derivatives: the first ones.

    Parameters
    ----------
    quantities
        The quantities of an expression.
    """

    def __init__(self, quantities: Sequence[Quantity]):
        self._quantities = list(quantities)
        sizes = [2 if quantity.is_vector else 1 for quantity in quantities]
        self._first = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
        self.count = int(self._first[-1])  #: Number of components.

    def value(self, states: States, quantity: Quantity, count: int) -> DerivedValue:
        """Return a quantity in states, with `count` derivatives; raise NotByAdjointError if there are none."""
        if quantity.beam or (quantity.recorded.array.is_shared and states.mechanism.redundancy.rows):
            raise NotByAdjointError(f"the expressions contain {quantity}")
        take = quantity.taker(archive_names(states.mechanism))
        pieces = states.pieces() if isinstance(states, LongStates) else (states,)
        value = np.concatenate([np.asarray(take(piece)) for piece in pieces]).T
        first = int(self._first[self._quantities.index(quantity)])
        slope = np.zeros((count, *value.shape))
        for component in range(len(value) if value.ndim > 1 else 1):
            slope[(first + component, component) if value.ndim > 1 else first] = 1.0
        return DerivedValue(value, slope)

    def add(self, bars: Bars, given: np.ndarray) -> None:
        """Add derivatives (C, T) with respect to all components."""
        for quantity, first, end in zip(self._quantities, self._first, self._first[1:], strict=False):
            if np.any(given[first:end]):
                bars.add(quantity, given[first:end])


class Nodes(NamedTuple):
    """The stages of steps, in windows of these: their weights (T,) in integrals over time [s], and a function that
    returns their states, given the number of the window.
    """

    weights: Sequence[np.ndarray]
    states: Callable[[int], States]


@dataclass(frozen=True)
class LongStates(States):
    """States whose quantities are computed piece by piece, because those of all states would need much storage.

    `pieces`: function that returns the pieces, in order.
    """

    pieces: Callable[[], Iterable[States]] = tuple


MakeBars = Callable[[States | None], Bars]  #: Returns `Bars`, given states that are not stored.


@dataclass(frozen=True)
class _Read:
    """Where a reduction reads its operand: a part of the motion (see `Bars`), states if they are stored, weights (T,),
    and derivatives (C, T) of the operand with respect to the quantities.
    """

    part: int
    states: States | None
    weight: np.ndarray
    slope: np.ndarray


class AdjointMeasure(MeasureEvaluation):
    """A measure whose derivatives with respect to states are noted where reductions over time read them.

    The first derivatives of all values are those with respect to the components of the quantities; then follow those
    with respect to the times of events, and to the results of reductions.

    Parameters
    ----------
    run
        What `MeasureEvaluation` reads of a differentiated run.
    events, corners
        Events of the run, and the states before and after each discontinuity of a force law, in order of time.
    """

    def __init__(
        self,
        run: Any,
        states: Any,
        expression: MeasureExpression,
        events: Sequence[PassedEvent],
        corners: Sequence[Any],
    ):
        self._columns, self._corners = Columns(expression.quantities), corners
        reductions = sum(operation.startswith("over time") for operation, _ in expression.program)
        self._end_of_events = self._columns.count + len(events)
        self._next = self._end_of_events + len(corners)
        count = self._next + 2 * reductions
        self._times = slice(self._columns.count, self._next)
        units = np.eye(count)[self._columns.count : self._end_of_events]
        crossings = tuple(
            DifferentiatedCrossing(event.name, event.time, unit) for event, unit in zip(events, units, strict=True)
        )
        self._ends_at_event = bool(events) and events[-1].stops
        self._reads = list[tuple[int, _Read]]()
        run = SimpleNamespace(**run, end=units[-1] if self._ends_at_event else np.zeros(count), crossings=crossings)
        super().__init__(run, states, expression, np.zeros((len(expression.program), count)))

    def bars(self) -> tuple[DerivedMeasure, list[tuple[int, MakeBars]], np.ndarray]:
        """Return the measure without its slope, and its derivatives with respect to states of parts and windows, and
        to times of events.
        """
        derived = self.derived()
        bars: list[tuple[int, MakeBars]]
        bars = [(read.part, partial(self._bars, read, derived.slope[column])) for column, read in self._reads]
        return derived, bars, derived.slope[self._times]

    def _bars(self, read: _Read, factor: float, states: States | None) -> Bars:
        given = states or read.states
        assert given is not None
        one = Bars(read.part, given, self.run.rows.mechanism)
        self._columns.add(one, factor * read.weight * read.slope)
        return one

    def _quantity(self, states: Any, quantity: Quantity) -> DerivedValue:
        found = self._columns.value(states, quantity, self.count)
        if self._ends_at_event and states is self.run.rows:  # functions of time change the last state, whose time moves
            near, distance = cast("Any", self.states).held
            value = self._columns.value(near, quantity, self.count).value.T
            found.slope[self._end_of_events - 1, ..., -1] += rate_of(value, found.value[..., -1], distance)
        return found

    def _of_event(self, quantity: Quantity) -> DerivedValue:
        found = super()._of_event(quantity)
        if self.doubts:
            raise NotByAdjointError(self.doubts[0])
        return found

    def _noted(
        self, value: np.ndarray, reads: Sequence[tuple[int, States | None, np.ndarray, np.ndarray]]
    ) -> DerivedValue:
        """Return the result of a reduction, (1,) or (2, 1), and note where it reads its operand.

        `reads`: part, states, weights (T,) and derivatives (K, ..., T) of the operand.
        """
        slope = np.zeros((self.count, *value.shape))
        for component in range(len(value) if value.ndim > 1 else 1):
            for part, states, weight, slopes in reads:
                own = slopes[:, component] if value.ndim > 1 else slopes
                self._reads.append((self._next, _Read(part, states, weight, own[: self._columns.count])))
                # times of events, and other reductions, in the operand
                target = slope[:, component] if value.ndim > 1 else slope
                target[self._columns.count :, 0] += own[self._columns.count :] @ weight
            slope[(self._next, component) if value.ndim > 1 else self._next] = 1.0
            self._next += 1
        return DerivedValue(value, slope)

    def _reduction(self, index: int, name: str, number: int, operands: Sequence[DerivedValue]) -> DerivedValue:
        functional = self.expression.functionals[number - 1] if number else None
        if functional is None and name != "final":
            raise NotByAdjointError(f"'{self.expression.text}' needs the recorded rows")
        return super()._reduction(index, name, number, operands)

    def _at_end(self, value: DerivedValue) -> DerivedValue:
        """Return a value at the end of the run, which moves if an event ends the run."""
        *_, rows = cast("LongStates", self.run.rows).pieces()
        some = slice(-1, None)
        last = States(rows.mechanism, rows.time[some], rows.q[some], rows.v[some], lambda: rows.observed.rows(some))
        return self._noted(value.value, [(-1, last, np.ones(1), value.slope)])

    def _root(self, mean: DerivedValue, rows: DerivedValue) -> DerivedValue:
        if not np.any(mean.value != 0.0):
            raise NotByAdjointError("the operand of 'rms' is zero over the whole run")
        return super()._root(mean, rows)

    def _of_stages(self, index: int, square: bool) -> DerivedValue:
        nodes: Any = self.run.nodes
        found = [self._of_operand(index, nodes.states(k), square=square) for k in range(len(nodes.weights))]
        value, weight = np.concatenate([one.value for one in found], axis=-1), np.concatenate(nodes.weights)
        reads = [(-2 - k, None, weights, found[k].slope) for k, weights in enumerate(nodes.weights)]
        total = np.sum(value * weight, axis=-1, keepdims=True)
        return self._with_corners(self._noted(total, reads), index, square)

    def _with_corners(self, total: DerivedValue, index: int, square: bool) -> DerivedValue:
        """Return an integral with the derivatives by the times of discontinuities, at which the integrand may jump."""
        for number, states in enumerate(self._corners):
            sides = self._of_operand(index, states, square=square).value
            total.slope[self._end_of_events + number] += sides[..., :1] - sides[..., 1:]
        return total

    def _split(self, functional: Functional, index: int, square: bool) -> DerivedValue:
        total: np.ndarray | float = 0.0
        reads = []
        for number in range(len(self.run.motions[0].parts)):
            weight, states, values = self._at_nodes(functional, index, number, square=square)
            if self.doubts:
                raise NotByAdjointError(self.doubts[0])
            total = total + np.sum(values.value * weight, axis=-1, keepdims=True)
            reads.append((number, states, weight, values.slope))
        return self._with_corners(self._noted(np.asarray(total), reads), index, square)

    def _at_peak(self, number: int, peak: Peak, index: int) -> DerivedValue:
        corners = [part.span[0] for part in self.run.motions[0].parts if part.corner]
        if peak.switch >= 0 or peak.time in corners:
            raise NotByAdjointError(f"an extremum of '{self.expression.text}' is not smooth")
        if self._reads and self._peak_of == index:
            raise NotByAdjointError(f"an extremum of '{self.expression.text}' is attained at several times")
        self._peak_of = index
        return self._read_at(number, peak.time, index)

    _peak_of = -1

    def _read_at(self, number: int, time: float, index: int) -> DerivedValue:
        states = self.states.at(number, np.array([time]))
        here = self._of_operand(index, states)
        return self._noted(here.value, [(number, states, np.ones(1), here.slope)])

    def _at(self, functional: Functional | None, index: int, time: DerivedValue, operand: DerivedValue) -> DerivedValue:
        at = float(time.value.reshape(-1)[0])
        assert functional is not None
        number = self._part_at(functional, at)
        if number is None:
            return DerivedValue.constant(np.full((*operand.value.shape[:-1], 1), np.nan), self.count)
        moved = time.slope.reshape(self.count, time.value.size)[:, 0]
        if self._ends_at_event and at == self.run.rows.time[-1]:
            found = self._moved(self._at_end(operand[-1:]), number, at, index, moved - self.run.end)
            self._functionals[functional.text] = found
            return found
        if moved.any() and number != self._part_at(replace(functional, reduction="after"), at):
            raise NotByAdjointError("a time that the parameters change is that of a stop")
        found = self._moved(self._read_at(number, at, index), number, at, index, moved)
        self._functionals[functional.text] = found
        return found
