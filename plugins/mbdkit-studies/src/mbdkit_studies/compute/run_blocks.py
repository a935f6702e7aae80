"""The runs of a study that stores them in blocks of many runs."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from mbdkit.archive.layout import COUNTERS, TIMINGS
from mbdkit.base.errors import FormatVersionError, MbdkitError, SpecError
from mbdkit.runs.lane_runs import why_alone
from mbdkit_studies.compute.compute_block import MISALIGNMENT
from mbdkit_studies.compute.run_store import MISSING, Round, RunStore
from mbdkit_studies.compute.tasks import DIFFERS, Outcome, Task, forget_run_at_work
from mbdkit_studies.compute.unfinished_block import PIECE
from mbdkit_studies.folder.folder_lock import Shard
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_studies.store.blocks import Block, ForeignBlockError
from mbdkit_studies.store.study_index import BETWEEN_REASONS, NUMBERS, Index

#: Columns of texts and hashes in the index of a study that is stored in blocks.
OF_BLOCKS = ("run_id", "status", "status_reason", "verdict", "verdict_reasons", "worst_joint", "data_sha256")

#: If a file was last changed longer ago than this [s], its times reveal any further change.
#:
#: File systems record times with a resolution of 2 s or better.
SETTLED = 2.0


UNKNOWN = (0, 0, 0, 0)

TIMES = slice(1, 3)  #: Times of the last modification and of the last change in the result of `_state`.


class RunBlocks(RunStore[int]):
    """Blocks of many runs, which are assigned to shards (parts of the study) in turn.

    A block is complete if its file is sound and all of its runs are final (see `Outcome.is_final`). If its file has
    changed since it was indexed, the block is read again and its hashes are verified. A change is detected by the time
    (ctime) that the system records whenever the content, the modification time or the name of a file changes; programs
    cannot set it. On Windows, where ctime is the time of creation, the size and the modification time are compared.
    """

    def __init__(self, spec: StudySpec, folder: StudyFolder):
        super().__init__(spec, folder)
        self.count, self._sha256 = len(self.plan.points), spec.sha256()
        #: Rows of the index that were read from files, each with the state of its file; None if it is not valid.
        self._known: dict[int, tuple[tuple[int, ...], Index | None]] = {}

    def begin(self, shard: Shard | None, notify: Callable[[str], None]) -> int:
        """See `RunStore.begin`."""
        before = self.index_before()
        self._before = before if before is not None and len(before.states) == self.plan.blocks.count else None
        own = [block for block in range(self.plan.blocks.count) if shard is None or shard.has(block)]
        self._tasks = [self._task(block) for block in self.missing(own)]
        if self._tasks and (reason := self._why_alone()):
            notify(f"the runs are not vectorized but computed one after another, because {reason}")
        for task in self._tasks:
            forget_run_at_work(task.path)  # left by a process that was killed in an earlier call
        complete = {self.folder.block(block).stem for block in own} - {task.path.stem for task in self._tasks}
        for path in self.folder.runs.glob(f".*{PIECE}*"):  # left by a process that was killed at the end of a block
            if path.name[1:].partition(PIECE)[0] in complete:
                path.unlink(missing_ok=True)
        return sum(task.runs for task in self._tasks)

    def _task(self, block: int) -> Task:
        content = {"folder": str(self.folder.path.absolute()), "block": block}
        return Task(block, content, self.folder.block(block), len(self.plan.blocks.places(block)))

    def _why_alone(self) -> str:
        """Return the reason why the samples of the plan, and probably all runs, are not vectorized; empty if any sample
        is vectorized.
        """
        reasons = []
        for point in self.plan.samples:
            with suppress(SpecError):
                reasons.append("" if point.lacking else why_alone(point.spec, self.plan.expressions))
        return reasons[0] if reasons and all(reasons) else ""

    def rounds(self) -> Iterator[Round]:
        """Yield the missing blocks."""
        yield Round(self._tasks, sum(task.runs for task in self._tasks))

    def note(self, task: Task, outcome: Outcome) -> None:
        """See `RunStore.note`; raises MbdkitError if a run that was computed twice has different results."""
        self.note_file(task.key, outcome)
        if outcome.status == DIFFERS:
            raise MbdkitError(outcome.reason)
        if outcome.status == "complete":
            # while further blocks are computed; the file has just been written
            self._known[task.key] = _state(task.path), self._from_file(task.key, is_verified=False)
        self.unfinished += [*task.skip.values(), *([] if outcome.status == "complete" else [outcome.reason])]
        self.computed += task.runs
        self.failed += int(outcome.values.get("failed", 0))

    def index(self) -> Index:
        """Return the index of the blocks that exist; runs of other blocks are missing."""
        points, blocks = self.plan.points, self.plan.blocks
        count = len(points)
        found = {name: np.full(count, "", object) for name in OF_BLOCKS} | {MISALIGNMENT: np.full(count, np.nan)}
        found["status"][:] = "missing"
        described = {name: NUMBERS[name] for name in (MISALIGNMENT, *COUNTERS, *TIMINGS)}
        for number in range(blocks.count):
            places = blocks.places(number)
            rows = slice(places.start, places.stop)
            block = None
            with suppress(ForeignBlockError, FormatVersionError):  # in another shard
                block = self._rows(number)
            if block is None:
                found["status_reason"][rows] = self._outcomes.get(number, MISSING).reason
                continue
            described = {**block.described, **described}
            for name, column in block.runs.items():
                if name not in found:
                    found[name] = np.full(count, np.nan)
                found[name][rows] = column
        last = (*COUNTERS, *TIMINGS)
        numbers = [name for name in found if name not in OF_BLOCKS]
        ordered = sorted(numbers, key=lambda name: last.index(name) if name in last else -1)
        labels, families = points.labels(), points.families()
        columns = {
            **({"family": families} if any(families) else {}),
            **labels,
            **{name: found[name] for name in (*OF_BLOCKS[:-1], *ordered, OF_BLOCKS[-1])},
        }
        of_numbers = {name: described[name] for name in ordered}
        return Index(columns, of_numbers, axes=frozenset(labels), states=self._states())

    def read(self, key: int) -> Outcome:
        """See `RunStore.read`."""
        if (rows := self._rows(key)) is None:
            return MISSING
        if self.spec.store == "files":
            stored = rows.runs["run_id"][rows.runs["data_sha256"] != ""]
            if not all(self.folder.archive(run_id).exists() for run_id in stored):
                return MISSING
        runs = zip(rows.runs["status"], rows.runs["status_reason"], strict=True)
        is_final = all(Outcome(str(status), str(reason)).is_final for status, reason in set(runs))
        return Outcome("complete", "") if is_final else MISSING

    def _rows(self, block: int) -> Index | None:
        """Return the rows of the index for the runs of a block, read from its file if this has changed since it was
        indexed; None if it is not valid. ForeignBlockError and FormatVersionError are raised.
        """
        state, rows = self._known.get(block, (UNKNOWN, None))
        if state == UNKNOWN or state != _state(self.folder.block(block)):
            state = _state(self.folder.block(block))
            rows = self._indexed(block) or self._from_file(block, is_verified=True)
            self._known[block] = state, rows
        return rows

    def _from_file(self, block: int, *, is_verified: bool) -> Index | None:
        """Return the rows of the index for the runs of a block, read from its file; None if it is not valid."""
        numbers = [place + 1 for place in self.plan.blocks.places(block)]
        try:
            with Block(self.folder.block(block), self._sha256, is_verified=False) as file:
                if file.numbers.tolist() != numbers or (is_verified and not file.is_sound()):
                    return None
                columns = file.columns("runs", {*OF_BLOCKS, MISALIGNMENT})
                reasons = columns.get("verdict_reasons", np.full(len(numbers), "[]", object))  # lists in JSON
                joined = {text: BETWEEN_REASONS.join(json.loads(text)) for text in dict.fromkeys(reasons)}
                columns["verdict_reasons"] = np.array([joined[text] for text in reasons], object)
                return Index({**columns, **file.columns("measures"), **file.columns("stats")}, file.described())
        except (ForeignBlockError, FormatVersionError):
            raise
        except (MbdkitError, OSError):
            return None

    def _states(self) -> np.ndarray:
        """Return (B, 4) the states of those valid files whose changes would be detected; zeros for other files."""
        states = np.zeros((self.plan.blocks.count, len(UNKNOWN)), np.int64)
        now = time.time_ns()
        for block in range(self.plan.blocks.count):
            state = _state(self.folder.block(block))
            known, rows = self._known.get(block, (UNKNOWN, None))
            is_settled = now - max(state[TIMES]) > SETTLED * 1e9
            if self._indexed(block) is not None or (state == known and rows is not None and is_settled):
                states[block] = state
        return states

    def _indexed(self, block: int) -> Index | None:
        """Return the rows of a block from the index if its file has not changed since it was indexed."""
        if self._before is None:
            return None
        state = tuple(int(value) for value in self._before.states[block])
        if state == UNKNOWN or state != _state(self.folder.block(block)):
            return None
        places, columns = self.plan.blocks.places(block), self._before.runs
        rows = slice(places.start, places.stop)
        names = (*OF_BLOCKS, *self._before.described)
        return Index({name: columns[name][rows] for name in names}, self._before.described)


def _state(path: Path) -> tuple[int, ...]:
    """Return size, modification time, ctime and inode number of a file; zeros if it does not exist."""
    try:
        status = path.stat()
    except OSError:
        return UNKNOWN
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino & (2**63 - 1)
