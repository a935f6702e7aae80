"""The rows of many runs of a block, one run after another, with the interface of a single run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from mbdkit.archive.block_format import prefix
from mbdkit.archive.blocks import Block
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.stored_run import StoredRun

KEEPING_TIMES = ("histories", "all")
"""Values of `store` with which a study keeps the recorded rows."""


class JoinedRuns(StoredRun):
    """All runs of one structure of a block; its rows are those of the first run, then those of the second, and so on.

    Only quantities that are recorded row by row are those of the runs; spec, status and the like are of the first run.

    Attributes
    ----------
    numbers
        (N,) number of each run in the study, from 1.
    counts
        (N,) number of rows of each run.
    """

    def __init__(self, first: StoredRun, numbers: np.ndarray, arrays: _Rows):
        super().__init__(replace(first._finished, arrays=arrays), first._heading, first._store)
        self.numbers, self.counts = numbers, arrays.counts


def joined_runs(block: Block) -> Iterator[JoinedRuns]:
    """Yield the runs of each structure of a block, which must stay open.

    Raises
    ------
    SpecError
        If the block is damaged.
    """
    structure = block.runs["structure"].astype(int)
    for number in range(1, int(structure.max(initial=0)) + 1):
        numbers = block.numbers[structure == number]
        first = block.run(int(numbers[0]))
        assert first is not None
        yield JoinedRuns(first, numbers, _Rows(block, prefix(number - 1), first._finished.arrays))


class _Rows(Mapping[str, np.ndarray]):
    """Arrays over time of all runs of a structure, read on first access.

    Parameters
    ----------
    under
        Path of the groups of the structure.
    first
        Arrays of its first run, with the keys.
    """

    def __init__(self, block: Block, under: str, first: Mapping[str, np.ndarray]):
        self.block, self.under, self.first = block, under, first
        self.counts = np.asarray(block.file[f"{under}trajectory/rows"][:], int)
        self.known: dict[str, np.ndarray] = {}

    def __getitem__(self, key: str) -> np.ndarray:
        if key not in self.known:
            path = "trajectory/time" if key == "time" else key
            with reading(path, self.block.path, hint="run `mbdkit study` again to compute its block anew"):
                values = np.asarray(self.block.file[f"{self.under}{path}"][:])
                self.known[key] = values[np.arange(values.shape[1]) < self.counts[:, None]]
        return self.known[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self.first)

    def __len__(self) -> int:
        return len(self.first)
