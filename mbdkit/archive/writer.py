"""Writes a run archive during the run."""

from __future__ import annotations

import contextlib
import itertools
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.checkpoint import Checkpoint, StoredRows
from mbdkit.archive.fingerprint import attributes_sha256, digest_lines, layout_lines
from mbdkit.archive.growing_array import Table
from mbdkit.archive.hdf5 import create, set_text, set_texts
from mbdkit.archive.hdf5_errors import cause
from mbdkit.archive.layout import name_texts
from mbdkit.archive.measured_values import integrals_json
from mbdkit.archive.part_file import LIBVER, Target
from mbdkit.archive.run_writer import Ending, Origin, RunWriter, SharedForces, name_line, utc_now
from mbdkit.base.errors import MbdkitError, ResourceError
from mbdkit.quantities.array import FLOAT, GROWING, Array
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.table import sizes_of
from mbdkit.trust.criteria import Judgement

#: Time between flushes [s]. A crash loses only rows recorded after the last flush.
FLUSH_INTERVAL = 1.0

#: HDF5 distinguishes files in memory by name.
_MEMORY = itertools.count(1)

#: Number of rows that are copied at a time when a run continues.
_ROWS_COPIED = 1024

#: Disk space reserved for attributes.
_ATTRIBUTE_BYTES = 1 << 15


class ArchiveWriter(RunWriter):
    """Writes one archive: appends rows, flushes them regularly, and finishes or abandons the archive.

    Parameters
    ----------
    path
        Final name, ending in ``.h5``; the file is written as ``.part`` until `finish`. None for an archive in memory.
    names
        Names of bodies, joints and constraint rows.
    origin
        The spec of the run, its name, and where and how it was made.
    arrays
        The arrays to record; by default, those of all quantities.
    overwrite
        Whether `finish` replaces an existing file.
    part
        Name of the file until `finish`; by default, ``FILE.h5.part``.
    shared
        Attributes for a mechanism with redundant joints; None without them.

    Raises
    ------
    SpecError
        If no archive may be written at `path`.
    ResourceError
        If the system refuses the file, or another run is writing it.
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
        self._shared = shared
        self._provenance = dict(origin.provenance)
        self._lines: list[str] = []
        self._flushed: float | None = None
        self._kept = False
        self._ended = False
        self._target = None if path is None else Target(Path(path), overwrite=overwrite, part=part)
        self._file: h5py.File = (
            h5py.File(f"memory-{next(_MEMORY)}", "w", driver="core", backing_store=False, libver=LIBVER)
            if self._target is None
            else self._target.file
        )
        try:
            text = len(origin.spec_json) + 64 * sum(len(array.texts(names)) for array in self.arrays if array.texts)
            with self._storing(), self._room(more=False, also=_ATTRIBUTE_BYTES + text):
                self._write_head(origin)
                self._write_names()
        except BaseException:
            self.abandon()
            raise

    @property
    def row_keys(self) -> frozenset[str]:
        """Keys that `append` requires."""
        return self._tables["time"].keys

    @property
    def path(self) -> Path | None:
        """Final name of the archive; None in memory."""
        return None if self._target is None else self._target.path

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
    def keeps_checkpoints(self) -> bool:
        """Whether checkpoints are written, which requires that the archive is a file."""
        return self._target is not None

    @property
    def lines(self) -> tuple[str, ...]:
        """Sorted lines that describe the arrays with the rows written so far; `data_sha256` is their hash."""
        grown = (series.line() for table in self._tables.values() for series in table.series)
        return tuple(sorted(filter(None, grown)))

    def keep_checkpoint(self, state: Mapping[str, Any]) -> None:
        """Write the buffered rows, and the state from which a run can continue after them."""
        assert self._target is not None
        with self._storing():
            self._write_more()
            self._target.sync()  # before the checkpoint is written, which counts these rows
            attributes = self._file.attrs
            series = [one for table in self._tables.values() for one in table.series]
            checkpoint = Checkpoint(
                head={name: str(attributes[name]) for name in ("spec", "run_id", "created_utc")}
                | {"provenance": self._provenance},
                file=os.stat(self._target.part).st_ino,
                rows={dim: table.written for dim, table in self._tables.items()},
                lines=self.lines,
                arrays={one.array.path: StoredRows.of(one.dataset) for one in series if one.dataset is not None},
                state=state,
            )
            checkpoint.write(self._target.part)

    def copy_rows(self, checkpoint: Checkpoint, part: BinaryIO) -> None:
        """Append the rows of a checkpoint from its ``.part``, and adopt the creation time of that file."""
        self._file.attrs.modify("created_utc", checkpoint.head["created_utc"])
        for dim, table in self._tables.items():
            rows = checkpoint.rows[dim]
            for start in range(0, rows, _ROWS_COPIED):
                some = slice(start, min(rows, start + _ROWS_COPIED))
                self.take(
                    dim,
                    {
                        one.array.key: checkpoint.arrays[one.array.path].read(part, one.array, some)
                        for one in table.series
                    },
                )
        with self._storing():
            self._write_more()

    def take_place_of(self, part: Path) -> None:
        """Rename the file to `part`; it replaces the ``.part`` that an interrupted run has left there."""
        assert self._target is not None
        self._target.take_place_of(part)

    def finish(self, ending: Ending, *, measured: Callable[[h5py.File], str] | None = None) -> h5py.File | None:
        """Write the remaining rows, the hash and the status, and rename the archive to its final name."""
        started = time.perf_counter()
        file, accuracy = self._file, ending.accuracy
        misalignment_max = np.asarray(ending.misalignment_max, FLOAT)
        with self._storing():
            errors = 0 if accuracy is None else accuracy.size_in_bytes + _ATTRIBUTE_BYTES
            with self._room(more=False, also=_ATTRIBUTE_BYTES + 16 * len(misalignment_max) + errors):
                self._write_tables(more=False)
                file.flush()
                del file["trajectory"].attrs[layout.ROWS_FLUSHED]  # all rows have been written
                if accuracy is not None:
                    accuracy.write(file, self.names.bodies, self.names.joints)
                self._write_end(ending.reason, {**ending.stats, "finish_s": 0.0}, misalignment_max)
                self._write_verdict(ending.judgement, ending.warnings)
                if ending.integrals:
                    set_text(file, layout.INTEGRALS, integrals_json(ending.integrals))
                file.flush()
                file.attrs.modify("status", ending.status)  # written last, because it marks all other contents as valid
                if measured is not None:
                    set_text(file, layout.MEASURES, measured(file))
                # Computed from the file, so that the hash covers all of its contents. Attributes prescribed by the
                # layout are not read.
                set_text(file, layout.ATTRIBUTES_HASH, attributes_sha256(file, layout_lines()))
            if self._target is None:
                self._end(started)
                file.flush()
                return file
            self._target.sync()
            try:
                self._target.publish()
            finally:
                self._end(started)
                self._target.close()
            return None

    def abandon(self) -> None:
        """Remove the archive; no effect once it is finished or a write has failed."""
        if self._ended:
            return
        self._ended = True
        if self._target is None:
            self._file.close()
        else:
            self._target.drop()

    def _write_head(self, origin: Origin) -> None:
        created = origin.created_utc or utc_now()
        values = (
            layout.FORMAT, layout.FORMAT_VERSION, "running", "", origin.run_id, created, origin.spec_json,
            origin.spec_sha256, "",
        )  # fmt: skip
        for name, value in zip(layout.ROOT_ATTRIBUTES, values, strict=True):
            set_text(self._file, name, value)
        present = {array.group for array in self.arrays}
        for group in (*(group for group in layout.GROUPS if group in present), "stats", "provenance"):
            self._file.create_group(group)
        self._file["trajectory"].attrs[layout.ROWS_FLUSHED] = np.zeros(len(GROWING), np.int64)
        target = self._file["provenance"]
        for name, entry in origin.provenance.items():
            if isinstance(entry, str):
                set_text(target, name, entry)
            else:
                target.attrs[name] = _number(entry)
        if self._shared is not None:
            set_text(self._file["joints"], "redundancy", self._shared.redundancy)
            self._file["joints"].attrs["characteristic_length"] = np.float64(self._shared.length)

    def _write_names(self) -> None:
        texts = name_texts(self.names)
        arrays = [array for array in self.arrays if not array.grows]
        for array in sorted(arrays, key=lambda array: not array.is_scale):
            text = tuple(texts[array.path])
            create(self._file, array, np.array(text, dtype=object))
            self._lines.append(name_line(array.path, text))

    def _write_end(self, reason: str, stats: Mapping[str, int | float], misalignment_max: np.ndarray) -> None:
        attributes, joints = self._file["stats"].attrs, self._file["joints"]
        for name, value in stats.items():
            attributes[name] = _number(value)
        joints.attrs["misalignment_max"] = misalignment_max
        if "misalignment" in joints:
            joints["misalignment"].attrs["misalignment_max"] = misalignment_max
        if self._shared is not None:
            for path in layout.SHARED:
                names = self._shared.drivers if path == "joints/driver_power" else self._shared.joints
                if path in self._file and names:
                    set_text(self._file[path], "not_unique", ", ".join(names))
        self._file.attrs.modify("data_sha256", digest_lines([*self._lines, *self.lines]))
        self._file.attrs.modify("status_reason", reason)

    def _write_verdict(self, judgement: Judgement, warnings: Sequence[str]) -> None:
        set_text(self._file, "verdict", judgement.level)
        set_texts(self._file, "verdict_reasons", judgement.reasons)
        set_texts(self._file, "warnings", warnings)

    def _end(self, started: float) -> None:
        self._ended = True
        if self._file:
            self._file["stats"].attrs.modify("finish_s", time.perf_counter() - started)

    def _write_tables(self, *, more: bool) -> None:
        for table in self._tables.values():
            table.write(self._file, more=more)

    def _write_more(self) -> None:
        with self._room(more=True):
            self._write_tables(more=True)
            self._mark_rows()
        self._flushed = time.monotonic()
        self._kept = True

    def _mark_rows(self) -> None:
        """Flush the tables, then store the numbers of their rows in an attribute.

        HDF5 writes its metadata in many pieces. If the process is killed in between, arrays may seem to have rows that
        were never written. The attribute is written in one piece, so that the rows it counts are always complete.
        """
        if self._target is not None:
            self._file.flush()
            self._file["trajectory"].attrs.modify(layout.ROWS_FLUSHED, self._row_counts())

    def _row_counts(self) -> np.ndarray:
        counts = [self._tables[dim].written if dim in self._tables else 0 for dim in GROWING]
        return np.array(counts, np.int64)

    def _room(self, *, more: bool, also: int = 0) -> contextlib.AbstractContextManager[None]:
        """Return a context that reserves disk space for the buffered rows and flushes the file on exit."""
        if self._target is None:
            return contextlib.nullcontext()
        return self._target.reserved(also + sum(table.size_on_disk(more=more) for table in self._tables.values()))

    @contextlib.contextmanager
    def _storing(self) -> Iterator[None]:
        """Convert HDF5's errors on a full or missing disk into MbdkitError, and keep the data flushed before."""
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


def _number(value: int | float) -> np.int64 | np.float64:
    return np.int64(value) if isinstance(value, int | np.integer) else np.float64(value)
