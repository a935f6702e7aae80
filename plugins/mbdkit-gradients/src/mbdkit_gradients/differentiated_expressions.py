"""Expressions of measures and events, and the numbers that they contain, which may depend on named parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import path_text
from mbdkit.events.event_expression import RunExpression
from mbdkit.expressions.program import Program
from mbdkit.integrators.duals.dual_run import Seeds
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.spec.model_spec import ModelSpec

#: One expression, several, or expressions by name, as in the section `measures` of a spec.
Measures = str | Sequence[str] | Mapping[str, str | Mapping[str, str]]

#: Expression and unit of each measure, by name; the unit is empty if it follows from the expression.
Definitions = Mapping[str, tuple[str, str]]

NO_MEASURES: Definitions = MappingProxyType({})


def definitions_of(spec: ModelSpec, measures: Measures) -> Definitions:
    """Return the definitions of measures; names of measures of a spec may stand for their expressions.

    Raises SpecError if there are no measures, or if a name stands for a measure of a plugin.
    """
    known = {measure.name: measure for measure in spec.defined_measures()}
    if isinstance(measures, str):
        measures = [measures]
    named = measures.items() if isinstance(measures, Mapping) else ((text, text) for text in measures)
    found = {}
    for name, given in named:
        text, unit = (given, "") if isinstance(given, str) else (given.get("value", ""), given.get("unit", ""))
        if text in known and not isinstance(measures, Mapping):
            text, unit = known[name].expression, known[name].unit
            if known[name].item is not None:
                raise SpecError(f"the measure '{name}' of a plugin has no derivatives", key="measures")
        found[name] = text, unit
    if not found:
        raise SpecError("a gradient needs at least one measure", key="measures")
    return found


def expressions_of(spec: ModelSpec, definitions: Definitions) -> dict[str, MeasureExpression]:
    """Return the expressions of measures with the named parameters of a spec; raise SpecError if one is not valid."""
    found = {}
    for name, (text, unit) in definitions.items():
        try:
            found[name] = MeasureExpression.parse(text, spec, unit)
        except SpecError as error:
            raise error if name == text else error.located(prefix=path_text(("measures", name))) from None
    return found


def numbers_of(spec: ModelSpec, definitions: Definitions) -> dict[str, np.ndarray]:
    """Return the numbers in the instructions of all measures, by names such as ``measures.NAME``."""
    return numbers_in(expressions_of(spec, definitions), "measures")


def numbers_in(expressions: Mapping[str, MeasureExpression | RunExpression], kind: str) -> dict[str, np.ndarray]:
    """Return the numbers in the instructions of expressions, by kind and name."""
    return {f"{kind}.{name}": np.array([number for _, number in x.program]) for name, x in expressions.items()}


def slopes_of(program: Program, seeds: Seeds, name: str) -> np.ndarray:
    """Return the derivatives (I, K) of the numbers in the I instructions of a program with respect to K parameters.

    They are zero if `seeds` have no array with this name.
    """
    found = seeds.get(name)
    return np.zeros((len(program), seeds.count)) if found is None else found
