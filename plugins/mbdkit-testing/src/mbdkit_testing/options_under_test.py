"""Options of a plugin under test: given values, and example values for options without defaults."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar, cast

from pydantic import BaseModel, ValidationError

from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import STRICT
from mbdkit.base.text import listed
from mbdkit.mechanism.validation_errors import spec_error
from mbdkit.registry.catalogue import Registered
from mbdkit_testing.check import Skip
from mbdkit_testing.check_result import Result, failed, passed, warned

MOST_CHOICES = 4  #: Largest number of choices of an option that are tried.

Options = TypeVar("Options", bound=BaseModel)


class _NoOptions(BaseModel):
    """Options of a plugin that has none."""


def options_result(options_type: type[BaseModel], given: Mapping[str, object], words: str = "options") -> Result:
    """Return the result of the check that options round-trip through JSON and have descriptions.

    Parameters
    ----------
    given
        Values of the options.
    words
        Word for the options of this kind of plugin, in the plural.
    """
    if not options_type.model_fields:  # BaseModel itself has no schema
        return passed(**{words: 0})
    chosen = validated(options_type, given)
    again = options_type.model_validate_json(chosen.model_dump_json())
    if again != chosen:
        return failed(f"its {words} {chosen!r} become {again!r} in a JSON round trip")
    described = options_type.model_json_schema().get("properties", {})
    if silent := [name for name, info in described.items() if not info.get("description")]:
        one = words.removesuffix("s")
        return warned(f"{listed(silent, 'and')} have no description: write a docstring below each {one}")
    return passed(**{words: len(described)})


def plain_options(item: Registered, given: Mapping[str, object]) -> dict[str, object]:
    """Return valid options of an item: `given`, and an example value for each other option without default.

    An example is the first of ``examples`` in the option's JSON schema, the first of its choices, or a number within
    its bounds (1 if possible).

    Raises
    ------
    SpecError
        If the options are invalid, or an option has neither a default nor an example value.
    """
    model: type[BaseModel] = item.plugin.options
    schema = model.model_json_schema() if model.model_fields else {}  # BaseModel itself has no schema
    examples = {name: _example(schema["properties"][name]) for name in schema.get("required", ()) if name not in given}
    chosen = {**given, **examples}
    if missing := [name for name, example in examples.items() if example is None]:
        raise SpecError(
            f"{item.id} has no default and no example for {listed(missing, 'and')}; "
            f"give {'it' if len(missing) == 1 else 'them'} with --set {missing[0]}=VALUE"
        )
    strict = type(model.__name__, (model,), {"__module__": __name__, "model_config": STRICT})
    try:
        validated(strict, chosen)
    except ValidationError as error:
        wrong = spec_error(error, strict)
        if not given:
            raise SpecError(f"{item.id} needs options: {wrong}; give them with --set KEY=VALUE") from None
        raise wrong from None
    return chosen


def variants(item: Registered, chosen: Mapping[str, object]) -> Iterator[tuple[str, dict[str, object]]]:
    """Yield valid options of an item in which one option has another value, with a name such as ``damping = -1``.

    The values depend only on the type, the bounds and the present value of the option. They are smaller and larger
    numbers, of both signs if the bounds allow it; the other truth value; or at most `MOST_CHOICES` other choices.
    """
    model: type[BaseModel] = item.plugin.options
    if not model.model_fields:
        return
    schema = model.model_json_schema()
    strict = type(model.__name__, (model,), {"__module__": __name__, "model_config": STRICT})
    complete = {name: info.get("default") for name, info in schema["properties"].items()} | dict(chosen)
    for name, info in schema["properties"].items():
        for value in _others(info, complete[name]):
            options = {**chosen, name: value}
            try:
                validated(strict, options)
            except (ValidationError, SpecError):  # options may exclude each other
                continue
            yield f"{name} = {value}", options


def results_of_variants(
    item: Registered, chosen: Mapping[str, object], run: Callable[[str, dict[str, Any]], Result], what: str = "option"
) -> Result:
    """Return the first failure of a check, `run`, of the options that `variants` yields, or how many pass; options that
    are refused are left out. Raises Skip if there are none.
    """
    tried = 0
    for name, options in variants(item, chosen):
        try:
            result = run(name, options)
        except SpecError:  # the item refuses the values
            continue
        tried += 1
        if result.outcome == "fail":
            return failed(f"with {name}: {result.cause}; if that is not meant, give the {what} bounds")
    if not tried:
        raise Skip(f"none of its {what}s has another value to try")
    return passed(variants=tried)


def _others(schema: Mapping[str, Any], now: Any) -> list[object]:
    """Return values of an option other than its present one."""
    if "enum" in schema:
        return [value for value in schema["enum"] if value != now][:MOST_CHOICES]
    if schema.get("type") == "boolean":
        return [not now]
    kinds = [kind for kind in (schema, *schema.get("anyOf", ())) if kind.get("type") in ("number", "integer")]
    if not kinds:
        return []
    limits = kinds[0]
    size = abs(now) if isinstance(now, int | float) and now else 1
    if limits["type"] == "number":  # the bounds are not tried: they may be special cases, such as a tolerance of 0
        results = [-size, size / 2, 2 * size]
    else:
        results = [-size, size - 1, size + 1, *(limits[key] for key in ("minimum", "maximum") if key in limits)]
    return [value for value in dict.fromkeys(results) if value != now and _is_within(value, limits)]


def _is_within(value: float, limits: Mapping[str, Any]) -> bool:
    low, high = limits.get("minimum", -math.inf), limits.get("maximum", math.inf)
    above, below = limits.get("exclusiveMinimum", -math.inf), limits.get("exclusiveMaximum", math.inf)
    return bool(low <= value <= high and above < value < below)


def validated(model: type[Options], options: Mapping[str, object]) -> Options:
    """Return a validated `model` with these values, which are read as JSON, as the values of a spec are."""
    usable = cast("type[Options]", _NoOptions) if model is BaseModel else model  # BaseModel has no instances
    return usable.model_validate_json(json.dumps(options))


def _example(schema: Mapping[str, Any]) -> Any:
    for key in ("examples", "enum"):
        if schema.get(key):
            return schema[key][0]
    if "const" in schema:
        return schema["const"]
    for option in schema.get("anyOf", ()):
        if (example := _example(option)) is not None:
            return example
    if schema.get("type") not in ("number", "integer"):
        return None
    low = schema.get("minimum", schema.get("exclusiveMinimum", float("-inf")))
    high = schema.get("maximum", schema.get("exclusiveMaximum", float("inf")))
    if low < 1 < high or 1 in (schema.get("minimum"), schema.get("maximum")):
        return 1 if schema["type"] == "integer" else 1.0
    middle = 0.5 * (low + high) if max(abs(low), abs(high)) < float("inf") else low + 1 if low >= 1 else high - 1
    return int(middle) if schema["type"] == "integer" else middle
