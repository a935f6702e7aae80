"""Measures of a run with their derivatives with respect to parameters: the expressions are evaluated on values with
derivatives.

Reductions over time are evaluated on the recorded states (*rows*), on the stages of the steps, or on the continuous
motion, as in runs. The points at which an integrand changes its form, and the time of an extremum, depend on the
parameters. The contributions of these points cancel where the integrand is continuous. At a smooth extremum, the value
does not depend on the time to first order. At other extrema, the derivative of the time is ``-g_p / g_t`` for the
scalar g that changes sign there, where g_p is its derivative with respect to the parameter and g_t its rate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mbdkit.archive.measured_values import Integrals
from mbdkit.base import elementary
from mbdkit.expressions.operations import REDUCE, arity_of
from mbdkit.expressions.program import execute
from mbdkit.integrators.duals.dual_run import Seeds
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.measures.reductions import Functional
from mbdkit.quantities.quantity import Quantity
from mbdkit.runs.continuous_motion import EQUAL, Peak, Sampled, sampled
from mbdkit_gradients.derivative_doubts import AT_ZERO, LIMIT_POINTS, SMOOTH, DoubtedMeasure, switch_of
from mbdkit_gradients.derived_values import DerivedValue, of_operands
from mbdkit_gradients.differentiated_expressions import slopes_of
from mbdkit_gradients.differentiated_motion import DifferentiatedMotion, MotionStates
from mbdkit_gradients.differentiated_run import DifferentiatedRun, Needs
from mbdkit_gradients.differentiated_states import DifferentiatedStates, joined_states, one_after_another, quantity_of
from mbdkit_gradients.sided_stepper import LawCorner

BESIDE = 0.05  #: The limit on one side of a point is extrapolated from values within this share of a step.


def needs_of(expression: MeasureExpression) -> Needs:
    """Return the data that a measure needs in addition to the recorded states."""
    found = expression.functionals
    return Needs(any(one.is_of_stages for one in found), any(not one.is_of_stages for one in found))


class DerivedMeasure(NamedTuple):
    """A measure of a differentiated run.

    Attributes
    ----------
    value, slope
        The measure and its derivatives (K,), in its unit.
    size
        Largest absolute value to which functions over time were applied, in the unit of the measure.
    doubts
        Warnings about derivatives that do not exist.
    remarks
        Extrema that are at the end of the run, as clauses.
    """

    value: float
    slope: np.ndarray
    size: float
    doubts: tuple[str, ...]
    remarks: tuple[str, ...]


def derived_measures(
    run: DifferentiatedRun, expressions: Mapping[str, MeasureExpression], seeds: Seeds
) -> dict[str, DerivedMeasure]:
    """Return the measures of a run by name, with their derivatives.

    Parameters
    ----------
    seeds
        Derivatives of the numbers in the expressions with respect to the parameters of the run.
    """
    states = MotionStates(run.motions)
    _keep_shared_states(run, states, expressions.values())
    return {
        name: MeasureEvaluation(run, states, one, slopes_of(one.program, seeds, f"measures.{name}")).derived()
        for name, one in expressions.items()
    }


def _keep_shared_states(run: DifferentiatedRun, states: MotionStates, expressions: Iterable[MeasureExpression]) -> None:
    """Evaluate together the states between the steps that several measures use.

    These are the states at given times, and those of the quadrature of integrals in steps that no point divides.
    """
    functionals = [functional for expression in expressions for functional in expression.functionals]
    span = float(run.rows.time[0]), float(run.rows.time[-1])
    values = [one.time({}, span, lambda _: np.nan) for one in functionals if one.is_value and not one.is_nested]
    split = sum(functional.reduction == "integral" and not functional.is_of_stages for functional in functionals)
    if not run.motions or max(len(values), split) < 2:
        return
    for number, part in enumerate(run.motions[0].parts):
        begin, end = part.span
        time = [np.array([value for value in values if begin <= value <= end])]
        if split > 1:
            time.append(part.plain.nodes)
        states.keep(number, np.concatenate(time))


class MeasureEvaluation(DoubtedMeasure):
    """The evaluation of one measure.

    Parameters
    ----------
    states
        The states between the steps.
    slopes
        (I, K) derivatives of the numbers in the I instructions of the expression.
    """

    def __init__(self, run: DifferentiatedRun, states: MotionStates, expression: MeasureExpression, slopes: np.ndarray):
        super().__init__(run, expression)
        self.states = states
        self.slopes, self.count = slopes, slopes.shape[1]
        self._begins = _begins(expression)
        self._reduced: dict[int, DerivedValue] = {}  # by index of the instruction
        self._functionals: dict[str, DerivedValue] = {}  # by source text
        self._largest_term = 0.0  # largest term of the derivative of an extremum
        self._duration = run.rows.time[-1] - run.rows.time[0]

    def derived(self) -> DerivedMeasure:
        """Return the measure with its derivatives."""
        with np.errstate(all="ignore"):
            found = self._series(0, len(self.expression.program), self.run.rows)
        factor = self.expression.unit.factor
        return DerivedMeasure(
            float(found.value.reshape(-1)[0]) / factor,
            found.slope.reshape(self.count, found.value.size)[:, 0] / factor,
            self.size / factor,
            tuple(dict.fromkeys(self.doubts)),
            tuple(dict.fromkeys(self.remarks)),
        )

    def _series(
        self, begin: int, end: int, states: DifferentiatedStates, switches: list[DerivedValue] | None = None
    ) -> DerivedValue:
        """Return the value of some instructions in T states: (T,), (2, T) or, without quantities over time, (1,).

        Parameters
        ----------
        switches
            List to which the switches are appended: scalars whose sign determines the form of an operation, in the
            order of `Functional.values_and_switches`.
        """
        place = iter(range(begin, end))
        are_rows = states is self.run.rows

        def step(operation: str, number: float, *operands: DerivedValue) -> DerivedValue:
            index = next(place)
            if operation == "const":
                return DerivedValue.number(number, self.slopes[index])
            if operation == "t":
                time = DerivedValue.constant(states.time, self.count)
                if are_rows:
                    time.slope[:, -1] = self.run.end
                return time
            if operation == "get":
                quantity = self.expression.quantities[int(number)]
                return self._of_event(quantity) if quantity.kind == "events" else self._quantity(states, quantity)
            if operation.startswith(REDUCE):
                if index not in self._reduced:
                    self._reduced[index] = self._reduction(index, operation.removeprefix(REDUCE), int(number), operands)
                return self._reduced[index]
            if are_rows:
                self._note_corner(operation, operands)
            found = None if switches is None else switch_of(operation, operands)
            if switches is not None and found is not None and found.value.shape[-1] == len(states.time):
                switches.append(found)
            return of_operands(operation, number, *operands)

        return execute(self.expression.program[begin:end], step)

    def _quantity(self, states: DifferentiatedStates, quantity: Quantity) -> DerivedValue:
        return quantity_of(states, quantity)

    def _reduction(self, index: int, name: str, number: int, operands: Sequence[DerivedValue]) -> DerivedValue:
        """Return the value of the reduction over time at this index of the program.

        `operands` are the values of its operands in the rows.
        """
        rows = operands[0]
        functional = self.expression.functionals[number - 1] if number else None
        self.size = max(self.size, float(np.max(np.abs(rows.value))))
        if name == "at":
            return self._at(functional, index, operands[1], rows)
        if name == "final":
            return self._at_end(rows[-1:])
        if functional is not None and (self.run.nodes is None if functional.is_of_stages else not self.run.motions):
            functional = None  # inverse dynamics has rows only
        if name in ("max", "min"):
            if functional is None:
                return self._extremum(name, rows)
            found = self._peak(functional, index, rows)
            self._functionals[functional.text] = found
            return found
        total = self._integral(functional, index, rows, square=name == "rms")
        if functional is not None:
            self._functionals[functional.text] = total
        if name == "integral":
            return total
        mean = of_operands("div", 0.0, total, DerivedValue(np.array([self._duration]), self.run.end[:, None]))
        return self._root(mean, rows) if name == "rms" else mean

    def _at_end(self, value: DerivedValue) -> DerivedValue:
        """Return the value of a quantity in the last row, whose time changes if an event ends the run."""
        return value

    def _root(self, mean: DerivedValue, rows: DerivedValue) -> DerivedValue:
        """Return the root of a mean square; add a warning if the root is zero but its derivatives are not."""
        if np.any(mean.value != 0.0):
            return of_operands("sqrt", 0.0, mean)
        if not rows.slope.any():
            return DerivedValue.constant(mean.value, self.count)
        self._note_sides("the operand of 'rms' is zero over the whole run", "use mean(x**2), which has one")
        return DerivedValue(mean.value, np.full_like(mean.slope, np.nan))

    def _of_operand(
        self,
        index: int,
        states: DifferentiatedStates,
        *,
        square: bool = False,
        switches: list[DerivedValue] | None = None,
    ) -> DerivedValue:
        """Return the operand of a reduction in T states, (T,) or (2, T)."""
        is_value = self.expression.program[index][0] == REDUCE + "at"  # the second operand of `at` is a time
        found = self._series(self._begins[index], self._begins[index - 1] if is_value else index, states, switches)
        found = of_operands("mul", 0.0, found, found) if square else found
        shape = (*found.value.shape[:-1], len(states.time))
        return DerivedValue(np.broadcast_to(found.value, shape), np.broadcast_to(found.slope, (self.count, *shape)))

    # --- integrals

    def _integral(self, functional: Functional | None, index: int, rows: DerivedValue, *, square: bool) -> DerivedValue:
        """Return an integral over time, (1,), or (2, 1) of a vector."""
        rows = of_operands("mul", 0.0, rows, rows) if square else rows
        if functional is None:
            time = self.run.rows.time
            total = DerivedValue(
                np.trapezoid(rows.value, time, axis=-1)[..., None], np.trapezoid(rows.slope, time, axis=-1)[..., None]
            )
            last = 0.5 * (rows.value[..., -2:-1] + rows.value[..., -1:])
        else:
            total = (
                self._of_stages(index, square) if functional.is_of_stages else self._split(functional, index, square)
            )
            last = rows.value[..., -1:]
        return DerivedValue(total.value, total.slope + np.multiply.outer(self.run.end, last))

    def _of_stages(self, index: int, square: bool) -> DerivedValue:
        """Return an integral as a sum over the stages with the weights of the method."""
        nodes = self.run.nodes
        assert nodes is not None
        assert nodes.weight is not None
        return _weighted(self._of_operand(index, nodes, square=square), nodes.weight)

    def _split(self, functional: Functional, index: int, square: bool) -> DerivedValue:
        """Return an integral over the continuous motion, divided where the integrand changes its form."""
        total: DerivedValue | None = None
        for number, part in enumerate(self.run.motions[0].parts):
            weight, _, values = self._at_nodes(functional, index, number, square=square)
            piece = _weighted(values, np.column_stack([weight, np.zeros((len(weight), self.count))]))
            # the integrand may be discontinuous where the part begins, at a time that depends on the parameters
            if part.corner is not None:
                moved = self._moved_corner(number)
                sides = self._of_operand(index, self._at_corner(number), square=square).value
                piece = DerivedValue(
                    piece.value, piece.slope + np.multiply.outer(moved, sides[..., :1] - sides[..., 1:])
                )
            total = piece if total is None else DerivedValue(total.value + piece.value, total.slope + piece.slope)
        assert total is not None
        return total

    def _at_nodes(
        self, functional: Functional, index: int, number: int, *, square: bool
    ) -> tuple[np.ndarray, DifferentiatedStates, DerivedValue]:
        """Return the weights of a quadrature over a part of the motion, and the states and the integrand there."""
        found = self._sampled(functional, number)
        nodes = found.quadrature(found.steps)
        states = self.states.at(number, nodes.time)
        switches: list[DerivedValue] = []
        values = self._of_operand(index, states, square=square, switches=switches)
        self._note_rest(switches, nodes.time)
        return nodes.weight, states, values

    def _moved_corner(self, number: int) -> np.ndarray:
        """Return the derivatives (K,) of the time at which part `number` begins, at a discontinuity."""
        return np.concatenate([_corner_of(motion, number).slope for motion in self.run.motions])

    def _at_corner(self, number: int) -> DifferentiatedStates:
        """Return the states before and after the discontinuity at which part `number` begins."""
        corners = [_corner_of(motion, number) for motion in self.run.motions]
        return joined_states([one_after_another([corner.before, corner.after]) for corner in corners])

    def _sampled(self, functional: Functional, number: int) -> Sampled:
        known: Integrals = {
            text: tuple(x.value[:, 0].tolist()) if x.value.ndim > 1 else float(x.value[0])
            for text, x in self._functionals.items()
        }
        return sampled(self.run.motions[0].parts[number].plain, functional, known, self._duration)

    # --- extrema

    def _peak(self, functional: Functional, index: int, rows: DerivedValue) -> DerivedValue:
        """Return an extremum of the continuous motion; add a warning if it is not unique.

        `rows` are the values of the quantity in the rows.
        """
        sign = -1.0 if functional.reduction == "min" else 1.0
        found: list[tuple[int, Peak]] = []
        lowest, highest = np.inf, -np.inf
        for number in range(len(self.run.motions[0].parts)):
            samples = self._sampled(functional, number)
            if np.isnan(samples.values).any():
                return DerivedValue.number(np.nan, np.full(self.count, np.nan))
            lowest, highest = min(lowest, np.min(samples.values)), max(highest, np.max(samples.values))
            found += [(number, peak) for peak in samples.peaks()]
        best = max(sign * one.value for _, one in found)
        near = [(number, one) for number, one in found if sign * one.value >= best - EQUAL * (highest - lowest)]
        near.sort(key=lambda item: -sign * item[1].value)
        is_at_end = near[0][1].time == self.run.rows.time[-1]
        if is_at_end:
            self._note_end(functional.reduction, rows)
        first = self._at_end(rows[-1:]) if is_at_end and self.run.end.any() else self._at_peak(*near[0], index)
        slopes = {near[0][1].time: first.slope}
        step = float(np.max(self.run.motions[0].parts[near[0][0]].plain.size))
        for number, one in near[1:]:
            if min(abs(one.time - time) for time in slopes) > 1e-6 * step:
                slopes[one.time] = self._at_peak(number, one, index).slope
        rounding = 1e-9 * self._largest_term
        if not all(np.allclose(slope, first.slope, rtol=1e-6, atol=rounding) for slope in slopes.values()):
            self._note_several(functional.reduction, list(slopes))
        return first

    def _at_peak(self, number: int, peak: Peak, index: int) -> DerivedValue:
        part, time = self.run.motions[0].parts[number], np.array([peak.time])
        switches: list[DerivedValue] = []
        here = self._of_operand(index, self.states.at(number, time), switches=switches)
        self._largest_term = max(self._largest_term, float(np.max(np.abs(here.slope), initial=0.0)))
        for place, switch in enumerate(switches):
            # of the elements of a beam, others than that with the extremum may be at zero
            is_at_zero = bool(np.all(np.abs(switch.value) <= AT_ZERO * np.abs(here.value)))
            if place != peak.switch and switch.slope.any() and is_at_zero:
                self._note_sides(
                    "the operand of 'abs' is zero, or the operands of 'min' or 'max' are equal, at an extremum", SMOOTH
                )
        begin, end = part.span
        moved, side = np.zeros(self.count), -1.0
        if peak.switch < 0:
            following = self.run.motions[0].parts[number + 1 :]
            if peak.time == end and following and following[0].corner is not None:
                moved = self._moved_corner(number + 1)
            elif peak.time == begin and part.corner is not None:
                moved, side = self._moved_corner(number), 1.0
            if not moved.any():
                return here
        slope, rate, of_switch = self._limit(number, peak, index, side)
        return DerivedValue(here.value, (slope[:, 0] + rate * (moved if of_switch is None else of_switch))[:, None])

    def _limit(
        self, number: int, peak: Peak, index: int, side: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return limits at an extremum from one side, extrapolated by a polynomial in time.

        They are the derivatives of the quantity and its rate, and the derivatives (K,) of the time of the extremum if a
        scalar changes sign there (*switch*).
        """
        part = self.run.motions[0].parts[number]
        size = part.plain.size
        step = int(np.searchsorted(part.plain.ends.time, peak.time))
        near = size[max(0, step - 2) : step + 1]  # the step itself may be very short, for example if an event cuts it
        width = min(BESIDE * float(np.max(near)), part.span[1] - part.span[0])
        places = 0.5 - 0.5 * elementary.cos(np.pi * (np.arange(LIMIT_POINTS) + 0.5) / LIMIT_POINTS)
        time = np.clip(peak.time + side * width * places, *part.span)
        to_limit = np.linalg.inv(np.vander(side * places, increasing=True))[:2]
        switches: list[DerivedValue] = []
        values = self._of_operand(index, self.states.at(number, time), switches=switches)

        def extrapolated(x: DerivedValue) -> tuple[DerivedValue, np.ndarray]:
            value, rate = x.value @ to_limit[0], x.value @ to_limit[1]
            return DerivedValue(value[..., None], (x.slope @ to_limit[0])[..., None]), rate / width

        value, rate = extrapolated(values)
        if peak.switch < 0:
            return value.slope, rate, None
        switch, switch_rate = extrapolated(switches[peak.switch])
        return value.slope, rate, -switch.slope[:, 0] / float(switch_rate)

    # --- values at times

    def _at(self, functional: Functional | None, index: int, time: DerivedValue, operand: DerivedValue) -> DerivedValue:
        """Return an operand at a time.

        It is the value in the row with this time. If there is no such row, it is the value of the motion between the
        ends of steps or, if this motion is not stored, a linear interpolation between rows. At a discontinuity, ``at``
        is the limit from before and ``after`` that from after, of the value and of its derivatives.
        """
        rows, at = self.run.rows.time, float(time.value.reshape(-1)[0])
        if not rows[0] <= at <= rows[-1]:
            return DerivedValue.constant(np.full((*operand.value.shape[:-1], 1), np.nan), self.count)
        moved = time.slope.reshape(self.count, time.value.size)[:, 0]
        if functional is None or not self.run.motions:
            return self._between_rows(at, moved, operand)
        before, after = (self._part_at(replace(functional, reduction=name), at) for name in ("at", "after"))
        number, is_after = (after, True) if functional.reduction == "after" else (before, False)
        if number is None:
            return DerivedValue.constant(np.full((*operand.value.shape[:-1], 1), np.nan), self.count)
        found = self._on_part(number, at, index, moved)
        if before is not None and after is not None and before != after:
            self._compare_sides(before, after, at, index, moved)
        if at in rows and not is_after:  # as in runs
            k = int(np.searchsorted(rows, at))
            moved = moved - self.run.end if at == rows[-1] else moved
            found = self._moved(operand[k : k + 1], number, at, index, moved)
        self._functionals[functional.text] = found
        return found

    def _part_at(self, functional: Functional, at: float) -> int | None:
        """Return the number of the part of the motion that gives the value of a functional at a time."""
        parts = enumerate(self.run.motions[0].parts)
        inside = [number for number, part in parts if functional.is_given_by(at, *part.span)]
        return inside[-1 if functional.reduction == "after" else 0] if inside else None

    def _compare_sides(self, before: int, after: int, at: float, index: int, moved: np.ndarray) -> None:
        """Add a doubt if the time `at` and a discontinuity there move apart, so that the value changes its side."""
        is_fixed = self.run.motions[0].parts[after].corner is None
        if np.allclose(moved, 0.0 if is_fixed else self._moved_corner(after), rtol=1e-6, atol=0.0):
            return
        one, other = (self._on_part(number, at, index, moved).slope for number in (before, after))
        if not np.allclose(one, other, rtol=1e-6, atol=1e-9 * self.size):
            self._note_sides("the time in 'at' or 'after' is the time of a discontinuity", "choose another time")

    def _on_part(self, number: int, at: float, index: int, moved: np.ndarray) -> DerivedValue:
        """Return an operand at the time `at` in a part of the motion; `moved` (K,) has the derivatives of the time."""
        here = self._of_operand(index, self.states.at(number, np.array([at])))
        return self._moved(here, number, at, index, moved)

    def _moved(self, here: DerivedValue, number: int, at: float, index: int, moved: np.ndarray) -> DerivedValue:
        """Return an operand with derivatives that include those of its time `at`, `moved` (K,)."""
        if not moved.any():
            return here
        begin, end = self.run.motions[0].parts[number].span
        _, rate, _ = self._limit(number, Peak(np.nan, at), index, 1.0 if at - begin < end - at else -1.0)
        return DerivedValue(here.value, here.slope + np.multiply.outer(moved, rate[..., None]))

    def _between_rows(self, at: float, moved: np.ndarray, operand: DerivedValue) -> DerivedValue:
        """Return an operand at a time, interpolated linearly between the neighbouring rows; see `_on_part`."""
        rows = self.run.rows.time
        k = int(np.clip(np.searchsorted(rows, at, side="right") - 1, 0, len(rows) - 2))
        share = (at - rows[k]) / (rows[k + 1] - rows[k])
        rate = (operand.value[..., k + 1] - operand.value[..., k]) / (rows[k + 1] - rows[k])
        value = (1.0 - share) * operand.value[..., k] + share * operand.value[..., k + 1]
        slope = (1.0 - share) * operand.slope[..., k] + share * operand.slope[..., k + 1]
        if k == len(rows) - 2:  # the time of the last row depends on the parameters
            moved = moved - share * self.run.end
        slope = slope + np.multiply.outer(moved, rate)
        return DerivedValue(value[..., None], slope[..., None])

    def _of_event(self, quantity: Quantity) -> DerivedValue:
        """Return a quantity of an event: the time of its first or last crossing, or their number."""
        found = [crossing for crossing in self.run.crossings if crossing.name == quantity.name]
        if quantity.attribute == "count":
            return DerivedValue.constant(np.array([float(len(found))]), self.count)
        if not found:
            self.doubts.append(f"the event '{quantity.name}' does not happen, so that its time has no derivative")
            return DerivedValue.number(np.nan, np.full(self.count, np.nan))
        one = found[0 if quantity.attribute == "time" else -1]
        return DerivedValue.number(one.time, one.slope)

    def _extremum(self, name: str, rows: DerivedValue) -> DerivedValue:
        """Return the largest or smallest value in the rows; add a warning if it is not unique."""
        values = rows.value if name == "max" else -rows.value
        index = int(np.argmax(values))
        spread = float(np.max(values) - np.min(values))
        near = np.flatnonzero(values >= values[index] - EQUAL * spread) if np.isfinite(spread) else np.array([index])
        apart = near[np.abs(near - index) > 1]
        same = np.isclose(rows.slope[:, apart], rows.slope[:, [index]], rtol=1e-6, atol=0.0).all(axis=0)
        if not np.all(same):
            times = self.run.rows.time
            self._note_several(name, [float(times[index]), float(times[apart[~same][0]])])
        self._note_end(name, rows)
        return rows[index : index + 1]


def _begins(expression: MeasureExpression) -> list[int]:
    """Return, for each instruction, the index at which the program of its first operand begins."""
    begins: list[int] = []
    stack: list[int] = []
    for index, (operation, _) in enumerate(expression.program):
        first = len(stack) - arity_of(operation)
        begin = stack[first] if first < len(stack) else index
        begins.append(begin)
        stack[first:] = [begin]
    return begins


def _weighted(values: DerivedValue, weights: np.ndarray) -> DerivedValue:
    """Return the sum of values (..., T) times weights (T, 1 + K), with derivatives, (..., 1)."""
    moved = np.moveaxis(values.value @ weights[:, 1:], -1, 0)
    return DerivedValue((values.value @ weights[:, 0])[..., None], (values.slope @ weights[:, 0] + moved)[..., None])


def _corner_of(motion: DifferentiatedMotion, number: int) -> LawCorner:
    corner = motion.parts[number].corner
    assert corner is not None
    return corner
