"""Computes measures from runs, and checks measures against the spec."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Never

from mbdkit.archive.headlines import not_unique
from mbdkit.archive.measured_values import MeasuredValues
from mbdkit.archive.run import Run
from mbdkit.base.errors import PluginError, SpecError, blaming
from mbdkit.base.plain_data import path_text
from mbdkit.base.text import listed, message_of
from mbdkit.engine.compile_mechanism import characteristic_length
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.registry.items import MeasurePlugin
from mbdkit.registry.seam import Seam
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit.trust.measure_error import measure_error, natural_scales, natural_size


class SpecMeasure:
    """A measure of the runs of a spec: its unit, its value and the error of the value.

    `measure`, `spec`: the definition, and the spec of the runs.
    """

    def __init__(self, measure: DefinedMeasure, spec: ModelSpec):
        self.measure, self.spec = measure, spec

    @property
    def is_taken(self) -> bool:
        """Whether the measure is computed for the runs, although it may be defined in another base of a study."""
        return not self.measure.of_base or any(own.name == self.measure.name for own in self.spec.defined_measures())

    def describe(self) -> tuple[str, str]:
        """Check the measure, and return its unit and description; raise SpecError if its expression is not valid."""
        if self.measure.item is None:
            return self._expression().unit.text, self.measure.expression
        plugin = self.measure.item.plugin
        assert isinstance(plugin, MeasurePlugin)
        return plugin.units, plugin.summary

    def take(self, run: Run) -> float:
        """Return the value of the measure for a run; nan if it is not taken.

        Raises PluginError if the measure of a plugin fails.
        """
        if not self.is_taken:
            return math.nan
        if (item := self.measure.item) is None:
            return self._expression().of(run)
        assert isinstance(item.plugin, MeasurePlugin)
        with blaming(f"measure {item.id} failed for run {run.run_id}"):
            value: Any = item.plugin.take(run, self.measure.options)
            try:
                return float(value)
            except (TypeError, ValueError):
                what = type(value).__name__
                raise PluginError(f"measure {item.id} returned an object of type {what}, not a number") from None

    def error(self, value: float, run: Run) -> float:
        """Return the estimated error of a value of the measure; nan if unknown, as without `check` and for measures of
        plugins.
        """
        compared = self._compared(run)
        if self.measure.item is not None or not compared or not self.is_taken or self._why_undecided(run):
            return math.nan
        unit = self._expression().unit
        mechanism, duration = self.spec.mechanism(), float(run.time[-1] - run.time[0])
        mass = max((body.mass for body in mechanism.bodies.values()), default=0.0)
        scales = natural_scales(characteristic_length(mechanism), mass, mechanism.gravity, duration)
        return measure_error(value, [number / unit.factor for number in compared], natural_size(unit, *scales))

    def parameter_error(self, run: Run) -> float:
        """Return the error of the measure by the estimates of parameters; nan if unknown."""
        if self.measure.item is not None or run.accuracy is None:
            return math.nan
        (error,) = run.accuracy.measured_parameters.get(self.measure.expression, (math.nan,))
        return error / self._expression().unit.factor

    def remark(self, error: float, run: Run) -> str:
        """Return remarks on a value with this error, such as the reason why its error is unknown."""
        remarks = [] if self.measure.item else [*self._expression().remarks(run)]
        if why := self._why_unknown(error, run):
            remarks.append(f"its error is unknown: {why}")
        return "; ".join(remarks)

    def _expression(self) -> MeasureExpression:
        return MeasureExpression.parse(self.measure.expression, self.spec, self.measure.unit)

    def _compared(self, run: Run) -> Sequence[float]:
        return () if run.accuracy is None else run.accuracy.compared_measures.get(self.measure.expression, ())

    def _why_undecided(self, run: Run) -> str:
        """Return why the error is unknown if those of the motion are unknown at the end of a run, or if the measure
        takes a reaction of redundant joints; empty if it is known.

        With impacts, their order may then be undecided. The comparison runs may choose the same order as the run, so
        that the differences of their measures are smaller than the errors.
        """
        if shared := not_unique(run):
            quantities = self._expression().quantities
            if taken := [q.name for q in quantities if q.recorded.array.is_shared and q.name in shared]:
                return (
                    f"the reaction of {taken[0]} is not unique, because joints are redundant; that of least norm is "
                    "taken"
                )
        return "" if run.accuracy is None or run.accuracy.is_complete else self.spec.undecided

    def _why_unknown(self, error: float, run: Run) -> str:
        if not (self.spec.checks_measures and math.isnan(error)):
            return ""
        if self.measure.item is not None:
            return "errors of measures of plugins are not estimated"
        if run.status != "complete":
            return "the run is not complete"
        if why := self._why_undecided(run):
            return why
        compared = self._compared(run)
        if len(compared) == 3 and all(map(math.isfinite, compared)):
            values = listed([f"{number:.6g}" for number in compared], "and")
            return f"its values in the comparison runs, {values} in SI units, do not converge"
        return "a comparison run failed or has no value"


def check_measures(spec: ModelSpec) -> None:
    """Raise SpecError, with the key below ``measures``, if the expression of a measure is not valid for the spec."""
    for measure in spec.defined_measures():
        try:
            SpecMeasure(measure, spec).describe()
        except SpecError as error:
            raise spec.placed(error.located(prefix=path_text(measure.place))) from None


def take_all(run: Run, spec: ModelSpec) -> MeasuredValues:
    """Return the values of the measures of a run spec; if the measure of a plugin fails, nan with the reason."""
    values, units, reasons, errors, remarks, by_parameters = {}, {}, {}, {}, {}, {}
    for name, measure in {measure.name: SpecMeasure(measure, spec) for measure in spec.defined_measures()}.items():
        units[name], _ = measure.describe()
        try:
            values[name] = measure.take(run)
            errors[name] = measure.error(values[name], run)
            by_parameters[name] = measure.parameter_error(run)
            if math.isfinite(values[name]) and (remark := measure.remark(errors[name], run)):
                remarks[name] = remark
        except PluginError as error:
            values[name], reasons[name] = math.nan, message_of(error)
    return MeasuredValues(values, units, reasons, errors, remarks, by_parameters)


@Seam
def measure_function(run: Run, options: Never, /) -> float:
    """Return the value of a measure of a run, complete or not; nan if it cannot be computed for this run."""
    raise NotImplementedError
