"""Seams: decorators that declare what mbdkit passes to functions of plugins, and what these return.

A seam is declared as a function without a body, in the module that calls such functions::

    @Seam
    def summary_lines(run: Run, /) -> list[tuple[str, str]]:
        \"\"\"Return lines of the summary of a run, each a label and a text.\"\"\"
        raise NotImplementedError

and a plugin decorates its function with ``@summary_lines``. A type checker then compares the function with the
declaration, and so do ``mbdkit plugins verify`` and ``doctor``.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from contextlib import suppress
from types import UnionType
from typing import (
    Any,
    Concatenate,
    Generic,
    Never,
    ParamSpec,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from mbdkit.base.errors import PluginError
from mbdkit.registry.target import Target

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_MARK = "__mbdkit_seam__"
_NAMED = inspect.Parameter.KEYWORD_ONLY


class _Declaration:
    """What both kinds of seams have: a name, and the comparison of functions with the declaration."""

    def __init__(self, declared: Callable[..., object]):
        self.name, self.__doc__, self.declared = declared.__name__, declared.__doc__, declared

    def check(self, function: Callable[..., object]) -> None:
        """Raise PluginError if a function does not take or return what is declared.

        Types are compared as far as both functions have annotations of classes that can be imported.
        """
        wanted, given = inspect.signature(self.declared), inspect.signature(function)
        positional = [name for name, parameter in wanted.parameters.items() if parameter.kind is not _NAMED]
        named = {name: None for name, parameter in wanted.parameters.items() if parameter.kind is _NAMED}
        try:
            bound = given.bind(*positional, **named).arguments
        except TypeError:
            raise PluginError(f"takes {_arguments(given)}, not {_arguments(wanted)}") from None
        if isinstance(function, type):
            return
        declared, own = _hints(self.declared), _hints(function)
        for name, place in zip(bound, [*positional, *named], strict=False):
            if not _fits(declared.get(place), own.get(name)):
                raise PluginError(f"takes {_word(own[name])} as `{name}`, not {_word(declared[place])}")
        if not _fits(own.get("return"), declared.get("return")):
            raise PluginError(f"returns {_word(own['return'])}, not {_word(declared['return'])}")


class Seam(_Declaration, Generic[P, R]):
    """A decorator for functions with the arguments and the result of a declaration.

    Parameters
    ----------
    declared
        The declaration. Its docstring states shapes and units of the arguments.
    """

    def __init__(self, declared: Callable[P, R]):
        super().__init__(declared)

    def __call__(self, function: Callable[P, R]) -> Callable[P, R]:
        """Mark a function, which is not changed."""
        setattr(function, _MARK, self)
        return function

    def of(self, target: Target) -> Callable[P, R]:
        """Return the function behind a target."""
        return cast("Callable[P, R]", target())


class OwnSeam(_Declaration, Generic[P, R]):
    """A seam whose functions take an object of a class of the plugin, such as its options, as the first argument."""

    def __init__(self, declared: Callable[Concatenate[Never, P], R]):
        super().__init__(declared)

    def __call__(self, function: Callable[Concatenate[T, P], R]) -> Callable[Concatenate[T, P], R]:
        """Mark a function, which is not changed."""
        setattr(function, _MARK, self)
        return function

    def of(self, target: Target) -> Callable[Concatenate[object, P], R]:
        """Return the function behind a target."""
        return cast("Callable[Concatenate[object, P], R]", target())


def check_marked(target: Target, seam: str, field: str) -> None:
    """Raise PluginError if the function behind the target of a field is not marked by a seam, or differs from it."""
    function = target()
    own = vars(function).get(_MARK) if callable(function) else None
    if not isinstance(own, _Declaration) or not callable(function):
        sentence = f"is not decorated with `@{seam}`, which declares its arguments (see `mbdkit guide plugins`)"
    elif own.name != seam:
        sentence = f"is decorated with `@{own.name}`, not with `@{seam}`"
    else:
        try:
            own.check(function)
            return
        except PluginError as error:
            sentence = str(error)
    raise PluginError(f"its `{field}`, '{target.where}', {sentence}")


def _hints(function: Callable[..., object]) -> dict[str, object]:
    """Return the types of arguments and of the result by name, without those that only type checkers import."""
    hints: dict[str, object] = {}
    for name, text in getattr(function, "__annotations__", {}).items():
        holder = type("_", (), {"__annotations__": {name: text}})
        with suppress(Exception):
            hints |= get_type_hints(holder, vars(sys.modules[function.__module__]))
    return hints


def _fits(given: object, wanted: object) -> bool:
    """Return whether objects of one type can stand for another; True if one of them is unknown or not a class."""
    if Any in (given, wanted):
        return True
    if get_origin(given) in (Union, UnionType):
        return all(_fits(member, wanted) for member in get_args(given))
    if get_origin(wanted) in (Union, UnionType):
        return any(_fits(given, member) for member in get_args(wanted))
    first, second = (get_origin(hint) or hint for hint in (given, wanted))
    if given is None or wanted is None or not isinstance(first, type) or not isinstance(second, type):
        return True
    try:
        return issubclass(first, second) or (first, second) == (int, float)
    except TypeError:  # a protocol that cannot be checked
        return True


def _arguments(signature: inspect.Signature) -> str:
    texts = [str(parameter.replace(annotation=parameter.empty)) for parameter in signature.parameters.values()]
    return f"({', '.join(texts)})"


def _word(hint: object) -> str:
    return getattr(hint, "__name__", None) or str(hint)
