"""Execution of a study: computes the missing runs, times them, and writes the index."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mbdkit.base.errors import SpecError
from mbdkit.base.interrupts import interrupts_delayed
from mbdkit_studies import study_index
from mbdkit_studies.executor_pool import Engine
from mbdkit_studies.folder_lock import Shard
from mbdkit_studies.run_blocks import RunBlocks
from mbdkit_studies.run_files import RunFiles
from mbdkit_studies.run_store import RunStore
from mbdkit_studies.study_folder import StudyFolder
from mbdkit_studies.study_spec import StudySpec

#: Function called with the number of computations that are done, their total number, and the number of failed runs. A
#: run, a second run and a set of repeated timings count as one computation each.
Progress = Callable[[int, int, int], None]


@dataclass(frozen=True)
class Options:
    """Settings of the execution of a study.

    Parameters
    ----------
    shard
        Part of the study to compute, or None for all of it.
    progress
        Called after each task; None for no calls.
    notify
        Called with messages for the user, such as warnings.
    overwrite
        Whether to remove the study that the folder contains; not allowed with a shard.

    Raises
    ------
    SpecError
        If `overwrite` is set for a part of a study, which shares the folder with other parts.
    """

    shard: Shard | None
    progress: Progress | None
    notify: Callable[[str], None]
    overwrite: bool = False

    def __post_init__(self) -> None:
        if self.overwrite and self.shard is not None:
            raise SpecError(
                "--overwrite cannot be combined with --shard: it would remove the results of calls for other parts"
            )


class Execution:
    """One execution of a study in a folder, which may contain results of earlier ones.

    Attributes
    ----------
    computed, failed
        Number of runs that were computed, and number of these that failed.
    unfinished
        External reasons why runs were not computed.

    Raises
    ------
    SpecError
        If the study is invalid, or the folder belongs to another study. Nothing is written in this case.
    """

    def __init__(self, spec: StudySpec, folder: StudyFolder, options: Options):
        self.spec, self.folder, self.options = spec, folder, options
        self.computed = self.failed = 0
        self.unfinished: list[str] = []
        self.store: RunStore[Any] = (RunBlocks if spec.in_blocks else RunFiles)(spec, folder)
        folder.check(spec, overwrite=options.overwrite)

    def run(self, engine: Engine) -> None:
        """Compute the missing results and write the index; after Ctrl-C, the index contains the results so far.

        Parameters
        ----------
        engine
            Processes or executor that compute the runs.
        """
        if self.options.overwrite:
            self.folder.clear()
        self.folder.prepare(self.spec)
        with self.folder.locked(self.options.shard):
            total = self.store.begin(self.options.shard, self.options.notify)
            try:
                self._compute(engine, total)
            finally:
                with interrupts_delayed(), self.folder.indexing():
                    study_index.write(self.folder.index, self.spec, self.store.index())

    def _compute(self, engine: Engine, total: int) -> None:
        """Compute the missing results."""
        ended = 0  # number of runs that were planned for this round and the rounds before
        for some in self.store.rounds():
            ended += some.planned
            done = ended - sum(task.runs for task in some.tasks)  # planned runs without a task count as done
            with (Engine() if some.one_by_one else engine).pool(self.options.notify) as pool:
                for task, outcome in pool.work(some.tasks):
                    noted = self.store.note(task, outcome)
                    self.computed += noted.runs
                    self.failed += noted.failed
                    self.unfinished += noted.unfinished
                    done += task.runs
                    if self.options.progress is not None:
                        self.options.progress(done, total, self.failed)
