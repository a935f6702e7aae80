"""Computes measures from runs, and checks measures against the spec."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Never

from mbdkit.archive.headlines import not_unique
from mbdkit.archive.measured_values import MeasuredValues
from mbdkit.base.errors import PluginError, SpecError, blaming
from mbdkit.base.plain_data import path_text
from mbdkit.base.text import listed, message_of
from mbdkit.engine.compile_mechanism import characteristic_length
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.measures.natural_size import natural_scales, natural_size
from mbdkit.registry.items import MeasurePlugin
from mbdkit.registry.seam import Seam
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit.trust.measure_error import measure_error

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


@dataclass(frozen=True)
class Description:
    """Unit and description of a measure."""

    units: str
    long_name: str


def describe(measure: DefinedMeasure, spec: ModelSpec) -> Description:
    """Check a measure for the runs of a spec, and return its unit and description.

    Raises SpecError if the expression of the measure is not valid for the spec.
    """
    if measure.item is None:
        parsed = _expression(measure, spec)
        return Description(parsed.unit.text, measure.expression)
    plugin = measure.item.plugin
    assert isinstance(plugin, MeasurePlugin)
    return Description(plugin.units, plugin.summary)


def is_taken(measure: DefinedMeasure, spec: ModelSpec) -> bool:
    """Return whether a measure is computed for the runs of a spec."""
    return not measure.of_base or any(own.name == measure.name for own in spec.defined_measures())


def check_measures(spec: ModelSpec) -> None:
    """Raise SpecError, with the key below ``measures``, if the expression of a measure is not valid for the spec."""
    for measure in spec.defined_measures():
        try:
            describe(measure, spec)
        except SpecError as error:
            raise spec.placed(error.located(prefix=path_text(measure.place))) from None


def take(measure: DefinedMeasure, run: Run, spec: ModelSpec) -> float:
    """Return the value of a measure for a run; nan if only another base spec of the study defines the measure.

    `spec`: the spec of the run. Raises PluginError if the measure of a plugin fails.
    """
    if not is_taken(measure, spec):
        return math.nan
    if measure.item is None:
        return _expression(measure, spec).of(run)
    plugin = measure.item.plugin
    assert isinstance(plugin, MeasurePlugin)
    with blaming(f"measure {measure.item.id} failed for run {run.run_id}"):
        value: Any = plugin.take(run, measure.options)
        try:
            return float(value)
        except (TypeError, ValueError):
            what = type(value).__name__
            raise PluginError(f"measure {measure.item.id} returned an object of type {what}, not a number") from None


def error_of(measure: DefinedMeasure, value: float, run: Run, spec: ModelSpec) -> float:
    """Return the estimated error of the value of a measure; nan if unknown, as without `check` and for measures of
    plugins.
    """
    accuracy = run.accuracy
    compared = () if accuracy is None else accuracy.compared_measures.get(measure.expression, ())
    if measure.item is not None or not compared or not is_taken(measure, spec) or _why_undecided(measure, run, spec):
        return math.nan
    unit = _expression(measure, spec).unit
    mechanism, duration = spec.mechanism(), float(run.time[-1] - run.time[0])
    mass = max((body.mass for body in mechanism.bodies.values()), default=0.0)
    scales = natural_scales(characteristic_length(mechanism), mass, mechanism.gravity, duration)
    return measure_error(value, [number / unit.factor for number in compared], natural_size(unit, *scales))


def _parameter_error_of(measure: DefinedMeasure, run: Run, spec: ModelSpec) -> float:
    """Return the error of a measure by the estimates of parameters; nan if unknown."""
    if measure.item is not None or run.accuracy is None:
        return math.nan
    (error,) = run.accuracy.measured_parameters.get(measure.expression, (math.nan,))
    return error / _expression(measure, spec).unit.factor


def _why_undecided(measure: DefinedMeasure, run: Run, spec: ModelSpec) -> str:
    """Return why the error of a measure is unknown if those of the motion are unknown at the end of a run, or if it
    takes a reaction of redundant joints; empty if it is known.

    With impacts, their order may then be undecided. The comparison runs may choose the same order as the run, so that
    the differences of their measures are smaller than the errors.
    """
    if shared := not_unique(run):
        taken = [
            q.name for q in _expression(measure, spec).quantities if q.recorded.array.is_shared and q.name in shared
        ]
        if taken:
            return (
                f"the reaction of {taken[0]} is not unique, because joints are redundant; that of least norm is taken"
            )
    return "" if run.accuracy is None or run.accuracy.is_complete else spec.undecided


def take_all(run: Run, spec: ModelSpec) -> MeasuredValues:
    """Return the values of the measures of a run spec; if the measure of a plugin fails, nan with the reason."""
    values, units, reasons, errors, remarks, by_parameters = {}, {}, {}, {}, {}, {}
    for measure in spec.defined_measures():
        units[measure.name] = describe(measure, spec).units
        try:
            values[measure.name] = take(measure, run, spec)
            errors[measure.name] = error_of(measure, values[measure.name], run, spec)
            by_parameters[measure.name] = _parameter_error_of(measure, run, spec)
            if math.isfinite(values[measure.name]):
                clauses = [] if measure.item else _expression(measure, spec).remarks(run)
                if why := _why_unknown(measure, errors[measure.name], run, spec):
                    clauses.append(f"its error is unknown: {why}")
                if clauses:
                    remarks[measure.name] = "; ".join(clauses)
        except PluginError as error:
            values[measure.name], reasons[measure.name] = math.nan, message_of(error)
    return MeasuredValues(values, units, reasons, errors, remarks, by_parameters)


def _expression(measure: DefinedMeasure, spec: ModelSpec) -> MeasureExpression:
    return MeasureExpression.parse(measure.expression, spec, measure.unit)


def _why_unknown(measure: DefinedMeasure, error: float, run: Run, spec: ModelSpec) -> str:
    if not (spec.checks_measures and math.isnan(error)):
        return ""
    if measure.item is not None:
        return "errors of measures of plugins are not estimated"
    if run.status != "complete":
        return "the run is not complete"
    if why := _why_undecided(measure, run, spec):
        return why
    compared = () if run.accuracy is None else run.accuracy.compared_measures.get(measure.expression, ())
    if len(compared) == 3 and all(map(math.isfinite, compared)):
        values = listed([f"{number:.6g}" for number in compared], "and")
        return f"its values in the comparison runs, {values} in SI units, do not converge"
    return "a comparison run failed or has no value"


@Seam
def measure_function(run: Run, options: Never, /) -> float:
    """Return the value of a measure of a run, complete or not; nan if it cannot be computed for this run."""
    raise NotImplementedError
