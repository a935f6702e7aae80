"""A named check: a function with one sentence of docstring, carried out so that no plugin can take it down."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from mbdkit.errors import MbdkitError
from mbdkit.testing.outcome import Finding, Result, failed, skipped
from mbdkit.text import one_line

Subject = TypeVar("Subject")
PATIENCE = 60.0
"""Seconds after which a check counts as hanging."""


class Skip(Exception):  # noqa: N818 - not an error
    """Raised inside a check that cannot be carried out; its text says why."""


class _HangingError(BaseException):
    """Raised into a check that takes too long; no plugin that catches `Exception` can hold it."""


@dataclass(frozen=True)
class Check(Generic[Subject]):
    """A check that can be carried out on any subject of its kind.

    Attributes
    ----------
    name
        ``room.check``.
    function
        Takes the subject, returns a `Finding` or raises `Skip`; any other exception is a failure.
    slow
        Whether it takes more than a second or two, so that a quick verification leaves it out.
    """

    name: str
    function: Callable[[Subject], Finding]
    slow: bool = False

    @property
    def what(self) -> str:
        """What it does, in one sentence."""
        return " ".join((self.function.__doc__ or "").partition("\n\n")[0].split())

    def run(self, subject: Subject) -> Result:
        """Carry it out; whatever the plugin raises becomes a failure."""
        begin = time.perf_counter()
        try:
            with _deadline(PATIENCE):
                finding = self.function(subject)
        except Skip as skip:
            finding = skipped(str(skip))
        except KeyboardInterrupt:
            raise
        except _HangingError:
            finding = failed(f"it did not come to an end within {PATIENCE:g} s")
        except MbdkitError as error:
            finding = failed(str(error).rstrip("."))
        except BaseException as error:  # a plugin may raise anything, SystemExit included
            finding = failed(f"it raised {one_line(error)}")
        seconds = time.perf_counter() - begin
        return Result(self.name, self.what, finding.outcome, finding.cause, finding.figures, seconds)


def check(name: str, *, slow: bool = False) -> Callable[[Callable[[Any], Finding]], Check[Any]]:
    """Turn a function into a check of this name."""

    def named(function: Callable[[Any], Finding]) -> Check[Any]:
        return Check(name, function, slow)

    return named


@contextmanager
def _deadline(seconds: float) -> Iterator[None]:
    """Raise `_HangingError` in the block after some time, where the system has alarms and nobody else uses them."""
    usable = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
    if not usable or signal.getitimer(signal.ITIMER_REAL)[0] > 0:
        yield
        return

    def ring(number: int, frame: Any) -> None:
        raise _HangingError

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
