"""Named checks of plugins: functions whose docstrings state the requirements.

An exception that a plugin raises in a check is caught and reported as the result of the check. The work of a check is
limited in evaluations, so that its outcome does not depend on the load of the machine.
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
from mbdkit.engine.counters import Counters
from mbdkit_testing.check_result import Result, failed, skipped

UnderTest = TypeVar("UnderTest")
#: Number of evaluations of the equations, Jacobians and factorizations after which a check fails.
WORK_LIMIT = 2_000_000
#: Processor time [s] after which a check fails: a last resort against plugins that loop for ever without evaluations.
#:
#: It is generous, so that the outcome of a check does not depend on the load of the machine.
PROCESSOR_LIMIT = 300.0
STEP_LIMIT = 100_000  #: Largest number of steps of a run in a check.


class Skip(Exception):  # noqa: N818 - not an error
    """Raised by a check that does not apply; the message is the reason."""


class _LimitError(BaseException):
    """Raised in a check that exceeds a limit; a plugin that catches `Exception` does not catch it."""


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
        begin = time.process_time()
        reached = list[str]()
        try:
            with _limited_work(WORK_LIMIT, reached), _limited_time(PROCESSOR_LIMIT, reached):
                result = self.function(under_test)
        except Skip as skip:
            result = skipped(str(skip))
        except KeyboardInterrupt:
            raise
        except MbdkitError as error:
            is_claimed = isinstance(error, UnsupportedMechanismError) and _supported_mechanisms(under_test)
            result = (skipped if is_claimed else failed)(str(error).rstrip("."))
        except BaseException as error:  # a plugin may raise any exception, including SystemExit
            result = failed(f"it raised {with_place(error)}")
        if reached:  # a run may have turned the exception into another one
            result = failed(f"it did not finish within {reached[0]}")
        return replace(result, name=self.name, what=self.what, seconds=time.process_time() - begin)


def _supported_mechanisms(under_test: object) -> str:
    """Return a description of the mechanisms that a plugin claims to support; empty if it supports all."""
    return getattr(getattr(under_test, "claims", None), "mechanisms", "")


def check(name: str, *, slow: bool = False) -> Callable[[Callable[[Any], Result]], Check[Any]]:
    """Return a decorator that turns a function into a check with this name."""
    return lambda function: Check(name, function, slow)


@contextmanager
def _limited_work(most: int, reached: list[str]) -> Iterator[None]:
    """Raise `_LimitError` in the body of the `with` statement if the counters of all its runs add up to more than this
    number of evaluations, Jacobians and factorizations; `reached` then gets a description of the limit.

    A check within another one belongs to the work of the outer one.
    """
    if "__setattr__" in vars(Counters):
        yield
        return
    spent = 0

    def count(counters: Counters, name: str, value: int) -> None:
        nonlocal spent
        if name in _WORK:
            spent += max(value - getattr(counters, name), 0)
        object.__setattr__(counters, name, value)
        if spent > most:
            reached.append(f"{most} evaluations of the equations")
            raise _LimitError

    Counters.__setattr__ = count  # type: ignore[assignment, method-assign]
    try:
        yield
    finally:
        del Counters.__setattr__


_WORK = ("rhs_evaluations", "jacobian_evaluations", "factorizations")


@contextmanager
def _limited_time(seconds: float, reached: list[str]) -> Iterator[None]:
    """Raise `_LimitError` in the body of the `with` statement if the body takes more than this processor time [s];
    `reached` then gets a description of the limit.

    There is no limit outside the main thread, on systems without interval timers, or if another timer is running.
    """
    usable = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
    if not usable or signal.getitimer(signal.ITIMER_PROF)[0] > 0:
        yield
        return

    def ring(number: int, frame: object) -> None:
        reached.append(f"{seconds:g} s of processor time")
        raise _LimitError

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
