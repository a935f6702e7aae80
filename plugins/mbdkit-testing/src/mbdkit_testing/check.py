"""Named checks of plugins: functions whose docstrings state the requirements.

An exception that a plugin raises in a check is caught and reported as the result of the check.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from mbdkit.base.errors import MbdkitError, UnsupportedMechanismError, with_place
from mbdkit_testing.check_result import Result, failed, skipped

UnderTest = TypeVar("UnderTest")
TIME_LIMIT = 60.0
"""Duration [s] after which a check fails."""


class Skip(Exception):  # noqa: N818 - not an error
    """Raised by a check that does not apply; the message is the reason."""


class _TimeLimitError(BaseException):
    """Raised in a check that exceeds the time limit; a plugin that catches `Exception` does not catch it."""


@dataclass(frozen=True)
class Check(Generic[UnderTest]):
    """A check of one kind of plugin.

    Parameters
    ----------
    name
        ``group.check``.
    function
        Function of the plugin under test. It returns a `Result`, or raises `Skip` if the check does not apply.
    slow
        Whether a quick verification omits the check, because it takes more than a second or two.
    """

    name: str
    function: Callable[[UnderTest], Result]
    slow: bool = False

    @property
    def what(self) -> str:
        """The requirement in one sentence: the first paragraph of the function's docstring."""
        return " ".join((self.function.__doc__ or "").partition("\n\n")[0].split())

    def run(self, under_test: UnderTest) -> Result:
        """Run the check and return its result; an exception raised by the plugin is a failure.

        Two exceptions are not failures: KeyboardInterrupt is raised again, and UnsupportedMechanismError skips the
        check if the plugin claims to support some mechanisms only.
        """
        begin = time.perf_counter()
        try:
            with _time_limit(TIME_LIMIT):
                result = self.function(under_test)
        except Skip as skip:
            result = skipped(str(skip))
        except KeyboardInterrupt:
            raise
        except _TimeLimitError:
            result = failed(f"it did not finish within {TIME_LIMIT:g} s")
        except MbdkitError as error:
            is_claimed = isinstance(error, UnsupportedMechanismError) and _supported_mechanisms(under_test)
            result = (skipped if is_claimed else failed)(str(error).rstrip("."))
        except BaseException as error:  # a plugin may raise any exception, including SystemExit
            result = failed(f"it raised {with_place(error)}")
        return replace(result, name=self.name, what=self.what, seconds=time.perf_counter() - begin)


def _supported_mechanisms(under_test: Any) -> str:
    """Return a description of the mechanisms that a plugin claims to support; empty if it supports all."""
    return getattr(getattr(under_test, "claims", None), "mechanisms", "")


def check(name: str, *, slow: bool = False) -> Callable[[Callable[[Any], Result]], Check[Any]]:
    """Return a decorator that turns a function into a check with this name."""

    def named(function: Callable[[Any], Result]) -> Check[Any]:
        return Check(name, function, slow)

    return named


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """Raise `_TimeLimitError` in the body of the `with` statement if the body takes longer than this many seconds.

    There is no limit outside the main thread, on systems without interval timers, or if another timer is running.
    """
    usable = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
    if not usable or signal.getitimer(signal.ITIMER_REAL)[0] > 0:
        yield
        return

    def ring(number: int, frame: Any) -> None:
        raise _TimeLimitError

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
