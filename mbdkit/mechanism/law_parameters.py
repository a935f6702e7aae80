"""The parameters and the range of a force law, computed from the options of an element of type ``law``."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any

from mbdkit.base.errors import PluginError, blaming
from mbdkit.base.text import listed
from mbdkit.base.traced_numbers import as_float
from mbdkit.mechanism.force_law import ARGUMENTS, ExpressionLaw, ForceLaw, TracedLaw


def law_parameters(law: ForceLaw, options: object, name: str) -> tuple[tuple[str, ...], list[float]]:
    """Return the names and values of a law's parameters; those of functions and of machine code have no names.

    `name`: name of the law for error messages. Raises PluginError if the law fails to compute its parameters, or if
    they are not usable. Raises SpecError if the law itself raises it for these options.
    """
    with blaming(f"force law {name} failed to compute its parameters"):
        names, values = _parameters(law, options)
    if clash := sorted(set(names) & set(ARGUMENTS)):
        raise PluginError(
            f"force law {name}: its parameter '{clash[0]}' has the name of an argument of the law; rename it"
        )
    if missing := [state.name for state in law.states if state.name not in names]:
        raise PluginError(
            f"force law {name}: its state '{missing[0]}' needs a parameter of this name for its initial value"
        )
    if law.states and law.potential not in (None, False):
        raise PluginError(f"force law {name} has states, so its force cannot have a potential; leave out `potential`")
    if not all(abs(value) < inf for value in values):
        raise PluginError(f"force law {name} computed parameters that are not finite")
    return names, values


def law_range(law: ForceLaw, options: object, name: str) -> dict[str, tuple[float, float]]:
    """Return the lowest and the highest value of each argument (length, rate, time) for which a law holds.

    The values are infinite for arguments without a bound.

    `name`: name of the law for error messages. Raises PluginError if the law fails to compute its range, or if the
    result is not a range. Raises SpecError if the law itself raises it for these options.
    """
    with blaming(f"force law {name} failed to compute its valid range"):
        given: Any = law.valid_range(options) if callable(law.valid_range) else law.valid_range
    ranges = dict.fromkeys(ARGUMENTS, (-inf, inf))
    if not isinstance(given, Mapping) or not set(given) <= set(ARGUMENTS):
        raise PluginError(
            f"force law {name}: its valid range should be a mapping whose keys are {listed(ARGUMENTS, 'or')}"
        )
    for argument, bounds in given.items():
        try:
            low, high = map(float, bounds)
        except (TypeError, ValueError):
            low, high = inf, -inf
        if not low < high:
            raise PluginError(
                f"force law {name}: its valid range of {argument} should be two numbers, the lower one first"
            )
        ranges[argument] = low, high
    return ranges


def _parameters(law: ForceLaw, options: object) -> tuple[tuple[str, ...], list[float]]:
    given: Any
    if law.parameters is not None:
        given = law.parameters(options)
    elif isinstance(law, ExpressionLaw):
        every = {option: getattr(options, option) for option in law_options(options)}
        given = {option: value for option, value in every.items() if isinstance(value, int | float)}
    else:
        given = [getattr(options, option) for option in law_options(options)]
    if not isinstance(law, ExpressionLaw | TracedLaw):
        return (), [*map(as_float, given)]
    names = tuple(sorted(given))
    return names, [as_float(given[name]) for name in names]


def law_options(options: Any) -> list[str]:
    """Return the names of those options of an element that belong to its law, in the order of their definition."""
    texts: list[str] = list(type(options).law_options.model_fields)
    return texts
