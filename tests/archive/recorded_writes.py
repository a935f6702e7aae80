"""Records every change of the ``.part`` of a run, to reconstruct the files that a kill would have left."""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit.archive.layout import every_array
from mbdkit.archive.run import Run
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base.errors import MbdkitError

PAGE = 4096
"""The system may have written some pages of a call when the process is killed."""


class Change(NamedTuple):
    """A write to the file at a place, or its new size; `rows` have been flushed before, or the run has ended."""

    place: int
    data: bytes | None
    rows: int
    has_ended: bool


def recorded_writes(path: Path, run: Callable[[], object], monkeypatch: pytest.MonkeyPatch) -> list[Change]:
    """Return the changes of the ``.part`` of a run that is written to `path`, in their order.

    All changes are recorded: together, they make the archive to the byte.
    """
    changes: list[Change] = []
    state = [0, False]
    names = {str(path), f"{path}.part"}

    def concerns(handle: int) -> bool:
        return os.readlink(f"/proc/self/fd/{handle}") in names

    def write(handle: int, data: Any, original: Any = os.write) -> int:
        if concerns(handle):
            changes.append(Change(os.lseek(handle, 0, os.SEEK_CUR), bytes(data), *state))
        return int(original(handle, data))

    def truncate(handle: int, size: int, original: Any = os.ftruncate) -> None:
        if concerns(handle):
            changes.append(Change(size, None, *state))
        original(handle, size)

    def flush(writer: Any, original: Any = ArchiveWriter._write_more) -> None:
        original(writer)
        state[0] = writer.rows("time")

    def publish(*arguments: Any, original: Any = ArchiveWriter._publish, **options: Any) -> None:
        state[1] = state[0] > 0  # otherwise, the file is written as a whole from now on
        original(*arguments, **options)

    monkeypatch.setattr(os, "write", write)
    monkeypatch.setattr(os, "ftruncate", truncate)
    monkeypatch.setattr(ArchiveWriter, "_write_more", flush)
    monkeypatch.setattr(ArchiveWriter, "_publish", publish)
    run()
    monkeypatch.undo()
    assert content_after(changes) == path.read_bytes()
    return changes


def content_after(changes: Sequence[Change]) -> bytearray:
    """Return the file after these changes."""
    content = bytearray()
    for change in changes:
        _apply(content, change)
    return content


def _apply(content: bytearray, change: Change) -> None:
    if change.data is None:
        content[change.place :] = bytes(max(0, change.place - len(content)))
    else:
        content.extend(bytes(max(0, change.place - len(content))))
        content[change.place : change.place + len(change.data)] = change.data


State = tuple[bytes, int, bool]
"""A file, the rows that had been flushed, and whether the run had ended."""


def _ends(change: Change) -> Sequence[int]:
    """Return the numbers of bytes after which a change may have been interrupted; the last one is its end."""
    if change.data is None:
        return (0,)
    return (*range(PAGE - change.place % PAGE, len(change.data), PAGE), len(change.data))


def drawn_states(changes: Sequence[Change], number: int, draw: random.Random) -> Iterator[State]:
    """Yield `number` of the files after each page of each change, or all of them if there are fewer."""
    moments = [(index, end) for index, change in enumerate(changes) for end in _ends(change)]
    drawn = {*draw.sample(moments, min(number, len(moments)))}
    content = bytearray()
    for index, change in enumerate(changes):
        for end in _ends(change):
            if (index, end) in drawn:
                torn = bytearray(content)
                _apply(torn, change if change.data is None else change._replace(data=change.data[:end]))
                yield bytes(torn), change.rows, change.has_ended
        _apply(content, change)


def problems_of_state(part: Path, state: State, whole: Run) -> list[str]:
    """Return what is wrong with a ``.part`` that a kill has left: it should be sound, or have all flushed rows."""
    content, least, has_ended = state
    part.write_bytes(content)
    try:
        with mbdkit.load(part) as run:
            rows, status = len(run.time), run.status
            if status == "running":
                problems = [
                    f"{path} differs in {rows} rows"
                    for path in (array.path for array in every_array() if array.grows)
                    if run.records(path) and not _begins(run, whole, path)
                ]
                problems += [f"there are {rows} rows, not {least}"] * (rows < least or has_ended)
                problems += ["the intervals are not those of the rows"] * (
                    len(run.array("steps/interval")) != max(0, rows - 1)
                )
                return problems
    except MbdkitError as error:
        is_empty = not least and not has_ended and "killed before it wrote any rows" in str(error)
        return [] if is_empty else [str(error)]
    return check(part)


def _begins(run: Run, whole: Run, path: str) -> bool:
    values, expected = run.array(path), whole.array(path)[: len(run.array(path))]
    return len(values) == len(expected) and bool(np.array_equal(values, expected, equal_nan=values.dtype != object))
