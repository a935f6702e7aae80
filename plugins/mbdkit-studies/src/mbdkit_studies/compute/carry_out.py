"""The functions `study`, `ensemble` and `load_study`, which run studies and open their folders."""

from __future__ import annotations

import json
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from mbdkit.archive.missing_plugins import missing_plugins
from mbdkit.archive.reader import load
from mbdkit.base.called_functions import calls_allowed
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.interrupts import interrupts_noted
from mbdkit.base.logs import logger_of
from mbdkit.base.plain_data import plain, value_text
from mbdkit.base.progress_bars import count_bar, in_notebook
from mbdkit.base.terminal import say
from mbdkit.base.text import counted, shown
from mbdkit.runs.preparation import check_calls
from mbdkit.spec.loading import RunSource, load_spec, read_source
from mbdkit.spec.reading import parse_key
from mbdkit_studies.compute.added_methods import MethodSource, with_methods
from mbdkit_studies.compute.executor_pool import Engine
from mbdkit_studies.compute.run_blocks import RunBlocks
from mbdkit_studies.compute.run_files import RunFiles
from mbdkit_studies.folder import member_table
from mbdkit_studies.folder.folder_lock import Shard, alone
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.points.sampled_values import with_sample_values
from mbdkit_studies.spec.study_loading import StudySource, load_study_spec
from mbdkit_studies.spec.study_spec import Storing, StudySpec
from mbdkit_studies.store import study_index
from mbdkit_studies.store.storage import with_store
from mbdkit_studies.study import Study
from mbdkit_studies.texts import without_numbers

RunStores = RunFiles | RunBlocks

_LOG = logger_of(__name__)

#: Function called with the number of computations that are done, their total number, and the number of failed runs. A
#: run, a second run and a repeated timing count as one computation each.
Progress = Callable[[int, int, int], None]


class _TemporaryFolder:
    """A folder that is deleted together with this object, or at the end of the process.

    `tempfile.TemporaryDirectory` would issue a ResourceWarning, because studies are not closed explicitly.
    """

    def __init__(self) -> None:
        self.path = tempfile.mkdtemp(prefix="mbdkit-study-")
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


def load_study(folder: str | Path) -> Study:
    """Open the folder of a study without computing anything.

    Parameters
    ----------
    folder
        Folder that was written by `study` or ``mbdkit study``.

    Raises
    ------
    SpecError
        If the folder contains no study with an index.

    Examples
    --------
    >>> import mbdkit
    >>> study = mbdkit.study(
    ...     {"mbdkit_study": 1, "base": "pendulum", "axes": [{"time.step": [0.02, 0.01]}]}, out="steps"
    ... )
    >>> len(mbdkit.load_study("steps").points)
    2
    """
    return Study(folder)


def study(
    source: StudySource,
    *,
    out: str | Path | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    shard: Shard | None = None,
    progress: Progress | None = None,
    notify: Callable[[str], None] = say,
    assignments: Sequence[str] = (),
    with_: Sequence[MethodSource] | MethodSource = (),
    overwrite: bool = False,
    store: Storing | None = None,
    call: bool = False,
    quick: bool = False,
) -> Study:
    """Run a study: compute the runs that are missing in its folder.

    Parameters
    ----------
    source
        Name of a packaged study, path of a file, mapping, or `StudySpec`.
    out
        Folder of the study; by default a temporary one that is deleted with the returned study.
    workers
        Number of processes that compute in parallel.
    executor
        A `concurrent.futures.Executor` to use instead of these processes, such as ``client.get_executor()`` of Dask, or
        an executor of submitit. Its workers must see the folder under the same path. If it breaks, as a
        `ProcessPoolExecutor` does when a process dies, local processes compute the remaining runs.
    shard
        Part of the study to compute; by default all of it.
    progress
        Called with three numbers after each task: the number of computations that are done, their total number, and the
        number of failed runs. A run, a second run and a repeated timing count as one computation each. By
        default, notebooks show a progress bar.
    notify
        Called with messages for the user, such as warnings.
    assignments
        Assignments such as ``"time.end=5"`` that are set in the base of every run.
    with_
        Further methods for a study that compares methods: names of integrators, or mappings of a name and options, such
        as ``{"name": "gauss", "stages": 4}``. Each is one more value on every axis of methods, with the formulation of
        the study or the first of its claims that suits the mechanisms. Where the study varies the step, an adaptive
        method has a family of its own, with tolerances in place of steps.
    overwrite
        Whether to replace an earlier study in the folder: its study.yaml, index, table of values, archives of runs,
        report and charts are removed once the new study has been validated. Other files remain.
    store
        What is stored of each run, in place of `store` in the study spec: an archive for each run (``files``) or, in
        files of many runs, ``all`` arrays, ``histories``, a ``summary`` or ``hashes``.
    call
        Whether the Python functions that controllers of the specs name may be called. They can execute any code.
    quick
        Whether to run the short form of a packaged study that has one, such as ``methods``.

    Returns
    -------
    Study
        The study with its index. Failed runs do not raise an error; they are part of the results. A run for which a
        resource is not available, such as disk space, is missing; `Study.unfinished` has the reasons.

    Raises
    ------
    SpecError
        If an argument, the study or one of its runs is invalid, if a method cannot be added, or if the folder belongs
        to another study or contains other files. Nothing is written in this case. If runs are stored in files of many
        runs, up to eight of them are checked beforehand; any other invalid run counts as a failed run.
    ResourceError
        If the folder cannot be written to, is in use by another call, or no process can be started.

    Examples
    --------
    >>> import mbdkit
    >>> study = mbdkit.study(
    ...     {
    ...         "mbdkit_study": 1,
    ...         "base": "pendulum",
    ...         "overrides": {"time": {"end": 1.0, "step": 0.01}},
    ...         "axes": [{"integrator": [{"name": "rk4"}, {"name": "gauss"}]}, {"time.step": [0.02, 0.01]}],
    ...     },
    ...     out="methods",
    ... )
    >>> [point.status for point in study.points]
    ['complete', 'complete', 'complete', 'complete']
    """
    engine = Engine.of(workers, executor)
    if overwrite and shard is not None:
        message = "--overwrite cannot be combined with --shard: it would remove the results of calls for other parts"
        raise SpecError(message)
    spec = with_methods(load_study_spec(source, assignments, quick=quick), with_, notify)
    spec = spec if store is None else spec.stored_as(store)
    with calls_allowed(call):
        return _carried_out(spec, out, engine, shard, progress, notify, overwrite=overwrite)


def ensemble(
    source: RunSource,
    variables: Mapping[str, object],
    *,
    store: Storing = "summary",
    out: str | Path | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    measures: object = "all",
    block: int | None = None,
    compress: bool = False,
    progress: Progress | None = None,
    notify: Callable[[str], None] = say,
    overwrite: bool = False,
) -> Study:
    """Run one spec with many values of some of its keys, and store the results in blocks.

    Parameters
    ----------
    source
        The spec: a file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism.
    variables
        (N,) values by key of the spec, such as ``model.angles.0``: numbers or texts. Run i has the values at index i.
    store
        What is stored of each run: ``all`` arrays, ``histories``, a ``summary`` or ``hashes``; ``files`` writes an
        archive of each run beside a summary. In all cases, `Study.remake` can compute a run again and verify that it is
        bitwise identical.
    out
        Folder of the study; by default a temporary one that is deleted with the returned study. A second call with the
        same arguments computes only what is missing in it.
    workers
        Number of processes that compute in parallel.
    executor
        Executor to use instead of these processes; see `study`.
    measures
        Measures to compute, as in a study spec.
    block
        Number of runs in a block; by default an eighth of all runs, from 64 to 1000, or fewer if arrays are large.
        Studies of more than 20,000 runs have larger blocks, of up to 5000 runs.
    compress
        Whether arrays are compressed.
    progress, notify, overwrite
        See `study`.

    Returns
    -------
    Study
        The study, whose points are the runs in the order of the values. Runs that fail, or whose spec is not valid with
        their values, do not raise an error; they are part of the results.

    Raises
    ------
    SpecError
        If the spec, a key or the values are invalid, or the folder belongs to another study. Nothing is written in this
        case.
    ResourceError
        If the folder cannot be written to, is in use by another call, or no process can be started.

    Examples
    --------
    >>> import mbdkit
    >>> import numpy as np
    >>> pendulum = {
    ...     "mbdkit": 1,
    ...     "model": {"name": "double-pendulum"},
    ...     "integrator": {"name": "rk4"},
    ...     "time": {"end": 0.5, "step": 0.01},
    ... }
    >>> study = mbdkit.ensemble(pendulum, {"model.angles.0": np.linspace(-1.0, 1.0, 5)}, store="hashes")
    >>> study.to_frame()["status"].tolist()
    ['complete', 'complete', 'complete', 'complete', 'complete']
    >>> float(study.remake(4).bodies["rod1"].angle[0])
    1.0
    """
    columns = _columns_of(variables)
    keys = {"block": block, "compress": compress or None, "measures": None if measures == "all" else measures}
    spec = _spec_of(source, columns, store, {name: value for name, value in keys.items() if value is not None})
    engine = Engine.of(workers, executor)
    return _carried_out(load_study_spec(spec), out, engine, None, progress, notify, overwrite=overwrite)


def _carried_out(
    spec: StudySpec,
    out: str | Path | None,
    engine: Engine,
    shard: Shard | None,
    progress: Progress | None,
    notify: Callable[[str], None],
    *,
    overwrite: bool,
) -> Study:
    """Compute the missing runs of a study, in a temporary folder unless `out` is given, and open the study."""
    keep = None
    if out is None:
        keep = _TemporaryFolder()
        out = keep.path
    folder = StudyFolder(Path(out))
    spec = with_sample_values(spec, folder, overwrite=overwrite)
    spec = with_store(spec, folder, overwrite=overwrite)
    try:
        with count_bar(spec.title or folder.path.name, quiet=progress is not None or not in_notebook()) as bar:
            store: RunStores = (RunBlocks if spec.in_blocks else RunFiles)(spec, folder)
            folder.check(spec, overwrite=overwrite)
            for _, checked in store.plan.validated:
                check_calls(checked)
                if spec.in_blocks and spec.store == "files" and checked.limits.wall_time is not None:
                    message = "writes archives of runs that are computed twice, which `limits.wall_time` ends at"
                    raise SpecError(
                        f"{message} different times; leave the limit out, or choose another store", key="store"
                    )
            _LOG.info("study in %s begins: %s", shown(folder.path), counted(store.count, "run"))
            of_sample = store.plan.warnings_of_sample()

            def notify_unless_told(text: str) -> None:
                if without_numbers(text.removeprefix("warning: ")) not in of_sample:
                    notify(text)

            for warning in (*of_sample.values(), *store.plan.notes()):
                _LOG.warning("%s", warning)
                notify(f"warning: {warning}")
            if overwrite:
                folder.clear()
            _execute(store, engine, shard, progress or bar, notify_unless_told)
            _LOG.info("study in %s ends: %d computed, %d failed", shown(folder.path), store.computed, store.failed)
    except SpecError as error:
        raise _advised(error, sorted(folder.path.glob("runs/*.h5"))) from None
    return Study(folder.path, computed=store.computed, unfinished=store.unfinished, keep=keep)


def _execute(
    store: RunStores, engine: Engine, shard: Shard | None, progress: Progress | None, notify: Callable[[str], None]
) -> None:
    """Compute the missing runs of a study and write the index; after Ctrl-C, the index contains the results so far."""
    folder = store.folder
    folder.prepare(store.spec)
    with folder.locked(shard):
        total, ended = store.begin(shard, notify), 0  # ended: runs planned for this round and the rounds before
        try:
            for some in store.rounds():
                ended += some.planned
                done = ended - sum(task.runs for task in some.tasks)  # planned runs without a task count as done
                with (Engine() if some.one_by_one else engine).pool(notify) as pool:
                    for task, outcome in pool.work(some.tasks):
                        store.note(task, outcome)
                        done += task.runs
                        if progress is not None:
                            progress(done, total, store.failed)
        finally:
            with interrupts_delayed(), alone(folder.spec):  # other calls may write the index
                study_index.write(folder.index, store.spec, store.index())


def _spec_of(
    source: RunSource, columns: dict[str, np.ndarray], store: Storing, keys: Mapping[str, object]
) -> StudySpec:
    """Return the spec of a study that runs one spec with the values of a table."""
    document = read_source(source)
    base = plain(document.data)
    whole = json.loads(load_spec(document).canonical_json())
    for key in columns:
        _complete(base, whole, key)
    _, digest = member_table.image(columns)
    members = {"runs": len(next(iter(columns.values()))), "sha256": digest}
    spec = StudySpec(mbdkit_study=1, base=base, store=store, members=members, **keys)
    spec._columns = columns
    return spec


def _complete(base: dict[str, object], whole: Mapping[str, object], key: str) -> None:
    """Make sure that a spec has the mapping or list in which a key is set; add it with its default values if not."""
    there: object = base
    default: object = whole
    for part in parse_key(key)[:-1]:
        if not isinstance(there, dict) or not isinstance(default, Mapping) or part not in default:
            return  # setting the value will raise the error
        if there.get(str(part)) is None:
            there[str(part)] = default[part]
        there, default = there[str(part)], default[part]


def _columns_of(variables: Mapping[str, object]) -> dict[str, np.ndarray]:
    """Return the values of variables as columns of floats, integers or texts."""
    columns = {}
    for key, values in variables.items():
        column = np.asarray(values)
        kind = {"U": str, "S": str, "i": np.int64, "u": np.int64, "f": np.float64}.get(column.dtype.kind)
        if kind is None:
            raise SpecError(f"needs an array of numbers or of texts, not {value_text(values)}", key=f"variables: {key}")
        if column.ndim != 1 or not len(column):
            raise SpecError(f"needs an array (N,), not one of the shape {column.shape}", key=f"variables: {key}")
        columns[str(key)] = column.astype(kind).astype(object) if kind is str else column.astype(kind)
    lengths = {key: len(column) for key, column in columns.items()}
    if len(set(lengths.values())) != 1:
        told = ", ".join(f"{key} has {length}" for key, length in lengths.items()) or "there are none"
        raise SpecError(f"the variables need the same number of values, one for each run; {told}")
    return columns


def _advised(error: SpecError, archives: Iterable[Path]) -> SpecError:
    """Return `error`, with installation advice if it names a missing plugin that was used to create one of the
    archives.
    """
    if "there is no " not in error.message:
        return error
    for path in archives:
        try:
            with load(path) as run:
                missing = missing_plugins(run.provenance)
        except (MbdkitError, OSError):
            continue
        for needed in missing:
            if any(f"'{name}'" in error.message for name in (needed.id, needed.id.partition(":")[2])):
                hint = f"; {path.name} was made with it: {needed.advice}"
                return SpecError(error.message + hint, key=error.key, file=error.file, line=error.line)
    return error


@contextmanager
def interrupts_delayed() -> Iterator[None]:
    """Delay the KeyboardInterrupt of Ctrl-C, SIGTERM or SIGHUP to the end of a block; a second SIGTERM ends the
    process.
    """
    noted: list[bool] = []
    with interrupts_noted(lambda: noted.append(True)):
        yield
    if noted:
        raise KeyboardInterrupt
