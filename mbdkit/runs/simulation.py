"""Runs a spec: builds the mechanism, integrates it in stretches (some steps per call), and writes the archive."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from mbdkit.archive.finished_run import FinishedRun
from mbdkit.archive.part_file import check_target
from mbdkit.archive.result_table import ResultTable
from mbdkit.archive.run import Run
from mbdkit.archive.run_contents import ArrayContents
from mbdkit.base import higher_layers
from mbdkit.base.called_functions import calls_allowed
from mbdkit.base.errors import MbdkitError
from mbdkit.base.interrupts import interrupts_noted
from mbdkit.base.logs import logger_of, warn_on_stderr
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.base.progress_bars import in_notebook, progress_bar
from mbdkit.base.text import one_line, shown
from mbdkit.engine.assembly import AssembledState
from mbdkit.engine.consistent_start import Starts
from mbdkit.engine.workspace import Workspace
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.runs.corners import check_jumps
from mbdkit.runs.findings import findings
from mbdkit.runs.preparation import RunSetup, build, check_calls, check_disk_space, make_method
from mbdkit.runs.run_record import Request, RunRecord, begin_archive, begin_arrays
from mbdkit.runs.run_seams import Progress, computed_run
from mbdkit.runs.simulated_run import SimulatedRun
from mbdkit.spec import RunSpec, load_spec
from mbdkit.spec.loading import RunSource, Sections
from mbdkit.trust.finding import Finding

if TYPE_CHECKING:
    from mbdkit.runs.accuracy.chosen_method import Choice

_Start = tuple[Workspace, AssembledState]

_LOG = logger_of(__name__)


def run(
    source: RunSource,
    *,
    archive: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    call: bool = False,
    **sections: Unpack[Sections],
) -> Run:
    """Run a spec.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism with its `sections`.
    archive
        File to which results are written during the run; by default, results stay in memory.
    overwrite
        Whether an existing archive may be replaced.
    progress
        Called with the time reached and the end time [s], several times per second; for the comparison runs of a check,
        the time starts again from the beginning. If it raises KeyboardInterrupt, the run ends as after Ctrl-C, with the
        status ``interrupted``. If it raises any other exception, the archive is removed, and the exception is passed
        on. By default, notebooks show a progress bar.
    call
        Whether the Python functions that controllers of the spec name may be called. They can execute any code.
    **sections
        Sections of the spec, such as ``integrator={"name": "gauss", "stages": 2}``; they replace those of `source`.

    Returns
    -------
    Run
        The results. If the run stopped early, `Run.status` and `Run.status_reason` say why, and `Run.check` raises.
        `Run.warnings` are also printed on stderr.

    Raises
    ------
    SpecError
        If the input is wrong or the joints cannot be assembled; no file is left behind.
    ResourceError
        If the archive does not fit into the free space of its disk or of memory, or cannot be written.
    PluginError
        If a plugin fails. If a third-party integrator fails in its steps, the run instead ends with the status
        ``failed``.

    Examples
    --------
    >>> import mbdkit
    >>> run = mbdkit.run("pendulum", integrator={"name": "gauss", "stages": 3}, time={"end": 1.0, "step": 0.01})
    >>> run.status
    'complete'
    >>> run.misalignment_max < 1e-9
    True
    """
    path = None if archive is None else Path(archive)
    is_shown = progress is None and in_notebook()
    is_plain = type(source) is dict and path is None and progress is None and not (is_shown or call)
    if is_plain and not _LOG.isEnabledFor(logging.INFO):
        from mbdkit.runs.repeated_runs import repeated_run

        again = repeated_run({**source, **sections}, load_spec)  # type: ignore[dict-item]
        if again is not None:
            return again
    spec = load_spec(source, (), **sections)
    with progress_bar(spec.title or spec.model_item.name, quiet=not is_shown) as bar, calls_allowed(call):
        result = simulate(spec, path=path, overwrite=overwrite, progress=progress or bar)
    warn_on_stderr(result.warnings)
    return result


def simulate(
    spec: RunSpec,
    *,
    path: Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    starts: Starts | None = None,
    measures: Sequence[str] = (),
    tables: Mapping[str, ResultTable] | None = None,
) -> Run:
    """Run a validated spec; see `run`. Warnings are not printed.

    Parameters
    ----------
    path
        Final name of the archive; None to store the results in memory.
    overwrite
        Whether an existing archive may be replaced.
    progress
        See `run`.
    starts
        Cache of compiled mechanisms for further runs, if given.
    measures
        Expressions that will be evaluated for the run, in addition to the measures of the spec. The integrals over time
        and extrema that they contain are computed during the run; see `mbdkit.runs.integrals`.
    tables
        Tables of further results by name, which the archive stores.
    """
    begin = time.perf_counter()
    if path is not None:
        check_target(path, overwrite=overwrite)
    in_arrays = path is None and not tables
    request = Request(
        begin=begin_arrays if in_arrays else partial(begin_archive, path=path, overwrite=overwrite),
        since=begin, measured_in=measured_in, path=path, starts=starts, measures=measures,
        tables=tables or {},
    )  # fmt: skip
    return integrate_to_run(spec, request, progress)


computed_run(simulate)


def simulate_arrays(spec: RunSpec, *, starts: Starts | None = None, measures: Sequence[str] = ()) -> FinishedRun:
    """Run a validated spec without writing an archive, and return its arrays with the hash that the archive would have.

    Parameters
    ----------
    starts, measures
        See `simulate`.
    """
    request = Request(
        begin=begin_arrays, since=time.perf_counter(), measured_in=measured_in, starts=starts, measures=measures,
        becomes_run=False,
    )  # fmt: skip
    finished = _integrate(spec, request, None)
    assert isinstance(finished, FinishedRun)
    return finished


def integrate_to_run(spec: RunSpec, request: Request, progress: Progress | None = None) -> Run:
    """Integrate a spec from its start, or from a checkpoint, to its end, and return the run."""
    run = _integrate(spec, request, progress)
    assert isinstance(run, Run)
    return run


def start_run(spec: RunSpec, request: Request, choice: Choice | None = None) -> SimulatedRun:
    """Return the simulation of a spec; `choice` says how method and step were chosen, and is None if the user gave
    them.
    """
    method = make_method(spec)
    check_jumps(spec)
    if spec.gradients:
        higher_layers.check_gradients(spec, method)
    cautions = findings("spec", spec, request.measures)
    _log(cautions)
    setup = RunSetup.of(spec, request.starts, method=method)
    mechanism = setup.workspace.mechanism
    setup.require_support()
    moves = findings("start", spec, setup.start)
    _log(moves)
    if _LOG.isEnabledFor(logging.DEBUG):
        _LOG.debug("mechanism: %s; start: %s", mechanism.freedoms(), setup.start.describe())
    if not request.is_open:
        check_disk_space(spec, mechanism, request.path)
    noted: list[bool] = []
    noting = nullcontext if request.begin is begin_arrays else interrupts_noted
    with noting(lambda: noted.append(True)):  # otherwise the archive could not be removed after Ctrl-C
        simulation = SimulatedRun(RunRecord(setup, request, (*cautions, *moves)), choice)
    if noted:
        simulation.interrupt()
    return simulation


def _integrate(spec: RunSpec, request: Request, progress: Progress | None) -> Run | FinishedRun:
    method = "the method is chosen during the run" if spec.choose == "method" else spec.integrator_item.id
    if _LOG.isEnabledFor(logging.INFO):
        _LOG.info("run %s begins: %s with %s", spec.run_id(), spec.model_item.id, method)
    check_calls(spec)
    with one_thread_of_linear_algebra():
        if spec.is_to_be_chosen:
            return _integrate_accurately(spec, request, progress)
        with _integrated(start_run(spec, request), progress) as simulation:
            return simulation.conclude()


def _integrate_accurately(spec: RunSpec, request: Request, progress: Progress | None) -> Run | FinishedRun:
    """Choose method and step for the requested accuracy of a spec, and repeat the run with smaller steps or tolerances
    until it reaches the accuracy.

    If no attempt reaches the accuracy, the best one is returned, and its verdict says so.
    """
    from mbdkit.runs.accuracy.chosen_method import choose_method

    check_jumps(spec)
    workspace, _ = build(spec)
    choice = choose_method(spec, workspace, progress)
    tried: list[tuple[tuple[float, float], Choice]] = []
    while True:
        with _integrated(start_run(choice.applied_to(spec), request, choice), progress) as simulation:
            tried.append((simulation.merit(), choice))
            best = max(tried, key=lambda attempt: attempt[0])[1]
            following = None if simulation.is_final else _following(spec, workspace, simulation, len(tried))
            simulation.tried = [attempted for _, attempted in tried]
            if simulation.is_final or (following is None and best is choice):
                return simulation.conclude()
        if following is None:
            # Only one archive is written at a time, so that the best attempt has to be repeated. Equal settings give
            # equal results.
            with _integrated(start_run(best.applied_to(spec), request, best), progress) as simulation:
                simulation.tried = [attempted for _, attempted in tried]
                return simulation.conclude()
        choice = following


def _following(spec: RunSpec, workspace: Workspace, simulation: SimulatedRun, attempts: int) -> Choice | None:
    from mbdkit.runs.accuracy.chosen_method import MOST_ATTEMPTS, other_method

    choice = simulation.choice
    assert spec.accuracy is not None
    assert choice is not None
    if choice.limited:
        return None if math.isnan(simulation.reached) else other_method(spec, workspace, choice)
    return None if attempts >= MOST_ATTEMPTS else choice.tightened(spec, spec.accuracy, simulation.reached)


def measured_in(expressions: Sequence[str], spec: RunSpec) -> Sequence[float] | None:
    """Return the values of expressions in a comparison run, in SI units; None if the run fails."""
    try:
        run = Run(ArrayContents(simulate_arrays(spec, measures=expressions), spec))
        return [MeasureExpression.in_si(text, run) for text in expressions] if run.status == "complete" else None
    except (MbdkitError, ArithmeticError):
        return None


def _log(found: Iterable[Finding]) -> None:
    for warning in found:
        _LOG.warning("%s", shown(warning))


@contextmanager
def _integrated(simulation: SimulatedRun, progress: Progress | None) -> Iterator[SimulatedRun]:
    """Integrate a simulation, and remove its archive if it is not finished; handle Ctrl-C by ending the run.

    Without a run, whose rows would be of use, Ctrl-C raises KeyboardInterrupt.
    """
    try:
        noting = interrupts_noted if simulation.request.becomes_run else nullcontext
        with noting(simulation.interrupt):
            simulation.integrate(progress)
            yield simulation
    except BaseException as error:
        _LOG.warning("run %s is abandoned: %s", simulation.spec.run_id(), one_line(error))
        raise
    finally:
        simulation.record.writer.abandon()
