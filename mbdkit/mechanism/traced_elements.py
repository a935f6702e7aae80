"""Traced numbers in validated models: validation by pydantic converts numbers to floats, and they are put back.

The bounds of the fields, and the checks of models and fields that are written in Python, are repeated with the traced
numbers, which record the conditions under which they hold.
"""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import annotated_types
from pydantic import AfterValidator, BaseModel, BeforeValidator
from pydantic.fields import FieldInfo

from mbdkit.base.traced_numbers import TracedNumber, TracedText, UntraceableError, is_recording, is_traced, plain

AnyModel = TypeVar("AnyModel", bound=BaseModel)


def traced(validate: Callable[[Any], Any], kind: object, values: Any) -> Any:
    """Return validated data; traced numbers in them are validated by their values, and put back."""
    if not (is_recording() and is_traced(values)):
        return validate(values)
    result = with_numbers(validate(plain(values)), values)
    if not isinstance(result, BaseModel):
        _check(kind, (), result)
    return result


def with_numbers(validated: Any, given: Any) -> Any:
    """Return a validated value with the traced numbers of the data from which it was validated.

    Raises UntraceableError if it does not contain these numbers as they are, or if their conditions are not known.
    """
    if not is_traced(given):
        return validated
    if isinstance(given, TracedNumber):
        if type(validated) is not float or validated != given.traced_value:
            raise given.traced_by.failure("a traced number is changed by validation")
        return given
    if isinstance(given, TracedText):
        if validated != given.traced_value:
            raise UntraceableError("a text with traced numbers is changed by validation")
        return given
    if isinstance(validated, BaseModel) and isinstance(given, Mapping):
        return _model_with_numbers(validated, given)
    if isinstance(validated, Mapping) and isinstance(given, Mapping):
        return {key: with_numbers(value, given.get(key)) for key, value in validated.items()}
    if isinstance(validated, tuple | list) and isinstance(given, tuple | list) and len(validated) == len(given):
        return type(validated)(map(with_numbers, validated, given))
    raise UntraceableError("a traced number is in data of another form")


def _model_with_numbers(validated: AnyModel, given: Mapping[Any, Any]) -> AnyModel:
    cls, update = type(validated), {}
    for name, field in cls.model_fields.items():
        key = field.alias if field.alias in given else name
        if is_traced(value := given.get(key)):
            update[name] = with_numbers(getattr(validated, name), value)
            _check(field.annotation, field.metadata, update[name])
    if sum(map(is_traced, given.values())) != len(update):
        raise UntraceableError("a traced number is in no field")
    decorators = cls.__pydantic_decorators__
    if any(not update.keys().isdisjoint(check.info.fields) for check in decorators.field_validators.values()):
        raise UntraceableError("a field has a validator of its own")
    model = validated.model_copy(update=update)
    for name in model.__dict__.keys() - cls.model_fields.keys():
        del model.__dict__[name]  # a cached property, which follows from the plain numbers
    for check in decorators.model_validators.values():
        if check.info.mode == "after":
            _require_same(check.func(model), model)
        elif check.info.mode == "before":
            _require_same(check.func(given), given)
    return model


def _require_same(checked: Any, value: Any) -> None:
    """Raise UntraceableError if a check returns other traced numbers than those that it is given."""
    if len(found := _numbers(checked)) != len(given := _numbers(value)) or any(map(operator.is_not, found, given)):
        raise UntraceableError("a check changes numbers")


def _numbers(value: Any) -> list[TracedNumber]:
    """Return the traced numbers in data."""
    if isinstance(value, TracedNumber):
        return [value]
    items = vars(value).values() if isinstance(value, BaseModel) else value
    items = items.values() if isinstance(items, Mapping) else items if isinstance(items, Iterable) else ()
    return [] if isinstance(value, str) else [number for item in items for number in _numbers(item)]


def _check(kind: Any, metadata: Sequence[Any], value: Any) -> None:
    """Repeat the checks of a type, and of its metadata, with traced numbers."""
    if not is_traced(value):
        return
    for one in metadata:
        _check_by(one, value)
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        _check(arguments[0], arguments[1:], value)
    elif isinstance(value, BaseModel):
        return  # its fields were checked
    elif origin is tuple:
        kinds = arguments[:1] * len(value) if arguments[-1:] == (...,) else arguments
        for own, item in zip(kinds, value, strict=True):
            _check(own, (), item)
    elif isinstance(value, Mapping) and len(arguments) == 2:
        for item in value.values():
            _check(arguments[1], (), item)
    elif origin is Union or type(kind).__name__ == "UnionType":
        fits = [one for one in arguments if _could_be(one, value)]
        if len(fits) != 1:
            raise UntraceableError("a number has several types")
        _check(fits[0], (), value)
    elif not (kind is float and isinstance(value, TracedNumber)) and not (
        kind is str and isinstance(value, TracedText)
    ):
        raise UntraceableError(f"the conditions of {kind} are not known")


def _could_be(kind: Any, value: Any) -> bool:
    while get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    if isinstance(value, TracedText):
        return kind is str
    return kind is float if isinstance(value, TracedNumber) else get_origin(kind) is tuple


def _check_by(one: Any, value: Any) -> None:
    if isinstance(one, FieldInfo):
        for inner in one.metadata:
            _check_by(inner, value)
    elif isinstance(one, BeforeValidator | AfterValidator):
        if len(inspect.signature(one.func).parameters) != 1:
            raise UntraceableError("a validator takes more than its value")
        _require_same(one.func(value), value)  # type: ignore[call-arg]
    elif isinstance(value, TracedNumber):
        for name in ("gt", "ge", "lt", "le"):
            if isinstance(one, getattr(annotated_types, name.capitalize())):
                getattr(operator, name)(value, getattr(one, name))
                return
        if not _is_harmless(one):
            raise UntraceableError(f"the condition {one!r} is not known")


def _is_harmless(one: Any) -> bool:
    """Return whether metadata say nothing about the value of a finite float."""
    settings = getattr(one, "__dict__", {})
    return len(settings) > 0 and settings.keys() <= {"allow_inf_nan", "strict"}
