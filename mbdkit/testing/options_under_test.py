"""Options of a plugin under test: given values, and example values for options without default."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from mbdkit.errors import SpecError
from mbdkit.mechanism.validation_errors import spec_error
from mbdkit.registry.catalogue import Registered
from mbdkit.strict_model import STRICT
from mbdkit.text import listed

Options = TypeVar("Options", bound=BaseModel)


def plain_options(item: Registered, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return valid options of an item: `given`, and an example value for each other option without default.

    An example is the first of ``examples`` in the option's JSON schema, the first of its choices, or a number within
    its bounds, 1 if that is one.

    Raises
    ------
    SpecError
        The options are invalid, or one has neither default nor example value.
    """
    model: type[BaseModel] = item.plugin.options
    schema = model.model_json_schema() if model.model_fields else {}  # none of BaseModel itself
    chosen = dict(given)
    missing = []
    for name in schema.get("required", ()):
        if name not in chosen:
            example = _example(schema["properties"][name])
            if example is None:
                missing.append(name)
            else:
                chosen[name] = example
    if missing:
        raise SpecError(
            f"{item.id} has no default and no example for {listed(missing, 'and')}; "
            f"give {'it' if len(missing) == 1 else 'them'} with --set {missing[0]}=VALUE"
        )
    strict = type(model.__name__, (model,), {"__module__": __name__, "model_config": STRICT})
    try:
        validated(strict, chosen)
    except ValidationError as error:
        raise spec_error(error, strict) from None
    return chosen


def validated(model: type[Options], options: Mapping[str, Any]) -> Options:
    """Return the options with these values, read as JSON like a spec."""
    return model.model_validate_json(json.dumps(options))


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
