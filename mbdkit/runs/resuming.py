"""Continues a killed or interrupted run from the checkpoint beside its archive, with bitwise identical results.

The rows up to the checkpoint are copied into a new file. The old file is not modified: after a crash, HDF5 may not know
all parts of the file that are in use. The new file takes the place of the ``.part`` of a killed run before the first
step, and that of the archive of an interrupted run at its end.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

from mbdkit.archive.archive_check import check
from mbdkit.archive.checkpoint import Checkpoint
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.missing_plugins import check_plugins_of
from mbdkit.archive.part_file import SUFFIX, check_target, checkpoint_path, part_path
from mbdkit.archive.part_stream import complete_flush
from mbdkit.archive.reader import load
from mbdkit.archive.recorded_data import outputs_by_sample
from mbdkit.archive.run import Run
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base import file_locks
from mbdkit.base.called_functions import Returned, calls_allowed, returning
from mbdkit.base.errors import ArchiveError, ResourceError, SpecError
from mbdkit.base.files import check_regular, rename_new, replace_file
from mbdkit.base.files_read import only_known
from mbdkit.base.logs import warn_on_stderr
from mbdkit.base.progress_bars import in_notebook, progress_bar
from mbdkit.base.terminal import command_line
from mbdkit.base.text import listed, shown
from mbdkit.quantities.registered_kinds import kind_of_group
from mbdkit.runs.preparation import RunSetup, check_calls, make_method
from mbdkit.runs.provenance import DECIDE_LAST_BITS, provenance
from mbdkit.runs.recorded_states import ObservedRows
from mbdkit.runs.run_checkpoint import INTERVAL, why_without
from mbdkit.runs.run_record import Continuation, Request, begin_archive
from mbdkit.runs.run_seams import Progress
from mbdkit.runs.simulation import integrate_to_run, measured_in
from mbdkit.spec import RunSpec, load_spec

PART = f"{SUFFIX}.part"

_ANEW = "run it anew"


def resume(
    part: str | Path,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    files: bool = False,
    call: bool = False,
) -> Run:
    """Continue a run that was killed or interrupted, from the last checkpoint beside its archive.

    The spec is read from the checkpoint. The results are bitwise identical to those of an uninterrupted run.

    - `part`: the unfinished archive of a killed run, ``FILE.h5.part``, which has its checkpoint,
      ``FILE.h5.part.checkpoint``, beside it; or the archive of an interrupted run, ``FILE.h5``, with
      ``FILE.h5.checkpoint``.
    - `overwrite`: whether an existing ``FILE.h5`` may be replaced, as the archive of an interrupted run is at the end.
    - `progress`: see `mbdkit.run`. If this function raises an exception, the file and its checkpoint are kept.
    - `files`: whether files that the spec names may be read, such as a model of another program; they must have the
      SHA-256 that the checkpoint lists.
    - `call`: whether the Python functions that controllers of the spec name may be called.

    Returns the results, in ``FILE.h5``. Raises SpecError if the run cannot be continued: a file is damaged, there is no
    checkpoint, or another version of mbdkit or of a plugin wrote it. The files remain as they are. Raises ResourceError
    if the run is still in progress, or a file cannot be read, written or renamed.
    """
    quiet = progress is not None or not in_notebook()
    with calls_allowed(call), progress_bar(Path(part).stem, quiet=quiet) as bar:
        result = continue_run(Path(part), overwrite=overwrite, progress=progress or bar, files=files)
    warn_on_stderr(result.warnings)
    return result


def continue_run(
    part: Path,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    measures: Sequence[str] = (),
    files: bool = False,
) -> Run:
    """Continue a run; see `resume`. The `measures` must be those with which it began; see `simulate`."""
    path = final_path(part)
    with only_known((), allowed=False):
        if path == part:
            _check_interrupted(part, overwrite=overwrite)
        check_target(path, overwrite=overwrite)
        _finish_replacement(part)
        complete_flush(part)
    with _held(part) as stream:
        if (checkpoint := Checkpoint.of(part)) is None:
            with only_known((), allowed=False):
                return _renamed(part, path, overwrite)
        with only_known(checkpoint.files, allowed=files):
            return _Unfinished(part, checkpoint, path, overwrite, stream).continued(progress, measures)


def final_path(part: Path) -> Path:
    """Return the final name of an unfinished archive, or the archive of an interrupted run itself.

    Raises SpecError if `part` is not such a name or does not exist.
    """
    is_unfinished = part.name.endswith(PART) and part.name != PART
    if not is_unfinished and part.suffix != SUFFIX:
        raise SpecError(
            "only an archive can be resumed: FILE.h5.part of a killed run, FILE.h5 of a stopped one", file=part
        )
    if not part.exists():
        other = part.with_suffix("") if is_unfinished else part_path(part)
        what = "the run has ended, and {} is its archive" if is_unfinished else "the run was killed and has left {}"
        raise SpecError(f"there is no such file{f'; {what.format(other.name)}' if other.exists() else ''}", file=part)
    if part.is_dir():
        raise SpecError("this is a folder; name the archive of a run", file=part)
    check_regular(part)
    return part.with_suffix("") if is_unfinished else part


def _check_interrupted(path: Path, *, overwrite: bool) -> None:
    """Raise SpecError unless `path` is the archive of an interrupted run with its checkpoint, and may be replaced."""
    left = part_path(path)
    if left.is_file() and checkpoint_path(left).is_file():  # of this run, resumed and killed, or of another one
        with _held(left):
            message = f"a later run was killed and has left {left.name}; resume that file, or remove it"
            raise SpecError(message, file=path)
    with load(path) as run:
        if run.status == "complete":
            hint = "to simulate a longer time, run its spec with another time.end"
            raise SpecError(f"this run is complete, so there is nothing to resume; {hint}", file=path)
        if run.status != "interrupted" or not run.spec_kind.is_integrated:
            raise _refused(path, f"it was not interrupted but has ended with the status {run.status}")
        if (checkpoint := Checkpoint.of(path)) is None:
            spec = _same_spec(path, run.spec_json, run.run_id, run.provenance)
            missing = f"its checkpoint {checkpoint_path(path).name} is not in the same folder"
            raise _refused(path, why_without(spec, make_method(spec)) or missing)
        if checkpoint.head["run_id"] != run.run_id:
            raise _refused(path, f"{checkpoint_path(path).name} belongs to another run")
    if not overwrite:
        raise SpecError("at its end, the resumed run replaces this file; allow this with --overwrite", file=path)


@contextlib.contextmanager
def _held(part: Path) -> Iterator[BinaryIO]:
    """Lock a ``.part`` against runs that would replace it, and yield it as an open file.

    Raises ResourceError if it cannot be read, or if a run is still writing it.
    """
    try:
        stream = os.fdopen(file_locks.open_file(part, os.O_RDONLY), "rb")
    except OSError as error:
        raise ResourceError(f"it cannot be read: {error.strerror}", file=part) from error
    with stream:
        try:
            file_locks.lock(stream.fileno(), shared=True)
        except BlockingIOError:
            raise _still_going(part) from None
        except OSError:
            pass  # the file system does not support locks
        yield stream


def _replacement(part: Path) -> Path:
    return part.with_name(f"{part.name.removesuffix('.part')}.resumed.part")


def _finish_replacement(part: Path) -> None:
    """Rename the new file of a resumed run if the run was killed when only the checkpoint had been renamed."""
    new = _replacement(part)
    if not new.is_file():
        return
    if (checkpoint := Checkpoint.of(part)) is not None and checkpoint.file == new.stat().st_ino:
        with _held(new):
            replace_file(new, part)


def _still_going(part: Path) -> ResourceError:
    return ResourceError("a run is still writing this file, so there is nothing to resume", file=part)


def _refused(part: Path, why: str, *, hint: str = _ANEW) -> SpecError:
    return SpecError(f"this run cannot be resumed: {why}; {hint}", file=part)


def _renamed(part: Path, path: Path, overwrite: bool) -> Run:
    """Rename the archive of a run that was killed after its end, and return the run.

    Raises SpecError if the run had not ended, or its archive is damaged. Raises ResourceError if the archive cannot be
    renamed.
    """
    with load(part) as run:
        if run.status == "running":
            spec = _same_spec(part, run.spec_json, run.run_id, run.provenance)
            why = why_without(spec, make_method(spec))
            missing = f"its checkpoint {checkpoint_path(part).name} is not in the same folder"
            first = f"the first one is written after {INTERVAL:g} s of steps"
            raise _refused(part, why or f"{missing} (a run may also end before it has one: {first})")
    if problems := check(part):
        message = f"this run cannot be resumed: it has ended, but its archive is damaged ({problems[0]}); {_ANEW}"
        raise ArchiveError(message, file=part)
    try:
        (replace_file if overwrite else rename_new)(part, path)
    except OSError as error:
        raise ResourceError(f"it cannot be renamed to {path.name} ({error.strerror})", file=part) from error
    return load(path)


def _same_spec(part: Path, spec_json: str, run_id: str, then: Mapping[str, object]) -> RunSpec:
    """Return the spec of a run; raise SpecError if the run began with other versions of software.

    Its results might then differ from those of an uninterrupted run.
    """
    check_plugins_of(part, then)
    try:
        spec = load_spec(json.loads(spec_json))
    except SpecError as error:
        raise error.located(file=part) from error
    except ValueError:
        raise _refused(part, "its spec is damaged") from None
    now = provenance(spec)
    keys = [*DECIDE_LAST_BITS, *(key for key in now if key.endswith(("_distribution", "_version", "_digest")))]
    if other := [(key, then.get(key), now[key]) for key in keys if str(then.get(key)) != str(now[key])]:
        changes = [f"{_word(key, now)} {shown(str(old))}, now {new}" for key, old, new in other]
        same = "use such a processor" if [key for key, *_ in other] == ["processor"] else "install the same"
        raise _refused(part, f"it began with {listed(changes, 'and')}", hint=f"{same}, or {_ANEW}")
    if spec.run_id() != run_id:
        raise _refused(part, "this version interprets its spec differently")
    return spec


class _Unfinished:
    """An unfinished run that is continued from its checkpoint.

    `path`: final name of the archive. `stream`: the open ``.part``, from which the rows are read. It also shows whether
    another file has replaced the ``.part`` in the meantime.
    """

    def __init__(self, part: Path, checkpoint: Checkpoint, path: Path, overwrite: bool, stream: BinaryIO):
        self.part, self.path, self.overwrite, self.stream = part, path, overwrite, stream
        self.checkpoint = checkpoint

    @property
    def has_ended(self) -> bool:
        """Whether the file is the archive of a run that was interrupted, not that of a killed run."""
        return self.part == self.path

    def continued(self, progress: Progress | None, measures: Sequence[str] = ()) -> Run:
        """Continue the run to its end."""
        head = self.checkpoint.head
        spec = _same_spec(self.part, head["spec"], head["run_id"], head["provenance"])
        if why := why_without(spec, make_method(spec)):
            raise _refused(self.part, why)
        writers: list[ArchiveWriter] = []

        def begin(setup: RunSetup) -> ArchiveWriter:
            writers.append(self._writer(setup))
            try:
                self._copy(writers[0])
            except BaseException:
                writers[0].abandon()
                raise
            return writers[0]

        def restored() -> None:
            if file_locks.IS_WINDOWS:
                self.stream.close()  # Windows cannot replace an open file
            if not self.has_ended:
                writers[0].take_place_of(self.part)
            self.stream.close()

        continuation = Continuation(self.checkpoint.state, self._observed, restored)
        try:
            check_calls(spec)
            with returning(self._returned()):
                request = Request(
                    begin=begin, since=time.perf_counter(), measured_in=measured_in, measures=measures,
                    continuation=continuation,
                )  # fmt: skip
                return integrate_to_run(spec, request, progress)
        except SpecError as error:
            raise error.located(file=self.part) from error

    def _writer(self, setup: RunSetup) -> ArchiveWriter:
        then, part = self.checkpoint.head["provenance"], None if self.has_ended else _replacement(self.part)
        origin = {**then, "resumed": int(then.get("resumed", 0)) + 1, "resumed_by": command_line()}
        writer = begin_archive(setup, path=self.path, overwrite=self.overwrite, part=part, origin=origin)
        # Another call may have resumed and finished the run after this call opened the file.
        if not file_locks.has_name(self.stream.fileno(), self.part):
            writer.abandon()
            raise _still_going(self.part)
        return writer

    def _copy(self, writer: ArchiveWriter) -> None:
        with reading("its rows", self.part, hint=_ANEW):
            writer.copy_rows(self.checkpoint, self.stream)
        if writer.lines != self.checkpoint.lines:
            raise _refused(self.part, "it is damaged: its rows do not match its checkpoint")
        writer.keep_checkpoint(self.checkpoint.state)

    def _returned(self) -> Returned | None:
        """Return what functions of controllers have returned so far; None without such controllers."""
        if "samples/value" not in self.checkpoint.arrays:
            return None
        rows, known = slice(0, self.checkpoint.rows["sample"]), kind_of_group("samples").by_path
        with reading("its samples", self.part, hint=_ANEW):
            times, outputs, values = (
                self.checkpoint.arrays[path].read(self.stream, known[path], rows).tolist()
                for path in ("samples/time", "samples/output", "samples/value")
            )
        return outputs_by_sample(times, outputs, values)

    def _observed(self) -> list[ObservedRows]:
        paths = (
            "trajectory/time", "trajectory/position", "trajectory/velocity",
            "joints/reaction_force", "joints/reaction_torque",
        )  # fmt: skip
        arrays, rows = self.checkpoint.arrays, slice(0, self.checkpoint.rows["time"])
        with reading("its rows", self.part, hint=_ANEW):
            known = {path: kind_of_group(path.partition("/")[0]).by_path[path] for path in paths}
            return [ObservedRows(*(arrays[path].read(self.stream, array, rows) for path, array in known.items()))]


def _word(key: str, provenance: Mapping[str, object]) -> str:
    kind, _, part = key.rpartition("_")
    if part == "version":
        return f"{provenance[kind]} {part}"
    if part == "digest":
        return f"{provenance[kind]} with the digest"
    return str(provenance[kind]) + " from" if part == "distribution" else key
