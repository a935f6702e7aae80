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
from mbdkit_studies.run_store import RunStore

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


def execute(store: RunStore[Any], options: Options, engine: Engine) -> None:
    """Compute the missing runs of a study and write the index; after Ctrl-C, the index contains the results so far.

    Parameters
    ----------
    engine
        Processes or executor that compute the runs.
    """
    folder = store.folder
    if options.overwrite:
        folder.clear()
    folder.prepare(store.spec)
    with folder.locked(options.shard):
        total = store.begin(options.shard, options.notify)
        try:
            _compute(store, options, engine, total)
        finally:
            with interrupts_delayed(), folder.indexing():
                study_index.write(folder.index, store.spec, store.index())


def _compute(store: RunStore[Any], options: Options, engine: Engine, total: int) -> None:
    """Compute the missing results."""
    ended = 0  # number of runs that were planned for this round and the rounds before
    for some in store.rounds():
        ended += some.planned
        done = ended - sum(task.runs for task in some.tasks)  # planned runs without a task count as done
        with (Engine() if some.one_by_one else engine).pool(options.notify) as pool:
            for task, outcome in pool.work(some.tasks):
                store.note(task, outcome)
                done += task.runs
                if options.progress is not None:
                    options.progress(done, total, store.failed)
