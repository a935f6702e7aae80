"""Continues a run that was killed, from the last checkpoint in its ``.part``, to the same bits.

The rows up to the checkpoint are copied into a new file, which then takes the place of the ``.part``. The old file is
not written to: after a crash, HDF5 may not know all places in it that are in use.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shlex
import shutil
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.archive_check import check
from mbdkit.archive.checkpoint import Checkpoint, checkpoints, found_in
from mbdkit.archive.fingerprint import line, spec_sha256, text_bytes
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.missing_plugins import check_plugins_of
from mbdkit.archive.part_file import SUFFIX, check_target
from mbdkit.archive.reader import load
from mbdkit.archive.run import Run
from mbdkit.archive.stranger_file import check_regular
from mbdkit.archive.writer import ROWS_COPIED, ArchiveWriter, stored_rows
from mbdkit.base.errors import ResourceError, SpecError
from mbdkit.base.files import rename_new
from mbdkit.base.progress_bars import in_notebook, progress_bar
from mbdkit.base.text import listed, shown
from mbdkit.engine.assembly import AssembledState
from mbdkit.engine.workspace import Workspace
from mbdkit.methods.kinds import Method
from mbdkit.runs.preparation import make_method, optional_arrays
from mbdkit.runs.provenance import provenance
from mbdkit.runs.recorded_columns import ObservedRows
from mbdkit.runs.recorder import archive_names, shared_forces
from mbdkit.runs.run_checkpoint import INTERVAL, Continuation, why_without
from mbdkit.runs.simulated_run import Progress
from mbdkit.runs.simulation import simulate_on
from mbdkit.spec import RunSpec, load_spec
from mbdkit.stepping.warm_up import to_stderr

PART = f"{SUFFIX}.part"

_NEEDED = ("mbdkit", "numpy", "scipy", "numba", "llvmlite", "processor")
"""Entries of the provenance that must be the same for the same bits, besides the plugins."""

_ANEW = "run it anew"


def resume(part: str | Path, *, overwrite: bool = False, progress: Progress | None = None) -> Run:
    """Continue a run that was killed, from the last checkpoint in the file that it left.

    The spec is the one in the file. The result has the bits of the run that nobody disturbed.

    Parameters
    ----------
    part
        The unfinished archive, ``FILE.h5.part``.
    overwrite
        Whether an existing ``FILE.h5`` may be replaced.
    progress
        As for `mbdkit.run`, except that the ``.part`` is kept if it raises an exception.

    Returns
    -------
    Run
        The results, in ``FILE.h5``.

    Raises
    ------
    SpecError
        If the run cannot be continued: the file is damaged, has no checkpoint, or was written by another version of
        mbdkit or of a plugin. It remains as it is.
    ResourceError
        If the run is still going.
    """
    with progress_bar(Path(part).stem, quiet=progress is not None or not in_notebook()) as bar:
        return continue_run(Path(part), overwrite=overwrite, progress=progress or bar)


def continue_run(
    part: Path,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    notify: Callable[[str], None] = to_stderr,
) -> Run:
    """Continue a run; see `resume`, and `mbdkit.runs.simulation.simulate` for `notify`."""
    path = check_target(final_path(part), overwrite=overwrite)
    with contextlib.ExitStack() as opened:
        handle = opened.enter_context(_held(part))
        try:
            unfinished = _Unfinished(part, opened.enter_context(load(part)), path, overwrite, handle)
            if not unfinished.has_checkpoints and unfinished.run.status != "running":
                return unfinished.renamed()
            unfinished.choose_checkpoint()
        except SpecError as damage:
            copy = opened.enter_context(_repaired(part, path, damage))
            unfinished = _Unfinished(part, opened.enter_context(load(copy)), path, overwrite, handle)
            unfinished.choose_checkpoint()
        return unfinished.continued(opened.close, progress, notify)


def final_path(part: Path) -> Path:
    """Return the final name of an unfinished archive; raise SpecError if `part` is no such name or does not exist."""
    if not part.name.endswith(PART) or part.name == PART:
        left = part.with_name(f"{part.name}.part")
        other = left.name if part.suffix == SUFFIX and left.exists() else "FILE.h5.part"
        raise SpecError(f"only the unfinished archive of a run can be resumed: name {other}", file=part)
    if not part.exists():
        ended = part.with_suffix("")
        hint = f"; the run has ended, and {ended.name} is its archive" if ended.exists() else ""
        raise SpecError(f"there is no such file{hint}", file=part)
    if part.is_dir():
        raise SpecError("this is a folder; name the unfinished archive of a run", file=part)
    check_regular(part)
    return part.with_suffix("")


@contextlib.contextmanager
def _held(part: Path) -> Iterator[int]:
    """Hold a ``.part`` against runs that would replace it; yield a handle of the file."""
    try:
        handle = os.open(part, os.O_RDONLY)
    except OSError as error:
        raise ResourceError(f"it cannot be read: {error.strerror}", file=part) from error
    try:
        if sys.platform != "win32":
            import fcntl

            try:
                fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                raise _still_going(part) from None
            except OSError:
                pass  # a file system without locks
        yield handle
    finally:
        os.close(handle)


@contextlib.contextmanager
def _repaired(part: Path, path: Path, damage: SpecError) -> Iterator[Path]:
    """Yield a copy of a damaged ``.part`` that is returned to its newest whole checkpoint; raise `damage` without one.

    A run that is killed while HDF5 rearranges its tables can leave a file that cannot be read.
    """
    found = found_in(part) if part.stat().st_size else []
    if not found:
        raise damage
    copy = path.with_name(f"{path.name}.repaired.part")
    try:
        try:
            shutil.copyfile(part, copy)
            found[0].image.write_to(copy)
        except (ValueError, zlib.error):
            raise damage from None
        except OSError as error:
            raise ResourceError(f"it cannot be copied to {copy.name} ({error.strerror})", file=part) from error
        yield copy
    finally:
        copy.unlink(missing_ok=True)


def _still_going(part: Path) -> ResourceError:
    return ResourceError("a run is still writing this file, so there is nothing to resume", file=part)


class _Unfinished:
    """The archive of a run that was killed, open for reading.

    Parameters
    ----------
    path
        Final name of the archive.
    handle
        Handle of the file `part`, by which a file is recognized that has replaced it.
    """

    def __init__(self, part: Path, run: Run, path: Path, overwrite: bool, handle: int):
        self.part, self.run, self.path, self.overwrite, self.handle = part, run, path, overwrite, handle
        self.file: h5py.File = run.file
        self.checkpoint: Checkpoint | None = None

    def refused(self, why: str) -> SpecError:
        return SpecError(f"this run cannot be resumed: {why}", file=self.part)

    @property
    def has_checkpoints(self) -> bool:
        """Whether the file has checkpoints, whole or not."""
        return layout.CHECKPOINT in self.file

    def continued(self, release: Callable[[], None], progress: Progress | None, notify: Callable[[str], None]) -> Run:
        """Continue the run to its end; call `release` when the old file is no longer needed."""
        spec = self._spec()
        self._check_versions(spec)
        if why := why_without(spec, make_method(spec)):
            raise self.refused(f"{why}; {_ANEW}")
        checkpoint = self.checkpoint
        if checkpoint is None:
            first = f"runs write the first one after {INTERVAL:g} s of steps"
            raise self.refused(f"it has no checkpoint; {first}; {_ANEW}")
        writers: list[ArchiveWriter] = []

        def begun(spec: RunSpec, method: Method, start: tuple[Workspace, AssembledState]) -> ArchiveWriter:
            writers.append(self._writer(spec, method, start))
            try:
                self._copy(writers[0], checkpoint)
            except BaseException:
                writers[0].abandon()
                raise
            return writers[0]

        def restored() -> None:
            writers[0].take_place_of(self.part)
            release()

        continuation = Continuation(checkpoint.state, lambda: self._observed(checkpoint.rows["time"]), restored)
        try:
            return simulate_on(spec, continuation, begun, progress=progress, notify=notify)
        except SpecError as error:
            raise error.located(file=self.part) from error

    def renamed(self) -> Run:
        """Give the archive of a run that had ended when it was killed its final name."""
        if problems := check(self.part):
            raise self.refused(f"it has ended, but its archive is damaged ({problems[0]}); {_ANEW}")
        try:
            (os.replace if self.overwrite else rename_new)(self.part, self.path)
        except OSError as error:
            raise ResourceError(
                f"it cannot be renamed to {self.path.name} ({error.strerror})", file=self.part
            ) from error
        return load(self.path)

    def _spec(self) -> RunSpec:
        """Return the spec of the run."""
        if spec_sha256(self.run.spec_json) != self.run.spec_sha256:
            raise self.refused(f"its spec is damaged; {_ANEW}")
        check_plugins_of(self.part, self.run.provenance)
        try:
            return load_spec(self.run.spec)
        except SpecError as error:
            raise error.located(file=self.part) from error

    def _check_versions(self, spec: RunSpec) -> None:
        """Raise SpecError if the run began with other versions: the bits may not be the same."""
        now, then = provenance(spec), self.run.provenance
        keys = [*_NEEDED, *(key for key in now if key.endswith(("_distribution", "_version")))]
        other = [(key, then.get(key), now[key]) for key in keys if str(then.get(key)) != str(now[key])]
        if other:
            told = [f"{_word(key, now)} {shown(str(old))}, now {new}" for key, old, new in other]
            raise self.refused(f"it began with {listed(told, 'and')}; install the same, or {_ANEW}")
        if spec.run_id() != self.run.run_id:
            raise self.refused(f"this version reads its spec in another way; {_ANEW}")

    def choose_checkpoint(self) -> None:
        """Choose the newest checkpoint whose rows are in the file; raise SpecError if the file is damaged."""
        if not self.has_checkpoints:
            return
        with reading("its checkpoints", self.part, hint=_ANEW):
            found = checkpoints(self.file)
        self.checkpoint = next((one for one in found if self._has_rows(one)), None)
        if self.checkpoint is None:
            raise self.refused(f"it is damaged, so that none of its checkpoints can be used; {_ANEW}")

    def _has_rows(self, checkpoint: Checkpoint) -> bool:
        """Return whether the file has the rows that a checkpoint counts, with their hashes."""
        try:
            arrays = [array for array in layout.LAYOUT if array.grows and array.path in self.file]
            hashed = [array for array in arrays if layout.is_hashed(array.path)]
            lines = (_line(self.file, array, checkpoint.rows[array.dims[0]]) for array in hashed)
            return sorted(lines) == list(checkpoint.lines)
        except (OSError, RuntimeError, LookupError, ValueError, TypeError):
            return False

    def _writer(self, spec: RunSpec, method: Method, start: tuple[Workspace, AssembledState]) -> ArchiveWriter:
        """Begin the file that takes the place of the ``.part``."""
        workspace, _ = start
        then = self.run.provenance
        writer = ArchiveWriter(
            self.path,
            archive_names(workspace.mechanism),
            spec.canonical_json(),
            spec.sha256(),
            spec.run_id(),
            {**then, "resumed": int(then.get("resumed", 0)) + 1, "resumed_by": shlex.join(sys.argv)},
            quantities=spec.output.recorded,
            extra_datasets=optional_arrays(spec, method, workspace.mechanism),
            overwrite=self.overwrite,
            part=self.part.with_name(f"{self.path.name}.resumed.part"),
            shared=shared_forces(workspace.mechanism),
        )
        # Another call may have resumed the run, and ended, since this one opened the file.
        if not (self.part.exists() and os.path.samestat(os.fstat(self.handle), os.stat(self.part))):
            writer.abandon()
            raise _still_going(self.part)
        return writer

    def _copy(self, writer: ArchiveWriter, checkpoint: Checkpoint) -> None:
        """Copy the rows and the checkpoint into the new file."""
        with reading("its rows", self.part, hint=_ANEW):
            writer.copy_rows(self.file, checkpoint)
        writer.keep_checkpoint(checkpoint.state)
        if writer.lines != checkpoint.lines:
            raise self.refused(f"it is damaged, because its rows are not those of its checkpoints; {_ANEW}")

    def _observed(self, rows: int) -> list[ObservedRows]:
        """Return states and reactions of the rows up to the checkpoint."""
        paths = (
            "trajectory/time", "trajectory/position", "trajectory/velocity",
            "joints/reaction_force", "joints/reaction_torque",
        )  # fmt: skip
        with reading("its rows", self.part, hint=_ANEW):
            return [ObservedRows(*(self.file[path][:rows] for path in paths))]


def _line(file: h5py.File, array: layout.Array, rows: int) -> str:
    """Return the line of the first rows of an array for `data_sha256`."""
    sha, dataset = hashlib.sha256(), file[array.path]
    for start in range(0, rows, ROWS_COPIED):
        values = stored_rows(file, array, slice(start, min(rows, start + ROWS_COPIED)))
        sha.update(text_bytes(values) if array.dtype == layout.TEXT else np.ascontiguousarray(values).data)
    return line(array.path, array.dtype, (rows, *dataset.shape[1:]), sha.hexdigest())


def _word(key: str, provenance: Mapping[str, object]) -> str:
    """Return what an entry of the provenance belongs to, such as the name of a plugin."""
    kind, _, part = key.rpartition("_")
    if part == "version":
        return f"{provenance[kind]} {part}"
    return str(provenance[kind]) + " from" if part == "distribution" else key
