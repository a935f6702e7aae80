"""State of the blocks of a study, from the index of an earlier call and from their files."""

from __future__ import annotations

import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mbdkit.base.errors import ResourceError, SpecError
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies import block_index
from mbdkit.studies.block_index import BlockIndex, BlockRows
from mbdkit.studies.study_blocks import StudyBlocks, is_passing
from mbdkit.studies.study_folder import StudyFolder

SETTLED = 2.0
"""Time since the last change of a file after which its times tell the next change apart from it [s].

File systems count time in steps, of 2 s at most.
"""


class KnownBlocks:
    """State of the blocks in the folder of a study.

    A block is read, and its hashes are computed, if its file has changed since it was indexed. The system notes the
    time of a change (ctime) of the content, the modification time or the name of a file; programs cannot set it.
    """

    def __init__(self, spec: StudySpec, folder: StudyFolder, blocks: StudyBlocks):
        self.spec, self.folder, self.blocks = spec, folder, blocks
        self._before: BlockIndex | None = None
        try:
            before = block_index.read(folder.index, spec.sha256())
        except (SpecError, ResourceError):
            pass  # no index, or a damaged one: read the blocks instead
        else:
            if before.version == version("mbdkit") and len(before.states) == blocks.count:
                self._before = before
        self._sound: dict[int, tuple[int, ...]] = {}  # states of the files that are known to be sound

    def is_whole(self, block: int) -> bool:
        """Return whether the file of a block is sound, and no run in it failed for a reason outside the study.

        Raises
        ------
        SpecError
            If the file is a block of another study.
        """
        state = _state(self.folder.block(block))
        rows = self._indexed(block)
        if rows is None:
            whole = self.blocks.is_whole(self.folder, self.spec, block)
        else:
            whole = not is_passing(rows.texts["status"], rows.texts["status_reason"])
        if whole:
            self._sound[block] = state
        return whole

    def note_computed(self, block: int) -> None:
        """Record that a block was computed just now."""
        self._sound[block] = _state(self.folder.block(block))

    def rows(self, block: int) -> BlockRows | None:
        """Return the rows of the index for the runs of a block; None if its file cannot be read."""
        return self._indexed(block) or block_index.read_rows(
            self.folder.block(block), self.spec.sha256(), len(self.blocks.places(block))
        )

    def states(self) -> np.ndarray:
        """Return (B, 4) the states of the files that are sound and will not change unnoticed; zero for others."""
        states = np.zeros((self.blocks.count, len(UNKNOWN)), np.int64)
        now = time.time_ns()
        for block in range(self.blocks.count):
            state = _state(self.folder.block(block))
            if self._indexed(block) is not None or (
                state == self._sound.get(block) and now - state[CHANGED] > SETTLED * 1e9
            ):
                states[block] = state
        return states

    def _indexed(self, block: int) -> BlockRows | None:
        """Return the rows of a block from the index, if its file is the one that was indexed."""
        if self._before is None:
            return None
        state = tuple(int(value) for value in self._before.states[block])
        if state == UNKNOWN or state != _state(self.folder.block(block)):
            return None
        return self._before.rows(self.blocks.places(block))


UNKNOWN = (0, 0, 0, 0)

CHANGED = 2
"""Place of the time of the last change in a state."""


def _state(path: Path) -> tuple[int, ...]:
    """Return size, modification time, time of change and number of a file; zeros if it does not exist."""
    try:
        found = path.stat()
    except OSError:
        return UNKNOWN
    return found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino & (2**63 - 1)
