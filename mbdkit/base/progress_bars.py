"""Progress of runs, studies and designs: bars on a terminal and in Jupyter notebooks, otherwise lines."""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import ParamSpec, Protocol

from mbdkit.base.text import counted, shown

PATIENCE = 0.5  #: A bar appears if a run takes longer than this [s].
_PAUSE = 0.1  #: Smallest time between two updates of a bar in a notebook [s].
LINES_EVERY = 10.0  #: If there is no terminal: smallest time before the first line, and between two lines [s].


P = ParamSpec("P")


class _Bar(Protocol):
    def draw(self, share: float | None, note: str) -> None: ...

    def close(self) -> None: ...


@contextmanager
def _drawing(
    what: str, quiet: bool, state_of: Callable[P, tuple[float | None, str]], patience: float = 0.0, lines: bool = False
) -> Iterator[Callable[P, None] | None]:
    """Yield a function that draws a bar; `state_of` returns a fraction (None if unknown) and a note from its arguments.

    In a notebook, or if stderr is a terminal, the function draws a bar, at the earliest `patience` seconds after the
    start. Elsewhere, it prints lines if `lines` is set. In all other cases, and if `quiet` is set, None is yielded
    instead of a function.
    """
    make = None if quiet else _kind_of_bar() or (_Lines if lines else None)
    if make is None:
        yield None
        return
    begin = time.perf_counter()
    bar: _Bar | None = None if patience else make(shown(what))

    def draw(*args: P.args, **kwargs: P.kwargs) -> None:
        nonlocal bar
        state = state_of(*args, **kwargs)
        if bar is None and time.perf_counter() - begin >= patience:
            bar = make(shown(what))
        if bar is not None:
            bar.draw(*state)

    try:
        yield draw
    finally:
        if bar is not None:
            bar.close()


def progress_bar(what: str, quiet: bool = False) -> AbstractContextManager[Callable[[float, float], None] | None]:
    """Yield a function of (time reached, end time) [s] of a run that draws a bar; see `_drawing`."""
    first: float | None = None

    def state(now: float, end: float) -> tuple[float, str]:
        nonlocal first
        first = now if first is None else first
        return (now - first) / (end - first) if end > first else 1.0, f"t = {now:.4g} of {end:.4g} s"

    return _drawing(what, quiet, state, PATIENCE)


def count_bar(what: str, quiet: bool = False) -> AbstractContextManager[Callable[[int, int, int], None] | None]:
    """Yield a function of (items done, total items, failed runs) that draws a bar; see `_drawing`."""

    def state(done: int, total: int, failed: int) -> tuple[float, str]:
        return done / total if total else 1.0, f"{done}/{total}{_failed(failed)}"

    return _drawing(what, quiet, state, lines=True)


def tally_bar(what: str, quiet: bool = False) -> AbstractContextManager[Callable[[int, int, str], None] | None]:
    """Yield a function of (runs done, failed runs, stage) that draws a bar for work of unknown length; see
    `_drawing`.
    """

    def state(done: int, failed: int, stage: str) -> tuple[None, str]:
        return None, f"{stage}, {counted(done, 'run')}{_failed(failed)}"

    return _drawing(what, quiet, state, lines=True)


def _failed(count: int) -> str:
    return f", {count} failed" if count else ""


def in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook, without importing IPython."""
    get_shell = getattr(sys.modules.get("IPython"), "get_ipython", None)
    return get_shell is not None and getattr(get_shell(), "kernel", None) is not None


def _kind_of_bar() -> Callable[[str], _Bar] | None:
    if in_notebook():
        return _NotebookBar
    return _TerminalBar if sys.stderr.isatty() else None


class _TerminalBar:
    """A bar on stderr, which is removed at the end."""

    def __init__(self, what: str):
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[note]}", markup=False),
            TimeRemainingColumn(),
            console=Console(file=getattr(sys.stderr, "stream", sys.stderr)),
            transient=True,
        )
        self._task = self._bar.add_task(what, total=None, note="")
        with suppress(OSError):
            self._bar.start()

    def draw(self, share: float | None, note: str) -> None:
        total = None if share is None else 1.0
        with suppress(OSError):  # the terminal has been closed; the run continues, or is ended by SIGHUP
            self._bar.update(self._task, completed=share, total=total, note=note)

    def close(self) -> None:
        with suppress(OSError):
            self._bar.stop()


class _Lines:
    """Lines on stderr, at most one in `LINES_EVERY` seconds."""

    def __init__(self, what: str):
        self._what, self._begin = what, time.perf_counter()
        self._printed, self._first = self._begin, 0.0

    def draw(self, share: float | None, note: str) -> None:
        now = time.perf_counter()
        self._first = self._first or share or 0.0  # results that already existed at the start took no time
        if now - self._printed < LINES_EVERY:
            return
        self._printed, passed = now, now - self._begin
        result = (share or 0.0) - self._first
        left = f", about {passed * (1.0 - (share or 0.0)) / result:.0f} s left" if result > 0 else ""
        with suppress(OSError):  # the reader of stderr has closed it
            print(f"{self._what}: {note} after {passed:.0f} s{left}", file=sys.stderr, flush=True)

    def close(self) -> None:
        pass


class _NotebookBar:
    """A bar in the output of a notebook cell, which is removed at the end."""

    def __init__(self, what: str):
        self._what, self._drawn = what, time.perf_counter()
        display = importlib.import_module("IPython.display").display
        self._handle = display(self._content(None, ""), raw=True, display_id=True)

    def _content(self, share: float | None, note: str) -> dict[str, object]:
        import html

        value = "" if share is None else f' value="{share:.4f}"'
        text = " ".join(filter(None, (self._what, note)))
        bar = f'<progress{value} max="1" style="width: 20em; vertical-align: middle"></progress>'
        return {"text/html": f"<div>{bar} {html.escape(text)}</div>", "text/plain": text}

    def draw(self, share: float | None, note: str) -> None:
        if time.perf_counter() - self._drawn >= _PAUSE:
            self._drawn = time.perf_counter()
            self._handle.update(self._content(share, note), raw=True)

    def close(self) -> None:
        self._handle.update({"text/html": "", "text/plain": ""}, raw=True)
