"""Writes a run archive during the run."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.fingerprint import attributes_sha256, digest_lines, line, text_bytes
from mbdkit.archive.growing_array import Table
from mbdkit.archive.hdf5 import create, set_text, set_texts
from mbdkit.archive.hdf5_errors import cause
from mbdkit.archive.layout import Array
from mbdkit.archive.part_file import LIBVER, Target
from mbdkit.errors import MbdkitError, ResourceError
from mbdkit.trust.criteria import Judgement

#: Time between flushes [s]. A crash loses only rows recorded after the last flush.
FLUSH_INTERVAL = 1.0

#: HDF5 distinguishes files in memory by name.
_MEMORY = itertools.count(1)

#: Keys accepted by the `append` methods.
_KEYS = frozenset(array.key for array in layout.LAYOUT)

#: Disk space reserved for attributes.
_ATTRIBUTE_BYTES = 1 << 15


UNJUDGED = Judgement("unknown")


@dataclass(frozen=True)
class ArchiveNames:
    """Names along the axes of an archive.

    Parameters
    ----------
    bodies, joints
        Names, in the order of the engine.
    constraints
        ``joint.row`` for every constraint row, such as ``J1.x``.
    constraint_units
        Unit of the constraint function of every constraint row, ``m`` or ``rad``.
    joint_bodies
        First and second body of every joint.
    joint_units
        Unit of the coordinate of every joint, ``rad`` or ``m``; by default, ``rad``.
    forces, force_bodies
        Names of the force elements, and first and second body of each.
    force_units
        Unit of the length of every force element, ``m`` or ``rad``.
    markers, marker_bodies
        Names of the markers, and the body of each.
    """

    bodies: Sequence[str]
    joints: Sequence[str]
    constraints: Sequence[str]
    constraint_units: Sequence[str]
    joint_bodies: Sequence[tuple[str, str]]
    joint_units: Sequence[str] = ()
    forces: Sequence[str] = ()
    force_bodies: Sequence[tuple[str, str]] = ()
    force_units: Sequence[str] = ()
    markers: Sequence[str] = ()
    marker_bodies: Sequence[str] = ()

    @property
    def sizes(self) -> dict[str, int]:
        """Lengths of the axes that do not grow, by name."""
        return {
            "body": len(self.bodies),
            "coordinate": len(layout.COORDINATES),
            "joint": len(self.joints),
            "axis": len(layout.AXES),
            "constraint": len(self.constraints),
            "force": len(self.forces),
            "marker": len(self.markers),
        }

    def present(self, quantities: frozenset[str]) -> frozenset[str]:
        """Return the `quantities` without the groups of elements that the mechanism does not have."""
        there = {"forces": self.forces, "markers": self.markers}
        return frozenset(group for group in quantities if group not in layout.ELEMENTS or there[group])


@dataclass(frozen=True)
class SharedForces:
    """Attributes of the archive of a mechanism with redundant joints.

    Parameters
    ----------
    redundancy
        Description, such as ``1 redundant row: joint D``.
    joints
        The joints whose reactions are not unique.
    length
        Characteristic length [m]. Of all reactions that produce the same motion, the recorded ones minimize the sum
        over joints of ``|force|^2 + (torque / length)^2``.
    drivers
        The drivers among these joints, whose powers are not unique.
    """

    redundancy: str
    joints: Sequence[str]
    length: float
    drivers: Sequence[str] = ()


class ArchiveWriter:
    """Writes one archive: appends rows, flushes them regularly, and finishes or abandons the archive.

    Parameters
    ----------
    path
        Final name, ending in ``.h5``; the file is written as ``.part`` until `finish`. None for an archive in memory.
    names
        Names of bodies, joints and constraint rows.
    spec_json, spec_sha256
        The canonical JSON of the spec, and the SHA-256 of its UTF-8 bytes.
    run_id
        Unique name of the run.
    provenance
        Attributes of ``/provenance``: versions, platform, command.
    quantities
        Which of `layout.QUANTITIES` are recorded.
    extra_datasets
        Paths of the optional arrays to record, such as ``constraints/method_multiplier``.
    overwrite
        Whether `finish` replaces an existing file.
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
        spec_json: str,
        spec_sha256: str,
        run_id: str,
        provenance: Mapping[str, str | int | float],
        *,
        quantities: frozenset[str] = layout.QUANTITIES,
        extra_datasets: Iterable[str] = (),
        overwrite: bool = False,
        shared: SharedForces | None = None,
    ):
        arrays = layout.recorded(names.present(quantities), frozenset(extra_datasets))
        sizes = names.sizes
        growing = [array for array in arrays if array.grows]
        self._rows = Table([array for array in growing if array.dims[0] == "time"], sizes, self._write_more)
        self._steps = Table([array for array in growing if array.dims[0] == "interval"], sizes, self._write_more)
        events = [array for array in growing if array.dims[0] == "event"]
        self._events = Table(events, sizes, self._write_more) if events else None
        self._tables = tuple(filter(None, (self._rows, self._steps, self._events)))
        self._shared, self._names = shared, names
        self._lines: list[str] = []
        self._flushed: float | None = None
        self._kept = False
        self._ended = False
        self._target = None if path is None else Target(Path(path), overwrite=overwrite)
        self._file: h5py.File = (
            h5py.File(f"memory-{next(_MEMORY)}", "w", driver="core", backing_store=False, libver=LIBVER)
            if self._target is None
            else self._target.file
        )
        try:
            counted = len(names.bodies) + 2 * len(names.joints) + 4 * len(names.constraints)
            text = len(spec_json) + 64 * (counted + 6 * len(names.forces) + 2 * len(names.markers))
            with self._storing(), self._room(more=False, also=_ATTRIBUTE_BYTES + text):
                self._write_head(spec_json, spec_sha256, run_id, provenance, arrays)
                self._write_names([array for array in arrays if not array.grows], names)
        except BaseException:
            self.abandon()
            raise

    @property
    def row_keys(self) -> frozenset[str]:
        """Keys that `append` requires; it ignores other keys of the layout."""
        return self._rows.keys

    @property
    def path(self) -> Path | None:
        """Final name of the archive; None in memory."""
        return None if self._target is None else self._target.path

    def append(self, rows: Mapping[str, np.ndarray]) -> None:
        """Append recorded rows; the values are copied.

        Parameters
        ----------
        rows
            An array with T rows for every key of `row_keys`: paths such as ``trajectory/position`` (T, B, 3), and
            ``time`` (T,) for the times of all groups.

        Raises
        ------
        ResourceError
            If the archive cannot be written, as on a full disk.
        """
        self._take(self._rows, rows)

    def append_steps(self, rows: Mapping[str, np.ndarray]) -> None:
        """Append the statistics of recorded intervals; the values are copied.

        Parameters
        ----------
        rows
            ``time``, ``steps``, ``size``, ``iterations``, ``iterations_max``, ``rejected``, and the corrections of a
            stabilized run, each (N,).
        """
        count = len(rows["time"])
        numbers = np.arange(self._steps.rows + 1, self._steps.rows + count + 1)
        keyed = {f"steps/{name}": values for name, values in rows.items()}
        self._take(self._steps, {**keyed, "steps/interval": numbers})

    def append_events(self, rows: Mapping[str, np.ndarray]) -> None:
        """Append crossings of events; the values are copied.

        Parameters
        ----------
        rows
            ``name`` (strings), ``time`` and ``direction``, each (E,), and ``position`` and ``velocity`` (E, B, 3).
        """
        assert self._events is not None
        numbers = np.arange(self._events.rows + 1, self._events.rows + len(rows["name"]) + 1)
        self._take(self._events, {"events/event": numbers, **{f"events/{key}": values for key, values in rows.items()}})

    def _take(self, table: Table, rows: Mapping[str, np.ndarray]) -> None:
        unknown = rows.keys() - _KEYS
        if unknown:
            raise ValueError(f"the layout has no {', '.join(sorted(unknown))}")
        if self._flushed is None:
            self._flushed = time.monotonic()
        with self._storing():
            table.append(rows)

    def flush_if_due(self) -> None:
        """Write the buffered rows and flush the file if `FLUSH_INTERVAL` has passed since the last flush."""
        if self._target is None or self._flushed is None:
            return
        if time.monotonic() - self._flushed >= FLUSH_INTERVAL:
            with self._storing():
                self._write_more()

    def finish(
        self,
        status: str,
        reason: str,
        stats: Mapping[str, int | float],
        misalignment_max: np.ndarray,
        *,
        judgement: Judgement = UNJUDGED,
        warnings: Sequence[str] = (),
        accuracy: Accuracy | None = None,
        measured: Callable[[h5py.File], str] | None = None,
    ) -> h5py.File | None:
        """Write the remaining rows, the hash and the status, and rename the archive to its final name.

        Parameters
        ----------
        status
            ``complete``, ``failed`` or ``interrupted``.
        reason
            Code and sentence saying why the run is not complete, such as ``newton-failed: the step at t = ...``. For
            a complete run, the event that ended it, or an empty string.
        stats
            Attributes of ``/stats``: counters (integers) and ``setup_s``, ``wall_s``, ``cpu_s``. This method adds
            ``finish_s``, its own duration up to the renaming.
        misalignment_max
            Largest misalignment of each joint over all steps, (J,), m.
        accuracy
            Estimated errors of the rows, if they were checked.
        judgement
            The verdict on the run; ``unknown`` by default.
        warnings
            Warnings about the spec and the run, as sentences.
        measured
            Takes the measures of the run from the file, in which all else is written, and returns the attribute
            ``measures``.

        Returns
        -------
        h5py.File or None
            The open archive if it is in memory; None for a file, which this method closes.

        Raises
        ------
        ResourceError
            If the archive cannot be written or renamed.
        """
        started = time.perf_counter()
        if status not in layout.STATUSES[1:]:
            raise ValueError(f"a run ends as complete, failed or interrupted, not {status!r}")
        file = self._file
        with self._storing():
            errors = 0 if accuracy is None else accuracy.size_in_bytes + _ATTRIBUTE_BYTES
            with self._room(more=False, also=_ATTRIBUTE_BYTES + 16 * len(misalignment_max) + errors):
                self._write_tables(more=False)
                file.flush()
                del file["trajectory"].attrs[layout.ROWS_FLUSHED]  # from now on, all rows are there
                if accuracy is not None:
                    accuracy.write(file, self._names.bodies, self._names.joints)
                self._write_end(reason, {**stats, "finish_s": 0.0}, np.asarray(misalignment_max, layout.FLOAT))
                self._write_verdict(judgement, warnings)
                file.flush()
                file.attrs.modify("status", status)  # after all that it declares valid
                if measured is not None:
                    set_text(file, layout.MEASURES, measured(file))
                # read back from the file, so that it covers attributes and arrays by whatever way they were written
                set_text(file, layout.ATTRIBUTES_HASH, attributes_sha256(file))
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

    def _write_head(
        self, spec: str, sha256: str, run_id: str, provenance: Mapping[str, str | int | float], arrays: Sequence[Array]
    ) -> None:
        now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        values = (layout.FORMAT, layout.FORMAT_VERSION, "running", "", run_id, now, spec, sha256, "")
        for name, value in zip(layout.ROOT_ATTRIBUTES, values, strict=True):
            set_text(self._file, name, value)
        present = {array.group for array in arrays}
        for group in (*(group for group in layout.GROUPS if group in present), "stats", "provenance"):
            self._file.create_group(group)
        self._file["trajectory"].attrs[layout.ROWS_FLUSHED] = np.zeros(len(layout.GROWING), np.int64)
        target = self._file["provenance"]
        for name, entry in provenance.items():
            if isinstance(entry, str):
                set_text(target, name, entry)
            else:
                target.attrs[name] = _number(entry)
        if self._shared is not None:
            set_text(self._file["joints"], "redundancy", self._shared.redundancy)
            self._file["joints"].attrs["characteristic_length"] = np.float64(self._shared.length)

    def _write_names(self, arrays: Sequence[Array], names: ArchiveNames) -> None:
        units = names.constraint_units
        rates = [f"{unit}/s" for unit in ("m", "m", "rad")]
        values: dict[str, Sequence[str]] = {
            **{f"{group}/body": names.bodies for group in ("trajectory", "events")},
            **{f"{group}/coordinate": layout.COORDINATES for group in ("trajectory", "events")},
            **{f"{group}/row_units": ("m", "m", "rad") for group in ("trajectory", "events")},
            **{f"{group}/velocity_row_units": rates for group in ("trajectory", "events")},
            "trajectory/acceleration_row_units": [f"{rate}^2" for rate in rates],
            "joints/joint": names.joints,
            **{f"{group}/axis": layout.AXES for group in ("joints", "markers")},
            "joints/first_body": [first for first, _ in names.joint_bodies],
            "joints/second_body": [second for _, second in names.joint_bodies],
            "joints/angle_row_units": names.joint_units or ["rad"] * len(names.joints),
            "forces/force": names.forces,
            "forces/first_body": [first for first, _ in names.force_bodies],
            "forces/second_body": [second for _, second in names.force_bodies],
            "forces/row_units": names.force_units,
            "forces/rate_row_units": [layout.RATE_UNITS[unit] for unit in names.force_units],
            "forces/value_row_units": [layout.MULTIPLIER_UNITS[unit] for unit in names.force_units],
            "markers/marker": names.markers,
            "markers/body": names.marker_bodies,
            "constraints/constraint": names.constraints,
            "constraints/row_units": units,
            "constraints/velocity_row_units": [layout.RATE_UNITS[unit] for unit in units],
            "constraints/multiplier_row_units": [layout.MULTIPLIER_UNITS[unit] for unit in units],
        }
        for array in sorted(arrays, key=lambda array: not array.is_scale):
            text = values[array.path]
            create(self._file, array, np.array(text, dtype=object))
            digest = hashlib.sha256(text_bytes(text)).hexdigest()
            self._lines.append(line(array.path, array.dtype, (len(text),), digest))

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
        grown = (series.line() for table in self._tables for series in table.series)
        self._file.attrs.modify("data_sha256", digest_lines([*self._lines, *filter(None, grown)]))
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
        for table in self._tables:
            table.write(self._file, more=more)

    def _write_more(self) -> None:
        with self._room(more=True):
            self._write_tables(more=True)
            self._mark_rows()
        self._flushed = time.monotonic()
        self._kept = True

    def _mark_rows(self) -> None:
        """Flush the tables, and then note the number of their rows.

        HDF5 writes its metadata in many pieces. If the process is killed meanwhile, arrays may show rows that are not
        there. The note is one piece of its own, so that the rows it counts are always complete.
        """
        if self._target is not None:
            self._file.flush()
            self._file["trajectory"].attrs.modify(layout.ROWS_FLUSHED, self._row_counts())

    def _row_counts(self) -> np.ndarray:
        counts = {table.series[0].array.dims[0]: table.written for table in self._tables}
        return np.array([counts.get(dim, 0) for dim in layout.GROWING], np.int64)

    def _room(self, *, more: bool, also: int = 0) -> contextlib.AbstractContextManager[None]:
        """Return a context that reserves disk space for the buffered rows and flushes the file on exit."""
        if self._target is None:
            return contextlib.nullcontext()
        return self._target.reserved(also + sum(table.size_on_disk(more=more) for table in self._tables))

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
