"""Execution of a study in blocks: compute the blocks that are missing, and write the index."""

from __future__ import annotations

from contextlib import suppress

from mbdkit.base.errors import SpecError
from mbdkit.runs.lane_runs import why_alone
from mbdkit.studies import block_index
from mbdkit.studies.block_index import BlockIndex
from mbdkit.studies.compute_block import plan_blocks
from mbdkit.studies.execute import AnyExecution
from mbdkit.studies.executor_pool import Engine
from mbdkit.studies.known_blocks import KnownBlocks
from mbdkit.studies.tasks import BlockTask, Outcome


class BlockExecution(AnyExecution):
    """An execution that stores runs in blocks, which are assigned to the parts of a study in turn."""

    def make_plan(self) -> None:
        """Find all blocks, and check a few runs."""
        self.plan = plan_blocks(self.spec)
        self.reasons: dict[int, str] = {}

    @property
    def count(self) -> int:
        """Number of runs of the study."""
        return len(self.plan.points)

    def begin(self) -> None:
        """Find the blocks that are missing."""
        self.known = KnownBlocks(self.spec, self.folder, self.plan.blocks)
        self.tasks = [
            BlockTask(self.folder, block)
            for block in range(self.plan.blocks.count)
            if (self.shard is None or self.shard.has(block)) and not self.known.is_whole(block)
        ]
        if self.tasks and (reason := self.why_alone()):
            self.notify(f"the runs are advanced one after another, not in lanes, because {reason}")

    def why_alone(self) -> str:
        """Return why some runs of the study, and so probably all, are not advanced in lanes; empty if one is."""
        reasons = []
        for point in self.plan.samples:
            with suppress(SpecError):
                reasons.append("" if point.lacking else why_alone(point.spec, self.plan.expressions))
        return reasons[0] if reasons and all(reasons) else ""

    def compute(self, engine: Engine) -> None:
        """Compute blocks in parallel."""
        blocks = self.plan.blocks
        total = sum(len(blocks.places(task.block)) for task in self.tasks)
        for task in self.tasks:
            self.folder.forget_run_at_work(task.block)  # of a process that was killed in an earlier call
        with engine.pool(self.notify) as pool:
            for task, outcome in pool.work(self.tasks):
                self.computed += len(blocks.places(task.block))
                self.note(task, outcome)
                self.tell(self.computed, total)

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
