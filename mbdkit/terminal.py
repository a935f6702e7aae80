"""Error messages, exit statuses and progress bars of the commands."""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TextIO

import typer
from typer.core import TyperGroup

from mbdkit.errors import MbdkitError, PluginError, ResourceError, RunError, file_error
from mbdkit.interrupts import INTERRUPTED as INTERRUPTED
from mbdkit.text import shown

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

DONE, BUG, WRONG_INPUT, STOPPED_EARLY, PLUGIN_FAILED = 0, 1, 2, 3, 4
DIFFERS = NOT_VERIFIED = 1

DEBUG = "mbdkit.debug"
PATIENCE = 0.5  # seconds before a progress bar appears


class PlainStream:
    """A text stream that escapes control characters: titles, names and messages from outside must not steer a terminal.

    Parameters
    ----------
    stream
        The stream to write to; progress bars, which need its control characters, use it directly.
    """

    def __init__(self, stream: TextIO):
        self.stream = stream

    def write(self, text: str) -> int:
        """Write text with its control characters escaped; raise TypeError for bytes, by which click tells streams."""
        if not isinstance(text, str):
            raise TypeError(f"text is written here, not {type(text).__name__}")
        self.stream.write(shown(text, lines=True))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write several pieces of text."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


class Commands(TyperGroup):
    """The top-level command group: reports exceptions on stderr and converts them to exit statuses."""

    def invoke(self, ctx: Any) -> Any:
        """Run the selected command."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise
        except (Exception, KeyboardInterrupt) as error:
            if hasattr(error, "exit_code"):  # a usage error or an exit of the framework
                raise
            if ctx.meta.get(DEBUG):
                traceback.print_exc()
            say(_sentence(error))
            raise typer.Exit(_status(error)) from None


def say(text: str) -> None:
    """Print a line to stderr; only results go to stdout."""
    print(text, file=sys.stderr)


def silence(text: str) -> None:
    """Print nothing; replaces `say` in quiet mode."""


@contextmanager
def progress_bar(what: str, quiet: bool = False) -> Iterator[Callable[[float, float], None] | None]:
    """Yield a function of (time reached, end time) [s] that draws a progress bar after `PATIENCE` seconds.

    Yields None if `quiet` is set or stderr is not a terminal.
    """
    if quiet or not sys.stderr.isatty():
        yield None
        return
    begin = time.perf_counter()
    first: float | None = None
    bar: Progress | None = None

    def advance(now: float, end: float) -> None:
        nonlocal bar, first
        if first is None:
            first = now
        if bar is None:
            if time.perf_counter() - begin < PATIENCE:
                return
            bar = _bar()
            bar.add_task(shown(what), total=1.0, now=now, end=end)
            bar.start()
        done = (now - first) / (end - first) if end > first else 1.0
        bar.update(bar.task_ids[0], completed=done, now=now, end=end)

    def advance_while_there_is_a_terminal(now: float, end: float) -> None:
        with suppress(OSError):  # it has been closed; the run goes on, or ends by SIGHUP
            advance(now, end)

    try:
        yield advance_while_there_is_a_terminal
    finally:
        if bar is not None:
            with suppress(OSError):
                bar.stop()


@contextmanager
def count_bar(what: str, quiet: bool = False) -> Iterator[Callable[[int, int, int], None] | None]:
    """Yield a function of (items done, total items, failed runs) that draws a progress bar.

    Yields None if `quiet` is set or stderr is not a terminal.
    """
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("[red]{task.fields[failed]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=_console(), transient=True) as bar:
        task = bar.add_task(shown(what), total=None, failed="")

        def advance(done: int, total: int, failed: int) -> None:
            bar.update(task, completed=done, total=total, failed=f"{failed} failed" if failed else "")

        yield advance


def _bar() -> Progress:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("t = {task.fields[now]:.4g} of {task.fields[end]:.4g} s"),
        TimeRemainingColumn(),
        console=_console(),
        transient=True,
    )


def _console() -> Console:
    from rich.console import Console

    return Console(file=getattr(sys.stderr, "stream", sys.stderr))


def _status(error: BaseException) -> int:
    match error:
        case PluginError():
            return PLUGIN_FAILED
        case RunError() | ResourceError() | MemoryError():
            return STOPPED_EARLY
        case OSError() if error.errno:
            return _status(file_error(error.errno, ""))
        case MbdkitError() | OSError():
            return WRONG_INPUT
        case KeyboardInterrupt():
            return INTERRUPTED
    return BUG


def _sentence(error: BaseException) -> str:
    match error:
        case MbdkitError():
            return f"error: {error}"
        case OSError():
            why = error.strerror or str(error) or type(error).__name__
            return f"error: {error.filename}: {why}" if error.filename else f"error: {why}"
        case MemoryError():
            return "error: there is not enough memory for this"
        case KeyboardInterrupt():
            return "interrupted"
    return (
        f"error: this is a bug in mbdkit: {type(error).__name__}: {error}\n"
        "  rerun the command with --debug for a traceback, and please report it"
    )
