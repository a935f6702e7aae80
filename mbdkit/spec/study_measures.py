"""The key `measures` of runs and studies: definitions by expressions or plugins and, for studies, also names."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, cast

from pydantic import BaseModel, BeforeValidator, GetJsonSchemaHandler, ValidationError, WithJsonSchema
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from mbdkit.base import higher_layers
from mbdkit.base.errors import MissingPartError, SpecError, blaming
from mbdkit.base.frozen import dataclass, replace
from mbdkit.base.plain_data import Path, path_text, value_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.base.units import read_unit
from mbdkit.mechanism.validation_errors import spec_error
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.item_options import named_options
from mbdkit.registry.manager import registry


def built_in_measures() -> Mapping[str, str]:
    """Return what each built-in measure needs in addition to the run, by its name.

    The values are ``reference``, ``second run``, or an empty text for measures that need nothing else.
    """
    try:
        return cast("Mapping[str, str]", higher_layers.built_in_measures())
    except MissingPartError:
        return {}


_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]{0,99}")
_FORMS = 'an expression such as "max(abs(joints.B.force))", {value: EXPRESSION, unit: UNIT} or {name: PLUGIN, ...}'


@dataclass(frozen=True)
class DefinedMeasure:
    """A measure that a run spec or a study spec defines.

    - `name`: name of the measure and of its column.
    - `place`: key path of the definition in the spec.
    - `expression`, `unit`: expression of a run, and the unit of its value; if the unit is empty, it follows from the
      expression.
    - `item`, `options`: measure of a plugin and its options, instead of an expression.
    - `of_base`: whether the measure is defined in the base of a study instead of the study itself. It is then computed
      only for the runs whose spec contains it, because other families may have other bases.
    """

    name: str
    place: Path
    expression: str = ""
    unit: str = ""
    item: Registered | None = None
    options: BaseModel | None = None
    of_base: bool = False

    def is_like(self, other: DefinedMeasure) -> bool:
        """Return whether another measure of this name has the same definition."""
        return replace(other, place=self.place, of_base=self.of_base) == self


def defined(measures: object, above: Path = ()) -> Iterator[DefinedMeasure]:
    """Yield the measures that a spec defines, and those of plugins that it names.

    `above`: key path of `measures`; the key paths of measures and of errors begin with it. Raises SpecError if a
    measure is not valid.
    """
    if isinstance(measures, Mapping):
        yield from _defined_in(measures, above)
    for index, entry in enumerate(measures if isinstance(measures, list) else ()):
        if isinstance(entry, Mapping):
            yield from _defined_in(entry, (*above, index))
        elif entry not in built_in_measures():
            yield _of_plugin(entry, {"name": entry}, (*above, index))


def _defined_in(definitions: Mapping[str, Any], above: Path) -> Iterator[DefinedMeasure]:
    for name, definition in definitions.items():
        path = (*above, name)
        if not _NAME.fullmatch(name):
            message = "a measure has a name of at most 100 letters, digits and _ . -, which begins with a letter"
            raise SpecError(message, key=path_text(path))
        if name in built_in_measures():
            raise SpecError(f"'{name}' is a built-in measure; choose another name", key=path_text(path))
        match definition:
            case str():
                yield DefinedMeasure(name, path, definition)
            case {"value": str() as expression}:
                yield DefinedMeasure(name, path, expression, _unit(definition, path))
            case {"name": str()}:
                yield _of_plugin(name, definition, path)
            case _:
                raise SpecError(f"should be {_FORMS}, not {value_text(definition)}", key=path_text(path))


def _unit(keys: Mapping[str, object], path: Path) -> str:
    for key in keys:
        if key not in ("value", "unit"):
            hint = did_you_mean(key, ["value", "unit"])
            raise SpecError(f"unknown key{hint}; a measure has value and unit", key=path_text((*path, key)))
    unit = keys.get("unit", "")
    if "unit" in keys:
        if not isinstance(unit, str):
            message = f"should be a unit such as N, in quotes if it is a number, not {value_text(unit)}"
            raise SpecError(message, key=path_text((*path, "unit")))
        with SpecError.locate(path_text((*path, "unit"))):
            read_unit(unit)
    return str(unit)


def _of_plugin(name: str, definition: Mapping[str, object], path: Path) -> DefinedMeasure:
    installed = registry()
    wanted = str(definition["name"])
    items = installed.of_kind("measure")
    if not any(wanted in (item.name, item.id) for item in items):
        if wanted in built_in_measures():
            message = f"'{wanted}' is a built-in measure, which is selected by its name alone: `measures: [{wanted}]`"
            raise SpecError(message, key=path_text(path))
        known = [*(built_in_measures() if isinstance(path[-1], int) else ()), *installed.names("measure")]
        text = f"; known: {listed(known)}" if known else "; no installed plugin has any"
        hint = did_you_mean(wanted, known) or text
        raise SpecError(f"there is no measure '{wanted}'{hint}{installed.advice(wanted)}", key=path_text(path))
    with SpecError.rekey(path_text(path)):  # several distributions use this name
        item = installed.get("measure", wanted)
    model = named_options(item)
    with blaming(f"measure {item.id} failed to check its options"):
        try:
            options = model.model_validate_json(json.dumps(dict(definition)))
        except ValidationError as error:
            raise spec_error(error, model, prefix=path_text(path)) from None
    return DefinedMeasure(name, path, item=item, options=options)


def _check(given: object) -> object:
    if given == "all":
        return given
    if not isinstance(given, list | Mapping):
        raise SpecError(
            f"should be 'all', a list of measures, or a mapping of names and expressions, not {value_text(given)}"
        )
    for index, entry in enumerate(given if isinstance(given, list) else ()):
        if not isinstance(entry, str | Mapping):
            message = f"should be the name of a measure, or a mapping of a name and {_FORMS}, not {value_text(entry)}"
            raise SpecError(message, key=path_text((index,)))
    places: dict[str, Path] = {}
    for measure in defined(given):
        if measure.name in places:
            raise SpecError(f"'{measure.name}' is defined twice", key=path_text(measure.place))
        places[measure.name] = measure.place
    return given


def _check_definitions(given: object) -> object:
    if not isinstance(given, Mapping):
        raise SpecError(f"should be a mapping of names and expressions, not {value_text(given)}")
    return _check(given)


_DEFINITIONS: dict[str, Any] = {
    "type": "object",
    "propertyNames": {"pattern": f"^{_NAME.pattern}$"},
    "additionalProperties": {
        "description": f"The measure: {_FORMS}.",
        "anyOf": [
            {"type": "string"},
            {
                "type": "object",
                "properties": {
                    "value": {"type": "string", "description": "Expression of a run."},
                    "unit": {"type": "string", "description": "Unit of its value."},
                },
                "required": ["value"],
                "additionalProperties": False,
            },
            {"type": "object", "properties": {"name": {"type": "string"}}, "required": ["name"]},
        ],
    },
}

#: The value of `measures` of a run spec: plain data that has been checked.
RunMeasures = Annotated[dict[str, Any], BeforeValidator(_check_definitions), WithJsonSchema(_DEFINITIONS)]


class _MeasuresSchema:
    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        named = {"anyOf": [{"enum": list(built_in_measures())}, {"type": "string"}, _DEFINITIONS]}
        return {"anyOf": [{"const": "all"}, {"type": "array", "items": named}, _DEFINITIONS]}


#: The value of `measures`: plain data that has been checked.
Measures = Annotated[Any, BeforeValidator(_check), _MeasuresSchema]
