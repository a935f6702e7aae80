"""Measures that a study defines by expressions or takes from plugins, checked before the first run."""

from __future__ import annotations

from collections.abc import Iterable

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import path_text
from mbdkit.measures.take import Description, describe, is_taken
from mbdkit.spec import RunSpec
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit.spec.study_spec import StudySpec


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
            if not is_taken(measure, run):
                continue
            try:
                now = describe(measure, run)
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


def _placed(spec: StudySpec, measure: DefinedMeasure, error: SpecError) -> SpecError:
    """Return an error about a measure with the file and line of its definition."""
    return spec.placed(error.located(prefix=path_text(measure.place)))
