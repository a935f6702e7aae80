"""How the runs of a study are stored in its folder and read from it: an archive of each run, or blocks of many runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from mbdkit.archive.disk_space import row_bytes
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.run_contents import NotStoredError
from mbdkit.base.errors import MbdkitError
from mbdkit.base.files_read import only_known
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.quantities.names import archive_names
from mbdkit.runs.preparation import rows_expected
from mbdkit.spec.run_spec import RunSpec
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.points.planned_points import PlannedPoints, number_of_points
from mbdkit_studies.points.sampled_values import study_in
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.spec.study_spec import LARGEST_TABLE, StudySpec
from mbdkit_studies.store.block_writer import HISTORIES, KEEPING_TIMES, Store
from mbdkit_studies.store.blocks import Block
from mbdkit_studies.store.study_point import StudyPoint

MOST_FILES = 500  #: Number of runs above which studies are stored in blocks, unless files are requested.

#: Default of the largest number of runs in a block, in studies of up to `LARGE_BLOCKS` times as many runs and in larger
#: ones. Writing a block, and reading it for the index, takes 0.1 s whatever its number of runs.
RUNS, LARGE_BLOCKS, MOST_RUNS = 1000, 20, 5000

#: Number of blocks of studies with fewer than `BLOCKS` times `RUNS` runs, so that all processes have work, and smallest
#: number of runs in each of them, which vectorized runs need; both are defaults.
BLOCKS, FEWEST = 8, 64

#: Largest size of the arrays of a block [bytes], which must fit in memory; blocks of large runs have fewer runs.
BYTES = 1 << 26

ROWS = 1000  #: Assumed number of recorded rows of a run if it depends on step-size control.


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
        return self.folder.block((point.number - 1) // self._blocks.size)

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
                yield from ((run, numbers.tolist(), counts) for run, numbers, counts in block.joined_runs())

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


class FilesBesideBlocks(BlockStorage):
    """The stored runs of a study, in an archive for each, beside blocks from which the index is made."""

    HOW_TO_READ = Storage.HOW_TO_READ
    open, joined_runs = Storage.open, Storage.joined_runs

    def path(self, point: StudyPoint) -> Path:
        """See `Storage.path`."""
        return self.folder.archive(point.run_id)


def storage_of(spec: StudySpec, folder: StudyFolder, planned: PlannedPoints) -> Storage:
    """Return how the runs of a study are stored."""
    kind = Storage if not spec.in_blocks else FilesBesideBlocks if spec.store == "files" else BlockStorage
    return kind(spec, folder, planned)


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


def with_store(spec: StudySpec, folder: StudyFolder, *, overwrite: bool = False) -> StudySpec:
    """Return a study whose `store` is set if its runs are to be stored in blocks.

    If the study does not set `store`, the value is that of the same study in the folder. Without such a study, the
    value is ``all`` for a sample, a table of members, or a large study. `store` remains unset for other studies, which
    store an archive for each run.
    """
    if spec.store is not None:
        return spec
    if folder.spec.is_file() and not overwrite:
        there = study_in(folder)
        is_same = there is not None and there.stored_as(None).sha256() == spec.sha256()
        return spec.stored_as(there.store) if there is not None and is_same else spec
    return spec.stored_as("all") if is_for_blocks(spec) else spec


def is_for_blocks(spec: StudySpec) -> bool:
    """Return whether a study is stored in blocks, on request or because it is large."""
    if spec.store is not None:
        return spec.in_blocks
    return spec.has_table or (number_of_points(spec) > MOST_FILES and not spec.needs_files)


@dataclass(frozen=True)
class StudyBlocks:
    """The division of the runs of a study into blocks.

    Parameters
    ----------
    runs
        Number of runs of the study.
    size
        Number of runs in each block but the last.
    """

    runs: int
    size: int

    @classmethod
    def of(cls, spec: StudySpec, points: PlannedPoints) -> StudyBlocks:
        """Return the blocks of a study.

        Unless the spec sets the size of the blocks, the size depends on the first valid spec among those of the first
        ten runs, so that all processes that compute the study use the same blocks.
        """
        if spec.block is not None:
            return cls(len(points), min(spec.block, LARGEST_TABLE))
        for point in points[:10]:
            with suppress(MbdkitError):
                if not point.lacking:
                    row = _bytes(point.spec, stored(spec))
                    return cls(len(points), max(1, min(_most_runs(len(points)), BYTES // max(1, row))))
        return cls(len(points), _most_runs(len(points)))

    @property
    def count(self) -> int:
        """Number of blocks."""
        return math.ceil(self.runs / self.size)

    def places(self, block: int) -> range:
        """Return the indices of the runs of a block; runs and blocks are numbered from 0."""
        return range(block * self.size, min(self.runs, (block + 1) * self.size))


def _most_runs(runs: int) -> int:
    """Return the largest number of runs in a block of a study with `runs` runs."""
    largest = min(MOST_RUNS, max(RUNS, math.ceil(runs / LARGE_BLOCKS)))
    return min(largest, max(FEWEST, math.ceil(runs / BLOCKS)))


def stored(spec: StudySpec) -> Store:
    """Return the value of `store`: which data of each run the blocks of a study contain."""
    assert spec.store is not None
    return "summary" if spec.store == "files" else spec.store


def _bytes(spec: RunSpec, store: Store) -> int:
    """Return the estimated size of the arrays that are stored for a run [bytes]."""
    if store in ("hashes", "summary"):
        return 0
    names = archive_names(compile_mechanism(spec.mechanism()))
    row = row_bytes(names, spec.output.recorded, None if store == "all" else HISTORIES)
    return row * (rows_expected(spec) or ROWS)
