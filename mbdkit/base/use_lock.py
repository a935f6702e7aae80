"""Objects that one thread may use at a time, such as simulations; calls of other threads meanwhile are refused.

A lock for which they wait would not help: where threads share a simulation, its time and inputs after a call are not
those that the thread left.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

from mbdkit.base.errors import SpecError

P = ParamSpec("P")
R = TypeVar("R")


class UseLock:
    """Held by the thread that uses an object; copies are locks of their own.

    `refusal`: the sentence for other threads.
    """

    def __init__(self, refusal: str):
        self.refusal = refusal
        lock = threading.RLock()
        self.acquire, self.release = lock.acquire, lock.release

    def __reduce__(self) -> tuple[type[UseLock], tuple[str]]:
        return UseLock, (self.refusal,)


def one_thread_at_a_time(method: Callable[Concatenate[Any, P], R]) -> Callable[Concatenate[Any, P], R]:
    """Let a method of an object with the `UseLock` `in_use` raise SpecError while another thread is in one of them."""

    @wraps(method)
    def exclusive(self: Any, /, *args: P.args, **kwargs: P.kwargs) -> R:
        lock: UseLock = self.in_use
        if not lock.acquire(blocking=False):
            raise SpecError(lock.refusal)
        try:
            return method(self, *args, **kwargs)
        finally:
            lock.release()

    return exclusive
