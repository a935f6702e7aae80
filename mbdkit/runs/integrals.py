"""Time integrals, extrema, and values at given times for measures, computed during the run.

For a smooth integrand, the weighted sum of its values at the stages is what the method would compute for an additional
equation ``z' = f(t, q, v)``. The integral therefore has the order of the method, however few states are recorded.
Integrals with `abs`, `min` or `max`, extrema, and values at given times are computed from the motion between the ends
of steps; see `mbdkit.runs.continuous_motion`.

An integrand that contains other integrals, as in ``rms(x - mean(x))``, can be evaluated only at the end of the run.
Until then, the values of its quantities are stored at all nodes (times of stages), or at the ends of all steps.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import chain

import numpy as np

from mbdkit.archive.checkpoint import StoredState
from mbdkit.archive.measured_values import Integrals
from mbdkit.archive.peak_errors import expression_of_largest
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Nodes, Timetable
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.measures.reductions import EventTimes, Functional, Series
from mbdkit.mechanism.joints import Distance, Revolute
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.quantity import Quantity
from mbdkit.quantities.registered_kinds import Peaks
from mbdkit.quantities.states import States
from mbdkit.runs.continuous_functionals import ContinuousFunctionals, no_events
from mbdkit.runs.continuous_motion import observed_at
from mbdkit.runs.law_ranges import steps_are_rows
from mbdkit.spec import RunSpec

#: Largest number of joints whose largest forces are determined between rows if every step is recorded.
#:
#: Each force is searched for separately, which takes a time proportional to the number of joints: for a chain of 150
#: rods with 150 steps, these searches take longer than the rest of the check.
MOST_JOINTS = 100

MOST_COMPARED = 4  #: Largest number of elements of a kind whose largest forces have errors.

#: Number of nodes that are summed together.
#:
#: It is fixed, because sums must not depend on the number of steps between two calls, which varies with wall time.
BLOCK = 1024


def expressions_of(spec: RunSpec, expressions: Iterable[str] = ()) -> tuple[str, ...]:
    """Return the expressions of the measures of a run, followed by the given ones."""
    texts = [*(measure.expression for measure in spec.defined_measures() if measure.item is None), *expressions]
    return tuple(dict.fromkeys(texts))


def largest_loads_of(spec: RunSpec, peaks: Iterable[Peaks]) -> tuple[str, ...]:
    """Return expressions of the largest loads of a checked run, to determine what its rows miss between them.

    These are the largest force and torque of each joint that is recorded, except those that are always zero, and the
    quantities of further elements in `peaks`; see `mbdkit.archive.peak_errors`. If there are more than
    `MOST_JOINTS` joints and every step is recorded, peaks between rows are estimated by interpolation of the rows.

    """
    if not spec.estimates_errors:
        return ()
    joints = spec.mechanism().joints if "joints" in spec.recorded else {}
    if steps_are_rows(spec) and len(joints) > MOST_JOINTS:
        joints = {}
    loads = {
        "joints.force": [name for name, joint in joints.items() if joint.rows != ("angle",)],
        "joints.torque": [
            name
            for name, joint in joints.items()
            if not isinstance(joint, Revolute | Distance) or getattr(joint, "friction", None) is not None
        ],
    }
    loads |= {quantity: of_kind.names for of_kind in peaks for quantity in of_kind.quantities}
    return tuple(expression_of_largest(quantity, name) for quantity, names in loads.items() for name in names)


def compared_loads(spec: RunSpec, integrals: Integrals, peaks: Iterable[Peaks]) -> tuple[str, ...]:
    """Return expressions of the largest loads whose errors are estimated from comparison runs, like those of measures.

    These are the first quantities of `peaks`, of the elements with the largest ones. The forces of joints have errors
    in every row, and those of elements whose impacts are not located include impulses.

    `integrals`: integrals and extrema of the run.
    """
    chosen, compared = spec.reacting, list[str]()
    for kind in peaks:
        if chosen is None or chosen.key != kind.of or not chosen.item.includes_impacts:
            texts = [expression_of_largest(kind.quantities[0], name) for name in kind.names]
            largest = {text: force for text in texts if isinstance(force := integrals.get(text), float) and force > 0.0}
            compared += sorted(largest, key=lambda text: -largest[text])[:MOST_COMPARED]
    return tuple(compared)


def functionals_of(spec: RunSpec, expressions: Iterable[str] = ()) -> tuple[Functional, ...]:
    """Return the integrals, extrema and values at given times that the measures of a run need.

    `expressions`: expressions of further measures, in addition to those of the spec. Raises SpecError if an expression
    is not valid for the spec.
    """
    functionals = (MeasureExpression.functionals_of(text, spec) for text in expressions_of(spec, expressions))
    return tuple({functional.text: functional for functional in chain.from_iterable(functionals)}.values())


class RunIntegrals:
    """Integrals over time, extrema, and values at given times of quantities of one run.

    `workspace`: the mechanism at its start. Accelerations and reactions are computed with pivots that the stepper does
    not use. `functionals`: the integrals, extrema and values to compute. `timetable`: the times of the run.
    `suits_stiff`: whether the method is intended for stiff mechanisms. `is_controlled`: whether its step size is
    controlled, so that steps end where forces switch.
    """

    def __init__(
        self,
        workspace: Workspace,
        functionals: Sequence[Functional],
        timetable: Timetable,
        *,
        suits_stiff: bool,
        is_controlled: bool,
    ):
        self.functionals = functionals
        self._workspace = workspace.with_own_pivots()
        # First-order states at the stages are not stored; if there are any, integrals use the ends of steps instead.
        has_states = bool(workspace.mechanism.states)
        others = [functional for functional in functionals if has_states or not functional.is_of_stages]
        #: Functionals that are computed from the motion between the ends of steps; None if there are none.
        self.continuous: ContinuousFunctionals | None = None
        if others:
            self.continuous = ContinuousFunctionals(
                workspace, others, timetable, uses_accelerations=not suits_stiff, is_controlled=is_controlled
            )
        self._observer = StateObserver(self._workspace)
        mechanism = workspace.mechanism
        self._names = archive_names(mechanism)
        self._waiting = [Nodes.none(mechanism.size)]
        of_stages = [] if has_states else [functional for functional in functionals if functional.is_of_stages]
        self._direct = [functional for functional in of_stages if not functional.is_nested]
        self._nested = [functional for functional in of_stages if functional.is_nested]
        self._sums: list[np.ndarray] | None = None
        self._low: list[np.ndarray] = []
        self._read = tuple(dict.fromkeys(quantity for functional in self._nested for quantity in functional.read))
        self._kept: list[list[np.ndarray]] = []

    @property
    def needs_nodes(self) -> bool:
        """Whether any of the integrals needs the states at the stages of the steps."""
        return bool(self._direct or self._nested)

    def add(self, nodes: Nodes) -> None:
        """Add the nodes of further steps."""
        self._waiting.append(nodes)
        if sum(len(waiting.time) for waiting in self._waiting) >= BLOCK:
            self._take(whole=True)

    def totals(self, events: EventTimes = no_events, deadline: float = math.inf) -> Integrals:
        """Return the values of all functionals by their source text, in SI units; nan where undefined.

        `events`: function that returns quantities of the events of the run. `deadline`: when the wall time of the run
        is over (`time.perf_counter`); nested functionals that are not known then are nan.
        """
        self._take(whole=False)
        totals: dict[str, float | tuple[float, ...]] = {}
        for functional, total in zip(self._direct, self._sums or [np.zeros(1)] * len(self._direct), strict=True):
            totals[functional.text] = _plain(total)
        if self.continuous is not None:
            totals |= {text: _plain(total) for text, total in self.continuous.totals().items()}
        time, weight, *values = self._joined_kept()
        series, duration = Series(time, dict(zip(self._read, values, strict=True)).__getitem__), float(weight.sum())
        for functional in self.functionals:  # inner functionals come before those that contain them
            if functional in self._nested:
                at_nodes = functional.values(series, totals, duration)
                totals[functional.text] = _plain(np.atleast_1d(np.sum(at_nodes * weight, axis=-1)))
            elif functional.is_nested and self.continuous is not None:
                totals[functional.text] = _plain(self.continuous.nested(functional, totals, events, deadline))
        return {functional.text: totals[functional.text] for functional in self.functionals}

    def stored(self) -> StoredState:
        """Return the sums and the waiting nodes as plain values, for a checkpoint."""
        waiting = Nodes.joined(self._waiting)
        return {
            "texts": [functional.text for functional in self.functionals],
            "sums": self._sums,
            "low": self._low,
            "waiting": [waiting.time, waiting.weight, waiting.q, waiting.v],
            "kept": self._joined_kept(),
            "continuous": None if self.continuous is None else self.continuous.stored(),
        }

    def restore(self, state: StoredState) -> None:
        """Continue from a checkpoint; raise ValueError if it is not valid for this run."""
        sums, low, size = state["sums"], state["low"], self._workspace.mechanism.size
        if state["texts"] != [functional.text for functional in self.functionals]:
            raise ValueError("it has other integrals")
        waiting = Nodes(*state["waiting"])
        count = len(waiting.time)
        shapes = [x.shape for x in (waiting.time, waiting.weight, waiting.q, waiting.v)]
        if shapes != [(count,), (count,), (count, size), (count, size)]:
            raise ValueError("its nodes have other shapes")
        if sums is not None and not len(sums) == len(low) == len(self._direct):
            raise ValueError("it has other integrals")
        kept, empty = list(state["kept"]), self._joined_kept()
        if [x.shape[:-1] for x in kept] != [x.shape[:-1] for x in empty] or len({x.shape[-1] for x in kept}) > 1:
            raise ValueError("its nodes have other shapes")
        self._waiting, self._sums, self._low, self._kept = [waiting], sums, list(low), [kept]
        if self.continuous is not None:
            self.continuous.restore(state["continuous"])

    def _take(self, *, whole: bool) -> None:
        """Sum the waiting nodes in blocks; if `whole`, nodes that do not fill a block remain waiting."""
        nodes = Nodes.joined(self._waiting)
        count = len(nodes.time)
        done = count - count % BLOCK if whole else count
        for first in range(0, done, BLOCK):
            self._add_block(nodes.part(slice(first, min(first + BLOCK, done))))
        self._waiting = [nodes.part(slice(done, None))]

    def _joined_kept(self) -> list[np.ndarray]:
        if not self._kept:
            return [np.zeros(0), np.zeros(0), *map(self._none_of, self._read)]
        return [np.concatenate(x, axis=-1) for x in zip(*self._kept, strict=True)]

    def _none_of(self, quantity: Quantity) -> np.ndarray:
        """Return the values of a quantity at no nodes, with the shape of the quantity."""
        if quantity.beam:
            elements = self._workspace.mechanism.beam_elements(quantity.beam)
            return np.zeros((elements.stop - elements.start, 0))
        return np.zeros((2, 0) if quantity.is_vector else 0)

    def _add_block(self, nodes: Nodes) -> None:
        time, q, v = (np.ascontiguousarray(x) for x in (nodes.time, nodes.q, nodes.v))
        mechanism, none = self._workspace.mechanism, np.zeros((len(time), 0))
        states = States(mechanism, time, q, v, lambda: observed_at(self._observer, time, q, v, none))
        series = Series(time, lambda quantity: quantity.taker(self._names)(states).T)
        values = [functional.values(series, {}, 0.0) for functional in self._direct]
        values = [np.broadcast_to(x, (*x.shape[:-1], len(time))) for x in values]
        if self._nested:
            self._kept.append([time, nodes.weight, *map(series.of, self._read)])
        gains = [np.atleast_1d(np.sum(x * nodes.weight, axis=-1)) for x in values]
        if self._sums is None:
            self._sums, self._low = ([np.zeros_like(x) for x in gains] for _ in range(2))
        for index, gain in enumerate(gains):  # compensated summation
            y = gain + self._low[index]
            total = self._sums[index] + y
            self._low[index], self._sums[index] = y - (total - self._sums[index]), total


def _plain(total: np.ndarray) -> float | tuple[float, ...]:
    return tuple(total.tolist()) if len(total) > 1 else float(total[0])
