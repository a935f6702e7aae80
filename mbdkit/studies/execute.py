"""Execution of a study: compute the missing runs, time them, and write the index."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from mbdkit.base.errors import SpecError
from mbdkit.base.interrupts import interrupts_delayed
from mbdkit.base.text import counted
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

#: Called with (tasks done, tasks in all, failed runs). A run is one task, and so are its repeated timings.
Progress = Callable[[int, int, int], None]


@dataclass(frozen=True)
class Options:
    """How a study is executed.

    Parameters
    ----------
    shard
        Part of the study to compute, or None for all of it.
    progress
        Called after each task; None: not at all.
    notify
        Called with a message before an operation that takes long.
    overwrite
        Whether to remove the study that the folder contains; not with a shard.

    Raises
    ------
    SpecError
        If a part of a study is to overwrite the folder that it shares with other parts.
    """

    shard: Shard | None
    progress: Progress | None
    notify: Callable[[str], None]
    overwrite: bool = False

    def __post_init__(self) -> None:
        if self.overwrite and self.shard is not None:
            raise SpecError(
                "--overwrite cannot be combined with --shard: it would remove what the calls for other parts computed"
            )


class AnyExecution(ABC):
    """One execution of a study in a folder, which may contain results of earlier ones.

    Attributes
    ----------
    computed, failed
        Numbers of runs that were computed, and of those that failed.
    unfinished
        Reasons outside the study why something was not computed.

    Raises
    ------
    SpecError
        If the study is invalid, or the folder belongs to another study. Nothing is written in this case.
    """

    def __init__(self, spec: StudySpec, folder: StudyFolder, options: Options):
        self.spec, self.folder, self.options = spec, folder, options
        self.shard, self.notify = options.shard, options.notify
        self.computed = self.failed = 0
        self.unfinished: list[str] = []
        self.make_plan()
        folder.check(spec, overwrite=options.overwrite)

    @property
    @abstractmethod
    def count(self) -> int:
        """Number of different runs of the study."""

    @abstractmethod
    def make_plan(self) -> None:
        """Find out what the study consists of; raise SpecError if it is invalid."""

    @abstractmethod
    def begin(self) -> None:
        """Find out what is missing in the folder, which is locked."""

    @abstractmethod
    def compute(self, engine: Engine) -> None:
        """Compute what is missing."""

    @abstractmethod
    def index(self) -> None:
        """Write the index of the results."""

    def run(self, engine: Engine) -> None:
        """Compute what is missing and write the index; after Ctrl-C, index the results so far.

        Parameters
        ----------
        engine
            What computes the runs.
        """
        if self.options.overwrite:
            self.folder.clear()
        self.folder.prepare(self.spec)
        with self.folder.locked(self.shard):
            self.begin()
            try:
                self.compute(engine)
            finally:
                with interrupts_delayed(), self.folder.indexing():
                    self.index()

    def tell(self, done: int, total: int) -> None:
        """Report progress."""
        if self.options.progress is not None:
            self.options.progress(done, total, self.failed)


class Execution(AnyExecution):
    """An execution that stores an archive for each run.

    Repeated timings are made without a shard only, by the call that completes the study, in a single separate process
    of this machine.
    """

    def make_plan(self) -> None:
        """Find all runs, and check them."""
        plan = plan_study(self.spec)
        self.points, self.runs, self.defined = plan.points, plan.runs, plan.defined
        self.names = {self.folder.archive(run_id): run_id for run_id in self.runs}
        self.timings: dict[str, tuple[float, ...]] = {}
        self.second: dict[str, Outcome] = {}

    @property
    def count(self) -> int:
        """Number of different runs of the study."""
        return len(self.runs)

    def begin(self) -> None:
        """Find the runs and timings that are missing."""
        self.tell_left_out()
        self.known_runs = KnownRuns(self.spec, self.folder, self.runs)
        self.missing: list[str] = []
        for place, run_id in enumerate(self.runs):
            if not self.known_runs.is_done(run_id):
                self.known_runs.note(run_id, None)  # another shard, or a worker before an interrupt, may still write it
                self.missing += [run_id] if self.shard is None or self.shard.has(place) else []
        self.repeats = self.missing_repeats() if self.shard is None else {}
        self.again = self.to_run_again() if self.shard is None else []

    def compute(self, engine: Engine) -> None:
        """Compute the missing runs, and then the second ones and the timings of complete runs."""
        self.compute_missing(engine)
        self.run_again(engine)
        self.time()

    @property
    def total(self) -> int:
        """Number of tasks."""
        return len(self.missing) + len(self.again) + len(self.repeats)

    def index(self) -> None:
        """Write the index with a row for each run."""
        found = collect(self.spec, self.points, self.known_runs, self.timings, self.second, self.defined)
        study_index.write(self.folder.index, found)

    def tell_left_out(self) -> None:
        """Report how many runs are left out because a distribution is not installed."""
        for name, count in Counter(point.lacking for point in self.points if point.lacking).items():
            self.notify(f"{counted(count, 'run')} left out: the distribution {name} is not installed")

    def missing_repeats(self) -> dict[str, int]:
        """Return the number of timings to make for each run that lacks some."""
        wanted: dict[str, int] = {}
        for point in self.points:
            count = point.grid.repeats
            if not point.lacking and count > max(1, len(self.known_runs.repeats(point.run_id))):
                wanted[point.run_id] = max(count, wanted.get(point.run_id, 0))
        return wanted

    def compute_missing(self, engine: Engine) -> None:
        """Compute runs in parallel."""
        measures = expressions_of(self.spec.defined_measures())
        tasks = [Task(self.runs[run_id], self.folder.archive(run_id), measures=measures) for run_id in self.missing]
        with engine.pool(self.notify) as pool:
            for task, outcome in pool.work(tasks):
                self.computed += 1
                self.known_runs.note(self.names[task.path], outcome)
                self.failed += outcome.status == "failed" or outcome.is_passing
                self.note_unfinished(outcome)
                self.tell(self.computed, self.total)

    def to_run_again(self) -> list[str]:
        """Return the runs that still need a second run; references never do."""
        if not self.spec.second_run_measures:
            return []
        wanted = dict.fromkeys(point.run_id for point in self.points if not point.lacking)
        return [run_id for run_id in wanted if self.known_runs.run_twice(run_id) is None]

    def run_again(self, engine: Engine) -> None:
        """Take the measures that need a second run from complete runs, in parallel."""
        tasks = [
            Task(self.runs[run_id], self.folder.archive(run_id), second=self.spec.second_run_measures)
            for run_id in self.again
            if self.known_runs.outcome(run_id).status == "complete"
        ]
        last = self.total - len(self.repeats)
        with engine.pool(self.notify) as pool:
            for done, (task, outcome) in enumerate(pool.work(tasks), start=last - len(tasks) + 1):
                self.second[self.names[task.path]] = outcome
                self.note_unfinished(outcome)
                self.tell(done, self.total)

    def time(self) -> None:
        """Time complete runs, one after another."""
        tasks = [
            Task(self.runs[run_id], self.folder.archive(run_id), count)
            for run_id, count in self.repeats.items()
            if self.known_runs.outcome(run_id).status == "complete"
        ]
        with Engine().pool(self.notify) as pool:
            for done, (task, outcome) in enumerate(pool.work(tasks), start=self.total - len(tasks) + 1):
                self.timings[self.names[task.path]] = outcome.seconds
                self.note_unfinished(outcome)
                self.tell(done, self.total)

    def note_unfinished(self, outcome: Outcome) -> None:
        """Keep the reason of an outcome if the next call tries again."""
        if outcome.is_passing:
            self.unfinished.append(outcome.reason)
