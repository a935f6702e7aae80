"""The runs that a study stores, in archives of one run or in blocks of many, and the state of their files.

Which runs exist is determined from the index of an earlier call, from the files, and from the answers of workers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from mbdkit.base.distributions import own_version
from mbdkit.base.errors import ArchiveError, ResourceError, SpecError
from mbdkit_studies.compute.study_plan import plan_study
from mbdkit_studies.compute.tasks import Outcome, Task
from mbdkit_studies.folder.folder_lock import Shard
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_studies.store import study_index
from mbdkit_studies.store.study_index import Index

MISSING = Outcome("missing", "")

Key = TypeVar("Key", str, int)


@dataclass(frozen=True)
class Round:
    """Tasks that may be computed in any order, after the tasks of all previous rounds.

    Parameters
    ----------
    planned
        Number of runs that were expected in this round when the study began. There may be fewer tasks, because runs of
        earlier rounds have failed.
    one_by_one
        Whether one process of this machine computes the tasks, one after another.
    """

    tasks: Sequence[Task]
    planned: int
    one_by_one: bool = False


class RunStore(ABC, Generic[Key]):
    """The runs of a study in its folder: those that exist, those that are missing, and the index.

    A file contains one run (`RunFiles`, whose keys are the run ids) or a block of many runs (`RunBlocks`, whose keys
    are the numbers of the blocks). A file is read only if it has changed since it was indexed. The constructor checks
    that the spec of the study is valid; nothing is read from the folder before `begin`.

    Attributes
    ----------
    count
        Number of distinct runs of the study, including reference runs; for a study in blocks, number of its points.
    plan
        The plan of the study.
    computed, failed
        Number of runs that were computed, and number of these that failed.
    unfinished
        External reasons why runs were not computed.
    """

    count: int

    def __init__(self, spec: StudySpec, folder: StudyFolder):
        self.spec, self.folder, self.plan = spec, folder, plan_study(spec)
        self._outcomes: dict[Key, Outcome] = {}
        self.computed = self.failed = 0
        self.unfinished: list[str] = []

    @abstractmethod
    def begin(self, shard: Shard | None, notify: Callable[[str], None]) -> int:
        """Determine what is missing in the locked folder, and return the number of runs to compute.

        Parameters
        ----------
        shard
            Part of the study to compute, or None for all of it.
        notify
            Called with messages for the user.
        """

    @abstractmethod
    def rounds(self) -> Iterator[Round]:
        """Yield the tasks to be computed; each round depends on the outcomes of the rounds before."""

    @abstractmethod
    def note(self, task: Task, outcome: Outcome) -> None:
        """Record the outcome of a task, and count its runs."""

    @abstractmethod
    def index(self) -> Index:
        """Return the index of the present contents of the folder."""

    @abstractmethod
    def read(self, key: Key) -> Outcome:
        """Return the outcome stored in a file, according to the index if the file has not changed since it was indexed;
        ``missing`` if there is no sound file, or if its runs have not ended.

        Raises
        ------
        SpecError
            If the file contains other runs.
        """

    def index_before(self) -> Index | None:
        """Return the index of an earlier call; None if this version of mbdkit has not written one for this study."""
        try:
            before = study_index.read(self.folder.index)
        except (SpecError, ArchiveError, ResourceError) as error:
            if isinstance(error, ArchiveError) and error.is_other_version:
                raise
            return None  # the files are read instead
        return before if (before.study_sha256, before.version) == (self.spec.sha256(), own_version()) else None

    def missing(self, keys: Iterable[Key]) -> list[Key]:
        """Return the keys of the files that are to be computed.

        These files are read again for the index, because another shard, or a worker of an interrupted call, may have
        written them in the meantime.

        Raises
        ------
        SpecError
            If a file contains other runs.
        """
        missing = [key for key in keys if not self.outcome(key).is_final]
        for key in missing:
            self.forget(key)
        return missing

    def outcome(self, key: Key) -> Outcome:
        """Return the outcome stored in a file; ``missing`` if there is no file, or if it has to be computed again.

        Raises
        ------
        SpecError
            If the file contains other runs.
        """
        if key not in self._outcomes:
            self._outcomes[key] = self.read(key)
        return self._outcomes[key]

    def note_file(self, key: Key, outcome: Outcome) -> None:
        """Record the outcome of a file that has just been computed."""
        self.forget(key)
        self._outcomes[key] = outcome if outcome.status in ("complete", "failed", "missing") else MISSING

    def forget(self, key: Key) -> None:
        """Discard what was read from a file."""
        self._outcomes.pop(key, None)
