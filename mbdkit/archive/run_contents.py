"""The contents of a `Run`: the interface, and its two implementations, an archive in HDF5 and arrays in memory."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from operator import methodcaller
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import h5py
import numpy as np

from mbdkit.archive import layout, run_header
from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.fingerprint import StoredHashes
from mbdkit.archive.finished_run import FinishedRun
from mbdkit.archive.hdf5 import set_text
from mbdkit.archive.hdf5_errors import closed_on_error, reading
from mbdkit.archive.layout import name_texts
from mbdkit.archive.measured_values import Integrals, MeasuredValues, integrals_from_json
from mbdkit.archive.named_columns import NotRecordedError
from mbdkit.archive.plain_spec import PlainSpec
from mbdkit.archive.read_only_dict import ReadOnlyDict
from mbdkit.archive.result_table import ResultTable, is_table
from mbdkit.archive.run_header import open_archive
from mbdkit.archive.run_writer import Ending, Origin, SharedForces
from mbdkit.archive.stored_kinds import kinds_of_file
from mbdkit.archive.stored_mechanism import StoredMechanism, built_mechanism, read_mechanism
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base import higher_layers
from mbdkit.base.errors import MbdkitError, UnknownNameError
from mbdkit.base.files_read import FileRead, read_files
from mbdkit.base.frozen import dataclass, field, replace
from mbdkit.base.plain_data import json_data
from mbdkit.quantities.array import FLOAT, Kind
from mbdkit.quantities.registered_kinds import array_at, kinds
from mbdkit.spec import RunSpec

_Provenance = Mapping[str, str | int | float]


@dataclass(frozen=True, eq=False)
class Header:
    """The data of a run except its arrays.

    - `attributes`: values of `layout.ROOT_ATTRIBUTES`.
    - `verdict`, `verdict_reasons`, `warnings`: verdict on the run, its reasons, and warnings; empty if the run crashed.
    - `stats`: counters and times [s].
    - `misalignment_max`: (J,) largest misalignment of each joint over all steps [m]; None if unknown.
    - `redundancy`: description of the redundant constraints; empty if there are none.
    """

    attributes: Mapping[str, str]
    verdict: str = ""
    verdict_reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    stats: Mapping[str, int | float] = field(default_factory=ReadOnlyDict)
    misalignment_max: np.ndarray | None = None
    redundancy: str = ""

    @classmethod
    def of(cls, attributes: Mapping[str, str], ending: Ending, shared: SharedForces | None) -> Header:
        """Return the header of a run that has ended."""
        return cls(
            attributes,
            ending.judgement.level,
            tuple(ending.judgement.reasons),
            ending.warnings,
            ReadOnlyDict(ending.stats),
            np.asarray(ending.misalignment_max, FLOAT),
            "" if shared is None else shared.redundancy,
        )


class RunContents(ABC):
    """Interface through which a `Run` reads its data.

    - `header`: status, spec, verdict and counters.
    - `provenance`: attributes of ``/provenance``.
    - `names`: names and units along the axes, by path.
    - `kinds`: kinds of quantities by group: those of the core, and those of plugins whose groups the run has.
    - `path`: path of the archive; None without a file.
    - `run_spec`: the validated spec; None if it has to be read from `header`.
    - `cause`: the exception of a plugin that ended the run in this process.
    - `measures`: values of the measures in the spec.
    - `integrals`: integrals over time and extrema by their expressions.
    - `gradients`: gradients of the measures; see `Run.gradients`.
    - `accuracy`: estimated errors; None if there are none, or if a study did not store them.
    - `tables`: tables of further results by name.
    """

    header: Header
    provenance: _Provenance
    names: Mapping[str, tuple[str, ...]]
    path: Path | None = None
    run_spec: RunSpec | None = None
    cause: BaseException | None = None
    kinds: Mapping[str, Kind]
    measures: MeasuredValues
    integrals: Integrals
    gradients: Mapping[str, Mapping[str, Any]]
    accuracy: Accuracy | None
    tables: Mapping[str, ResultTable]

    @abstractmethod
    def dataset(self, path: str) -> h5py.Dataset | np.ndarray:
        """Return an array; see `Run.dataset`."""

    @abstractmethod
    def mechanism(self) -> StoredMechanism:
        """Return the mechanism that was run, as far as it is known."""

    @property
    @abstractmethod
    def files(self) -> Sequence[FileRead]:
        """The files that were read for the run."""

    @property
    @abstractmethod
    def file(self) -> h5py.File:
        """The contents as an HDF5 file."""

    def verify(self, below: str = "") -> None:  # noqa: B027
        """Raise ArchiveError if an array at a path or below it has changed since it was written to a file."""

    @abstractmethod
    def close(self) -> None:
        """Release the file, if there is one."""


class ArchiveContents(RunContents):
    """The contents of an archive.

    `file`: the open archive. It is closed if its header is damaged. `path`: path of the archive; None if it is in
    memory. `header`, `provenance`: those of the archive, if they are known already; by default, they are read. Raises
    ArchiveError if the header is read and is damaged.
    """

    def __init__(
        self,
        file: h5py.File,
        path: Path | None = None,
        header: Header | None = None,
        hashes: StoredHashes | None = None,
        provenance: _Provenance | None = None,
    ):
        self._file, self.path, self._hashes = file, path, hashes
        if header is not None and provenance is not None:
            self.header, self.provenance = header, ReadOnlyDict(provenance)
            return
        with closed_on_error(file), reading("its header", path):
            self.header = self._read_header()
            self.provenance = run_header.plain_attributes(file["provenance"])

    @cached_property
    def names(self) -> Mapping[str, tuple[str, ...]]:  # type: ignore[override]
        """See `RunContents`."""
        with reading("its names", self.path):
            paths = [
                array.path
                for kind in self.kinds.values()
                for array in kind.arrays
                if kind.axis and (array.label or array.path == kind.named_by)
            ]
            present = [path for path in paths if path in self.file]
            for path in present:
                self.verify(path)
            return {path: run_header.names(self.file, path) for path in present}

    @cached_property
    def kinds(self) -> Mapping[str, Kind]:  # type: ignore[override]
        """See `RunContents`."""
        return kinds_of_file(self.file)

    @classmethod
    def open(cls, path: Path) -> ArchiveContents:
        """Open the archive at a path, and check its header, its names and the shapes of its arrays."""
        file = open_archive(path)
        with closed_on_error(file):
            with reading("its contents", path):
                # archives of crashed runs have no hashes
                is_sealed = file.attrs.get("status") != "running" or layout.ATTRIBUTES_HASH in file.attrs
                hashes = StoredHashes(file) if is_sealed else None
            with reading("its arrays", path):
                known = kinds_of_file(file)
                run_header.check_shapes(file, known.values())
            contents = cls(file, path, hashes=hashes)
            contents.kinds = known
            assert contents.names is not None
        return contents

    @classmethod
    def just_written(cls, writer: ArchiveWriter) -> ArchiveContents:
        """Open an archive that this process has just written; the header is taken from the writer."""
        path, ending = writer.path, writer.ending
        assert path is not None
        assert ending is not None
        header = Header.of(writer.head, ending, writer.shared)
        with reading("its header", path):
            file = h5py.File(path, "r", locking="best-effort")
        contents = cls(file, path, header, provenance=writer.origin.provenance)
        contents.cause = ending.cause
        return contents

    def _read_header(self) -> Header:
        file = self._file
        attributes = {name: str(file.attrs[name]) for name in layout.ROOT_ATTRIBUTES}
        redundancy = str(file["joints"].attrs.get("redundancy", ""))
        if attributes["status"] == "running":  # a crash may have left the other attributes incomplete
            return Header(attributes, redundancy=redundancy)
        reasons, warnings = (
            tuple(map(str, np.atleast_1d(file.attrs.get(name, ())))) for name in ("verdict_reasons", "warnings")
        )
        return Header(
            attributes,
            str(file.attrs.get("verdict", "")),
            reasons,
            warnings,
            run_header.numbers(file["stats"]),
            run_header.misalignments(file),
            redundancy,
        )

    def dataset(self, path: str) -> h5py.Dataset | np.ndarray:
        """Return an array; see `Run.dataset`."""
        file = self.file
        kind = self.kinds.get(path.partition("/")[0])
        array = array_at(path) if kind is None else kind.by_path.get(path)
        with reading(path, self.path):
            if path in file:
                self.verify(path)
                return file[path]
        if array is None:
            raise UnknownNameError("array", path, [array.path for array in layout.every_array()])
        raise NotRecordedError(path)

    @cached_property
    def measures(self) -> MeasuredValues:  # type: ignore[override]
        """See `RunContents`."""
        with reading("the measures", self.path):
            return MeasuredValues.from_json(str(self.file.attrs.get(layout.MEASURES, "{}")))

    @cached_property
    def integrals(self) -> Integrals:  # type: ignore[override]
        """See `RunContents`."""
        with reading("the integrals", self.path):
            return integrals_from_json(str(self.file.attrs.get(layout.INTEGRALS, "{}")))

    @cached_property
    def gradients(self) -> Mapping[str, Mapping[str, Any]]:  # type: ignore[override]
        """See `RunContents`."""
        with reading("the gradients", self.path):
            return ReadOnlyDict(json_data(str(self.file.attrs.get(layout.GRADIENTS, "{}"))))

    def mechanism(self) -> StoredMechanism:
        """Return the mechanism that was run."""
        with reading("its mechanism", self.path):
            text = self.file.attrs.get(layout.MECHANISM)  # absent if another program has written the archive
            if text is not None:
                return read_mechanism(str(text), self.names["trajectory/body"])
            return built_mechanism(run_header.spec_of(self.header.attributes["spec"]))

    @property
    def files(self) -> Sequence[FileRead]:
        """The files that were read for the run."""
        with reading("its files", self.path):
            return read_files(str(self.file.attrs.get(layout.FILES, "[]")))

    @cached_property
    def accuracy(self) -> Accuracy | None:  # type: ignore[override]
        """See `RunContents`."""
        self.verify("accuracy")
        with reading("accuracy", self.path):
            group = self.file.get("accuracy")
            return None if group is None else Accuracy.read(group)

    @cached_property
    def tables(self) -> Mapping[str, ResultTable]:  # type: ignore[override]
        """See `RunContents`."""
        with reading("its tables", self.path):
            for name in filter(lambda name: is_table(self.file[name]), self.file):
                self.verify(name)
            return ReadOnlyDict(ResultTable.of_file(self.file))

    def verify(self, below: str = "") -> None:
        """See `RunContents`."""
        if self._hashes is not None and self._file:
            with reading(below or "its contents", self.path):
                self._hashes.verify(below)

    @property
    def file(self) -> h5py.File:
        """The archive."""
        if not self._file:
            raise MbdkitError(f"this run is closed; load {self.path} again" if self.path else "this run is closed")
        return self._file

    def close(self) -> None:
        """Close the archive."""
        self._file.close()


class NotStoredError(NotRecordedError):
    """The run recorded the requested array, but the study does not store it."""

    def __init__(self, what: str, store: str):
        MbdkitError.__init__(
            self, f"this study keeps no {what} (store: {store}); `study.remake` computes the run again"
        )


class _Spec:
    """A spec, or what a function returns when it is needed first."""

    def __init__(self, given: RunSpec | PlainSpec | Callable[[], RunSpec]):
        self._given = given

    @cached_property
    def spec(self) -> RunSpec | PlainSpec:
        """The spec."""
        return self._given() if callable(self._given) else self._given


class LateTexts(Mapping[str, str]):
    """Texts by name; those that are functions of the spec are computed when they are needed first."""

    def __init__(self, texts: dict[str, Any], spec: _Spec):
        self._texts, self._spec = texts, spec

    def __getitem__(self, name: str) -> str:
        text = self._texts[name]
        if callable(text):
            self._texts[name] = text = text(self._spec.spec)
        return str(text)

    def __iter__(self) -> Iterator[str]:
        return iter(self._texts)

    def __len__(self) -> int:
        return len(self._texts)


class ArrayContents(RunContents):
    """A run whose arrays are in memory, such as one read from a block of a study.

    - `finished`: the results; `FinishedRun.layout` lists only the arrays that are stored.
    - `spec`: spec of the run.
    - `run_id`, `created_utc`, `provenance`: see `Origin`.
    - `mechanism`: the mechanism; None for that of `spec`.
    - `store`: which arrays the study stores of each run; empty if it stores all.
    - `measured`: values of the measures in the spec.
    - `gradients`: gradients of the measures as JSON; empty if there are none.

    The results of a run that is complete, and its spec, may be functions, which are called once, when they are needed;
    so may run_id and provenance, which are functions of the spec.
    """

    def __init__(
        self,
        finished: FinishedRun | Callable[[], FinishedRun],
        spec: RunSpec | PlainSpec | Callable[[], RunSpec],
        *,
        run_id: str | Callable[[RunSpec], str] = "",
        created_utc: str = "",
        provenance: _Provenance | Callable[[RunSpec], _Provenance] = MappingProxyType({}),
        mechanism: StoredMechanism | None = None,
        store: str = "",
        measured: MeasuredValues | None = None,
        gradients: str = "",
    ):
        self._given, self._mechanism, self._store = (finished, provenance), mechanism, store
        self._spec = _Spec(spec)
        self._identified = run_id, created_utc
        self.measures = measured or MeasuredValues({}, {})
        self.gradients, self._gradients = ReadOnlyDict(json.loads(gradients or "{}")), gradients
        self._closed = False
        self.cause = None if callable(finished) else finished.cause

    @cached_property
    def _finished(self) -> FinishedRun:
        finished = self._given[0]
        return finished() if callable(finished) else finished

    @property
    def run_spec(self) -> RunSpec | None:  # type: ignore[override]
        """See `RunContents`."""
        return self._spec.spec if isinstance(self._spec.spec, RunSpec) else None

    @property
    def integrals(self) -> Integrals:  # type: ignore[override]
        """See `RunContents`."""
        return self._finished.integrals

    @property
    def accuracy(self) -> Accuracy | None:  # type: ignore[override]
        """See `RunContents`."""
        return self._finished.accuracy

    @property
    def tables(self) -> Mapping[str, ResultTable]:  # type: ignore[override]
        """See `RunContents`."""
        return self._finished.tables

    @cached_property
    def provenance(self) -> _Provenance:  # type: ignore[override]
        """See `RunContents`."""
        given = self._given[1]
        entries = given(cast(RunSpec, self._spec.spec)) if callable(given) else given
        assembly = {"assembly": self._finished.assembly} if self._finished.assembly else {}
        return ReadOnlyDict({**entries, **assembly})

    @cached_property
    def header(self) -> Header:  # type: ignore[override]
        """See `RunContents`."""
        finished, (run_id, created_utc) = self._finished, self._identified
        attributes = LateTexts(
            {
                "format_version": layout.FORMAT_VERSION,
                "status": finished.status,
                "status_reason": finished.reason,
                "run_id": run_id,
                "created_utc": created_utc,
                "spec": methodcaller("canonical_json"),
                "spec_sha256": methodcaller("sha256"),
                "data_sha256": finished.data_sha256,
            },
            self._spec,
        )
        return Header.of(attributes, finished, finished.shared)

    @cached_property
    def _texts(self) -> Mapping[str, tuple[str, ...]]:
        texts = name_texts(self._finished.names)
        return {array.path: tuple(texts[array.path]) for array in self._finished.layout if not array.grows}

    @cached_property
    def kinds(self) -> Mapping[str, Kind]:  # type: ignore[override]
        """See `RunContents`."""
        return {kind.group: kind for kind in kinds(array.group for array in self._finished.layout)}

    @cached_property
    def _recorded(self) -> frozenset[str]:
        return frozenset([array.path for array in self._finished.layout if array.grows])

    @cached_property
    def names(self) -> Mapping[str, tuple[str, ...]]:  # type: ignore[override]
        """See `RunContents`."""
        names = self._finished.names
        return {**self._texts, "trajectory/body": tuple(names.bodies), "joints/joint": tuple(names.joints)}

    def dataset(self, path: str) -> np.ndarray:
        """Return an array; see `Run.dataset`."""
        self._check_open()
        if path in self._recorded:
            return self._finished.arrays[self.kinds[path.partition("/")[0]].by_path[path].key]
        if path in self._texts:
            return np.array(self._texts[path], object)
        if self._finished.accuracy is not None and path.startswith("accuracy/"):
            names = self._finished.names
            of_accuracy = self._finished.accuracy.arrays(names.bodies, names.joints)
            if path in of_accuracy:
                return of_accuracy[path]
        if array_at(path) is None:
            raise UnknownNameError("array", path, [array.path for array in layout.every_array()])
        if self._store:
            raise NotStoredError(path, self._store)
        raise NotRecordedError(path)

    def mechanism(self) -> StoredMechanism:
        """Return the mechanism that was run."""
        return self._mechanism or StoredMechanism(self._spec.spec.mechanism())

    @property
    def files(self) -> Sequence[FileRead]:
        """The files that were read for the run."""
        return self._spec.spec.files_read

    @cached_property
    def file(self) -> h5py.File:
        """The contents as an HDF5 file in memory; raises NotStoredError if some arrays are not stored."""
        self._check_open()
        if self._store:
            raise NotStoredError("complete archive", self._store)
        finished, head = self._finished, self.header.attributes
        origin = Origin.of(self._spec.spec, self.provenance)
        writer = ArchiveWriter(
            None,
            finished.names,
            replace(origin, run_id=head["run_id"], created_utc=head["created_utc"]),
            arrays=finished.layout,
            shared=finished.shared,
        )
        finished.write(writer)
        file = writer.finish(finished, completed=self._complete)
        assert file is not None
        return file

    def _complete(self, file: h5py.File) -> None:
        if self.measures:
            set_text(file, layout.MEASURES, self.measures.to_json())
        if self._gradients:
            set_text(file, layout.GRADIENTS, self._gradients)
        if self.accuracy is not None:
            higher_layers.write_answers(file)

    def _check_open(self) -> None:
        if self._closed:
            raise MbdkitError("this run is closed")

    def close(self) -> None:
        """Release the HDF5 file in memory, if there is one."""
        self._closed = True
        if "file" in self.__dict__:
            self.__dict__.pop("file").close()
