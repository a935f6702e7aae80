"""Runs what is missing of a study, and writes its index."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from mbdkit.errors import SpecError
from mbdkit.spec import RunSpec
from mbdkit.spec.study_spec import SECOND_RUN, StudySpec
from mbdkit.studies import study_index
from mbdkit.studies.collect import collect
from mbdkit.studies.known_runs import KnownRuns
from mbdkit.studies.planned_points import plan_points
from mbdkit.studies.pool import Outcome, Pool, Task
from mbdkit.studies.study_folder import StudyFolder
from mbdkit.studies.verdict_lookup import check_verdict
from mbdkit.text import counted

#: Called with (pieces of work done, pieces in all, runs that failed); a run is one, and so are its repeated timings.
Progress = Callable[[int, int, int], None]


@dataclass(frozen=True)
class Shard:
    """One of several equal parts of a study.

    Parameters
    ----------
    number, count
        Which part, from 1, of how many: every run belongs to one of them, by its place in the list of all runs.
    """

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Return the part that was typed as ``2/3``.

        Raises
        ------
        SpecError
            If it is none.
        """
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise SpecError(f"a part of a study is written number/count, such as 1/2 and 2/2, not {text!r}")
        return cls(int(found[1]), int(found[2]))

    def has(self, place: int) -> bool:
        """Tell whether the run at this place, from 0, belongs to the part."""
        return place % self.count == self.number - 1


class Execution:
    """One call for a study in a folder.

    Parameters
    ----------
    spec
        The study.
    folder
        Where it goes; it may hold what earlier calls have done.
    shard
        The part of the study to compute; None for all of it. Parts are not timed repeatedly: the call that completes
        the study does that.
    progress
        Called after each piece of work.
    notify
        Told what takes long.

    Raises
    ------
    SpecError
        If a run of the study is wrong, or the folder is another study's; nothing has been done then.
    """

    def __init__(
        self,
        spec: StudySpec,
        folder: StudyFolder,
        *,
        shard: Shard | None,
        progress: Progress | None,
        notify: Callable[[str], None],
    ):
        self.spec, self.folder, self.shard = spec, folder, shard
        self.progress, self.notify = progress, notify
        check_verdict(spec)
        self.points = plan_points(spec)
        runs, references = {}, {}
        for point in self.points:
            if point.lacking:
                continue
            runs[point.run_id] = point.spec
            if point.reference is not None:
                references[point.reference_id] = point.reference
        self.runs: dict[str, RunSpec] = references | runs
        folder.check(spec)
        self.names = {folder.archive(run_id): run_id for run_id in self.runs}
        self.computed = 0
        self.failed = 0
        self.timings: dict[str, tuple[float, ...]] = {}
        self.second: dict[str, Outcome] = {}

    def run(self, workers: int) -> None:
        """Compute what is missing, time what is to be timed, write the index; on Ctrl-C write what there is.

        Parameters
        ----------
        workers
            How many processes compute at a time; one of its own does the timing.
        """
        self.folder.prepare(self.spec)
        self.tell_left_out()
        with self.folder.locked(shared=self.shard is not None):
            known_runs = KnownRuns(self.spec, self.folder, self.runs)
            missing = []
            for place, run_id in enumerate(self.runs):
                if not known_runs.is_done(run_id):
                    known_runs.note(run_id, None)  # its file may come from elsewhere, or just before an interrupt
                    missing += [run_id] if self.shard is None or self.shard.has(place) else []
            repeats = self.repeats(known_runs) if self.shard is None else {}
            again = self.to_run_again(known_runs) if self.shard is None else []
            total = len(missing) + len(again) + len(repeats)
            try:
                self.compute(missing, workers, total, known_runs)
                self.run_again(again, workers, total - len(repeats), total, known_runs)
                self.time(repeats, total, known_runs)
            finally:
                with self.folder.indexing():
                    found = collect(self.spec, self.points, known_runs, self.timings, self.second)
                    study_index.write(self.folder.index, found)

    def tell_left_out(self) -> None:
        """Say which runs are left out, and what they need."""
        for name, count in Counter(point.lacking for point in self.points if point.lacking).items():
            self.notify(f"{counted(count, 'run')} left out: the distribution {name} is not installed")

    def repeats(self, known_runs: KnownRuns) -> dict[str, int]:
        """Return how often each run is still to be timed."""
        wanted: dict[str, int] = {}
        for point in self.points:
            count = point.grid.repeats
            if not point.lacking and count > max(1, len(known_runs.repeats(point.run_id))):
                wanted[point.run_id] = max(count, wanted.get(point.run_id, 0))
        return wanted

    def compute(self, missing: list[str], workers: int, total: int, known_runs: KnownRuns) -> None:
        """Compute runs, several at a time."""
        tasks = [Task(self.runs[run_id], self.folder.archive(run_id)) for run_id in missing]
        with Pool(workers, self.notify) as pool:
            for task, outcome in pool.work(tasks):
                self.computed += 1
                known_runs.note(self.names[task.path], outcome)
                self.failed += outcome.status == "failed"
                self.tell(self.computed, total)

    @property
    def wanted_again(self) -> tuple[str, ...]:
        """The measures that need a second run of each."""
        return tuple(name for name in SECOND_RUN if self.spec.measures != "all" and name in self.spec.measures)

    def to_run_again(self, known_runs: KnownRuns) -> list[str]:
        """Return the runs that are still to be made a second time; references are not."""
        if not self.wanted_again:
            return []
        wanted = dict.fromkeys(point.run_id for point in self.points if not point.lacking)
        return [run_id for run_id in wanted if known_runs.run_twice(run_id) is None]

    def run_again(self, again: list[str], workers: int, last: int, total: int, known_runs: KnownRuns) -> None:
        """Take the measures that need a second run, of complete runs, several at a time."""
        tasks = [
            Task(self.runs[run_id], self.folder.archive(run_id), second=self.wanted_again)
            for run_id in again
            if known_runs.outcome(run_id).status == "complete"
        ]
        with Pool(workers, self.notify) as pool:
            for done, (task, outcome) in enumerate(pool.work(tasks), start=last - len(tasks) + 1):
                self.second[self.names[task.path]] = outcome
                self.tell(done, total)

    def time(self, repeats: dict[str, int], total: int, known_runs: KnownRuns) -> None:
        """Time complete runs, one after the other."""
        tasks = [
            Task(self.runs[run_id], self.folder.archive(run_id), count)
            for run_id, count in repeats.items()
            if known_runs.outcome(run_id).status == "complete"
        ]
        with Pool(1, self.notify) as pool:
            for done, (task, outcome) in enumerate(pool.work(tasks), start=total - len(tasks) + 1):
                self.timings[self.names[task.path]] = outcome.seconds
                self.tell(done, total)

    def tell(self, done: int, total: int) -> None:
        """Report progress."""
        if self.progress is not None:
            self.progress(done, total, self.failed)
