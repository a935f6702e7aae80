"""The runs of a study that has an archive for each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from mbdkit.base.text import counted
from mbdkit.spec.study_measures import expressions_of
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies.collect import collect
from mbdkit.studies.folder_lock import Shard
from mbdkit.studies.known_runs import KnownRuns
from mbdkit.studies.run_store import Noted, Round, RunStore
from mbdkit.studies.study_folder import StudyFolder
from mbdkit.studies.study_index import Index
from mbdkit.studies.study_plan import plan_study
from mbdkit.studies.tasks import Outcome, Task


class RunFiles(RunStore):
    """An archive for each run, with the results of second runs and repeated timings in the index.

    These are made without a shard only, by the call that completes the study; the timings in a single separate process
    of this machine.
    """

    def __init__(self, spec: StudySpec, folder: StudyFolder):
        self.spec, self.folder, self.plan = spec, folder, plan_study(spec)
        self.count = len(self.plan.runs)
        self._timings: dict[str, tuple[float, ...]] = {}
        self._second: dict[str, Outcome] = {}

    def begin(self, shard: Shard | None, notify: Callable[[str], None]) -> int:
        """See `RunStore.begin`."""
        for name, count in Counter(point.lacking for point in self.plan.points if point.lacking).items():
            notify(f"{counted(count, 'run')} left out: the distribution {name} is not installed")
        self._known = KnownRuns(self.spec, self.folder, self.plan.runs)
        missing = set(self._known.missing(self.plan.runs))
        own = [run_id for index, run_id in enumerate(self.plan.runs) if shard is None or shard.has(index)]
        self._missing = [run_id for run_id in own if run_id in missing]
        self._again = self._to_run_again() if shard is None else []
        self._repeats = self._missing_repeats() if shard is None else {}
        return len(self._missing) + len(self._again) + len(self._repeats)

    def _to_run_again(self) -> list[str]:
        """Return the runs that still need a second run; references never do."""
        if not self.spec.second_run_measures:
            return []
        wanted = dict.fromkeys(point.run_id for point in self.plan.points if not point.lacking)
        return [run_id for run_id in wanted if self._known.run_twice(run_id) is None]

    def _missing_repeats(self) -> dict[str, int]:
        """Return the number of timings to make for each run that lacks some."""
        wanted: dict[str, int] = {}
        for point in self.plan.points:
            count = point.grid.repeats
            if not point.lacking and count > max(1, len(self._known.repeats(point.run_id))):
                wanted[point.run_id] = max(count, wanted.get(point.run_id, 0))
        return wanted

    def rounds(self) -> Iterator[Round]:
        """Yield the missing runs, and then the second runs and the timings of complete ones."""
        measures = expressions_of(self.spec.defined_measures())
        yield Round([self._task(run_id, measures=measures) for run_id in self._missing], len(self._missing))
        second = self.spec.second_run_measures
        again = [self._task(run_id, second=second) for run_id in self._again if self._is_complete(run_id)]
        yield Round(again, len(self._again))
        repeats = [(run_id, count) for run_id, count in self._repeats.items() if self._is_complete(run_id)]
        timings = [self._task(run_id, repeats=count) for run_id, count in repeats]
        yield Round(timings, len(self._repeats), one_by_one=True)

    def _task(self, run_id: str, **content: Any) -> Task:
        """Return the task to compute a run for its archive, or, without writing it, for other results."""
        spec = self.plan.runs[run_id].canonical_json()
        return Task(run_id, {"spec": spec, **content}, self.folder.archive(run_id), writes="measures" in content)

    def _is_complete(self, run_id: str) -> bool:
        return self._known.outcome(run_id).status == "complete"

    def note(self, task: Task, outcome: Outcome) -> Noted:
        """See `RunStore.note`."""
        unfinished = [outcome.reason] if outcome.is_passing else []
        if "second" in task.content:
            self._second[task.key] = outcome
        elif "repeats" in task.content:
            self._timings[task.key] = outcome.seconds
        else:
            self._known.note(task.key, outcome)
            return Noted(1, int(outcome.status == "failed" or outcome.is_passing), unfinished)
        return Noted(unfinished=unfinished)

    def index(self) -> Index:
        """See `RunStore.index`."""
        return collect(self.spec, self.plan, self._known, self._timings, self._second)
