"""Use of the code of items: errors name the item and its distribution."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import MbdkitError, PluginError, blaming
from mbdkit.registry.catalogue import KINDS, Registered
from mbdkit.registry.item import described

T = TypeVar("T")


def use(item: Registered, work: Callable[[], T], of: type | tuple[type, ...] = object) -> T:
    """Return what `work`, which calls the code of an item, returns.

    Errors of mbdkit itself and of its own items pass unchanged.

    Parameters
    ----------
    of
        Class of the result.

    Raises
    ------
    PluginError
        If the target of the item is missing, or its code raises another error or returns an object of another class.
    """
    if item.origin.distribution == MBDKIT:
        return work()
    name = f"the {KINDS[item.kind].label()} '{item.id}'"
    try:
        with blaming(f"{name} failed", MbdkitError):
            result = work()
    except PluginError as error:
        raise error if str(error).startswith(name) else PluginError(f"{name} failed: {error}") from error
    if not isinstance(result, of):
        raise PluginError(f"{name} returned {described(result)}, not {_words(of)}")
    return result


def _words(of: type | tuple[type, ...]) -> str:
    return f"an object of type {' or '.join(kind.__name__ for kind in (of if isinstance(of, tuple) else (of,)))}"
