"""Base class of all user input: strict, frozen pydantic models that reject unknown keys."""

from __future__ import annotations

import ast
import inspect
import linecache
from collections.abc import Mapping
from contextlib import suppress
from functools import cache, lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, InitErrorDetails, PydanticKnownError

from mbdkit.base.errors import SpecError

if TYPE_CHECKING:
    from pydantic.json_schema import JsonSchemaValue

# For its first schema, Pydantic reads the entry points of all distributions, and fails if one of them is damaged. Later
# schemas have no plugins of Pydantic then.
with suppress(Exception):
    TypeAdapter(int)

#: Configuration of pydantic that rejects unknown keys, infinities and NaN, forbids assignment, and does not convert
#: text or booleans to numbers.
STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)


def schema_of(model: type[BaseModel]) -> CoreSchema:
    """Return the core schema of a model, which is built when it is first needed."""
    model.model_rebuild()
    return model.__pydantic_core_schema__


def _accept_lists(schema: object, owner: type[BaseModel]) -> None:
    """Let the tuples in a schema accept lists, but not those in other models than `owner`, which have their own."""
    if isinstance(schema, list):
        for part in schema:
            _accept_lists(part, owner)
    elif isinstance(schema, dict) and (schema.get("type") != "model" or schema["cls"] is owner):
        if schema.get("type") == "tuple":
            schema["strict"] = False
        for part in schema.values():
            _accept_lists(part, owner)


def _readable_version(value: object) -> object:
    if isinstance(value, bool):
        raise PydanticKnownError("literal_error", {"expected": "1"})
    if isinstance(value, int | float) and value > 1:
        raise LaterVersionError(f"should be 1, not {value}: a later mbdkit reads specs of this version")
    return value


class LaterVersionError(SpecError):
    """A spec of a later version, of which other problems say nothing."""


#: Version of the format of specs. Pydantic's ``Literal[1]`` alone also accepts True, which equals 1.
FormatVersion = Annotated[Literal[1], BeforeValidator(_readable_version)]


class StrictModel(BaseModel):
    """Base class of elements, options and sections of a spec; attribute docstrings are descriptions in the schema.

    The docstrings are read from the source on demand. Pydantic's ``use_attribute_docstrings`` would read them whenever
    a class is defined, which takes 0.2 s at every start of the program.
    """

    model_config = ConfigDict(**STRICT)
    FURTHER_AFTER: ClassVar[str] = ""
    """Key after which the `further_keys` are listed if they are sections; by default, they come last."""

    @classmethod
    def chosen_unit(cls, name: str, data: Mapping[str, object]) -> str:
        """Return the unit of the field `name` if it depends on other keys of `data`, which need not be valid.

        The result is empty if the unit is always that in the description of the field.
        """
        return ""

    @classmethod
    def further_keys(cls) -> list[str]:
        """Return keys that the model also accepts, with fields that a plugin adds if data have the key."""
        return []

    @classmethod
    def further_field(cls, key: str | int) -> FieldInfo | None:
        """Return the field of one of the `further_keys`; None for any other key."""
        return None

    @classmethod
    def __get_pydantic_core_schema__(cls, source: type[BaseModel], handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema with which lists are accepted for tuples, as JSON and YAML have no tuples."""
        schema = handler(source)
        _accept_lists(schema, cls)
        return schema

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the JSON schema with the docstrings of the attributes as descriptions."""
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema).get("properties", {})
        for name, field in cls.model_fields.items():
            key = field.alias or name
            if key in properties and (text := description(cls, name)):
                properties[key]["description"] = text
        return schema


def description(model: type[BaseModel], name: str) -> str:
    """Return the description of a field.

    This is the description given to pydantic, or else the docstring below the field, or else an empty string.
    """
    given = model.model_fields[name].description
    return given if given is not None else _docstrings(model).get(name, "")


@cache
def _docstrings(model: type[BaseModel]) -> Mapping[str, str]:
    """Return the docstrings of the attributes of a model and of its bases, by name of the attribute."""
    texts: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if issubclass(base, StrictModel) and (definition := _definition(base)) is not None:
            for statement, following in pairwise(definition.body):
                match statement, following:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                        texts[name] = inspect.cleandoc(text)
    return texts


def _definition(model: type) -> ast.ClassDef | None:
    """Return the syntax tree of a class definition; None for classes that are created at run time."""
    try:
        file = inspect.getsourcefile(model)
    except TypeError:
        return None
    node: ast.AST = _tree("".join(linecache.getlines(file))) if file else ast.Module([], [])
    for part in model.__qualname__.split("."):
        if part != "<locals>":
            inside = (one for one in ast.walk(node) if isinstance(one, ast.ClassDef | ast.FunctionDef))
            node = next((one for one in inside if one.name == part), ast.Module([], []))
    return node if isinstance(node, ast.ClassDef) else None


@lru_cache(maxsize=64)
def _tree(source: str) -> ast.Module:
    return ast.parse(source)


def located_below(error: ValidationError, tag: str) -> ValidationError:
    """Return the error with `tag` at the front of all locations, where pydantic puts the tag of a union."""
    lines: list[InitErrorDetails] = []
    for details in error.errors(include_url=False):
        context = details.get("ctx", {})
        line = InitErrorDetails(type=details["type"], loc=(tag, *details["loc"]), input=details["input"], ctx=context)
        lines.append(line)
    return ValidationError.from_exception_data(error.title, lines)
