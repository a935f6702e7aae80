"""The data that a run recorded: arrays by path, which are read on demand, and histories by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import h5py
import numpy as np

from mbdkit.archive import history, run_header
from mbdkit.archive.fingerprint import is_text
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.named_columns import NotRecordedError, histories_of
from mbdkit.archive.read_only_dict import ReadOnlyDict
from mbdkit.archive.recorded_columns import FurtherKinds
from mbdkit.archive.run_contents import ArchiveContents, Header, RunContents
from mbdkit.base.parts import GROUPS_OF_PARTS
from mbdkit.quantities.array import Kind
from mbdkit.quantities.registered_kinds import groups, kind_of_group, kind_of_word, words
from mbdkit.registry.accessors import Extensible

#: Arrays larger than this [bytes] are not cached, and are read column by column.
KEEP_BYTES = 1 << 28

T = TypeVar("T")

#: Constraint rows of drivers; no other joint has exactly one of these rows.
_ROWS_OF_DRIVERS = (["angle"], ["x"], ["y"])


class evaluated(cached_property[T]):  # noqa: N801
    """A property whose value is not kept, and that IPython evaluates for completion, which it refuses for `property`.

    The histories of a run refer to the run. A run that kept them would be part of a reference cycle, and its arrays
    would be freed only when Python collects garbage, which is seldom if there are few objects.
    """

    if not TYPE_CHECKING:

        def __get__(self, run: RecordedData | None, owner: type | None = None) -> Any:
            return self if run is None else self.func(run)


class RecordedData(FurtherKinds, Extensible):
    """Base class of `Run`: what it recorded, as arrays by path and as histories by name."""

    def __new__(cls, *arguments: object, **named: object) -> Self:
        """Make an object of the class, which has the histories of all kinds, also of those of plugins."""
        for word in {*words(), *GROUPS_OF_PARTS}:
            if not hasattr(cls, word):
                histories = _histories_of(word)
                setattr(cls, word, histories)
                histories.__set_name__(cls, word)
        return super().__new__(cls, *arguments, **named)

    def __init__(self, contents: RunContents | h5py.File):
        self._contents = contents if isinstance(contents, RunContents) else ArchiveContents(contents)
        self._arrays: dict[str, np.ndarray] = {}

    @property
    def _header(self) -> Header:
        return self._contents.header

    @cached_property
    def _names(self) -> Mapping[str, tuple[str, ...]]:
        return self._contents.names

    @property
    def kinds(self) -> Mapping[str, Kind]:
        """Kinds of quantities by group: those of the core, and those of plugins whose groups the run has."""
        return self._contents.kinds

    @property
    def path(self) -> Path | None:
        """Path of the archive; None if the run is in memory."""
        return self._contents.path

    @property
    def format_version(self) -> str:
        """Version of the archive format."""
        return self._header.attributes["format_version"]

    @property
    def spec_json(self) -> str:
        """Canonical JSON of the spec."""
        return self._header.attributes["spec"]

    @cached_property
    def spec(self) -> dict[str, Any]:
        """The spec of the run, including defaults, as plain values."""
        with reading("its spec", self.path):
            return run_header.spec_of(self.spec_json)

    @property
    def time(self) -> np.ndarray:
        """Time of the recorded rows, (T,), s."""
        return self.array("trajectory/time")

    @property
    def elapsed(self) -> np.ndarray:
        """Wall time from the first step to each recorded row, (T,), s."""
        return self.array("trajectory/elapsed_s")

    def records(self, path: str) -> bool:
        """Return whether the run recorded the array at `path` of the layout."""
        group = path.partition("/")[0]
        if group not in self.kinds and group in (*groups(), *GROUPS_OF_PARTS):
            return False
        try:
            self.dataset(path)
        except NotRecordedError:
            return False
        return True

    def array(self, path: str) -> np.ndarray:
        """Return a whole array of the archive as a read-only array.

        Parameters
        ----------
        path
            Path such as ``joints/misalignment``, (T, J). The layout of the archive lists paths, shapes and units.

        Raises
        ------
        UnknownNameError
            If there is no such array in the layout.
        MbdkitError
            If the run did not record the array, or is closed.
        """
        if path not in self._arrays:
            values = self._read(path, ())
            if values.nbytes > KEEP_BYTES:
                return values
            self._arrays[path] = values
        return self._arrays[path]

    def column(self, path: str, index: int | slice | None, part: slice | int | None) -> np.ndarray:
        """Return the array at `path` at an `index` of its second axis and a `part` of its third; read-only."""
        at = (slice(None), *(axis for axis in (index, part) if axis is not None))
        if path in self._arrays or self.dataset(path).nbytes <= KEEP_BYTES:
            return np.asarray(self.array(path)[at])
        return self._read(path, at)

    def dataset(self, path: str) -> h5py.Dataset | np.ndarray:
        """Return an array of the archive as an HDF5 dataset, to be read by slicing if it exceeds the memory.

        Parameters
        ----------
        path
            Path such as ``trajectory/position``, (T, B, 3).

        Returns
        -------
        h5py.Dataset or ndarray
            The dataset. It is an ndarray if the arrays of the run are in memory. It is also an ndarray, with the
            complete rows only, if the run crashed while it wrote the array.

        Raises
        ------
        UnknownNameError
            If there is no such array in the layout.
        NotRecordedError
            If the run did not record the array.
        MbdkitError
            If the run is closed.
        """
        return self._contents.dataset(path)

    def _read(self, path: str, at: tuple[int | slice, ...]) -> np.ndarray:
        dataset = self.dataset(path)
        with reading(path, self.path):
            if isinstance(dataset, h5py.Dataset) and is_text(dataset):
                dataset = dataset.asstr()
            values = np.asarray(dataset[at])
        values.flags.writeable = False
        return values

    def text(self, path: str, index: int | slice | None) -> str:
        """Return one of the texts in the array at `path`; an empty text if the archive lacks the array."""
        texts = self._names.get(path, ())
        return texts[index] if isinstance(index, int) and index < len(texts) else ""

    def objects(self, kind: Kind) -> Sequence[str]:
        """Return the name of the object of each element along the axis of a kind.

        Raises
        ------
        NotRecordedError
            If the run did not record the kind.
        """
        if kind.named_by in self._names:
            return self._names[kind.named_by]
        if kind.is_chosen:
            output = self.spec.get("output")
            asked = output.get("quantities") if isinstance(output, Mapping) else None
            is_left_out = isinstance(asked, list) and kind.group not in asked
            if is_left_out or not kind.is_optional:
                raise NotRecordedError(kind.group)
        return ()

    @evaluated
    def bodies(self) -> history.BodyHistories:
        """Motions of the bodies by name.

        Examples
        --------
        >>> import mbdkit
        >>> run = mbdkit.run("double-pendulum", time={"end": 1.0, "step": 0.01})
        >>> run.bodies["rod1"].position.shape
        (101, 2)
        """
        return history.BodyHistories(kind_of_word("bodies"), self)

    def __getitem__(self, name: str) -> history.BodyHistory:
        """Return the motion of the body `name`."""
        return self.bodies[name]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.bodies)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the second axis of the arrays in ``/joints``."""
        return self._names["joints/joint"]

    @evaluated
    def joints(self) -> history.JointHistories:
        """Misalignments, reactions and angles of the joints by name.

        Examples
        --------
        >>> import mbdkit
        >>> run = mbdkit.run("double-pendulum", time={"end": 1.0, "step": 0.01})
        >>> list(run.joints)
        ['J1', 'J2']
        >>> run.joints["J2"].reaction_force.shape
        (101, 2)
        """
        return history.JointHistories(kind_of_word("joints"), self)

    @cached_property
    def joint_misalignments(self) -> np.ndarray:
        """Largest misalignment of each joint over all steps, (J,), m.

        After a crash, only the recorded rows count; nan if they do not contain the misalignment.
        """
        if self._header.misalignment_max is not None:
            return self._header.misalignment_max
        # The archive of a crashed run lacks the maxima over all steps; use the maxima over the recorded rows.
        if not self.records("joints/misalignment"):
            return np.full(len(self.joint_names), np.nan)
        return np.asarray(np.max(self.array("joints/misalignment"), axis=0, initial=0.0))

    @property
    def misalignment_max(self) -> float:
        """Largest misalignment of any joint over all steps, m; 0 without joints.

        For crashed runs, see `joint_misalignments`.
        """
        return float(np.max(self.joint_misalignments, initial=0.0))

    @cached_property
    def drivers(self) -> tuple[str, ...]:
        """Names of the joints that are drivers, such as motors."""
        rows: dict[str, list[str]] = {}
        for constraint in self._names.get("constraints/constraint", ()):
            joint, _, row = constraint.rpartition(".")
            rows.setdefault(joint, []).append(row)
        return tuple(name for name in self.joint_names if rows.get(name) in _ROWS_OF_DRIVERS)

    @property
    def singularity_distance(self) -> np.ndarray:
        """Distance from a singular position at the recorded rows, (T,), accurate to about 1 %.

        This is the smallest singular value of the Jacobian of the independent constraints in the mass metric, with the
        rows of each joint point orthonormalized. It is 1 if the joints are uncoupled, and 0 in a singular position,
        where the rows are linearly dependent.

        Raises
        ------
        MbdkitError
            If the run did not record it, because the mechanism has no constraints.
        """
        return self.array("constraints/singularity_distance")

    @property
    def energy(self) -> history.Energy:
        """Energies of the mechanism; `Energy` says which losses count as `dissipated` and which as `work`."""
        return history.Energy(self)

    @property
    def steps(self) -> history.Steps:
        """Statistics of the integrator for each recorded interval."""
        return history.Steps(self)

    @cached_property
    def impacts(self) -> history.Impacts:
        """Impacts of elements, and impulses of drivers whose velocities jump, in order of time."""
        return history.Impacts.of(self)

    @property
    def events(self) -> history.Events:
        """Crossings of the spec's events in order of time; empty if the spec has no events."""
        return history.Events.of(self, tuple(self.spec.get("events") or ()), len(self.bodies))


def recorded_outputs(run: RecordedData) -> dict[str, list[list[float]]] | None:
    """Return what the functions of controllers in Python have returned in a run, one list for each sample, by the name
    of the controller; None if the run has no such controllers.
    """
    if not run.records("samples/value"):
        return None
    times, outputs, values = (run.array(f"samples/{name}").tolist() for name in ("time", "output", "value"))
    return outputs_by_sample(times, outputs, values)


def outputs_by_sample(
    times: Sequence[float], outputs: Sequence[str], values: Sequence[float]
) -> dict[str, list[list[float]]]:
    """Return recorded outputs, ``controller.output``, as one list for each sample by the name of the controller."""
    results: dict[str, list[list[float]]] = {}
    latest: dict[str, float] = {}
    for time, output, value in zip(times, outputs, values, strict=True):
        controller = output.rpartition(".")[0]
        if latest.get(controller) != time:
            results.setdefault(controller, []).append([])
            latest[controller] = time
        results[controller][-1].append(value)
    return results


def _histories_of(word: str) -> evaluated[Any]:
    """Return a property whose value contains the histories of the objects of a kind by name."""

    def histories(run: RecordedData) -> object:
        group = words().get(word, word)
        kind = run.kinds.get(group) or (kind_of_group(group) if group in groups() else None)
        return histories_of(kind)(kind, run) if kind else ReadOnlyDict()

    histories.__doc__ = f"Histories of the objects of the kind {word} by name; empty if the run has none."
    return evaluated(histories)
