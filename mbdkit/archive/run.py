"""The run as Python sees it: an archive, in a file or in memory, read when asked."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.fingerprint import is_text
from mbdkit.archive.hdf5_errors import cause, reading
from mbdkit.archive.history import (
    BodyHistory,
    ConstraintHistory,
    Energy,
    Events,
    Histories,
    JointHistory,
    NotRecordedError,
    Steps,
    UnknownNameError,
)
from mbdkit.archive.open_archive import open_archive
from mbdkit.archive.part_file import Target
from mbdkit.errors import MbdkitError, RunError, SpecError

if TYPE_CHECKING:
    import xarray

#: Larger arrays are not kept in memory once read, and read column by column.
KEEP_BYTES = 1 << 28


class Run:
    """A run: its spec, how it ended, and what it recorded, all in SI units and radians.

    Arrays are read-only and come from the archive when they are first asked for. Close the run, or use it in a
    `with` block, to release the file; a run without a file vanishes when it is closed.

    Parameters
    ----------
    file
        The open archive.
    path
        Where it lies; None if it is in memory.
    """

    def __init__(self, file: h5py.File, path: Path | None = None):
        self._file = file
        self._path = path
        self._arrays: dict[str, np.ndarray] = {}
        try:
            with reading("what it says of itself", path):
                self._attributes = {name: str(file.attrs[name]) for name in layout.ROOT_ATTRIBUTES}
                self._stats = _plain_attributes(file["stats"])
                self._provenance = _plain_attributes(file["provenance"])
                self._misalignment_max: np.ndarray | None = file["joints"].attrs.get("misalignment_max")
                self._redundancy = str(file["joints"].attrs.get("redundancy", ""))
                self._names = {
                    name: tuple(file[name].asstr()[:])
                    for name in (
                        "trajectory/body",
                        "joints/joint",
                        "joints/first_body",
                        "joints/second_body",
                        "constraints/constraint",
                        "constraints/row_units",
                    )
                    if name in file
                }
        except SpecError:
            file.close()
            raise

    @classmethod
    def open(cls, path: Path) -> Run:
        """Open the archive at `path`; see `mbdkit.load`."""
        return cls(open_archive(path), path)

    @property
    def path(self) -> Path | None:
        """Where the archive lies; None if the run is in memory."""
        return self._path

    @property
    def status(self) -> str:
        """``complete``, ``failed``, ``interrupted``, or ``running`` if the run crashed."""
        return self._attributes["status"]

    @property
    def status_reason(self) -> str:
        """Why the run is not complete, or which event ended it: a code and a sentence; else empty."""
        return self._attributes["status_reason"]

    @property
    def run_id(self) -> str:
        """The name of this run, unique to it."""
        return self._attributes["run_id"]

    @property
    def created_utc(self) -> str:
        """When the archive was begun, ISO 8601, UTC."""
        return self._attributes["created_utc"]

    @property
    def format_version(self) -> str:
        """The version of the archive's format."""
        return self._attributes["format_version"]

    @property
    def spec_json(self) -> str:
        """The canonical JSON of the spec."""
        return self._attributes["spec"]

    @property
    def spec_sha256(self) -> str:
        """The hash of the spec."""
        return self._attributes["spec_sha256"]

    @property
    def data_sha256(self) -> str:
        """The hash of every array but timings; empty if the run crashed."""
        return self._attributes["data_sha256"]

    @cached_property
    def spec(self) -> dict[str, Any]:
        """The spec as it was run, defaults included, as plain values."""
        with reading("its spec", self.path):
            spec = json.loads(self.spec_json)
            if not isinstance(spec, dict):
                raise TypeError("it is not a mapping")
        return spec

    @property
    def stats(self) -> Mapping[str, int | float]:
        """Counters (steps, evaluations, factorizations, ...) and times in s (setup_s, wall_s, finish_s, cpu_s)."""
        return self._stats

    @property
    def provenance(self) -> Mapping[str, str | int | float]:
        """Versions, platform and command."""
        return self._provenance

    @property
    def time(self) -> np.ndarray:
        """Time of the recorded rows, (T,), s."""
        return self.array("trajectory/time")

    @property
    def elapsed(self) -> np.ndarray:
        """Wall time since the first step at the recorded rows, (T,), s."""
        return self.array("trajectory/elapsed_s")

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The names of the joints, in the order of the second axis of the arrays in ``/joints``."""
        return self._names["joints/joint"]

    @cached_property
    def bodies(self) -> Histories[BodyHistory]:
        """The bodies' motions by name."""
        names = self._names["trajectory/body"]
        return Histories("body", names, lambda name, index: BodyHistory(self, name, index))

    def __getitem__(self, name: str) -> BodyHistory:
        """Return the motion of the body `name`."""
        return self.bodies[name]

    @cached_property
    def joints(self) -> Histories[JointHistory]:
        """The joints' misalignments and reactions by name."""
        largest = self._largest_misalignments
        first, second = (self._names.get(f"joints/{which}_body", ()) for which in ("first", "second"))
        return Histories(
            "joint",
            self._names["joints/joint"],
            lambda name, index: JointHistory(
                self, name, index, float(largest[index]), (first[index], second[index]) if first else ("", "")
            ),
        )

    @property
    def redundancy(self) -> str:
        """Which joints hold what others hold already, such as ``1 redundant row: joint D``; empty if none does.

        Reactions are not unique then. The recorded ones are, of all that give the same motion, those of the least sum
        over joints of ``|force|^2 + (torque / length)^2``; the length [m] is the attribute ``characteristic_length`` of
        the group ``joints``.
        """
        return self._redundancy

    @cached_property
    def constraints(self) -> Histories[ConstraintHistory]:
        """The constraint rows' residuals and multipliers by name, ``joint.row``."""
        if "constraints/constraint" not in self._names:
            raise NotRecordedError("constraints")
        units = self._names["constraints/row_units"]
        return Histories(
            "constraint",
            self._names["constraints/constraint"],
            lambda name, index: ConstraintHistory(self, name, index, units[index]),
        )

    @property
    def singularity_distance(self) -> np.ndarray:
        """How far the mechanism is from a singular position at the recorded rows, (T,), true to about 1 %.

        The smallest singular value of the Jacobian of the independent constraints in the mass metric, with the rows of
        each joint's point made orthonormal: 1 where no joint feels another, 0 where joints block each other or let go.

        Raises
        ------
        MbdkitError
            If this run did not record it: without constraints, or by an earlier version.
        """
        return self.array("constraints/singularity_distance")

    @property
    def energy(self) -> Energy:
        """The energies of the mechanism."""
        return Energy(self)

    @property
    def steps(self) -> Steps:
        """What the integrator did in each recorded interval."""
        return Steps(self)

    @property
    def events(self) -> Events:
        """The crossings of the spec's events, in order of time; none where the spec has no events."""
        return Events.of(self, tuple(self.spec.get("events") or ()), len(self.bodies))

    @cached_property
    def _largest_misalignments(self) -> np.ndarray:
        if self._misalignment_max is not None:
            return np.asarray(self._misalignment_max)
        # A crashed run could not leave the maxima over every step: those over the recorded rows stand in.
        if not self.records("joints/misalignment"):
            return np.full(len(self.joint_names), np.nan)
        return np.asarray(np.max(self.array("joints/misalignment"), axis=0, initial=0.0))

    @property
    def misalignment_max(self) -> float:
        """Largest misalignment of any joint over every step, m; 0 without joints, nan if a crashed run left none."""
        return float(np.max(self._largest_misalignments, initial=0.0))

    def records(self, path: str) -> bool:
        """Return whether the run recorded the array at `path` of the layout."""
        try:
            self.dataset(path)
        except NotRecordedError:
            return False
        return True

    def array(self, path: str) -> np.ndarray:
        """Return a whole array of the archive, read-only.

        Parameters
        ----------
        path
            Such as ``joints/misalignment``, (T, J); shapes and units are in the table of the archive's layout.

        Raises
        ------
        UnknownNameError
            If there is no such array in the layout.
        MbdkitError
            If this run did not record it, or is closed.
        """
        if path not in self._arrays:
            values = self._read(path, ())
            if values.nbytes > KEEP_BYTES:
                return values
            self._arrays[path] = values
        return self._arrays[path]

    def column(self, path: str, index: int | None, part: slice | int | None) -> np.ndarray:
        """Return an array at `index` of its second axis and `part` of its third, read-only."""
        at: tuple[Any, ...] = (slice(None),)
        if index is not None:
            at += (index,)
        if part is not None:
            at += (part,)
        if path in self._arrays or self.dataset(path).nbytes <= KEEP_BYTES:
            column: np.ndarray = self.array(path)[at]
            return column
        return self._read(path, at)

    def dataset(self, path: str) -> h5py.Dataset | np.ndarray:
        """Return an array of the archive unread, to be sliced: for those that are larger than memory.

        Parameters
        ----------
        path
            Such as ``trajectory/position``, (T, B, 3).

        Returns
        -------
        h5py.Dataset or ndarray
            An empty array where a run crashed before it wrote its first rows.

        Raises
        ------
        UnknownNameError
            If there is no such array in the layout.
        NotRecordedError
            If this run did not record it.
        MbdkitError
            If the run is closed.
        """
        file = self.file
        with reading(path, self.path):
            if path in file:
                return file[path]
        array = layout.BY_PATH.get(path)
        if array is None:
            raise UnknownNameError("array", path, list(layout.BY_PATH))
        group = file.get(array.group)
        if self.status == "running" and array.grows and not array.optional and group is not None:
            return np.empty((0, *(len(group[dim]) for dim in array.dims[1:])), array.dtype)
        raise NotRecordedError(path)

    @property
    def file(self) -> h5py.File:
        """The open archive, for whatever this class does not offer."""
        if not self._file:
            raise MbdkitError(f"this run is closed; load {self._path} again" if self._path else "this run is closed")
        return self._file

    def _read(self, path: str, at: tuple[Any, ...]) -> np.ndarray:
        dataset = self.dataset(path)
        with reading(path, self.path):
            if isinstance(dataset, h5py.Dataset) and is_text(dataset):
                dataset = dataset.asstr()
            values = np.asarray(dataset[at])
        values.flags.writeable = False
        return values

    def check(self) -> Run:
        """Return the run if it is complete.

        Raises
        ------
        RunError
            If it failed, was interrupted or crashed; the message says why.
        """
        if self.status == "complete":
            return self
        if self.status == "running":
            raise RunError("the run did not end: it crashed, or is still under way")
        reason = self.status_reason.removeprefix("interrupted: ")
        why = f": {reason}" if reason else ""
        raise RunError(f"the run {'failed' if self.status == 'failed' else 'was interrupted'}{why}")

    def summary(self) -> str:
        """Return what matters about the run on a few lines of plain text."""
        from mbdkit.archive.run_summary import summary  # the one import against the layers: a convenience for users

        return summary(self)

    def to_xarray(self) -> xarray.DataTree:
        """Return the archive as an xarray tree, in memory: the same as `xarray.open_datatree` gives for the file.

        Raises
        ------
        MbdkitError
            If xarray is not installed.
        """
        from mbdkit.archive.xarray_tree import to_datatree

        with reading("something", self.path):
            return to_datatree(self.file)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the archive to a file, byte for byte.

        Parameters
        ----------
        path
            The name, ending in ``.h5``.
        overwrite
            Whether an existing file may be replaced.

        Raises
        ------
        SpecError
            If no archive may be written there.
        MbdkitError
            If the disk is full, or the run is closed.
        """
        image = self.file.id.get_file_image()
        target = Target(Path(path), overwrite=overwrite)
        try:
            target.replace_content(image)
        except OSError as error:
            target.drop()
            raise MbdkitError(f"{path} cannot be written: {cause(error)}") from error
        try:
            target.publish()
        finally:
            target.close()

    def close(self) -> None:
        """Release the archive; arrays read before stay valid."""
        self._file.close()

    def __enter__(self) -> Run:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __reduce__(self) -> tuple[Any, ...]:
        if self._path is None:
            raise TypeError("a run in memory cannot be pickled; save it to a file and load that")
        return Run.open, (self._path.resolve(),)

    def __repr__(self) -> str:
        where = "in memory" if self._path is None else str(self._path)
        return f"<Run {self.run_id} {self.status}, {len(self._names['trajectory/body'])} bodies, {where}>"


def _plain_attributes(group: h5py.Group) -> Mapping[str, Any]:
    return MappingProxyType(
        {name: value.item() if isinstance(value, np.generic) else value for name, value in group.attrs.items()}
    )
