"""A run whose arrays are in memory, as those that a block of a study holds, with the interface of `Run`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.finished_run import FinishedRun
from mbdkit.archive.history import NotRecordedError, UnknownNameError
from mbdkit.archive.measured_values import Integrals, MeasuredValues
from mbdkit.archive.read_only_dict import ReadOnlyDict
from mbdkit.archive.run import Run
from mbdkit.archive.run_writer import name_texts
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base.errors import MbdkitError
from mbdkit.spec import RunSpec


@dataclass(frozen=True)
class Heading:
    """What the archive of a run says about its spec and its origin.

    Parameters
    ----------
    spec
        Its spec.
    run_id
        Its identifier.
    created_utc
        Time at which it was stored, ISO 8601.
    provenance
        Attributes of ``/provenance``.
    """

    spec: RunSpec
    run_id: str
    created_utc: str = ""
    provenance: Mapping[str, str | int | float] = field(default_factory=dict)


class NotStoredError(NotRecordedError):
    """The requested array was recorded by the run, but the study does not keep it."""

    def __init__(self, what: str, store: str):
        MbdkitError.__init__(
            self, f"this study keeps no {what} (store: {store}); `study.remake(number)` computes the run again"
        )


class StoredRun(Run):
    """A run in memory.

    Parameters
    ----------
    finished
        Its results; arrays that are not kept are missing in `FinishedRun.layout`.
    heading
        Its spec and origin.
    store
        What is kept of each run, if that is not everything; empty otherwise.
    measured
        Values of the measures in its spec.
    """

    def __init__(
        self, finished: FinishedRun, heading: Heading, store: str = "", measured: MeasuredValues | None = None
    ):
        self._measured = measured or MeasuredValues({}, {})
        self._finished, self._heading, self._store = finished, heading, store
        self._path = None
        self.cause = finished.cause
        self._arrays: dict[str, np.ndarray] = {}
        self._attributes = {
            "format_version": layout.FORMAT_VERSION,
            "status": finished.status,
            "status_reason": finished.reason,
            "run_id": heading.run_id,
            "created_utc": heading.created_utc,
            "spec": heading.spec.canonical_json(),
            "spec_sha256": heading.spec.sha256(),
            "data_sha256": finished.data_sha256,
        }
        assembly = {"assembly": finished.assembly} if finished.assembly else {}
        self._provenance = MappingProxyType({**heading.provenance, **assembly})
        self._verdict, self._reasons = finished.judgement.level, tuple(finished.judgement.reasons)
        self._warnings, self._stats = finished.warnings, MappingProxyType(dict(finished.stats))
        self._misalignment_max = finished.misalignment_max
        self._redundancy = "" if finished.shared is None else finished.shared.redundancy

    @property
    def finished(self) -> FinishedRun:
        """The results."""
        return self._finished

    @property
    def run_spec(self) -> RunSpec:
        """The spec of the run as a validated object."""
        return self._heading.spec

    @cached_property
    def _texts_of(self) -> dict[str, tuple[str, ...]]:
        """Names along the axes, by path."""
        texts = name_texts(self._finished.names)
        return {one.path: tuple(texts[one.path]) for one in self._finished.layout if not one.grows}

    @cached_property
    def _recorded(self) -> frozenset[str]:
        """Paths of the arrays with rows."""
        return frozenset([one.path for one in self._finished.layout if one.grows])

    @cached_property
    def _names(self) -> dict[str, tuple[str, ...]]:  # type: ignore[override]
        names = self._finished.names
        return {**self._texts_of, "trajectory/body": tuple(names.bodies), "joints/joint": tuple(names.joints)}

    def array(self, path: str) -> np.ndarray:
        """Return a whole array as a read-only array."""
        values = self.dataset(path).view()
        values.flags.writeable = False
        return values

    def dataset(self, path: str) -> np.ndarray:
        """Return an array of the run."""
        if path in self._recorded:
            return self._finished.arrays[layout.BY_PATH[path].key]
        if path in self._texts_of:
            return np.array(self._texts_of[path], object)
        if path not in layout.BY_PATH:
            raise UnknownNameError("array", path, list(layout.BY_PATH))
        if self._store:
            raise NotStoredError(path, self._store)
        raise NotRecordedError(path, self.format_version)

    @property
    def measures(self) -> MeasuredValues:
        """Values of the measures in the spec of the run by name, each in its unit; nan where one is undefined."""
        return self._measured

    @property
    def integrals(self) -> Integrals:
        """Time integrals by their integrands."""
        return self._finished.integrals

    @cached_property
    def gradients(self) -> Mapping[str, Mapping[str, Any]]:
        """Empty: gradients are computed only for runs with an archive of their own."""
        return ReadOnlyDict({})

    @cached_property
    def accuracy(self) -> Accuracy | None:
        """Estimated errors of the recorded rows; None if the run was not checked, or if they are not kept."""
        return self._finished.accuracy

    @cached_property
    def file(self) -> h5py.File:
        """An HDF5 file in memory with the contents of the run; raises MbdkitError if not all of its arrays are kept."""
        if self._store:
            raise NotStoredError("complete archive", self._store)
        finished, heading = self._finished, self._heading
        writer = ArchiveWriter(
            None,
            finished.names,
            heading.spec.canonical_json(),
            heading.spec.sha256(),
            heading.run_id,
            self._provenance,
            arrays=finished.layout,
            shared=finished.shared,
        )
        finished.write(writer)
        measured = (lambda file: self.measures.to_json()) if self.measures else None
        file = writer.finish(finished.ending, measured=measured)
        assert file is not None
        file.attrs.modify("data_sha256", finished.data_sha256)
        return file

    def close(self) -> None:
        """Release the HDF5 file in memory, if there is one."""
        if "file" in self.__dict__:
            self.__dict__.pop("file").close()
