"""Runs many specs one after another, without an archive of each, and yields their results in order."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice

from mbdkit.archive.finished_run import FinishedRun
from mbdkit.archive.finished_runs import FinishedRuns
from mbdkit.base.errors import ArchiveError, MbdkitError, PluginError, ResourceError, SpecError
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.base.text import one_line
from mbdkit.engine.consistent_start import Starts
from mbdkit.engine.native.levels import WIDTH
from mbdkit.runs.lane_runs import LaneRuns
from mbdkit.runs.simulation import simulate_arrays
from mbdkit.spec.run_spec import RunSpec
from mbdkit_studies.compute.tasks import Outcome
from mbdkit_studies.texts import joined_lines

#: Number of runs that are prepared before any of them is advanced; similar runs among them are vectorized together.
CHUNK = 32 * WIDTH


def simulate_batch(specs: Iterable[RunSpec], *, lanes: LaneRuns | None = None) -> Iterator[FinishedRun | Outcome]:
    """Run validated specs, and yield the result of each, in the order of `specs`; see `simulate_in_any_order`."""
    waiting: dict[int, FinishedRun | Outcome] = {}
    following = 0
    for places, result in simulate_in_any_order(specs, lanes=lanes):
        for number, place in enumerate(places):
            waiting[place] = result if isinstance(result, Outcome) else result.run(number)
        while following in waiting:
            yield waiting.pop(following)
            following += 1


class Batches:
    """Batches of runs that differ in numbers; loops and compiled mechanisms are prepared once.

    Attributes
    ----------
    SIZE
        Number of runs that a batch should have, so that runs can be vectorized.
    """

    SIZE = 8 * WIDTH

    def __init__(self) -> None:
        self._lanes = LaneRuns(Starts(), ())

    def simulate(self, specs: Iterable[RunSpec]) -> Iterator[FinishedRun | Outcome]:
        """Run validated specs; see `simulate_batch`."""
        return simulate_batch(specs, lanes=self._lanes)


def simulate_in_any_order(
    specs: Iterable[RunSpec],
    *,
    begun: Callable[[int], None] = lambda place: None,
    measures: Sequence[str] = (),
    lanes: LaneRuns | None = None,
) -> Iterator[tuple[list[int], FinishedRuns | Outcome]]:
    """Run validated specs, and yield indices and results of runs as soon as they are known.

    The numbers, and therefore `FinishedRun.data_sha256`, are equal to those of `simulate` for the same spec. Runs on
    index-1 equations with explicit, Gauss and Radau IIA methods are vectorized; see `mbdkit.runs.lane_runs`
    for the exceptions. All others are computed one after another. Similar vectorized runs are yielded together, other
    runs one by one.

    Parameters
    ----------
    begun
        Called with the index of a run in `specs`, from 0, before plugin code prepares the run or runs it alone. Several
        runs are prepared before the first result is yielded.
    measures
        See `simulate`. Runs whose measures contain time integrals are not vectorized.
    lanes
        Loops and compiled mechanisms of earlier batches with the same `measures`; by default, new ones.
    """
    lanes, remaining = lanes or LaneRuns(Starts(), measures), iter(enumerate(specs))
    while chunk := list(islice(remaining, CHUNK)):
        with one_thread_of_linear_algebra():
            prepared = lanes.members(_noted(chunk, begun))
        alone = [index for index, member in enumerate(prepared) if member is None]
        vectorized = [index for index, member in enumerate(prepared) if member is not None]
        vectors = lanes.finished([member for member in prepared if member is not None])
        while True:
            with one_thread_of_linear_algebra():
                some = next(vectors, None)
            if some is None:
                break
            numbers, runs = some
            if runs is None:
                alone += [vectorized[number] for number in numbers]
            else:
                yield [chunk[vectorized[number]][0] for number in numbers], runs
        for index in sorted(alone):
            place, spec = chunk[index]
            begun(place)
            result: FinishedRuns | Outcome
            try:
                result = FinishedRuns.of(simulate_arrays(spec, starts=lanes.starts, measures=measures))
            except (Exception, SystemExit) as error:
                result = refusal(error)
            yield [place], result


def _noted(chunk: Iterable[tuple[int, RunSpec]], begun: Callable[[int], None]) -> Iterator[RunSpec]:
    """Yield the specs of runs; before each, call `begun` with its index."""
    for place, spec in chunk:
        begun(place)
        yield spec


def refusal(error: BaseException) -> Outcome:
    """Return the outcome of a run that raised an exception.

    It is ``failed`` if the run is the cause, and ``missing`` if a resource was not available, so that a second attempt
    may succeed.
    """
    match error:
        case SpecError() | ArchiveError():
            return Outcome("failed", f"wrong-input: {joined_lines(str(error))}")
        case ResourceError() | OSError():
            return Outcome("missing", f"no-resources: {error}")
        case MemoryError():
            return Outcome("missing", "no-resources: there is not enough memory.")
        case PluginError():
            return Outcome("failed", f"plugin-error: {error}")
        case MbdkitError():
            return Outcome("failed", f"error: {error}")
    return Outcome("failed", f"error: {one_line(error)}")
