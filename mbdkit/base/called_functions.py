"""Python functions that a spec names: how they are found, whether they may be called, and what they returned before.

A spec from elsewhere must not run code by itself. Functions are therefore neither imported nor called except within
`calls_allowed`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from contextvars import ContextVar
from operator import attrgetter
from typing import Any

from mbdkit.base.context_values import value_within
from mbdkit.base.distributions import entry_points
from mbdkit.base.errors import SpecError
from mbdkit.base.interrupts import is_interrupt
from mbdkit.base.text import did_you_mean, listed, one_line

GROUP = "mbdkit.controllers"  #: Group of the entry points with functions of controllers.

#: Values that functions returned at their calls, one after another, by the name of what calls them.
Returned = Mapping[str, Sequence[Sequence[float]]]

_ALLOWED: ContextVar[bool] = ContextVar("allowed", default=False)
_RETURNED: ContextVar[Returned | None] = ContextVar("returned", default=None)


def calls_allowed(allowed: bool = True) -> AbstractContextManager[None]:
    """Allow that functions that a spec names are imported and called within a block, if `allowed`."""
    return value_within(_ALLOWED, allowed or _ALLOWED.get())


def may_call() -> bool:
    """Return whether functions that a spec names may be imported and called."""
    return _ALLOWED.get()


def returning(values: Returned | None) -> AbstractContextManager[None]:
    """Within a block, use what functions returned before, as long as there is something, instead of calling them."""
    return value_within(_RETURNED, values)


def returned_before() -> Returned | None:
    """Return what functions returned before; None if they are to be called."""
    return _RETURNED.get()


def function_at(target: str) -> Callable[..., Any]:
    """Import a function: ``module:name``, or the name of an entry point of the group `GROUP`.

    Raises SpecError if there is no such function.
    """
    module, colon, name = target.partition(":")
    try:
        if colon:
            result = attrgetter(name)(importlib.import_module(module))
        else:
            points = {point.name: point for point in entry_points(GROUP)[0]}
            if target not in points:
                hint = did_you_mean(target, points) or f"; there are {listed([*points]) or 'none'}"
                raise SpecError(f"there is no entry point '{target}' in the group {GROUP}{hint}")
            result = points[target].load()
    except BaseException as error:
        if isinstance(error, SpecError) or is_interrupt(error):
            raise
        raise SpecError(f"the function '{target}' cannot be imported: {one_line(error)}") from error
    if not callable(result):
        raise SpecError(f"'{target}' is not a function but of the type {type(result).__name__}")
    return result  # type: ignore[no-any-return]
