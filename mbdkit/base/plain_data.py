"""Plain data of a spec: conversion of Python objects, canonical form, key paths, and values in error messages."""

from __future__ import annotations

import gc
import json
import math
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sized
from contextlib import contextmanager
from functools import lru_cache
from itertools import islice
from typing import Any, NamedTuple

from pydantic import BaseModel

from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed, shown

Path = tuple[str | int, ...]

DEEPEST = 100  #: Largest number of nested mappings and lists in a spec.

LONGEST_TITLE = 10_000  #: Largest number of characters of a title; drawing longer titles would take minutes.

#: Largest number of characters of the name of an element; pictures with much longer names would take minutes.
LONGEST_NAME = 255

#: Largest magnitude of a whole number in a spec: the largest number in double precision.
LARGEST_NUMBER = int(sys.float_info.max)


@contextmanager
def without_collection() -> Iterator[None]:
    """Pause the cyclic garbage collector in a block, because it takes half of the time of building large plain data."""
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()


#: Characters with a special meaning in key paths or assignments; keys that contain one are quoted.
_MEANT = re.compile(r"[.\[\]\"=\\]")
QUOTED = r'"(?:[^"\\]|\\.)*+"'
_PART = re.compile(rf"({QUOTED})(?=[.\[]|$)|\[(\d{{1,9}})\]|(?:[^.\[]++|\[(?!\d{{1,9}}\]))+")


def quoted(name: str) -> str:
    """Return a key as it is written in a key path: quoted, with backslashes, if it contains special characters such as
    dots, or begins or ends with a blank.
    """
    if name and name == name.strip() and not _MEANT.search(name):
        return name
    return '"' + re.sub(r'(["\\])', r"\\\1", name) + '"'


@lru_cache(maxsize=1024)
def path_text(path: Path) -> str:
    """Return a key path as text, such as ``model.joints.A.bodies[1]`` or ``model.bodies."R.Shank".mass``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f"{'.' if text else ''}{quoted(part)}"
    return text


def parse_path(text: str) -> Path:
    """Return the parts of a key path such as ``model.joints.A.bodies[1]``; the inverse of `path_text`.

    At most ``DEEPEST + 1`` parts are returned, because specs have at most `DEEPEST` levels.
    """
    parts: list[str | int] = []
    for match in islice(_PART.finditer(text), DEEPEST + 1):
        name, index = match.groups()
        parts.append(match[0] if match.lastindex is None else int(index) if name is None else _unquoted(name))
    return tuple(parts)


def assignment_parts(text: str) -> tuple[str, str, str]:
    """Return the key, equals sign and value of ``KEY=VALUE``; equals signs within quotes belong to the key."""
    end = re.match(rf"(?:{QUOTED}|[^=])*", text)
    assert end is not None
    return text[: end.end()], text[end.end() : end.end() + 1], text[end.end() + 1 :]


def _unquoted(text: str) -> str:
    return re.sub(r"\\(.)", r"\1", text[1:-1])


def plain(value: object, path: Path = ()) -> Any:
    """Convert `value` to plain data: dicts, lists, text, numbers, booleans and None.

    In the columns of a mapping with the key ``data``, NaN is a gap and becomes None.

    Raises SpecError if there is a number that is too large or not finite, a key that is not text, an object that a spec
    cannot contain, or more than `DEEPEST` levels, as in a list that contains itself.
    """
    if len(path) > DEEPEST:
        raise SpecError(f"is nested too deeply (more than {DEEPEST} levels), or contains itself", key=str(path[0]))
    match value:
        case None | bool() | str():
            return value
        case int():
            if not -LARGEST_NUMBER <= value <= LARGEST_NUMBER:
                raise SpecError(f"is too large: numbers go up to {float(LARGEST_NUMBER):.2g}", key=path_text(path))
            return int(value)
        case float():
            if not math.isfinite(value):
                if math.isnan(value) and path[-3:-2] == ("data",):  # a gap in a column of measured data
                    return None
                raise SpecError(f"should be a finite number, not {float(value)!r}", key=path_text(path))
            return float(value)
        case BaseModel():
            return plain(canonical(value), path)
        case Mapping():
            return {_key(key, path): plain(item, (*path, key)) for key, item in value.items()}
        case list() | tuple():
            return [plain(item, (*path, index)) for index, item in enumerate(value)]
        case os.PathLike():
            return os.fspath(value)
    if hasattr(value, "tolist"):  # a NumPy array or number
        return plain(value.tolist(), path)
    if callable(value):
        raise SpecError(NO_FUNCTIONS, key=path_text(path))
    raise SpecError(f"a spec cannot contain an object of type {type(value).__name__}", key=path_text(path))


NO_FUNCTIONS = (
    "a spec cannot contain a Python function; write an expression of the time or of the state, such as '2*sin(t)' or "
    "'-40*leg.angle', or a table; a law of forces in Python is an mbdkit.FunctionLaw (`mbdkit guide plugins`), and a "
    "feedback that is computed at samples is one of `controllers` (`mbdkit guide mechanism`)"
)


def copied(value: object, path: Path = ()) -> Any:
    """Return a copy of a mapping or list; mappings and lists are copied at all levels, other values are not.

    Raises SpecError if the value has more than `DEEPEST` levels, as a list that contains itself does, or if a key is
    not text.
    """
    if len(path) > DEEPEST:
        raise SpecError(f"is nested too deeply (more than {DEEPEST} levels), or contains itself", key=str(path[0]))
    match value:
        case str() | float() | int():  # compared first, because tests for abstract classes are slow
            return value
        case Mapping():
            return {_key(key, path): copied(item, (*path, key)) for key, item in value.items()}
        case list():
            return [copied(item, (*path, index)) for index, item in enumerate(value)]
    return value


class _WrittenField(NamedTuple):
    """A field of a model, with its name in the spec."""

    name: str
    field: str
    may_be_absent: bool
    default: Any

    def is_written(self, value: object) -> bool:
        if not self.may_be_absent:
            return True
        is_empty = value is None or (isinstance(value, Sized) and not len(value))
        return not is_empty and bool(value != self.default)  # 0 is not empty, so it is written unless it is the default


@lru_cache(maxsize=512)
def _written_fields(kind: type[BaseModel]) -> tuple[_WrittenField, ...]:
    """Return the fields of a model, sorted by their names in the spec."""
    absent: tuple[str, ...] = getattr(kind, "ABSENT_BY_DEFAULT", ())
    fields = [
        _WrittenField(info.serialization_alias or info.alias or name, name, name in absent, info.default)
        for name, info in kind.model_fields.items()
    ]
    return tuple(sorted(fields, key=lambda field: field.name))


def canonical(value: Any) -> Any:
    """Convert models to dicts with sorted keys; mappings keep the order of their keys, which are names from the user.

    Keys listed in the model's ``ABSENT_BY_DEFAULT`` are omitted if they are empty or have their default value.
    """
    match value:
        case str() | float() | int() | None:  # compared first, because tests for abstract classes are slow
            return value
        case list() | tuple():
            return [canonical(item) for item in value]
        case BaseModel():
            parts = [(field, getattr(value, field.field)) for field in _written_fields(type(value))]
            return {one.name: canonical(part) for one, part in parts if one.is_written(part)}
        case Mapping():
            return {key: canonical(item) for key, item in value.items()}
        case set() | frozenset():
            return sorted(canonical(item) for item in value)
    return value


def canonical_text(data: Any) -> str:
    """Return plain data as the JSON that is hashed: without spaces, keys as ordered in the data, shortest numbers."""
    return _COMPACT.encode(data)


_COMPACT = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False)


#: Escapes in JSON; the group is half of a surrogate pair without the other half.
_ESCAPES = re.compile(r"\\(?:u[dD][89abAB]..\\u[dD][c-fC-F]..|(u[dD][89a-fA-F]..)|.)")


def json_data(text: str | bytes, **options: Any) -> Any:
    """Return the data of a JSON text from a file; `options` are those of `json.loads`.

    Raises ValueError, in most cases with the line, if the text is not JSON, is nested too deeply, or contains half of a
    surrogate pair, which cannot be written to any file.
    """
    if isinstance(text, bytes):
        text = text.decode()
    try:
        data = json.loads(text, **options)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if half := next((match for match in _ESCAPES.finditer(text) if match[1]), None):
        raise json.JSONDecodeError(f"half of a surrogate pair, {half[0]}", text, half.start())
    return data


def json_text(data: object, indent: int | None = None) -> str:
    """Return data as JSON; numbers that are not finite become null, and objects unknown to JSON become text."""
    return json.dumps(_finite(data), indent=indent, ensure_ascii=indent is None, allow_nan=False)


def _finite(data: object) -> object:
    match data:
        case None | bool() | str() | int():
            return data
        case float():
            return float(data) if math.isfinite(data) else None
        case Mapping():
            return {str(key): _finite(value) for key, value in data.items()}
        case list() | tuple():
            return [_finite(value) for value in data]
    return _finite(data.tolist()) if hasattr(data, "tolist") else str(data)


def value_text(value: object) -> str:
    """Return a short description of a value for an error message, including its type unless it is obvious."""
    match value:
        case None:
            return "nothing"
        case bool():
            return "true" if value else "false"
        case str():
            return f"the text '{shown(value if len(value) <= 60 else value[:57] + '...')}'"
        case Mapping():
            keys = listed(shown(key) for key in list(value)[:5])
            return f"a mapping with the keys {keys}" if value else "an empty mapping"
        case list() | tuple():
            return f"a list of {len(value)}" if value else "an empty list"
    if hasattr(value, "tolist") and not isinstance(value, type):  # a NumPy array or number
        return value_text(value.tolist())
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _key(key: object, path: Path) -> str:
    if not isinstance(key, str):
        raise SpecError(f"the key {value_text(key)} is not text; put it in quotes", key=path_text(path))
    return key
