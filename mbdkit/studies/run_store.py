"""What an execution needs of the runs that a study stores: the same for archives of single runs and for blocks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from mbdkit.studies.folder_lock import Shard
from mbdkit.studies.study_index import Index
from mbdkit.studies.tasks import Outcome, Task


@dataclass(frozen=True)
class Round:
    """Tasks that may be computed in any order, after those of the rounds before.

    Parameters
    ----------
    planned
        Number of runs that were expected when the study began; tasks of failed runs may be dropped since.
    one_by_one
        Whether one process of this machine computes them, one after another.
    """

    tasks: Sequence[Task]
    planned: int
    one_by_one: bool = False


@dataclass(frozen=True)
class Noted:
    """What the outcome of a task means for the numbers that a study reports.

    Parameters
    ----------
    runs
        Number of runs that the task has computed.
    failed
        Number of failed ones.
    unfinished
        External reasons why runs were not computed.
    """

    runs: int = 0
    failed: int = 0
    unfinished: Sequence[str] = ()


class RunStore(ABC):
    """The runs of a study in its folder: what is there, what is missing, and the index of it.

    A run is in an archive of its own (`RunFiles`) or in a block of many (`RunBlocks`). Whoever makes one has checked
    that the spec of the study is valid; nothing is read from the folder before `begin`.

    Attributes
    ----------
    count
        Number of different runs of the study.
    """

    count: int

    @abstractmethod
    def begin(self, shard: Shard | None, notify: Callable[[str], None]) -> int:
        """Find out what is missing in the folder, which is locked, and return the number of runs to compute.

        Parameters
        ----------
        shard
            Part of the study to compute, or None for all of it.
        notify
            Called with messages for the user.
        """

    @abstractmethod
    def rounds(self) -> Iterator[Round]:
        """Yield what is to be computed; the next round depends on the outcomes of the ones before."""

    @abstractmethod
    def note(self, task: Task, outcome: Outcome) -> Noted:
        """Record the outcome of a task."""

    @abstractmethod
    def index(self) -> Index:
        """Return the index of what is in the folder now."""
