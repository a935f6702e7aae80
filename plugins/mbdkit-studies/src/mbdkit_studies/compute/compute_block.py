"""Computes one block of runs of a study in any worker process, given the folder of the study and the block's number."""

from __future__ import annotations

import gc
import json
import os
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property, lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from mbdkit.archive.finished_run import FinishedRun
from mbdkit.archive.finished_runs import FinishedRuns
from mbdkit.archive.part_file import write_image
from mbdkit.archive.reader import load
from mbdkit.archive.stored_mechanism import mechanism_json
from mbdkit.base import file_locks
from mbdkit.base.errors import MbdkitError, ResourceError, SpecError
from mbdkit.base.files_read import files_json
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.base.plain_data import path_text
from mbdkit.base.terminal import say
from mbdkit.engine.consistent_start import Starts
from mbdkit.runs.lane_runs import LaneRuns
from mbdkit.runs.provenance import plugins_of, surroundings
from mbdkit.runs.simulation import simulate, simulate_arrays
from mbdkit.runs.varied_runs import VariedRuns
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit.spec.varied_specs import VariedSpecs
from mbdkit_studies.compute.batch import CHUNK, refusal, simulate_in_any_order
from mbdkit_studies.compute.study_plan import StudyPlan
from mbdkit_studies.compute.tasks import Outcome, mark_of, run_at_work
from mbdkit_studies.compute.unfinished_block import UnfinishedBlock
from mbdkit_studies.compute.varied_runs import DifferenceError, EnsembleRuns, drawn, is_determined
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.points.planned_points import PlannedPoint, PlannedPoints
from mbdkit_studies.spec.measures import MEASURES, OF_CHECKED_RUNS, Description, RunsInMemory, other_values
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.store.block_writer import UNSET, BlockHeading, BlockPoints, BlockRuns, Texts, block_image, kept
from mbdkit_studies.store.storage import stored
from mbdkit_studies.texts import joined_lines

MISALIGNMENT = "misalignment_max"  #: The measure that blocks store in a column apart from the other measures.

#: Time to wait for another process that computes the same block, such as one whose parent was killed [s].
PATIENCE = 10.0


class BlockPlan(StudyPlan):
    """The plan of a study, and the measures that are computed for its runs in blocks."""

    @cached_property
    def _defined_measures(self) -> tuple[DefinedMeasure, ...]:
        return self.spec.defined_measures()

    @cached_property
    def described(self) -> dict[str, Description]:
        """Unit and description of each measure."""
        # the misalignment has its own column
        built_in = {name: MEASURES[name] for name in self.built_in if name != MISALIGNMENT}
        return {**built_in, **self.defined, **(OF_CHECKED_RUNS if self.is_checked else {})}

    @cached_property
    def varied(self) -> EnsembleRuns:
        """The runs whose specs differ in numbers only."""
        return EnsembleRuns(self.points, self.expressions)

    @property
    def is_checked(self) -> bool:
        """Whether the spec of the first valid sample of the plan requests error estimates."""
        return any(spec.estimates_errors for _, spec in self.valid_samples[:1])

    def of(self, results: FinishedRuns, specs: Sequence[RunSpec]) -> tuple[dict[str, np.ndarray], dict[int, Outcome]]:
        """Return the measures of R runs by name, (R,), and the reasons why those of a run could not be computed."""
        runs, taken = RunsInMemory(results, specs), dict[str, np.ndarray]()
        failed: dict[int, Outcome] = {}

        def put(name: str, places: int | list[int], values: float | np.ndarray) -> None:
            taken.setdefault(name, np.full(len(runs), np.nan))[places] = values

        for places, group in runs.groups():
            for name in self.built_in:
                if name != MISALIGNMENT:
                    put(name, places, MEASURES[name].take(group))
        for place in range(len(runs)) if self._defined_measures or results.single is not None else ():
            try:
                for name, value in other_values(runs[place], specs[place], self._defined_measures).items():
                    put(name, place, value)
            except Exception as error:
                failed[place] = refusal(error)
        for place in failed:
            for values in taken.values():
                values[place] = np.nan
        return taken, failed


@contextmanager
def _collecting_new_objects_only() -> Iterator[None]:
    """Exclude existing objects from the cyclic garbage collector in a block.

    Otherwise the collector would traverse all modules repeatedly, which takes a sixth of the time of a block of runs.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def compute_block(
    folder: str | Path,
    block: int,
    *,
    skip: Mapping[int, str] | None = None,
    notify: Callable[[str], None] = say,
    one_by_one: bool = False,
) -> int:
    """Compute the runs of a block and write its file.

    Everything needed is read from the folder, so that any process with access to it can compute the block. Meanwhile, a
    file beside the block contains the number of the run in progress; see `mbdkit_studies.compute.tasks.run_at_work`.

    Parameters
    ----------
    folder
        Folder of the study, with its study.yaml.
    block
        Number of the block, from 0.
    skip
        Reasons for which runs are recorded as failed without being computed, by number of the run.
    notify
        Called with each warning of a run.
    one_by_one
        Whether each run has a spec of its own, even if the specs differ in numbers only.

    Returns
    -------
    int
        Number of failed runs.

    Raises
    ------
    SpecError
        If the folder contains no study.
    ResourceError
        If the block cannot be written, or another process is computing it.
    DifferenceError
        If a run that was computed twice has different results; the block has then been computed run by run.
    """
    try:
        return _compute_block(Path(folder), block, skip or {}, notify, one_by_one=one_by_one)
    except DifferenceError:
        _compute_block(Path(folder), block, skip or {}, notify, one_by_one=True)
        raise


def _compute_block(
    folder: Path, block: int, skip: Mapping[int, str], notify: Callable[[str], None], *, one_by_one: bool
) -> int:
    files = StudyFolder(folder)
    plan = _plan(str(files.spec.absolute()), files.spec.stat().st_mtime_ns)
    heading = BlockHeading(plan.spec.sha256(), stored(plan.spec), surroundings(), plan.described, plan.spec.compress)
    unfinished = UnfinishedBlock(files.block(block), heading)
    # The run in which a process has died is found if runs are computed one by one.
    one_by_one = one_by_one or bool(skip) or run_at_work(files.block(block)) is not None
    if block == 0 and not one_by_one and (reason := plan.varied.note):
        notify(reason)
    twice = drawn(plan.blocks.places(block), len(plan.points))
    # entered here, because entering it for each vector of runs would take time
    with _Mark(files.block(block)) as mark, _collecting_new_objects_only(), one_thread_of_linear_algebra():
        varied = {grid.base_json: VariedSpecs(grid.base_json) for grid in plan.points.grids}
        places, saved, lanes = plan.blocks.places(block), unfinished.saved(), LaneRuns(Starts(), plan.expressions)
        runs: list[BlockRuns] = []
        runs_of_numbers: VariedRuns | None = None
        # Specs and mechanisms of a few runs exist at a time, so that the memory does not depend on the size of blocks.
        for first in range(0, len(places), CHUNK):
            left: Sequence[int] = places[first : first + CHUNK]
            if not (one_by_one or saved or plan.varied.reason):
                mark.note(left[-1] + 1)
                runs_of_numbers = runs_of_numbers or plan.varied.varied_in(lanes)
                some_runs = list(_varied_runs(plan, left, runs_of_numbers, notify, twice))
                computed = {number for part in some_runs for number in part.numbers}
                left = [place for place in left if place + 1 not in computed]
                runs += some_runs
                unfinished.add(some_runs)
            members = {place + 1: _spec_of(plan.points[place], varied, skip, mark) for place in left}
            known = _taken_over(saved, members)
            runs += known.values()
            missing = {number: spec for number, spec in members.items() if number not in known}
            for numbers, result in _results(missing, lanes, plan.expressions, mark, notify):
                specs = [spec for number in numbers if isinstance(spec := missing[number], RunSpec)]
                runs.append(_own_runs(plan, numbers, specs, result))
                unfinished.add(runs[-1:])
        if plan.spec.store == "files":
            for some in runs:
                _write_archives(plan, files, some)
        write_image(files.block(block), block_image(heading, _points(plan.points, places), runs), overwrite=True)
        unfinished.remove()
    return sum(len(some.numbers) if some.status == "failed" else [*some.status].count("failed") for some in runs)


def _write_archives(plan: BlockPlan, files: StudyFolder, runs: BlockRuns) -> None:
    """Write the archives of runs that have results, computed again in the ordinary way; sound ones are kept."""
    for number, sha256 in zip(runs.numbers, runs.results.data_sha256 if runs.results else (), strict=False):
        spec = plan.points[number - 1].spec
        path = files.archive(spec.run_id())
        with suppress(MbdkitError), load(path) as there:
            if there.file and there.data_sha256 == sha256:  # all arrays are verified
                continue
        with simulate(spec, path=path, overwrite=True, measures=plan.expressions) as run:
            if run.status == "interrupted":
                raise KeyboardInterrupt
            _check_equal(number, "data_sha256", sha256, run.data_sha256)


def _points(points: PlannedPoints, places: range) -> BlockPoints:
    """Return the points of a study at some places for a block."""
    numbers, table = [place + 1 for place in places], points.table()
    if table is not None:
        values = {key: column[places.start : places.stop] for key, column in table.items()}
        return BlockPoints(numbers, [points.grids[0].base_json] * len(numbers), values)
    some = [points[place] for place in places]
    own = [{path_text(setting.path): setting.value for setting in point.settings} for point in some]
    keys = dict.fromkeys(key for values in own for key in values)
    columns = {key: [values.get(key, UNSET) for values in own] for key in keys}
    return BlockPoints(numbers, [point.grid.base_json for point in some], columns)


#: Specs of runs by their numbers, or the reasons why they are not computed.
Members = Mapping[int, RunSpec | Outcome]


def _taken_over(saved: Mapping[int, BlockRuns], members: Members) -> dict[int, BlockRuns]:
    """Return those saved runs, by number, that have the specs and the plugins of members."""
    runs = {}
    for number, spec in members.items() if saved else ():
        if (run := saved.get(number)) is None or not isinstance(spec, RunSpec):
            continue
        same = run.spec_sha256, run.run_id, run.plugins
        if same == (spec.sha256(), spec.run_id(), _plugins_json(tuple(plugins_of(spec).items()))):
            runs[number] = run
    return runs


@lru_cache(maxsize=4)
def _plan(study: str, changed: int) -> BlockPlan:
    """Return the plan of a study; cached for all blocks that a process computes."""
    return BlockPlan(load_study_spec(study))


def _spec_of(
    point: PlannedPoint, varied: Mapping[str, VariedSpecs], skip: Mapping[int, str], mark: _Mark
) -> RunSpec | Outcome:
    """Return the spec of a run, or the reason why it is not computed."""
    if point.lacking:
        return Outcome("left-out", f"not-installed: the distribution {point.lacking} is not installed.")
    if point.number in skip:
        return Outcome("failed", skip[point.number])
    mark.note(point.number)  # before the mechanism is built, because a model of a plugin may end the process
    try:
        spec = varied[point.grid.base_json].spec([(setting.path, setting.value) for setting in point.settings])
        spec.mechanism()
    except SpecError:
        try:
            # `point.spec` raises the error again, with the location in the study that causes it
            return point.spec
        except SpecError as error:  # stored without the file name, which depends on the folder
            text = f"{error.key}: {error.message}" if error.key else error.message
            return Outcome("failed", f"wrong-input: {joined_lines(text)}")
    except Exception as error:
        return refusal(error)
    return spec


def _results(
    members: Members, lanes: LaneRuns, measures: Sequence[str], mark: _Mark, notify: Callable[[str], None]
) -> Iterator[tuple[list[int], FinishedRuns | Outcome]]:
    """Yield the numbers of runs with their results as soon as these are known."""
    computed = {number: spec for number, spec in members.items() if isinstance(spec, RunSpec)}
    numbers = list(computed)
    results = simulate_in_any_order(
        computed.values(), begun=lambda place: mark.note(numbers[place]), measures=measures, lanes=lanes
    )
    for places, result in results:
        for warning in chain.from_iterable(() if isinstance(result, Outcome) else result.warnings):
            notify(f"warning: {warning}")
        yield [numbers[place] for place in places], result
    yield from (([number], spec) for number, spec in members.items() if isinstance(spec, Outcome))


def _varied_runs(
    plan: BlockPlan, places: Sequence[int], runs: VariedRuns, notify: Callable[[str], None], twice: Collection[int]
) -> Iterator[BlockRuns]:
    """Yield the data of those runs that can be computed without specs of their own; those at `twice` are compared.

    Raises DifferenceError if their results differ.
    """
    varied = plan.varied
    for done, results in varied.finished(runs, places):
        for warning in chain.from_iterable(results.warnings):
            notify(f"warning: {warning}")
        hashes, base = varied.hashes(done), varied.base
        for number, place in enumerate(done):
            if place in twice:
                _compare(place, varied.spec(place), results.run(number), [texts[number] for texts in hashes], plan)
        plugins = _plugins_json(tuple(plugins_of(base).items()))
        yield _block_runs(plan, [place + 1 for place in done], results, varied.specs(done), hashes, plugins=plugins)


def _compare(place: int, spec: RunSpec, run: FinishedRun, hashes: Sequence[str], plan: BlockPlan) -> None:
    """Raise DifferenceError if a run differs from the same run by the ordinary way."""
    other = simulate_arrays(spec, measures=plan.expressions)
    mine = run.data_sha256, *hashes, run.judgement, run.warnings, run.status
    theirs = other.data_sha256, spec.sha256(), spec.run_id(), other.judgement, other.warnings, other.status
    names = "data_sha256", "spec_sha256", "run_id", "verdict", "warnings", "status"
    for name, one, two in zip(names, mine, theirs, strict=True):
        _check_equal(place + 1, name, one, two)


def _check_equal(number: int, name: str, one: object, two: object) -> None:
    if one != two:
        raise DifferenceError(
            f"run {number} has the {name} {one} by the way of ensembles, but {two} by the ordinary way. This is "
            "a defect of mbdkit; please report it, with this study. Its block was computed by the ordinary way"
        )


def _own_runs(
    plan: BlockPlan, numbers: Sequence[int], specs: Sequence[RunSpec], result: FinishedRuns | Outcome
) -> BlockRuns:
    """Return the data that the block stores for several runs with specs of their own; none if they are not valid."""
    hashes = [spec.sha256() for spec in specs] or "", [spec.run_id() for spec in specs] or ""
    if isinstance(result, Outcome):
        return BlockRuns(numbers, result.status, result.reason, *hashes)
    return _block_runs(
        plan, numbers, result, specs, hashes,
        plugins=[_plugins_json(tuple(plugins_of(spec).items())) for spec in specs],
        # That of a packaged model is not stored for each run, because its spec alone determines it.
        mechanism=["" if is_determined(spec) else mechanism_json(spec.mechanism()) for spec in specs],
        files=[files_json(spec.files_read) if spec.files_read else "" for spec in specs],
    )  # fmt: skip


def _block_runs(
    plan: BlockPlan, numbers: Sequence[int], results: FinishedRuns, specs: Sequence[RunSpec],
    hashes: tuple[Texts, Texts], **columns: Any,
) -> BlockRuns:  # fmt: skip
    taken, failed = plan.of(results, specs)
    ended = [failed.get(place, results) for place in range(len(numbers))] if failed else ()
    status, reason = [one.status for one in ended] or results.status, [one.reason for one in ended] or results.reason
    stored_results = kept(results, stored(plan.spec))
    return BlockRuns(numbers, status, reason, *hashes, results=stored_results, measures=taken, **columns)


@lru_cache(maxsize=64)
def _plugins_json(plugins: tuple[tuple[str, str], ...]) -> str:
    return json.dumps(dict(plugins), separators=(",", ":"))


class _Mark:
    """The file with the number of the run in progress in a block; it is removed when the block is finished.

    It is locked, so that two processes cannot compute the same block, for example if the worker of an executor is
    wrongly considered lost.
    """

    def __init__(self, block: Path):
        self.path, self.block = mark_of(block), block
        self.number = 0

    def __enter__(self) -> _Mark:
        self.handle = file_locks.open_file(self.path, os.O_RDWR | os.O_CREAT | file_locks.NO_LINKS)
        try:
            self._lock()
            os.ftruncate(self.handle, 0)
        except BaseException:
            os.close(self.handle)
            raise
        return self

    def _lock(self) -> None:
        until = time.monotonic() + PATIENCE
        while True:
            try:
                file_locks.lock(self.handle)
                return
            except BlockingIOError:
                if time.monotonic() > until:
                    message = "another process is computing this block; repeat the command when it has ended"
                    raise ResourceError(message, file=self.block) from None
                time.sleep(0.05)
            except OSError:  # the file system does not support locks
                return

    def note(self, number: int) -> None:
        """Write the number of the run that is computed next."""
        if number != self.number:
            os.lseek(self.handle, 0, os.SEEK_SET)
            os.write(self.handle, f"{number:8d}".encode())
            self.number = number

    def __exit__(self, *_: object) -> None:
        os.close(self.handle)
        self.path.unlink(missing_ok=True)
