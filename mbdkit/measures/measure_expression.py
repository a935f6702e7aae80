"""Expressions of measures: one number of a whole run, such as ``max(abs(joints.B.force))``.

They are expressions of events with the following additions. Bodies, joints and markers have vectors, whose norm is
``abs``. ``max``, ``min``, ``mean``, ``rms``, ``final`` and ``integral`` of a quantity reduce its values over time to
one number, ``at(QUANTITY, TIME)`` is its value at one time, and ``after(QUANTITY, TIME)`` that right after it. With
several arguments, ``max`` and ``min`` compare the arguments at each time. ``events.NAME.time`` is the time of the first
crossing of an event, ``.last_time`` that of the last crossing, and ``.count`` the number of crossings. Internal forces
of beams have a value in each element: ``beams.NAME.moment[0]`` is that of one element, ``along_max`` and ``along_min``
are the extreme values along the beam at each time, and ``max`` and ``min`` the extreme values along the beam over time.
Units are checked.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mbdkit.archive.headlines import is_at_end
from mbdkit.archive.named_columns import NotRecordedError
from mbdkit.archive.run import Run
from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.base.units import Unit, read_unit
from mbdkit.expressions.operations import REDUCE
from mbdkit.expressions.program import Program, execute
from mbdkit.measures.measure_compiler import PLAIN, MeasureCompiler
from mbdkit.measures.measured_quantities import recorded
from mbdkit.measures.reductions import EXTREMA, REDUCTIONS, Functional, Series, applied, from_functional, interpolated
from mbdkit.quantities.quantity import Quantity
from mbdkit.spec.model_spec import ModelSpec

#: A remark is issued if a recorded row exceeds an extremum by more than this share of the range of the quantity.
BEYOND = 1e-6

AT_END_OF_RUN = "{} at the end of the run"  #: The remark on an extremum at the end of a run.


@dataclass(frozen=True)
class MeasureExpression:
    """An expression whose value is one number per run.

    - `text`: the expression as written by the user.
    - `program`: postfix instructions as in `mbdkit.events.event_expression.RunExpression`, and reductions over time.
    - `quantities`: quantities in the expression, except time.
    - `unit`: unit of the value.
    - `functionals`: integrals and extrema that are computed during the run. A reduction in the program refers to its
      functional by the index, from 1; the index is 0 if the quantity is known at the recorded times only.
    """

    text: str
    program: Program
    quantities: tuple[Quantity, ...]
    unit: Unit
    functionals: tuple[Functional, ...] = ()

    @staticmethod
    def parse(text: str, spec: ModelSpec, unit: str = "") -> MeasureExpression:
        """Parse an expression for the runs of a spec.

        `unit`: unit in which to give the value; by default the SI unit that follows from the expression. Raises
        SpecError if the syntax is wrong, a quantity does not exist or is not recorded, units do not match, or the value
        is not one number. The key of the error is ``unit`` if the given unit does not match.
        """
        with SpecError.locate("unit"):
            wanted = read_unit(unit) if unit else None
        compiler = MeasureCompiler(text, spec)
        program, value = compiler.measure()
        if wanted is None:
            if value.unit is None:
                raise SpecError(
                    "the unit of this expression is unknown, because parameters and some states have none; give the "
                    "unit of the result, as in {value: EXPRESSION, unit: N}"
                )
            wanted = value.unit
        elif value.unit is not None and not value.unit.is_like(wanted):
            raise SpecError(f"the expression has the unit {value.unit}, which cannot be given in {wanted}", key="unit")
        return MeasureExpression(text, program, tuple(compiler.quantities), wanted, compiler.functionals())

    @staticmethod
    def functionals_of(text: str, spec: ModelSpec) -> tuple[Functional, ...]:
        """Return the functionals of an expression; raise the same errors as `parse`, except for the unit."""
        compiler = MeasureCompiler(text, spec)
        compiler.measure()
        return compiler.functionals()

    @staticmethod
    def in_si(text: str, run: Run) -> float:
        """Return the value of an expression for a run in SI units, even if its unit depends on parameters with unknown
        units.
        """
        try:
            parsed = MeasureExpression.parse(text, run.run_spec)
        except SpecError:
            parsed = MeasureExpression.parse(text, run.run_spec, "1")
        return parsed.of(run) * parsed.unit.factor

    def of(self, run: Run) -> float:
        """Return the value for a run, in `unit`; nan where it is undefined or a quantity was not recorded."""
        if not len(run.time):
            return float("nan")
        try:
            value = float(self._values(run).reshape(-1)[0]) / self.unit.factor
        except NotRecordedError:
            return float("nan")
        return value if np.isfinite(value) else float("nan")

    def remarks(self, run: Run) -> list[str]:
        """Return a remark, as a clause, for each extremum of the continuous motion that recorded rows exceed, and for
        each at the end of the run, which a longer run may exceed.
        """
        remarks: list[str] = []
        if not len(run.time) or not any(functional.is_extremum for functional in self.functionals):
            return remarks

        def compared(name: str, extremum: np.ndarray, values: np.ndarray) -> None:
            sign, spread = -1.0 if name == "min" else 1.0, float(np.max(values) - np.min(values))
            row = int(np.argmax(sign * values))
            if sign * (values[row] - extremum[0]) > BEYOND * spread:
                remarks.append(
                    f"the recorded row at t = {run.time[row]:.6g} s has {values[row]:.6g}, beyond the {name} of the "
                    f"motion between the ends of steps, {extremum[0]:.6g}: states between steps are less accurate there"
                )
            if sign * (extremum[0] - values[-1]) <= BEYOND * spread and is_at_end(sign * values):
                remarks.append(AT_END_OF_RUN.format(name))

        try:
            self._values(run, compared)
        except NotRecordedError:
            return []
        return list(dict.fromkeys(remarks))

    def _values(
        self, run: Run, compared: Callable[[str, np.ndarray, np.ndarray], None] = lambda name, extremum, values: None
    ) -> np.ndarray:
        """Return the value of the program for a run, in SI units; see `applied` for its shape.

        `compared`: function called for each extremum of the continuous motion with ``max`` or ``min``, the extremum,
        and the values in the recorded rows.
        """
        series = Series(run.time, lambda one: recorded(one, run))

        def step(operation: str, number: float, *operands: np.ndarray) -> np.ndarray:
            if not operation.startswith(REDUCE):
                return applied(operation, number, operands, self.quantities, series)
            name, values = operation.removeprefix(REDUCE), operands[0]
            functional = self.functionals[int(number) - 1] if number else None
            extremum = None if functional is None else run.integrals.get(functional.text)
            if functional is not None and functional.reduction == "after":  # rows do not tell
                extremum = np.nan if extremum is None else extremum
            elif name == "at" and (extremum is None or np.any(run.time == operands[1][0])):
                return interpolated(float(operands[1][0]), run.time, values)
            duration = run.time[-1] - run.time[0]
            if extremum is None or not duration > 0.0:
                return np.asarray(REDUCTIONS[name](run.time, values)[..., None])
            reduced = from_functional(name, extremum, duration, values)
            if name in EXTREMA:
                compared(name, reduced, values)
            return reduced

        with np.errstate(all="ignore"):
            return execute(self.program, step)


@dataclass(frozen=True)
class SeriesExpression(MeasureExpression):
    """An expression with one number per recorded row, such as ``abs(joints.B.force)``."""

    @staticmethod
    def parse(text: str, spec: ModelSpec, unit: str = "") -> SeriesExpression:
        """Parse an expression for the runs of a spec.

        Named parameters are not available, because their values may differ between runs.

        Raises SpecError if the syntax is wrong, a quantity does not exist or is not recorded, units do not match, or
        the value is not one number in each row.
        """
        compiler = MeasureCompiler(text, spec, {})
        program, value = compiler.series()
        return SeriesExpression(text, program, tuple(compiler.quantities), value.unit or PLAIN)

    def rows(self, run: Run) -> np.ndarray:
        """Return the values in the T recorded rows of a run, (T,), in `unit`; raise NotRecordedError if a quantity is
        missing.
        """
        return self._values(run) / self.unit.factor
