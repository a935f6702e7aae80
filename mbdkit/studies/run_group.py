"""Runs with the same arrays and times, whose arrays are stacked so that a measure is one operation for all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mbdkit.archive.finished_run import FinishedRun
    from mbdkit.archive.run import Run


class RunGroup:
    """R runs of mechanisms with the same names, which recorded the same arrays at the same T times.

    Parameters
    ----------
    runs
        The runs, at least one.
    reference
        Reference run of a single run.
    """

    def __init__(self, runs: Sequence[Run], reference: Run | None = None):
        self.runs, self.reference = runs, reference
        self.first = runs[0]
        self._arrays: dict[str, np.ndarray] = {}

    def __len__(self) -> int:
        return len(self.runs)

    @property
    def time(self) -> np.ndarray:
        """(T,) times of the rows [s]."""
        return self.first.time

    @cached_property
    def complete(self) -> np.ndarray:
        """(R,) whether a run reached its end."""
        return np.array([run.status == "complete" for run in self.runs])

    def records(self, path: str) -> bool:
        """Return whether the runs recorded an array of the layout."""
        return self.first.records(path)

    def array(self, path: str) -> np.ndarray:
        """Return an array (T, ...) of all runs, (R, T, ...)."""
        if path not in self._arrays:
            self._arrays[path] = np.stack([run.array(path) for run in self.runs])
        return self._arrays[path]

    def everywhere(self, value: float) -> np.ndarray:
        """Return a value for each run, (R,)."""
        return np.full(len(self), value)


def places_by_group(runs: Sequence[FinishedRun]) -> Iterator[list[int]]:
    """Yield the places of those runs that can be a `RunGroup`."""
    groups: dict[bytes, list[list[int]]] = {}
    for place, run in enumerate(runs):
        alike = groups.setdefault(run.arrays["time"].tobytes(), [])
        for places in alike:
            other = runs[places[0]]
            if run.layout == other.layout and run.names == other.names:
                places.append(place)
                break
        else:
            alike.append([place])
    for found in groups.values():
        yield from found
