"""Execution of a study: compute the missing runs, time them, and write the index."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from mbdkit.errors import SpecError
from mbdkit.interrupts import interrupts_delayed
from mbdkit.spec.study_measures import expressions_of
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies import study_index
from mbdkit.studies.collect import collect
from mbdkit.studies.executor_pool import Engine
from mbdkit.studies.known_runs import KnownRuns
from mbdkit.studies.shard import Shard
from mbdkit.studies.study_folder import StudyFolder
from mbdkit.studies.study_plan import plan_study
from mbdkit.studies.tasks import Outcome, Task
from mbdkit.text import counted

#: Called with (tasks done, tasks in all, failed runs). A run is one task, and so are its repeated timings.
Progress = Callable[[int, int, int], None]


def check_shard(shard: Shard | None, *, overwrite: bool) -> None:
    """Raise SpecError if a part of a study is to overwrite the folder that it shares with other parts."""
    if overwrite and shard is not None:
        raise SpecError(
            "--overwrite cannot be combined with --shard: it would remove what the calls for other parts computed"
        )


class Execution:
    """One execution of a study in a folder.

    Parameters
    ----------
    folder
        Folder of the study; it may contain runs of earlier executions.
    shard
        Part of the study to compute, or None for all of it. Repeated timings are made only without a shard, by the call
        that completes the study.
    notify
        Called with a message before an operation that takes long.
    overwrite
        Whether to remove the study that the folder contains; not with a shard.

    Raises
    ------
    SpecError
        If a run of the study is invalid, or the folder belongs to another study. Nothing is written in this case.
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
        plan = plan_study(spec)
        self.points, self.runs, self.defined = plan.points, plan.runs, plan.defined
        folder.check(spec, overwrite=overwrite)
        self.names = {folder.archive(run_id): run_id for run_id in self.runs}
        self.computed = 0
        self.failed = 0
        self.unfinished: list[str] = []  # reasons outside the study why a run or a timing was not finished
        self.timings: dict[str, tuple[float, ...]] = {}
        self.second: dict[str, Outcome] = {}

    @property
    def count(self) -> int:
        """Number of different runs of the study."""
        return len(self.runs)

    def run(self, engine: Engine) -> None:
        """Compute missing runs, make the timings, and write the index; after Ctrl-C, index the results so far.

        Parameters
        ----------
        engine
            What computes the runs. Timings are made by a single separate process of this machine.
        """
        if self.overwrite:
            self.folder.clear()
        self.folder.prepare(self.spec)
        self.tell_left_out()
        with self.folder.locked(self.shard):
            known_runs = KnownRuns(self.spec, self.folder, self.runs)
            missing = []
            for place, run_id in enumerate(self.runs):
                if not known_runs.is_done(run_id):
                    known_runs.note(run_id, None)  # another shard, or a worker before an interrupt, may still write it
                    missing += [run_id] if self.shard is None or self.shard.has(place) else []
            repeats = self.repeats(known_runs) if self.shard is None else {}
            again = self.to_run_again(known_runs) if self.shard is None else []
            total = len(missing) + len(again) + len(repeats)
            try:
                self.compute(missing, engine, total, known_runs)
                self.run_again(again, engine, total - len(repeats), total, known_runs)
                self.time(repeats, total, known_runs)
            finally:
                with interrupts_delayed(), self.folder.indexing():
                    found = collect(self.spec, self.points, known_runs, self.timings, self.second, self.defined)
                    study_index.write(self.folder.index, found)

    def tell_left_out(self) -> None:
        """Report how many runs are left out because a distribution is not installed."""
        for name, count in Counter(point.lacking for point in self.points if point.lacking).items():
            self.notify(f"{counted(count, 'run')} left out: the distribution {name} is not installed")

    def repeats(self, known_runs: KnownRuns) -> dict[str, int]:
        """Return the number of timings to make for each run that lacks some."""
        wanted: dict[str, int] = {}
        for point in self.points:
            count = point.grid.repeats
            if not point.lacking and count > max(1, len(known_runs.repeats(point.run_id))):
                wanted[point.run_id] = max(count, wanted.get(point.run_id, 0))
        return wanted

    def compute(self, missing: list[str], engine: Engine, total: int, known_runs: KnownRuns) -> None:
        """Compute runs in parallel."""
        measures = expressions_of(self.spec.defined_measures())
        tasks = [Task(self.runs[run_id], self.folder.archive(run_id), measures=measures) for run_id in missing]
        with engine.pool(self.notify) as pool:
            for task, outcome in pool.work(tasks):
                self.computed += 1
                known_runs.note(self.names[task.path], outcome)
                self.failed += outcome.status == "failed" or outcome.is_passing
                self.note_unfinished(outcome)
                self.tell(self.computed, total)

    def to_run_again(self, known_runs: KnownRuns) -> list[str]:
        """Return the runs that still need a second run; references never do."""
        if not self.spec.second_run_measures:
            return []
        wanted = dict.fromkeys(point.run_id for point in self.points if not point.lacking)
        return [run_id for run_id in wanted if known_runs.run_twice(run_id) is None]

    def run_again(self, again: list[str], engine: Engine, last: int, total: int, known_runs: KnownRuns) -> None:
        """Take the measures that need a second run from complete runs, in parallel."""
        tasks = [
            Task(self.runs[run_id], self.folder.archive(run_id), second=self.spec.second_run_measures)
            for run_id in again
            if known_runs.outcome(run_id).status == "complete"
        ]
        with engine.pool(self.notify) as pool:
            for done, (task, outcome) in enumerate(pool.work(tasks), start=last - len(tasks) + 1):
                self.second[self.names[task.path]] = outcome
                self.note_unfinished(outcome)
                self.tell(done, total)

    def time(self, repeats: dict[str, int], total: int, known_runs: KnownRuns) -> None:
        """Time complete runs, one after another."""
        tasks = [
            Task(self.runs[run_id], self.folder.archive(run_id), count)
            for run_id, count in repeats.items()
            if known_runs.outcome(run_id).status == "complete"
        ]
        with Engine().pool(self.notify) as pool:
            for done, (task, outcome) in enumerate(pool.work(tasks), start=total - len(tasks) + 1):
                self.timings[self.names[task.path]] = outcome.seconds
                self.note_unfinished(outcome)
                self.tell(done, total)

    def note_unfinished(self, outcome: Outcome) -> None:
        """Keep the reason of an outcome if the next call tries again."""
        if outcome.is_passing:
            self.unfinished.append(outcome.reason)

    def tell(self, done: int, total: int) -> None:
        """Report progress."""
        if self.progress is not None:
            self.progress(done, total, self.failed)
