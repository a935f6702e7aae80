"""Seams: decorators that declare what mbdkit passes to functions of plugins, and what these return.

A seam is declared as a function without a body, in the module that calls such functions::

    @Seam
    def summary_lines(run: Run, /) -> list[tuple[str, str]]:
        \"\"\"Return lines of the summary of a run, each a label and a text.\"\"\"
        raise NotImplementedError

and a plugin decorates its function with ``@summary_lines``. A type checker then compares the function with the
declaration, and so do ``mbdkit plugins verify`` and ``doctor``.

A function gets the arguments that it asks for, by their names; the first may have any name, and underscores around a
name do not count. So a declaration can get further arguments, and lose those that ``@removed`` below its seam states.
"""

from __future__ import annotations

import inspect
import logging
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
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
from mbdkit.base.frozen import dataclass, field
from mbdkit.base.text import did_you_mean, listed
from mbdkit.registry.target import Target

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

F = TypeVar("F", bound=Callable[..., object])

_MARK, _REMOVED = "__mbdkit_seam__", "__mbdkit_removed__"
_EMPTY, _NAMED = inspect.Parameter.empty, inspect.Parameter.KEYWORD_ONLY
_VARIABLE = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)

_log = logging.getLogger("mbdkit")


@dataclass(frozen=True)
class Removed:
    """An argument that is passed no more.

    `since`: version of mbdkit. `instead`: what replaces it, as a noun phrase. `value`: what functions that still ask
    for the argument get; without it, functions with no default for the argument are refused.
    """

    since: str
    instead: str
    value: object = _EMPTY


def removed(**arguments: Removed) -> Callable[[F], F]:
    """Return a decorator of a declaration, which states the arguments that the declaration had."""

    def stated(declared: F) -> F:
        setattr(declared, _REMOVED, arguments)
        return declared

    return stated


@dataclass(frozen=True, eq=False)
class Arguments:
    """What mbdkit passes to functions of a seam: names of arguments by position and by keyword, and those removed."""

    seam: str
    positional: tuple[str, ...]
    named: tuple[str, ...] = ()
    removed: Mapping[str, Removed] = field(default_factory=dict)

    def taken(self, function: Callable[..., object]) -> dict[str, str]:
        """Return the arguments for which a function asks, by its own names for them.

        Raises PluginError if one is not passed, and ValueError or TypeError if the function has no signature.
        """
        parameters = inspect.signature(function).parameters
        names, passed = [name.strip("_") for name in parameters], (*self.positional, *self.named)
        taken: dict[str, str] = {}
        for place, (name, parameter) in enumerate(parameters.items()):
            source = names[place]
            if parameter.kind in _VARIABLE:
                continue
            if source not in passed and (place == 0 or not source) and parameter.kind is not _NAMED:
                free = self.positional[place : place + 1]
                source = next((argument for argument in free if argument not in names), source)
            if source in passed or (source in self.removed and self.removed[source].value is not _EMPTY):
                taken[name] = source
            elif parameter.default is _EMPTY and source in self.removed:
                raise PluginError(self.sentence_on(source))
            elif parameter.default is _EMPTY:
                known = listed([f"`{argument}`" for argument in passed], "and")
                raise PluginError(f"asks for `{name}`{did_you_mean(source, passed)}; `@{self.seam}` passes {known}")
        return taken

    def sentence_on(self, name: str) -> str:
        """Return a clause on an argument that is removed."""
        gone = self.removed[name]
        return f"asks for `{name}`, which `@{self.seam}` does not pass since mbdkit {gone.since}: use {gone.instead}"


@cache
def fitted(function: Callable[..., R], arguments: Arguments, owner: object) -> Callable[..., R]:
    """Return a function that takes the arguments of a seam and passes those for which another function asks.

    That is the other function itself, if it asks for all of them. `owner`: what offers it, for messages.

    Raises PluginError if the function asks for another argument.
    """
    try:
        taken, parameters = arguments.taken(function), inspect.signature(function).parameters
    except PluginError as error:
        raise PluginError(f"{owner} {error}") from None
    except (TypeError, ValueError):  # a function in machine code, or what cannot be called and is refused elsewhere
        return function
    for name in [name for name in parameters if name in arguments.removed]:
        _log.warning("mbdkit: warning: %s %s", owner, arguments.sentence_on(name))
    kinds = {name: parameter.kind for name, parameter in parameters.items()}
    in_order = [source for name, source in taken.items() if kinds[name] is not _NAMED][: len(arguments.positional)]
    takes_all = in_order == list(arguments.positional) or _VARIABLE[0] in kinds.values()
    takes_named = _VARIABLE[1] in kinds.values() or {*arguments.named} <= {*taken.values()}
    if takes_all and takes_named and arguments.removed.keys().isdisjoint(taken.values()):
        return function
    placed = [source for name, source in taken.items() if kinds[name] is inspect.Parameter.POSITIONAL_ONLY]
    stated = {name: gone.value for name, gone in arguments.removed.items()}

    def call(*given: object, **named: object) -> R:
        known = stated | dict(zip(arguments.positional, given, strict=True)) | named
        by_name = {name: known[source] for name, source in list(taken.items())[len(placed) :] if source in known}
        return function(*[known[source] for source in placed], **by_name)

    return call


class _Declaration:
    """What both kinds of seams have: a name, and the comparison of functions with the declaration."""

    def __init__(self, declared: Callable[..., object]):
        self.name, self.__doc__, self.declared = declared.__name__, declared.__doc__, declared
        parameters = inspect.signature(declared).parameters
        named = tuple(name for name, parameter in parameters.items() if parameter.kind is _NAMED)
        gone = getattr(declared, _REMOVED, {})
        self.arguments = Arguments(self.name, tuple(parameters)[: len(parameters) - len(named)], named, gone)

    def check(self, function: Callable[..., object]) -> None:
        """Raise PluginError if a function asks for what is not passed, or returns something else than declared.

        Types are compared as far as both functions have annotations of classes that can be imported.
        """
        taken = self.arguments.taken(function)
        if isinstance(function, type):
            return
        declared, own = _hints(self.declared), _hints(function)
        for name, source in taken.items():
            if not _fits(declared.get(source), own.get(name)):
                raise PluginError(f"takes {_word(own[name])} as `{name}`, not {_word(declared[source])}")
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
        """Return the function behind a target, which takes the arguments of the declaration."""
        return fitted(cast("Callable[P, R]", target()), self.arguments, target)


class OwnSeam(_Declaration, Generic[P, R]):
    """A seam whose functions take an object of a class of the plugin, such as its options, as the first argument."""

    def __init__(self, declared: Callable[Concatenate[Never, P], R]):
        super().__init__(declared)

    def __call__(self, function: Callable[Concatenate[T, P], R]) -> Callable[Concatenate[T, P], R]:
        """Mark a function, which is not changed."""
        setattr(function, _MARK, self)
        return function

    def of(self, target: Target) -> Callable[Concatenate[object, P], R]:
        """Return the function behind a target, which takes the arguments of the declaration."""
        return fitted(cast("Callable[Concatenate[object, P], R]", target()), self.arguments, target)


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


def _word(hint: object) -> str:
    return getattr(hint, "__name__", None) or str(hint)
