"""Reads blocks; see `mbdkit_studies.store.block_writer`."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mbdkit.archive.fingerprint import StoredHashes, is_text
from mbdkit.archive.finished_run import FinishedRun
from mbdkit.archive.hdf5_errors import DAMAGE, reading
from mbdkit.archive.layout import COUNTERS, TIMINGS
from mbdkit.archive.measured_values import MeasuredValues
from mbdkit.archive.plain_spec import PlainSpec
from mbdkit.archive.result_seams import file_problems
from mbdkit.archive.run import Run
from mbdkit.archive.run_contents import ArrayContents
from mbdkit.archive.run_header import plain_attributes
from mbdkit.archive.run_writer import SharedForces
from mbdkit.archive.stored_mechanism import StoredMechanism, built_mechanism, read_mechanism
from mbdkit.archive.untrusted_file import open_hdf5
from mbdkit.base.errors import ArchiveError, SpecError
from mbdkit.base.files_read import read_files
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.registered_kinds import kind_of_group
from mbdkit.spec.reading import parse_key, put
from mbdkit.spec.run_spec import RunSpec
from mbdkit.trust.criteria import LEVELS, Judgement, Level
from mbdkit_studies.folder import tables
from mbdkit_studies.spec.measures import Description
from mbdkit_studies.store.block_writer import FORMAT, FORMAT_VERSION, GROUPS, STORES, prefix
from mbdkit_studies.texts import ERROR

OBJECTS = 100_000  #: Largest number of groups and arrays in a block, about 60 for each structure.


class ForeignBlockError(SpecError):
    """A block of another study, which is not replaced."""


class Block:
    """A block file that is open for reading.

    Parameters
    ----------
    path
        The file, which may be untrusted.
    of_study
        Hash of the study to which the block must belong; empty if it may belong to any study.
    is_verified
        Whether a block that was changed after it was written is refused.

    Raises
    ------
    ForeignBlockError
        If the block belongs to another study.
    FormatVersionError
        If it has a version that this mbdkit does not read.
    ArchiveError
        If the file is not a block, or is damaged.
    ResourceError
        If the file is in use, or the system refuses to read it.
    """

    def __init__(self, path: Path, of_study: str = "", *, is_verified: bool = True):
        self.path = path
        self.file = open_hdf5(path, "block of a study", objects=OBJECTS)
        try:
            with reading("its header", path, hint=_HINT):
                tables.check_header(self.file, path, FORMAT, FORMAT_VERSION, "a block of a study")
                self.study_sha256 = str(self.file.attrs["study_sha256"])
                self.created_utc = str(self.file.attrs["created_utc"])
                self.store = next(name for name in STORES if name == str(self.file.attrs["store"]))
                self.numbers = np.asarray(self.file["runs/run"][:])
                if of_study and self.study_sha256 != of_study:
                    raise ForeignBlockError("this is a block of another study; move it to another folder", file=path)
            if is_verified:
                with reading("its contents", path, hint=_HINT):
                    StoredHashes(self.file).verify()
        except BaseException:
            self.file.close()
            raise

    def is_sound(self) -> bool:
        """Return whether arrays and attributes match their stored hashes."""
        try:
            StoredHashes(self.file).verify()
        except DAMAGE:
            return False
        return True

    def columns(self, group: str, wanted: Collection[str] | None = None) -> dict[str, np.ndarray]:
        """Return the columns of ``runs``, ``stats``, ``values`` or ``measures`` by name; none if the group does not
        exist.

        Parameters
        ----------
        wanted
            Names of the columns to read; None for all.
        """
        with reading(group, self.path, hint=_HINT):
            members = self.file.get(group, {})
            return {
                name: tables.read_column(item)
                for name, item in members.items()
                if name != "run"
                and (wanted is None or name in wanted)
                and len(item.dims)
                and len(item.dims[0])
                and item.dims[0][0].name.endswith("/run")
            }

    def described(self) -> dict[str, Description]:
        """Return unit and description of each measure."""
        with reading("measures", self.path, hint=_HINT):
            members = self.file.get("measures", {})
            return {
                name: Description(str(item.attrs["units"]), str(item.attrs["long_name"]))
                for name, item in members.items()
                if name != "run"
            }

    def row(self, number: int) -> int:
        """Return the index of a run in the block from its number in the study; raise SpecError if the block lacks the
        run.
        """
        rows = np.flatnonzero(self.numbers == number)
        if len(rows) != 1:
            raise SpecError(f"this block does not contain run {number}", file=self.path)
        return int(rows[0])

    @cached_property
    def runs(self) -> dict[str, np.ndarray]:
        """Columns of the group ``runs``."""
        return self.columns("runs")

    def _spec_data(self, number: int) -> dict[str, Any]:
        """Return the spec of a run as plain data."""
        row = self.row(number)
        with reading("specs", self.path, hint=_HINT):
            data: dict[str, Any] = json.loads(self.runs["base"][row])
            for item in self.file.get("values", {}).values():
                if "key" not in item.attrs:
                    continue
                key, value = parse_key(str(item.attrs["key"])), _at(item, row)
                if "texts" not in item.attrs:
                    put(data, key, value.item())
                elif value:
                    put(data, key, json.loads(value))
        return data

    def _spec_and_mechanism(
        self, number: int, bodies: Sequence[str]
    ) -> tuple[RunSpec | PlainSpec, StoredMechanism | None]:
        """Return the spec of a run, and its mechanism; None if that of the spec is its mechanism, which is so if mbdkit
        itself has its model and force laws.
        """
        row, data = self.row(number), self._spec_data(number)
        with reading("mechanisms", self.path, hint=_HINT):
            text, files = (str(self.runs[name][row]) if name in self.runs else "" for name in ("mechanism", "files"))
            stored = read_mechanism(text, bodies) if text else None
            read = read_files(files or "[]")
        try:
            spec = RunSpec(**data)
            if stored is not None and stored.mechanism is not None:
                spec.adopt(stored.mechanism, read)
        except SpecError:  # a plugin is not installed
            stored = stored or built_mechanism(data)
            hashes = str(self.runs["spec_sha256"][row]), str(self.runs["run_id"][row])
            return PlainSpec(data, *hashes, stored, read), stored
        if spec.sha256() != self.runs["spec_sha256"][row]:
            message = f"the spec of run {number} does not have the hash that was stored with it"
            raise ArchiveError(message, file=self.path)
        return spec, stored

    def run(self, number: int) -> Run | None:
        """Return a run with the arrays that the study has stored; None if the run has no results.

        Raises
        ------
        SpecError
            If the block is damaged or does not contain the run.
        """
        if not self.runs["data_sha256"][self.row(number)]:
            return None
        return Run(self._contents(number, self.results(number)))

    def joined_runs(self) -> Iterator[tuple[Run, np.ndarray, np.ndarray]]:
        """Yield, for each structure, a `Run` that joins its N runs, their numbers in the study (N,), and their numbers
        of rows (N,).

        The joined run has the rows of the first run, then those of the second, and so on. Everything else, such as spec
        and status, is taken from the first run. The block must stay open while the joined run is read.

        Raises
        ------
        SpecError
            If the block is damaged.
        """
        structure = self.runs["structure"].astype(int)
        for index in range(int(structure.max(initial=0))):
            numbers = self.numbers[structure == index + 1]
            first = self.results(int(numbers[0]))
            rows = _Rows(self, prefix(index), first.arrays)
            yield Run(self._contents(int(numbers[0]), replace(first, arrays=rows))), numbers, rows.counts

    def _contents(self, number: int, finished: FinishedRun) -> ArrayContents:
        """Return the contents of a run: its results, with its spec and provenance as stored in the block."""
        row = self.row(number)
        spec, stored = self._spec_and_mechanism(number, finished.names.bodies)
        with reading(f"run {number}", self.path, hint=_HINT):
            columns, described = self.columns("measures"), self.described()
            names = [name for name in spec.measures if name in columns]
            measured = MeasuredValues(
                {name: float(columns[name][row]) for name in names},
                {name: described[name].units for name in names},
                errors={name: float(columns[name + ERROR][row]) for name in names if name + ERROR in columns},
            )
            return ArrayContents(
                finished,
                spec,
                run_id=str(self.runs["run_id"][row]),
                created_utc=self.created_utc,
                provenance={**plain_attributes(self.file["provenance"]), **json.loads(self.runs["plugins"][row])},
                mechanism=stored,
                store="" if self.store == "all" else self.store,
                measured=measured,
            )

    def results(self, number: int) -> FinishedRun:
        """Return the results of a run, with the arrays that the study has stored.

        Raises
        ------
        SpecError
            If the block is damaged or does not contain the run.
        """
        with reading(f"run {number}", self.path, hint=_HINT):
            return self._results(self.row(number))

    def _results(self, row: int) -> FinishedRun:
        runs, place = self.runs, int(self.runs["place"][row]) - 1
        number = int(runs["structure"][row]) - 1
        texts = (self.file[f"structures/{name}"].asstr()[number] for name in ("names", "recorded", "shared"))
        names, recorded, shared = map(json.loads, map(str, texts))
        under = prefix(number)
        arrays, present = {}, []
        for array in (kind_of_group(path.partition("/")[0]).by_path[path] for path in recorded):
            if array.grows and array.key not in arrays:
                counts = self.file.get(f"{under}{GROUPS[array.dims[0]]}/rows")
                if counts is None or f"{under}{array.path}" not in self.file:
                    continue
                item, rows = self.file[f"{under}{array.path}"], int(counts[place])
                if array.is_scale and array.dims[0] != "time":
                    arrays[array.key] = np.arange(1, rows + 1)
                else:
                    arrays[array.key] = np.asarray((item.asstr() if is_text(item) else item)[place, :rows])
            present.append(array)
        stats = {
            name: int(item[row]) if name in COUNTERS else float(item[row])
            for name in (*COUNTERS, *TIMINGS)
            if (item := self.file.get(f"stats/{name}")) is not None
        }
        largest = self.file.get(f"{under}joints/misalignment_max")
        joints = len(names["joints"])
        if shared is not None and (length := self.file.get(f"{under}joints/characteristic_length")) is not None:
            shared["length"] = float(length[place])
        level: Level = next((level for level in LEVELS if level == runs["verdict"][row]), "unknown")
        reasons, warnings = (
            tuple(json.loads(runs[name][row])) if name in runs else () for name in ("verdict_reasons", "warnings")
        )
        by_joint = np.asarray(largest[place]) if largest is not None else np.full(joints, runs["misalignment_max"][row])
        return FinishedRun(
            str(runs["status"][row]),
            str(runs["status_reason"][row]),
            stats,
            by_joint,
            Judgement(level, reasons),
            warnings,
            names=ArchiveNames(**names),
            layout=tuple(present),
            arrays=arrays,
            shared=None if shared is None else SharedForces(**shared),
            data_sha256=str(runs["data_sha256"][row]),
            assembly=str(runs["assembly"][row]) if "assembly" in runs else "",
        )

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    def __enter__(self) -> Block:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Rows(Mapping[str, np.ndarray]):
    """Arrays over time of all runs of a structure, with their rows joined, read on first access.

    Parameters
    ----------
    under
        Path of the groups of the structure.
    first
        Arrays of the first run of the structure, of which only the keys are used.
    """

    def __init__(self, block: Block, under: str, first: Mapping[str, np.ndarray]):
        self.block, self.under, self.first = block, under, first
        self.counts = np.asarray(block.file[f"{under}trajectory/rows"][:], int)
        self.known: dict[str, np.ndarray] = {}

    def __getitem__(self, key: str) -> np.ndarray:
        if key not in self.known:
            path = "trajectory/time" if key == "time" else key
            with reading(path, self.block.path, hint=_HINT):
                values = np.asarray(self.block.file[f"{self.under}{path}"][:])
                self.known[key] = values[np.arange(values.shape[1]) < self.counts[:, None]]
        return self.known[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self.first)

    def __len__(self) -> int:
        return len(self.first)


_HINT = "run `mbdkit study` to compute its block again"


def _at(item: h5py.Dataset, row: int) -> Any:
    if "texts" in item.attrs:
        return str(item.parent[str(item.attrs["texts"])].asstr()[int(item[row])])
    return item[row]


@file_problems
def block_problems(path: Path) -> list[str] | None:
    """Return the problems of a block of runs, for `mbdkit archive check`; None if the file is no readable block."""
    try:
        with Block(path, is_verified=False) as block:
            sound = block.is_sound()
    except (SpecError, ArchiveError, FileNotFoundError):
        return None
    return [] if sound else ["its arrays, attributes or dimension scales have changed since they were written"]
