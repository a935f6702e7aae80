"""Writes a run archive during the run."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.checkpoint import Checkpoint, StoredRows, StoredState
from mbdkit.archive.fingerprint import attribute_line, digest_lines, layout_lines, seal
from mbdkit.archive.growing_array import Table
from mbdkit.archive.hdf5 import replace_number, set_text
from mbdkit.archive.hdf5_errors import cause
from mbdkit.archive.measured_values import integrals_json
from mbdkit.archive.part_file import Target
from mbdkit.archive.run_writer import Ending, Origin, RunWriter, SharedForces, name_lines, utc_now
from mbdkit.archive.skeleton import Attribute, add_attributes, begin_file, memory_file, skeleton_of
from mbdkit.base.errors import MbdkitError, ResourceError
from mbdkit.quantities.array import FLOAT, GROWING, Array
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.registered_kinds import sizes_of
from mbdkit.trust.criteria import Judgement

if TYPE_CHECKING:
    from mbdkit.spec.model_spec import ModelSpec

#: Time between flushes [s]. A crash loses only rows recorded after the last flush.
FLUSH_INTERVAL = 1.0

#: Number of rows that are copied at a time when a run continues.
_ROWS_COPIED = 1024


class ArchiveWriter(RunWriter):
    """Writes one archive: appends rows, flushes them regularly, and finishes or abandons the archive.

    - `path`: final name, ending in ``.h5``; the file is written as ``.part`` until `finish`. None for an archive in
      memory.
    - `names`: names of bodies, joints and constraint rows.
    - `origin`: the spec of the run, its name, and where and how it was made.
    - `arrays`: the arrays to record; by default, those of all quantities.
    - `overwrite`: whether `finish` replaces an existing file.
    - `part`: name of the file until `finish`; by default, ``FILE.h5.part``.
    - `shared`: attributes for a mechanism with redundant joints; None without them.
    - `ending`, `head`: how the run has ended, and the root attributes; None and empty while it is in progress.

    Raises SpecError if no archive may be written at `path`. Raises ResourceError if the system refuses to create the
    file, or another run is writing it.
    """

    def __init__(
        self,
        path: Path | None,
        names: ArchiveNames,
        origin: Origin,
        *,
        arrays: tuple[Array, ...] | None = None,
        overwrite: bool = False,
        part: Path | None = None,
        shared: SharedForces | None = None,
    ):
        super().__init__(names, arrays)
        sizes = sizes_of(names)
        self._tables = {
            dim: Table(growing, sizes, self._write_more)
            for dim in GROWING
            if (growing := [array for array in self.arrays if array.dims[0] == dim])
        }
        self.shared = shared
        self.origin = replace(origin, created_utc=origin.created_utc or utc_now())
        self._flushed: float | None = None
        self._kept = False
        self._ended = False
        self._target = None if path is None else Target(Path(path), overwrite=overwrite, part=part)
        #: None as long as all rows are in the buffers. A run that ends before the first flush is written as a whole,
        #: from an image in memory; until then, its ``.part`` is empty.
        self._file: h5py.File | None = None
        self.ending: Ending | None = None
        self.head: Mapping[str, str] = {}
        self._known: dict[str, str] = {}  # see `attributes_sha256`
        self._lines_of_tables: list[str] = []

    @property
    def row_keys(self) -> frozenset[str]:
        """Keys that `append` requires."""
        return self._tables["time"].keys

    @property
    def path(self) -> Path | None:
        """Final name of the archive; None in memory."""
        return None if self._target is None else self._target.path

    def use_spec(self, spec: ModelSpec) -> None:
        """See `RunWriter.use_spec`."""
        given = self.origin
        before = {**self._root_attributes(None), **given.texts}
        self.origin = replace(Origin.of(spec, given.provenance), created_utc=given.created_utc)
        if self._file is None:
            return
        after = {**self._root_attributes(None), **self.origin.texts}
        changed = {name: value for name, value in after.items() if before.get(name) != value}
        for name in changed.keys() & self._file.attrs.keys():
            del self._file.attrs[name]
        self._add(self._file, "", changed)

    def rows(self, dim: str) -> int:
        """Return the number of rows, written or buffered."""
        return self._tables[dim].rows

    def take(self, dim: str, rows: Mapping[str, np.ndarray]) -> None:
        """Append rows of the arrays that grow along `dim`, by key; the values are copied."""
        if self._flushed is None:
            self._flushed = time.monotonic()
        with self._storing():
            self._tables[dim].append(rows)

    def flush_if_due(self) -> None:
        """Write the buffered rows and flush the file if `FLUSH_INTERVAL` has passed since the last flush."""
        if self._target is None or self._flushed is None:
            return
        if time.monotonic() - self._flushed >= FLUSH_INTERVAL:
            with self._storing():
                self._write_more()

    @property
    def lines(self) -> tuple[str, ...]:
        """Sorted lines that describe the arrays with the rows written so far.

        `data_sha256` is the hash of these lines and those of the arrays of names.
        """
        return tuple(sorted(self._grown(timings=False).values()))

    def _grown(self, *, timings: bool) -> dict[str, str]:
        every = ((series.array.path, series) for table in self._tables.values() for series in table.series)
        return {path: series.line() for path, series in every if layout.is_timing(path) is timings}

    def keep_checkpoint(self, state: StoredState) -> None:
        """Write the buffered rows, and the state from which a run can continue after them."""
        assert self._target is not None
        with self._storing():
            self._write_more()
            self._target.sync()  # before the checkpoint is written, which counts these rows
            origin = self.origin
            series = [one for table in self._tables.values() for one in table.series]
            checkpoint = Checkpoint(
                head={
                    "spec": origin.spec_json,
                    "run_id": origin.run_id,
                    "created_utc": origin.created_utc,
                    "provenance": dict(origin.provenance),
                    "files": origin.texts.get(layout.FILES, "[]"),
                },
                file=os.stat(self._target.part).st_ino,
                rows={dim: table.written for dim, table in self._tables.items()},
                lines=self.lines,
                arrays={one.array.path: StoredRows.of(one.dataset) for one in series if one.dataset is not None},
                state=state,
            )
            checkpoint.write(self._target.part)

    def copy_rows(self, checkpoint: Checkpoint, part: BinaryIO) -> None:
        """Append the rows of a checkpoint from its ``.part``, and adopt the creation time of that file."""
        self.origin = replace(self.origin, created_utc=checkpoint.head["created_utc"])
        for dim, table in self._tables.items():
            rows, arrays = checkpoint.rows[dim], [series.array for series in table.series]
            for start in range(0, rows, _ROWS_COPIED):
                some = slice(start, min(rows, start + _ROWS_COPIED))
                stored = checkpoint.arrays
                self.take(dim, {array.key: stored[array.path].read(part, array, some) for array in arrays})
        with self._storing():
            self._write_more()

    def take_place_of(self, part: Path) -> None:
        """Rename the file to `part`; it replaces the ``.part`` that an interrupted run has left there."""
        assert self._target is not None
        self._target.take_place_of(part)

    def finish(self, ending: Ending, *, completed: Callable[[h5py.File], None] | None = None) -> h5py.File | None:
        """Write the remaining rows, the hash and the status, and rename the archive to its final name.

        `ending`: results known at the end. Besides `Ending.stats`, this method stores its own duration up to the last
        write [s], as ``finish_s``. `completed`: function that adds what is computed from the HDF5 file, which is
        otherwise complete: measures, gradients and answers. Returns the open archive in memory; None if it is a
        file on disk, which this method closes. Raises ResourceError if the archive cannot be written or renamed.
        """
        if ending.status not in layout.STATUSES[1:]:
            raise ValueError(f"a run ends as complete, failed or interrupted, not {ending.status!r}")
        started = time.perf_counter()
        accuracy = ending.accuracy
        with self._storing():
            with self._committing():
                is_begun = self._file is not None
                file, unread = self._with_all_rows()
                if accuracy is not None:
                    accuracy.write(file, self.names.bodies, self.names.joints)
                for name, table in ending.tables.items():
                    self._lines_of_tables += table.write(file, name)
                self._write_end(file, ending)
                self._write_verdict(file, ending.judgement, ending.warnings)
                if ending.integrals:
                    set_text(file, layout.INTEGRALS, integrals_json(ending.integrals))
                self.head = self._root_attributes(ending)
                if is_begun:
                    self._change_head(file)
                else:
                    self._write_head(file, self.head)
                if completed is not None:
                    completed(file)
                seconds = ending.stats.get("finish_s") or time.perf_counter() - started
                replace_number(file["stats"], "finish_s", np.float64(seconds))
                self._known["stats@finish_s"] = attribute_line("stats@finish_s", np.float64(seconds))
                self.ending = replace(ending, stats={**ending.stats, "finish_s": seconds})
                # Computed from the file, so that the hash covers all of its contents, except for known lines.
                lines = [*name_lines(self.names, self.arrays), *self.lines, *self._lines_of_tables]
                known = {**layout_lines(self.arrays), **self._grown(timings=True), **self._known}
                seal(file, {**known, **{line.rsplit(" ", 3)[0]: line for line in lines}}, unread)
            if self._target is not None:
                self._publish(self._target, file, keep=ending.status == "interrupted")
                return None
            self._ended = True
            file.flush()
            return file

    def _with_all_rows(self) -> tuple[h5py.File, Mapping[str, Sequence[str]]]:
        """Return the file with all rows, and the objects that `attributes_sha256` need not read."""
        if self._file is not None:
            self._write_tables(self._file, more=False)
            self._file.flush()
            return self._file, {}
        rows = tuple((dim, table.rows) for dim, table in self._tables.items())
        skeleton = skeleton_of(self.names, self.arrays, rows, self.origin.provenance)
        values = {path: rows for table in self._tables.values() for path, rows in table.taken().items()}
        self._file = skeleton.file(values)
        self._known |= skeleton.known
        changed = {"joints/misalignment", *(() if self.shared is None else layout.SHARED)}  # by `_write_end`
        return self._file, {path: lines for path, lines in skeleton.unread.items() if path not in changed}

    def _publish(self, target: Target, file: h5py.File, *, keep: bool) -> None:
        if target.file is None:
            file.flush()
            file.flush()  # HDF5 releases space at the end of the file that the first flush has left unused
            target.write(file.id.get_file_image())
            file.close()
        else:
            target.end()
        self._ended = True
        try:
            target.publish(keep=keep)
        finally:
            target.close()

    def abandon(self) -> None:
        """Remove the archive; no effect once it is finished or a write has failed."""
        if self._ended:
            return
        self._ended = True
        if self._file is not None and (self._target is None or self._target.file is None):
            self._file.close()
        if self._target is not None:
            self._target.drop()

    def _begin(self) -> h5py.File:
        if self._file is None:
            self._file = memory_file() if self._target is None else self._target.open()
            begin_file(self._file, self.names, self.arrays)
            self._write_head(self._file, self._root_attributes(None))
        return self._file

    def _write_head(self, file: h5py.File, head: Mapping[str, str]) -> None:
        self._add(file, "", {**head, **self.origin.texts})
        given = self.origin.provenance
        self._add(file, "provenance", {name: given[name] for name in given if f"provenance@{name}" not in self._known})
        self._add(file, "trajectory", self.origin.bodies)
        if self.shared is not None:
            length = float(self.shared.length)
            self._add(file, "joints", {"redundancy": self.shared.redundancy, "characteristic_length": length})

    def _add(self, file: h5py.File, path: str, values: Mapping[str, Attribute]) -> None:
        self._known |= add_attributes(file, path, values)

    def _change_head(self, file: h5py.File) -> None:
        """Change those root attributes of a file begun earlier that depend on how the run has ended."""
        for name in ("data_sha256", "status_reason", "status"):
            file.attrs.modify(name, self.head[name])
            self._known.pop(f"@{name}")

    def _root_attributes(self, ending: Ending | None) -> dict[str, str]:
        origin = self.origin
        status, reason, digest = "running", "", ""
        if ending is not None:
            digest = digest_lines([*name_lines(self.names, self.arrays), *self.lines, *self._lines_of_tables])
            status, reason = ending.status, ending.reason
        values = (
            layout.FORMAT, layout.FORMAT_VERSION, status, reason, origin.run_id, origin.created_utc, origin.spec_json,
            origin.spec_sha256, digest,
        )  # fmt: skip
        return dict(zip(layout.ROOT_ATTRIBUTES, values, strict=True))

    def _write_end(self, file: h5py.File, ending: Ending) -> None:
        self._add(file, "stats", {**ending.stats, "finish_s": 0.0})
        largest = {"misalignment_max": np.asarray(ending.misalignment_max, FLOAT)}
        self._add(file, "joints", largest)
        if any(array.path == "joints/misalignment" for array in self.arrays):
            self._add(file, "joints/misalignment", largest)
        if self.shared is not None:
            for path in layout.SHARED:
                names = self.shared.drivers if path == "joints/driver_power" else self.shared.joints
                if path in file and names:
                    self._add(file, path, {"not_unique": ", ".join(names)})

    def _write_verdict(self, file: h5py.File, judgement: Judgement, warnings: tuple[str, ...]) -> None:
        reasons = tuple(judgement.reasons)
        self._add(file, "", {"verdict": judgement.level, "verdict_reasons": reasons, "warnings": warnings})

    def _write_tables(self, file: h5py.File, *, more: bool) -> None:
        for table in self._tables.values():
            table.write(file, more=more)

    def _write_more(self) -> None:
        file = self._begin()
        with self._committing():
            self._write_tables(file, more=True)
        self._flushed = time.monotonic()
        self._kept = True

    def _committing(self) -> contextlib.AbstractContextManager[None]:
        """Return a context on whose exit all changes of the file take effect at once; see `Target.committing`."""
        if self._target is None or self._target.file is None:
            return contextlib.nullcontext()
        return self._target.committing()

    @contextlib.contextmanager
    def _storing(self) -> Iterator[None]:
        """Convert HDF5's errors, as on a full or missing disk, into ResourceError, and keep the data flushed before.

        The archive is closed by such an error. Raises MbdkitError if it is closed already.
        """
        if self._ended:
            raise MbdkitError("the archive is closed")
        try:
            yield
        except (OSError, RuntimeError) as error:
            if isinstance(error, NotImplementedError | RecursionError):
                raise
            self._ended = True
            if self._target is None:
                raise ResourceError(f"the archive in memory cannot be written: {cause(error)}") from error
            if self._kept:
                self._target.close()
                rest = f"; the data up to the last flush are in {self._target.part}"
            else:
                self._target.drop()
                rest = ""
            raise ResourceError(f"the archive {self._target.path} cannot be written: {cause(error)}{rest}") from error
