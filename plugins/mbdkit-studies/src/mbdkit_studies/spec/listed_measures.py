"""Measures that a study lists, and what the built-in ones need."""

from __future__ import annotations

from collections.abc import Iterable

from mbdkit.spec.study_measures import DefinedMeasure, built_in_measures

#: What a built-in measure may need in addition to the run.
#:
#: Measures that need a second run are computed only if a study lists them.
REFERENCE, SECOND_RUN = "reference", "second run"


def expressions_of(measures: Iterable[DefinedMeasure]) -> tuple[str, ...]:
    """Return the expressions of the measures that a study itself defines; those of its bases are part of the run
    specs.
    """
    return tuple(measure.expression for measure in measures if measure.item is None and not measure.of_base)


def built_in(measures: object) -> tuple[str, ...] | None:
    """Return the names of built-in measures that a study lists; None if all of them are computed."""
    if isinstance(measures, list):
        return tuple(entry for entry in measures if isinstance(entry, str) and entry in built_in_measures())
    return None
