"""How the runs of a study are read from its folder: from an archive of each run, or from blocks of many runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.run_contents import NotStoredError
from mbdkit.base.files_read import only_known
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_studies.store.block_writer import KEEPING_TIMES
from mbdkit_studies.store.blocks import Block
from mbdkit_studies.store.study_blocks import StudyBlocks
from mbdkit_studies.store.study_point import StudyPoint

#: Runs that join the rows of one or more runs of a study, each with the numbers of these runs in the study and the
#: number of rows of each of them.
JoinedRuns = Iterator[tuple[Run, Sequence[int], np.ndarray]]


class Storage:
    """The stored runs of a study, in an archive for each.

    Attributes
    ----------
    CONTENT
        What a file contains, as a word.
    HOW_TO_READ
        Sentences that say how to read or repeat a run, given its number.
    """

    CONTENT = "run"
    HOW_TO_READ = (
        'The study\'s folder contains an archive of every run, with its spec; the command "mbdkit rerun" repeats a '
        "run. In Python, mbdkit.load_study(folder).run(number=1) opens the archive of run 1."
    )
    _FILES = "[0-9a-f]" * 16 + ".h5"

    def __init__(self, spec: StudySpec, folder: StudyFolder, planned: PlannedPoints):
        self.spec, self.folder, self.planned = spec, folder, planned

    @property
    def count(self) -> int:
        """Number of files of the complete study; equal runs are counted as if each had a file."""
        return len(self.planned)

    @property
    def done(self) -> int:
        """Number of files that exist."""
        return len([*self.folder.runs.glob(self._FILES)])

    def path(self, point: StudyPoint) -> Path | None:
        """Return the file that contains the run of a point; None if there is none."""
        return point.path

    def open(self, point: StudyPoint) -> Run | None:
        """Return the run of a point with the arrays that the study stores; None if it has no results."""
        path = point.path
        return None if path is None else load(path)

    def joined_runs(self, runs: Iterable[tuple[StudyPoint, Run | None]]) -> JoinedRuns:
        """Yield joined runs, here single ones; `runs` are the points of the study, with runs that are opened when
        needed.
        """
        for point, run in runs:
            if run is not None:
                with run:
                    yield run, [point.number], np.array([len(run.time)])


class BlockStorage(Storage):
    """The stored runs of a study, in blocks of many; the runs of each structure of a block are joined."""

    CONTENT = "block"
    HOW_TO_READ = (
        "The study's folder contains the runs in blocks. In Python, mbdkit.load_study(folder).run(number=1) returns "
        "what is stored of run 1, and remake(number=1) integrates it again with all arrays."
    )
    _FILES = "block-[0-9]*.h5"

    @property
    def count(self) -> int:
        """See `Storage.count`."""
        return self._blocks.count

    def path(self, point: StudyPoint) -> Path:
        """See `Storage.path`."""
        return self.folder.block(self._blocks.block_of(point.number - 1))

    def open(self, point: StudyPoint) -> Run | None:
        """See `Storage.open`."""
        if not point.data_sha256:
            return None
        with Block(self.path(point), self._sha256) as block:
            return block.run(point.number)

    def joined_runs(self, runs: Iterable[tuple[StudyPoint, Run | None]]) -> JoinedRuns:
        """See `Storage.joined_runs`."""
        if self.spec.store not in KEEPING_TIMES:
            raise NotStoredError("values over time", str(self.spec.store))
        for path in filter(Path.exists, map(self.folder.block, range(self._blocks.count))):
            with Block(path, self._sha256) as block:
                for run, numbers, counts in block.joined_runs():
                    yield run, numbers.tolist(), counts

    @cached_property
    def _sha256(self) -> str:
        return self.spec.sha256()

    @cached_property
    def _blocks(self) -> StudyBlocks:
        first = self.folder.block(0)
        if self.spec.block is None and first.exists():  # without it, a run must be built, which may read a file
            with Block(first) as block:
                return StudyBlocks(len(self.planned), len(block.numbers))
        with only_known((), allowed=False):
            return StudyBlocks.of(self.spec, self.planned)


def storage_of(spec: StudySpec, folder: StudyFolder, planned: PlannedPoints) -> Storage:
    """Return how the runs of a study are stored."""
    return (BlockStorage if spec.in_blocks else Storage)(spec, folder, planned)


def storage_in(folder: Path) -> Storage:
    """Return how the runs of the study in a folder are stored.

    Raises
    ------
    SpecError
        If the folder contains no valid study spec.
    """
    files = StudyFolder(folder)
    spec = load_study_spec(files.spec)
    return storage_of(spec, files, PlannedPoints(spec))
