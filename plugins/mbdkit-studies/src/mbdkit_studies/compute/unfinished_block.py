"""The finished runs of a block while it is computed, which are saved every few seconds in small files beside the block.

Each file, ``.block-000000.piece-NUMBER``, is itself a block. After an interruption, the next process that computes
the block takes over the runs of these files. They are removed when the block has been written.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from mbdkit.archive.finished_runs import FinishedRuns
from mbdkit.archive.hdf5_errors import DAMAGE
from mbdkit.base.errors import MbdkitError
from mbdkit.runs.provenance import DECIDE_LAST_BITS
from mbdkit_studies.compute.tasks import Outcome
from mbdkit_studies.store.block_writer import BlockHeading, BlockPoints, BlockRuns, block_image
from mbdkit_studies.store.blocks import Block

#: Smallest processor time between two files [s]. Writing one takes about 0.04 s of it, and 5 s per GB.
INTERVAL = 2.0

#: Share of the wall time that counts as processor time if a process gets less of it, or waits.
LEAST_SHARE = 0.1

#: Bytes of arrays per second of processor time above which runs are not saved, because saving them would take more than
#: 5 % of the time. At this rate, a block of 64 MB is complete after 6 s.
LARGEST_RATE = 1e7

PIECE = ".piece-"


def pieces_of(block: Path) -> list[Path]:
    """Return the files with runs of an unfinished block."""
    return list(block.parent.glob(f".{block.stem}{PIECE}*"))


class UnfinishedBlock:
    """The runs of a block that have been computed so far.

    Parameters
    ----------
    block
        Path of the block.
    heading
        What all of its runs have in common.
    """

    def __init__(self, block: Path, heading: BlockHeading):
        self._block, self._heading = block, heading
        self._unsaved: list[BlockRuns] = []
        self._bytes, self._begin = 0, (time.thread_time(), time.monotonic())

    def saved(self) -> dict[int, BlockRuns]:
        """Return the runs that an interrupted process has saved, each alone, by number.

        Runs that a second attempt may change are left out, and so are files of other versions of software, whose
        results may have other last bits.
        """
        runs: dict[int, BlockRuns] = {}
        for path in pieces_of(self._block):
            # a kill may leave a truncated file
            with suppress(MbdkitError, *DAMAGE), Block(path, is_verified=False) as piece:
                if self._suits(piece):
                    runs |= {run.numbers[0]: run for run in _runs(piece)}
        return runs

    def _suits(self, piece: Block) -> bool:
        """Return whether a file is sound, and contains runs of this study that have the bits of new ones."""
        then, now = piece.file["provenance"].attrs, self._heading.provenance
        same = all(str(then.get(name)) == str(now[name]) for name in DECIDE_LAST_BITS)
        return same and piece.study_sha256 == self._heading.study_sha256 and piece.is_sound()

    def add(self, runs: Sequence[BlockRuns]) -> None:
        """Add runs, and save all that have not been saved if enough time has passed since the last file."""
        self._unsaved += runs
        results = (some.results for some in runs if some.results is not None)
        self._bytes += sum(array.nbytes for result in results for array in result.arrays.values())
        processor, begin = self._begin
        if (wall := time.monotonic() - begin) < INTERVAL:  # some systems take 0.3 ms to read the processor time
            return
        passed = max(time.thread_time() - processor, LEAST_SHARE * wall)
        if passed < INTERVAL or self._bytes > LARGEST_RATE * passed:
            return
        path = self._block.with_name(f".{self._block.stem}{PIECE}{time.time_ns()}")
        points = BlockPoints(sorted(number for some in self._unsaved for number in some.numbers))
        with suppress(OSError):  # the disk may be full, as an error says when the block itself is written
            path.write_bytes(block_image(self._heading, points, self._unsaved))
        self._unsaved, self._bytes, self._begin = [], 0, (time.thread_time(), time.monotonic())

    def remove(self) -> None:
        """Remove the files, after the block itself has been written."""
        for path in pieces_of(self._block):
            path.unlink(missing_ok=True)


def _runs(piece: Block) -> list[BlockRuns]:
    """Return the final runs of a file, each alone."""
    columns, stored = piece.columns("measures"), piece.runs
    runs = []
    for row, number in enumerate(piece.numbers.tolist()):
        names = ("status", "status_reason", "spec_sha256", "run_id", "plugins", "mechanism", "files")
        texts = {name: str(stored[name][row]) for name in names}
        if not (stored["data_sha256"][row] and Outcome(texts["status"], texts["status_reason"]).is_final):
            continue
        result, worst = piece.results(number), str(stored["worst_joint"][row])
        if piece.store == "hashes" and worst:  # only the largest misalignment and its joint are stored
            others = np.array(result.names.joints) != worst
            result = replace(result, misalignment_max=np.where(others, 0.0, result.misalignment_max))
        measures = {name: values[row : row + 1] for name, values in columns.items()}
        runs.append(BlockRuns([number], results=FinishedRuns.of(result), measures=measures, **texts))
    return runs
