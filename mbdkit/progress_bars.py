"""Progress bars of runs, studies and designs, on a terminal and in Jupyter notebooks."""

from __future__ import annotations

import html
import importlib
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Protocol

from mbdkit.text import counted, shown

PATIENCE = 0.5
"""Time before the bar of a run appears [s]."""
_PAUSE = 0.1
"""Least time between two changes of a bar in a notebook [s]."""


class _Bar(Protocol):
    def draw(self, share: float | None, note: str) -> None: ...

    def close(self) -> None: ...


@contextmanager
def progress_bar(what: str, quiet: bool = False) -> Iterator[Callable[[float, float], None] | None]:
    """Yield a function of (time reached, end time) [s] that draws a progress bar after `PATIENCE` seconds.

    Yields None if `quiet` is set, or if this is no notebook and stderr is not a terminal.
    """
    make = None if quiet else _kind_of_bar()
    if make is None:
        yield None
        return
    begin = time.perf_counter()
    first: float | None = None
    bar: _Bar | None = None

    def advance(now: float, end: float) -> None:
        nonlocal bar, first
        if first is None:
            first = now
        if bar is None:
            if time.perf_counter() - begin < PATIENCE:
                return
            bar = make(shown(what))
        done = (now - first) / (end - first) if end > first else 1.0
        bar.draw(done, f"t = {now:.4g} of {end:.4g} s")

    try:
        yield advance
    finally:
        if bar is not None:
            bar.close()


@contextmanager
def count_bar(what: str, quiet: bool = False) -> Iterator[Callable[[int, int, int], None] | None]:
    """Yield a function of (items done, total items, failed runs) that draws a progress bar.

    Yields None if `quiet` is set, or if this is no notebook and stderr is not a terminal.
    """
    make = None if quiet else _kind_of_bar()
    if make is None:
        yield None
        return
    bar = make(shown(what))

    def advance(done: int, total: int, failed: int) -> None:
        bar.draw(done / total if total else 1.0, f"{done}/{total}{f', {failed} failed' if failed else ''}")

    try:
        yield advance
    finally:
        bar.close()


@contextmanager
def tally_bar(what: str, quiet: bool = False) -> Iterator[Callable[[int, int], None] | None]:
    """Yield a function of (runs done, failed runs) that draws a bar of work whose end is not known.

    Yields None if `quiet` is set, or if this is no notebook and stderr is not a terminal.
    """
    make = None if quiet else _kind_of_bar()
    if make is None:
        yield None
        return
    bar = make(shown(what))
    try:
        yield lambda done, failed: bar.draw(None, f"{counted(done, 'run')}{f', {failed} failed' if failed else ''}")
    finally:
        bar.close()


def in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook; IPython is not imported to find out."""
    get_shell = getattr(sys.modules.get("IPython"), "get_ipython", None)
    return get_shell is not None and getattr(get_shell(), "kernel", None) is not None


def _kind_of_bar() -> Callable[[str], _Bar] | None:
    if in_notebook():
        return _NotebookBar
    return _TerminalBar if sys.stderr.isatty() else None


class _TerminalBar:
    """A bar on stderr, which vanishes at the end."""

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
        with suppress(OSError):  # the terminal has been closed; the run goes on, or ends by SIGHUP
            self._bar.update(self._task, completed=share, total=total, note=note)

    def close(self) -> None:
        with suppress(OSError):
            self._bar.stop()


class _NotebookBar:
    """A bar in the output of a cell, which is empty at the end."""

    def __init__(self, what: str):
        self._what, self._drawn = what, time.perf_counter()
        display = importlib.import_module("IPython.display").display
        self._handle = display(self._content(None, ""), raw=True, display_id=True)

    def _content(self, share: float | None, note: str) -> dict[str, Any]:
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
