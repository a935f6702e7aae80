"""Methods whose keyword arguments are the fields of models, from which their signatures and docstrings are made."""

from __future__ import annotations

import inspect
import json
import textwrap
from collections.abc import Callable, Iterator
from functools import cached_property, update_wrapper
from types import MethodType, NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, BeforeValidator
from pydantic_core import PydanticUndefined

from mbdkit.base.strict_model import description

#: Descriptions of arguments that are not fields.
TEXTS = {
    "name": "Name of the element.",
    "a": "First body.",
    "b": "Second body.",
    "along": "The length of the pathway: ``line``, the distance between two points [m]; ``angle``, angle_b - angle_a "
    "[rad]; or ``x`` or ``y``, a coordinate of b's point in a's frame [m]. For `x` and `y`, `points` are ((0, 0), b's "
    "point in b's frame) [m]; by default, b's origin.",
    "options": "Options of the force law; ``mbdkit plugins show LAW`` lists them.",
}


def of_models(*models: type[BaseModel]) -> Callable[[Callable[..., object]], Any]:
    """Replace the argument ``**keys`` of a method by the fields of these models, except `type`, `bodies` and other
    arguments.

    Arguments without an annotation have the type of the field with their name, or else are text. The docstring of the
    method is a summary, and after an empty line, examples.
    """
    return lambda function: _ModelMethod(function, models)


class _ModelMethod:
    """A method whose signature and docstring are made when they are asked for, because all of them take 30 ms."""

    def __init__(self, function: Callable[..., object], models: tuple[type[BaseModel], ...]):
        update_wrapper(self, function, ("__module__", "__name__", "__qualname__"))
        self.function, self.main = function, models[0]
        self.models = {name: model for model in reversed(models) for name in model.model_fields}

    def __get__(self, owner: object, cls: type) -> object:
        return self if owner is None else MethodType(self, owner)

    def __call__(self, *args: object, **keys: object) -> object:
        return self.function(*args, **keys)

    @cached_property
    def __signature__(self) -> inspect.Signature:
        given = inspect.signature(self.function)
        own, *arguments = [parameter for name, parameter in given.parameters.items() if name != "keys"]
        if "keys" in given.parameters:
            hidden = {"type", "bodies", *given.parameters}
            fields = {name: model.model_fields[name] for name, model in self.models.items() if name not in hidden}
            for name, field in fields.items():
                default = inspect.Parameter.empty if field.is_required() else field.default
                arguments.append(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default))
        returned = _Unquoted("None" if given.return_annotation is given.empty else given.return_annotation)
        return given.replace(parameters=[own, *map(self._annotated, arguments)], return_annotation=returned)

    def _annotated(self, argument: inspect.Parameter) -> inspect.Parameter:
        is_own = argument.annotation is not argument.empty
        text: str = argument.annotation if is_own else accepted(self._type(argument.name))
        text += " | None" if argument.default is None and "None" not in text else ""
        return argument.replace(annotation=_Unquoted(text))

    def _type(self, name: str) -> object:
        hints = get_type_hints(self.models[name], include_extras=True) if name in self.models else {}
        return hints.get(name, Any if name == "options" else str)

    @cached_property
    def __doc__(self) -> str:  # type: ignore[override]
        summary, _, examples = (inspect.getdoc(self.function) or "").partition("\n\n")
        lines = [summary, "", inspect.getdoc(self.main) or "", "", "Parameters", "----------"]
        for name, argument in list(self.__signature__.parameters.items())[1:]:
            text = description(self.models[name], name) if name in self.models else TEXTS[name]
            for model in dict.fromkeys(_models_in(self._type(name))):
                text += f" Keys of `{model.__name__}`: {', '.join(model.model_fields)}."
            lines.append(str(argument.replace(annotation=argument.empty, default=argument.empty)))
            lines.append(textwrap.indent(textwrap.fill(text, 104, break_on_hyphens=False), "    "))
        return "\n".join([*lines, "", "Examples", "--------", examples] if examples else lines)


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    """Yield the models that a type consists of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


class _Unquoted(str):
    """The text of an annotation, which signatures show without quotation marks."""

    __repr__ = str.__str__


def accepted(annotation: Any) -> str:
    """Return the annotation of an argument for a field of this type: any sequences, and mappings for models."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        inputs = (part.json_schema_input_type for part in parts[1:] if isinstance(part, BeforeValidator))
        return accepted(next((kind for kind in inputs if kind is not PydanticUndefined), parts[0]))
    if origin is Literal:
        return f"Literal[{', '.join(map(json.dumps, parts))}]"
    if origin is dict:
        return f"Mapping[str, {accepted(parts[1])}]"
    if origin is not None:  # a union, list or tuple
        items = " | ".join(dict.fromkeys(accepted(part) for part in parts if part is not ...))
        return items if origin in (Union, UnionType) else f"Sequence[{items}]"
    name = "None" if annotation is NoneType else str(annotation.__name__)
    return f"Mapping[str, Any] | {name}" if issubclass(annotation, BaseModel) else name
