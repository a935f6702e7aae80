"""Measures that a study defines by expressions or takes from plugins: checked before the first run, then taken."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbdkit.errors import PluginError, SpecError, blaming
from mbdkit.plain_data import path_text
from mbdkit.registry.items import MeasurePlugin
from mbdkit.spec import RunSpec
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies.measure_expression import MeasureExpression

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


@dataclass(frozen=True)
class Description:
    """Unit and description of a column."""

    units: str
    long_name: str


def describe_measures(spec: StudySpec, runs: Iterable[tuple[str, RunSpec]]) -> dict[str, Description]:
    """Check the measures that a study defines for all of its runs, and return what describes their columns.

    Parameters
    ----------
    runs
        Each different run of the study with a name for error messages.

    Raises
    ------
    SpecError
        If an expression is not valid for a run, or has different units in two runs.
    """
    measures = spec.defined_measures()
    found: dict[str, Description] = {}
    first: dict[str, str] = {}
    for number, (label, run) in enumerate(runs if measures else ()):
        for measure in measures:
            try:
                now = _description(measure, run)
            except SpecError as error:
                told = f" (in {label})" if number else ""
                raise _placed(spec, measure, SpecError(error.message + told, key=error.key)) from None
            before = found.setdefault(measure.name, now)
            if before != now:
                raise _placed(
                    spec,
                    measure,
                    SpecError(
                        f"its unit is {before.units} in {first[measure.name]} and {now.units} in {label}; a column of "
                        "the index has one unit"
                    ),
                )
            first.setdefault(measure.name, label)
    return found


def take(measure: DefinedMeasure, run: Run, spec: RunSpec) -> float:
    """Return the value of a measure for a run.

    Parameters
    ----------
    spec
        The spec of the run.

    Raises
    ------
    PluginError
        If the measure of a plugin fails.
    """
    if measure.item is None:
        return MeasureExpression.parse(measure.expression, spec, measure.unit).of(run)
    plugin = measure.item.plugin
    assert isinstance(plugin, MeasurePlugin)
    with blaming(f"measure {measure.item.id} failed for run {run.run_id}"):
        value: Any = plugin.take(run, measure.options)
        try:
            return float(value)
        except (TypeError, ValueError):
            what = type(value).__name__
            raise PluginError(f"measure {measure.item.id} returned an object of type {what}, not a number") from None


def _description(measure: DefinedMeasure, spec: RunSpec) -> Description:
    if measure.item is None:
        parsed = MeasureExpression.parse(measure.expression, spec, measure.unit)
        return Description(parsed.unit.text, measure.expression)
    plugin = measure.item.plugin
    assert isinstance(plugin, MeasurePlugin)
    return Description(plugin.units, plugin.summary)


def _placed(spec: StudySpec, measure: DefinedMeasure, error: SpecError) -> SpecError:
    """Return an error about a measure with the file and line of its definition."""
    return spec.placed(error.located(prefix=path_text(("measures", *measure.place))))
