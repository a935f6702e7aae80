"""Execution of a study in blocks: compute the blocks that are missing, and write the index."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from mbdkit.errors import SpecError
from mbdkit.interrupts import interrupts_delayed
from mbdkit.lane_runs import why_alone
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies import block_index
from mbdkit.studies.block_index import BlockIndex
from mbdkit.studies.compute_block import plan_blocks
from mbdkit.studies.execute import Progress, check_shard
from mbdkit.studies.executor_pool import Engine
from mbdkit.studies.known_blocks import KnownBlocks
from mbdkit.studies.shard import Shard
from mbdkit.studies.study_folder import StudyFolder
from mbdkit.studies.tasks import BlockTask, Outcome


class BlockExecution:
    """One execution of a study in blocks.

    Parameters
    ----------
    folder
        Folder of the study; it may contain blocks of earlier executions.
    shard
        Part of the study to compute, or None for all of it. Blocks are assigned to parts in turn.
    notify
        Called with a message before an operation that takes long.
    overwrite
        Whether to remove the study that the folder contains; not with a shard.

    Raises
    ------
    SpecError
        If the study is invalid, as far as a few of its runs show, or the folder belongs to another study. Nothing is
        written in this case.
    """

    def __init__(
        self,
        spec: StudySpec,
        folder: StudyFolder,
        *,
        shard: Shard | None,
        progress: Progress | None,
        notify: Callable[[str], None],
        overwrite: bool = False,
    ):
        check_shard(shard, overwrite=overwrite)
        self.spec, self.folder, self.shard, self.overwrite = spec, folder, shard, overwrite
        self.progress, self.notify = progress, notify
        self.plan = plan_blocks(spec)
        folder.check(spec, overwrite=overwrite)
        self.computed = self.failed = 0
        self.unfinished: list[str] = []  # reasons outside the study why blocks were not computed
        self.reasons: dict[int, str] = {}

    @property
    def count(self) -> int:
        """Number of runs of the study."""
        return len(self.plan.points)

    def run(self, engine: Engine) -> None:
        """Compute the missing blocks and write the index; after Ctrl-C, index the results so far.

        Parameters
        ----------
        engine
            What computes the blocks.
        """
        if self.overwrite:
            self.folder.clear()
        self.folder.prepare(self.spec)
        with self.folder.locked(self.shard):
            self.known = KnownBlocks(self.spec, self.folder, self.plan.blocks)
            tasks = [
                BlockTask(self.folder, block)
                for block in range(self.plan.blocks.count)
                if (self.shard is None or self.shard.has(block)) and not self.known.is_whole(block)
            ]
            if tasks and (reason := self.why_alone()):
                self.notify(f"the runs are advanced one after another, not in lanes, because {reason}")
            try:
                self.compute(tasks, engine)
            finally:
                with interrupts_delayed(), self.folder.indexing():
                    self.index()

    def why_alone(self) -> str:
        """Return why some runs of the study, and so probably all, are not advanced in lanes; empty if one is."""
        reasons = []
        for point in self.plan.samples:
            with suppress(SpecError):
                reasons.append("" if point.lacking else why_alone(point.spec, self.plan.expressions))
        return reasons[0] if reasons and all(reasons) else ""

    def compute(self, tasks: list[BlockTask], engine: Engine) -> None:
        """Compute blocks in parallel."""
        blocks = self.plan.blocks
        total = sum(len(blocks.places(task.block)) for task in tasks)
        for task in tasks:
            self.folder.forget_run_at_work(task.block)  # of a process that was killed in an earlier call
        with engine.pool(self.notify) as pool:
            for task, outcome in pool.work(tasks):
                self.computed += len(blocks.places(task.block))
                self.note(task, outcome)
                if self.progress is not None:
                    self.progress(self.computed, total, self.failed)

    def note(self, task: BlockTask, outcome: Outcome) -> None:
        """Keep the outcome of a block."""
        self.failed += int(outcome.values.get("failed", 0))
        self.unfinished += task.skip.values()
        if outcome.status == "complete":
            self.known.note_computed(task.block)
        else:
            self.reasons[task.block] = outcome.reason
            self.unfinished.append(outcome.reason)

    def index(self) -> None:
        """Write the index of the blocks that are there."""
        plan = self.plan
        columns, described = block_index.collect(plan.points, plan.blocks, self.known.rows, reasons=self.reasons)
        found = BlockIndex(columns, described, self.known.states())
        block_index.write(self.folder.index, self.spec, found, plan.points.labels())
