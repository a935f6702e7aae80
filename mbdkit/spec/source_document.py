"""The source of a spec: plain data, and the line number of each key."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, parse_path, without_collection


@dataclass
class Document:
    """Plain data and its origin.

    Parameters
    ----------
    file
        Name of the file it was read from; empty for data from Python.
    lines
        Function that returns the line numbers of key paths; called only if there is an error to locate.
    overridden
        Key paths set on the command line, with the text of each assignment.
    keywords
        Top-level sections replaced by Python keyword arguments.
    folder
        Folder that relative names of files in it count from; by default, the current folder.
    """

    data: dict[str, Any]
    file: str = ""
    lines: Callable[[], Mapping[Path, int]] = dict
    overridden: dict[Path, str] = field(default_factory=dict)
    keywords: frozenset[str] = frozenset()
    folder: FilePath = FilePath()

    @without_collection()
    def place(self, error: SpecError) -> SpecError:
        """Return the error with the file and line of its key, or with the command-line assignment that set the key."""
        if error.file is not None:
            return error
        path = parse_path(error.key)
        for length in range(len(path), 0, -1):
            if path[:length] in self.overridden:
                return error.located(file=f"--set {self.overridden[path[:length]]}")
        if self.file and path and path[0] in self.keywords:
            return error.located(file=f"keyword {path[0]}")
        if not self.file or error.line is not None:
            return error.located(file=self.file or None)
        lines = self.lines()
        nearest = next((lines[path[:length]] for length in range(len(path), 0, -1) if path[:length] in lines), None)
        return error.located(file=self.file, line=nearest)
