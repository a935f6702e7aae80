"""Blocks: HDF5 files that hold many runs of a study, with an axis ``run`` in front of the arrays of a run archive.

Runs of one mechanism and method have the same arrays; they are a *structure* of the block. The groups of the first
structure are those of a run archive, the groups of others are in ``structure-2``, ``structure-3`` and so on.
`schemas/block.md` describes the format.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any, Literal, get_args

import h5py
import numpy as np

from mbdkit.archive.fingerprint import seal
from mbdkit.archive.finished_runs import FinishedRuns
from mbdkit.archive.hdf5 import create, set_text
from mbdkit.archive.layout import COUNTERS, TIMINGS, name_texts
from mbdkit.archive.run_writer import utc_now
from mbdkit.base.plain_data import canonical_text
from mbdkit.quantities.array import FLOAT, INTEGER, TEXT, Array, Recorded
from mbdkit.quantities.registered_kinds import sizes_of
from mbdkit.quantities.table import KINDS
from mbdkit_studies.folder import tables
from mbdkit_studies.spec.measures import Description

FORMAT = "mbdkit-block"
FORMAT_VERSION = "1.0"

Store = Literal["hashes", "summary", "histories", "all"]
STORES: tuple[Store, ...] = get_args(Store)

#: Paths of the arrays with rows that ``store: histories`` keeps; names are kept as well.
HISTORIES = frozenset(
    ["trajectory/time"]
    + [array.path for kind in KINDS for array in kind.arrays if isinstance(array, Recorded) and array.is_history]
)

#: Values of `store` for which a study keeps recorded rows.
KEEPING_TIMES: tuple[Store, ...] = ("histories", "all")

#: Groups in which a block stores the lengths of the axes that grow during a run, by the axis of a run archive.
GROUPS = {
    "time": "trajectory", "interval": "steps", "event": "events", "impact": "impacts", "set/number": "inputs",
    "sample": "samples",
}  # fmt: skip


def prefix(structure: int) -> str:
    """Return the path, with a slash at the end, of the groups of a structure, counted from 0; empty for the first."""
    return f"structure-{structure + 1}/" if structure else ""


#: Columns of the group ``runs``.
_BY_RUN = tables.described_columns("block")
_OF_SUMMARY = ("verdict_reasons", "warnings", "assembly")
_HASHES = ("run_id", "spec_sha256", "data_sha256")

UNSET = object()  #: Stands for a value that a run does not set.

Texts = str | Sequence[str]


@dataclass(frozen=True, eq=False)
class BlockPoints:
    """The points of a study in a block of N runs.

    Parameters
    ----------
    numbers
        Numbers of the runs in the study, from 1.
    base
        The spec without the values that distinguish the runs, as JSON; one for each run, or one for all.
    values
        (N,) values that are set in `base`, by dotted key; `UNSET` for a run that does not set the key.
    """

    numbers: Sequence[int]
    base: str | Sequence[str] = ""
    values: Mapping[str, Sequence[Any] | np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class BlockRuns:
    """Runs to be written into a block; a text is that of all of them, a sequence has one for each.

    Parameters
    ----------
    numbers
        Numbers of the runs in the study, from 1.
    status, status_reason
        Status of a run, and why it is not complete or which event ended it; otherwise empty.
    spec_sha256, run_id
        Hash and identifier of the run's spec; empty if the spec is not valid.
    plugins
        Attributes of ``/provenance`` that depend on the spec, as JSON.
    results
        Results of the runs; None if there are none.
    measures
        (R,) values of the measures by name; a measure may be missing.
    mechanism, files
        The mechanism that was run and the files that were read, as JSON; empty if the spec alone determines them.
    """

    numbers: Sequence[int]
    status: Texts
    status_reason: Texts
    spec_sha256: Texts = ""
    run_id: Texts = ""
    plugins: Texts = ""
    results: FinishedRuns | None = None
    measures: Mapping[str, Sequence[float] | np.ndarray] = field(default_factory=dict)
    mechanism: Texts = ""
    files: Texts = ""


@dataclass(frozen=True)
class BlockHeading:
    """What all runs of a block have in common.

    Parameters
    ----------
    study_sha256
        Hash of the study spec.
    store
        Which arrays of each run are stored.
    provenance
        Attributes of ``/provenance``.
    measures
        Unit and description of each measure.
    compress
        Whether arrays are compressed.
    """

    study_sha256: str
    store: Store
    provenance: Mapping[str, str | int | float]
    measures: Mapping[str, Description]
    compress: bool = False


def kept(finished: FinishedRuns, store: Store) -> FinishedRuns:
    """Return runs with the arrays selected by `store` and the arrays of names."""
    return finished if store == "all" else finished.with_layout(_kept_arrays(finished.layout, store))


@lru_cache(maxsize=8)
def _kept_arrays(recorded: tuple[Array, ...], store: Store) -> tuple[Array, ...]:
    """Return the arrays selected by `store`, and the arrays of names; one object for runs with the same layout."""
    wanted = HISTORIES if store == "histories" else frozenset[str]()
    return tuple(array for array in recorded if not array.grows or array.path in wanted)


def block_image(heading: BlockHeading, points: BlockPoints, runs: Sequence[BlockRuns]) -> bytes:
    """Return the bytes of a block."""
    with tables.hdf5_in_memory() as file:
        _Writer(file, heading, points, runs).write()
        return tables.file_bytes(file)


class _Writer:
    def __init__(self, file: h5py.File, heading: BlockHeading, points: BlockPoints, runs: Sequence[BlockRuns]):
        self.file, self.heading, self.points, self.runs = file, heading, points, runs
        self.count, self.has_summary = len(points.numbers), heading.store != "hashes"
        numbers = np.asarray(points.numbers)
        order = np.argsort(numbers)
        #: Rows of the block in which the runs of each part are.
        self.rows = [order[np.searchsorted(numbers, part.numbers, sorter=order)] for part in runs]
        self.results = [(part.results, rows) for part, rows in zip(runs, self.rows, strict=True) if part.results]
        self.structures: dict[tuple[str, str, str], list[tuple[FinishedRuns, np.ndarray]]] = {}
        last: FinishedRuns | None = None
        for results, rows in sorted(self.results, key=lambda part: int(part[1][0])):
            if last is None or not _is_alike(last, results):
                structure = self.structures.setdefault(_structure(results), [])
            structure.append((results, rows))
            last = results

    def write(self) -> None:
        heading = self.heading
        tables.write_header(
            self.file, FORMAT, FORMAT_VERSION, "Runs of a study",
            f"{self.count} runs of the study with the hash {heading.study_sha256[:16]}.",
            created_utc=utc_now(), study_sha256=heading.study_sha256, store=heading.store,
        )  # fmt: skip
        provenance = self.file.create_group("provenance")
        for name, value in heading.provenance.items():
            provenance.attrs[name] = value
        self.by_run()
        self.values()
        self.measures()
        self.names_of_structures()
        for number, parts in enumerate(self.structures.values()):
            self.structure(prefix(number), parts)
        seal(self.file)

    def add(self, path: str, values: Any, dtype: str, units: str, what: str) -> h5py.Dataset:
        """Write a column with one row for each run of the block; create its group, with the axis ``run``, if needed."""
        if (group := path.partition("/")[0]) not in self.file:
            self.scale("", group, "run", self.points.numbers, "number of the run in the study, from 1")
        array = Array(path, ("run",), units, what, dtype)
        return tables.write_column(self.file, array, values, compress=self.heading.compress)

    def scale(self, under: str, group: str, name: str, numbers: Sequence[int], what: str) -> None:
        """Write `numbers` as the dimension scale `name` of a group, which is created if it does not exist."""
        self.file.require_group(f"{under}{group}/{name}".rpartition("/")[0])
        tables.write_scale(self.file, f"{group}/{name}", numbers, what, under)

    def column(self, parts: Iterable[tuple[Any, np.ndarray]], empty: object = np.nan, dtype: Any = float) -> np.ndarray:
        """Return a column (N,), from values of some runs with their rows in the block; `empty` for the other runs."""
        return _scattered((self.count,), parts, empty, dtype)

    def by_run(self) -> None:
        """Write the columns with one row for each run."""

        def of_results(values: Callable[[FinishedRuns], Any]) -> Iterator[tuple[Any, np.ndarray]]:
            return ((values(results), rows) for results, rows in self.results)

        texts: dict[str, Iterable[tuple[Any, np.ndarray]]] = {
            name: [(getattr(part, name), rows) for part, rows in zip(self.runs, self.rows, strict=True)]
            for name in ("status", "status_reason", "plugins", "mechanism", "files", "run_id", "spec_sha256")
        }
        texts |= {
            "base": [(self.points.base, np.arange(self.count))],
            "verdict": of_results(lambda one: [judgement.level for judgement in one.judgements]),
            "worst_joint": of_results(_worst_joints),
            "verdict_reasons": of_results(lambda one: [_json_of(x.reasons) for x in one.judgements]),
            "warnings": of_results(lambda one: [*map(_json_of, one.warnings)]),
            "assembly": of_results(lambda one: one.assembly),
            "data_sha256": of_results(lambda one: one.data_sha256),
        }
        for name, what in _BY_RUN.items():
            if name in _OF_SUMMARY and not self.has_summary:
                continue
            values = self.column(texts[name], "[]" if name in ("verdict_reasons", "warnings") else "", object)
            if name in _HASHES:
                array = Array(f"runs/{name}", ("run",), "1", what)
                tables.write_hashes(self.file, array, values.tolist(), compress=self.heading.compress)
            else:
                self.add(f"runs/{name}", values, TEXT, "1", what)
        largest = self.column(of_results(lambda one: one.misalignment_max.max(axis=1, initial=0.0)))
        what = "largest misalignment of any joint over every step"
        self.add("runs/misalignment_max", largest, FLOAT, "m", what)
        structure, place = np.zeros((2, self.count), INTEGER)
        for number, parts in enumerate(self.structures.values(), start=1):
            rows = self._rows_of(parts)
            structure[rows], place[rows] = number, np.arange(1, len(rows) + 1)
        self.add("runs/structure", structure, INTEGER, "1", "number of its structure; 0 without results")
        self.add("runs/place", place, INTEGER, "1", "number of the run in the arrays of its structure")
        for name in (*COUNTERS, *TIMINGS) if self.has_summary else ():
            numbers = self.column([(results.stats.get(name, np.nan), rows) for results, rows in self.results])
            self.add(f"stats/{name}", numbers, FLOAT, "s" if name in TIMINGS else "1", name.replace("_", " "))

    @staticmethod
    def _rows_of(parts: Iterable[tuple[FinishedRuns, np.ndarray]]) -> np.ndarray:
        """Return the rows in the block of the runs of a structure, in order."""
        return np.sort(np.concatenate([rows for _, rows in parts]))

    def values(self) -> None:
        """Write the values that distinguish the runs: numbers as numbers, anything else as JSON."""
        for key, given in self.points.values.items():
            path, what = f"values/{key.replace('/', '|')}", f"value of {key}"
            is_array = isinstance(given, np.ndarray) and given.dtype != object
            kinds = {type(given[0].item())} if is_array else {type(value) for value in given}
            if kinds == {int} and (is_array or all(-(2**63) <= value < 2**63 for value in given)):
                item = self.add(path, given, INTEGER, "1", what)
            elif kinds <= {int, float}:
                item = self.add(path, given, FLOAT, "1", what)
            else:
                texts = ["" if value is UNSET else canonical_text(value) for value in given]
                item = self.add(path, texts, TEXT, "1", f"{what}, JSON")
            set_text(item, "key", key)

    def measures(self) -> None:
        """Write the value of each measure for each run; nan where a run has none."""
        for name, measure in self.heading.measures.items():
            placed = zip(self.runs, self.rows, strict=True)
            parts = [(part.measures[name], rows) for part, rows in placed if name in part.measures]
            self.add(f"measures/{name}", self.column(parts), FLOAT, measure.units, measure.long_name)

    def names_of_structures(self) -> None:
        """Write the names of bodies and joints, the recorded arrays, and the redundant joints of each structure."""
        self.scale("", "structures", "structure", range(1, len(self.structures) + 1), "number of the structure")
        described = {
            "names": "names of bodies, joints and other elements, JSON",
            "recorded": "paths of the arrays that the runs recorded, JSON",
            "shared": "redundant joints, JSON",
        }
        for index, (name, what) in enumerate(described.items()):
            array = Array(f"structures/{name}", ("structure",), "1", what, TEXT)
            create(self.file, array, np.array([key[index] for key in self.structures], object))

    def structure(self, under: str, parts: Sequence[tuple[FinishedRuns, np.ndarray]]) -> None:
        """Write the groups of one structure, below the path `under`, for runs with their rows in the block."""
        order = self._rows_of(parts)
        results = [(some, np.searchsorted(order, rows)) for some, rows in parts]
        first, count = results[0][0], len(order)
        numbers = np.asarray(self.points.numbers)[order]
        sizes = sizes_of(first.names)
        texts = name_texts(first.names)
        groups = dict.fromkeys(one.group for one in first.layout if self.has_summary)
        lengths = {
            dim: _scattered((count,), [(some.lengths.get(dim, 0), places) for some, places in results], 0, int)
            for dim in GROUPS
        }
        for group in groups:
            for home in dict.fromkeys(_home(one) for one in first.layout if one.group == group):
                self.scale(under, group, f"{home}run", numbers, "number of the run in the study, from 1")
            for dim in dict.fromkeys(one.dims[0] for one in first.layout if one.group == group and one.grows):
                whole = range(1, max(lengths[dim]) + 1)
                self.scale(under, group, _axis(dim), whole, f"number of the {_word(dim)}, from 1")
        for one in sorted(first.layout, key=lambda one: not one.is_scale):
            if not one.grows and one.group in groups:
                create(self.file, one, np.array(texts[one.path], object), under=under)
        for one in first.layout:
            if one.grows and (not one.is_scale or one.path in ("trajectory/time",)):
                shape = (count, max(lengths[one.dims[0]]), *(sizes[dim] for dim in one.dims[1:]))
                self.array(under, one, results, shape)
        if not self.has_summary:
            return
        for dim, group in GROUPS.items():
            if any(one.grows and one.dims[0] == dim for one in first.layout):
                counted = Array(f"{group}/rows", ("run",), "1", f"number of {_word(dim)}s of the run", INTEGER)
                tables.write_column(self.file, counted, lengths[dim], under=under)
        of_joints = [(some.misalignment_max, places) for some, places in results]
        largest = _scattered((count, first.misalignment_max.shape[1]), of_joints)
        what = "largest misalignment of the joint over every step"
        array = Array("joints/misalignment_max", ("run", "joint"), "m", what)
        tables.write_column(self.file, array, largest, compress=self.heading.compress, under=under)
        if first.shared is not None:
            known = [(some.shared.length, places) for some, places in results if some.shared]
            array = Array("joints/characteristic_length", ("run",), "m", "length in the norm of redundant reactions")
            tables.write_column(self.file, array, _scattered((count,), known), under=under)

    def array(
        self, under: str, one: Array, found: Sequence[tuple[FinishedRuns, np.ndarray]], shape: tuple[int, ...]
    ) -> None:
        """Write one array of all runs of a structure; rows that a run does not have are nan, 0 or empty."""
        empty: object = {FLOAT: np.nan, INTEGER: 0}.get(one.dtype, "")
        values = np.full(shape, empty, object if one.dtype == TEXT else one.dtype)
        for some, places in found:
            own, lengths = some.arrays[one.key], some.lengths[one.dims[0]]
            values[places, : own.shape[1]] = own
            for run in np.flatnonzero(lengths < own.shape[1]).tolist():
                values[places[run], lengths[run] :] = empty
        dims = (f"{_home(one)}run", _axis(one.dims[0]), *one.dims[1:])
        stored = Array(one.path, dims, one.units, one.long_name, one.dtype, one.row_units)
        if one.dtype == TEXT:
            create(self.file, stored, values, under=under)
        else:
            tables.write_column(self.file, stored, values, compress=self.heading.compress, under=under)


def _home(array: Array) -> str:
    """Return the path of the subgroup of an array below its group, with a slash at the end; empty without one."""
    home, slash, _ = array.name.rpartition("/")
    return home + slash


def _axis(dim: str) -> str:
    """Return the name in a block of an axis that grows during a run; its scale numbers the rows, because the recorded
    times differ between runs.
    """
    return "row" if dim == "time" else dim


def _word(dim: str) -> str:
    return "setting" if dim == "set/number" else _axis(dim)


def _scattered(
    shape: tuple[int, ...], parts: Iterable[tuple[Any, np.ndarray]], empty: object = np.nan, dtype: Any = float
) -> np.ndarray:
    """Return an array of the values of some runs, given with their rows in it, and of `empty` in the other rows."""
    values = np.full(shape, empty, dtype)
    for some, rows in parts:
        values[rows] = some
    return values


def _structure(result: FinishedRuns) -> tuple[str, str, str]:
    shared = None if result.shared is None else asdict(result.shared) | {"length": 0.0}
    return (
        canonical_text(asdict(result.names)),
        canonical_text([array.path for array in result.layout]),
        canonical_text(shared),
    )


def _is_alike(run: FinishedRuns, other: FinishedRuns) -> bool:
    """Return whether two runs share their names and layout as objects, and have no redundant joints.

    Runs that are alike have one structure. The contents of the objects are not compared, to save time.
    """
    return run.names is other.names and run.layout is other.layout and run.shared is other.shared is None


@lru_cache(maxsize=1024)
def _json_of(texts: tuple[str, ...]) -> str:
    return canonical_text(texts)


def _worst_joints(results: FinishedRuns) -> list[str]:
    """Return the joint with the largest misalignment of each run; empty if it is 0 or nan."""
    values, names = results.misalignment_max, results.names.joints
    if not values.shape[1]:
        return [""] * len(values)
    joints = values.argmax(axis=1)
    largest = values[np.arange(len(values)), joints]
    return [names[joint] if gap > 0.0 else "" for joint, gap in zip(joints.tolist(), largest.tolist(), strict=True)]
