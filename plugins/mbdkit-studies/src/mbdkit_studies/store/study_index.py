"""The index of a study: columns with one value per run in an HDF5 file, readable as netCDF-4 and written atomically.

Texts are strings in tables of up to `PLAIN` runs. Longer tables, of up to a million runs, store hashes as bytes and
other texts as indices into an array of the distinct texts, see `mbdkit_studies.folder.tables`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mbdkit.archive.fingerprint import StoredHashes, seal
from mbdkit.archive.hdf5 import create, set_text
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.layout import COUNTERS, SOME_COUNTERS, TIMINGS
from mbdkit.archive.untrusted_file import open_hdf5
from mbdkit.base.distributions import own_version
from mbdkit.base.errors import SpecError
from mbdkit.base.files import replacing
from mbdkit.quantities.array import FLOAT, INTEGER, TEXT, Array
from mbdkit_studies.folder import tables
from mbdkit_studies.points.planned_points import Label
from mbdkit_studies.spec.measures import MEASURES, OF_CHECKED_RUNS, SECOND, Description
from mbdkit_studies.spec.study_spec import StudySpec

FORMAT, FORMAT_VERSION = "mbdkit-study", "1.0"

PLAIN = 10_000  #: Largest number of runs whose texts are stored as strings.

STATUSES = ("complete", "failed", "missing", "left-out")

#: Columns with the minimum, quartiles and median of repeated timings, and their probabilities.
QUARTILES = {"wall_min_s": 0.0, "wall_q1_s": 0.25, "wall_median_s": 0.5, "wall_q3_s": 0.75}

TEXTS = tables.described_columns("index")  #: Descriptions of the columns of texts.

#: Units and descriptions of the numeric columns that the index of any study may have, in addition to measures that the
#: study defines.
NUMBERS: Mapping[str, Description] = {
    **MEASURES,
    **OF_CHECKED_RUNS,
    **SECOND,
    **{name: Description("1", f"counter of the run: {name.replace('_', ' ')}") for name in (*COUNTERS, *SOME_COUNTERS)},
    **{name: Description("s", f"time of the run: {name.removesuffix('_s')}") for name in TIMINGS},
    **{q: Description("s", f"wall time of the steps, {q.split('_')[1]} of the serial timings") for q in QUARTILES},
}

HASHES = ("run_id", "data_sha256")  #: Columns of hashes.

#: Separates the reasons for a verdict: two spaces, because a reason may have several sentences.
BETWEEN_REASONS = "  "

REPEATS = "wall_repeats_s"

#: All columns except those of the axes.
COLUMNS = frozenset((*TEXTS, *NUMBERS, "run", "reference", "repeat", REPEATS))


@dataclass(frozen=True)
class Row:
    """One run in the index.

    Parameters
    ----------
    status
        ``complete``, ``failed``, ``missing``, or ``left-out`` if it needs a distribution that is not installed.
    status_reason
        Reason why the run is not complete: a code and a sentence.
    family, axes, reference_id
        Family, axis labels and reference run; empty for a reference.
    worst_joint, data_sha256
        Joint with the largest misalignment, and hash of the recorded data, from the archive.
    values
        Measures, counters and timings by column; nan if not available.
    repeats
        Wall times of the repeated timings, each made after those of all other runs [s].
    file_sha256
        Hash of the bytes of the archive; empty without an archive.
    second_run
        ``complete`` if measures were computed by a second run, or the reason why this failed; empty if there was none.
    verdict, verdict_reasons
        Verdict on the run and its reasons, from the archive; empty without an archive.
    """

    run_id: str
    status: str
    status_reason: str = ""
    family: str = ""
    axes: Mapping[str, Label] = field(default_factory=dict)
    reference_id: str = ""
    worst_joint: str = ""
    data_sha256: str = ""
    values: Mapping[str, float] = field(default_factory=dict)
    repeats: tuple[float, ...] = ()
    file_sha256: str = ""
    second_run: str = ""
    verdict: str = ""
    verdict_reasons: str = ""


@dataclass(frozen=True, eq=False)
class Index:
    """The columns of a study.

    Parameters
    ----------
    runs
        (N,) values by name, in the order of the table: families and axes, results, measures, counters, hashes.
    described
        Unit and description of each numeric column that is not an axis.
    references
        The same columns, without axes, for the reference runs; empty if the study has none.
    axes
        Names of the columns that are axes of the study.
    states
        (B, 4) states of the files of blocks, see `mbdkit_studies.compute.run_blocks`; zero if unknown. B is 0 in a
        study with an archive for each run.
    study_sha256, version
        Hash of the study, and version of mbdkit that wrote the index.
    """

    runs: Mapping[str, np.ndarray]
    described: Mapping[str, Description]
    references: Mapping[str, np.ndarray] = field(default_factory=dict)
    axes: frozenset[str] = frozenset()
    states: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), np.int64))
    study_sha256: str = ""
    version: str = ""

    @classmethod
    def of_rows(cls, runs: Sequence[Row], references: Sequence[Row], defined: Mapping[str, Description]) -> Index:
        """Return the index of runs that have one archive each.

        Parameters
        ----------
        defined
            Units and descriptions of the measures that the study defines.
        """
        names = {name for row in (*runs, *references) for name in row.values}
        described = {name: column for name, column in {**defined, **NUMBERS, **defined}.items() if name in names}
        axes = frozenset(key for row in runs for key in row.axes)
        return cls(_columns(runs, described), described, _columns(references, described), axes)

    def __len__(self) -> int:
        return len(self.runs["status"])

    def rows(self) -> list[Row]:
        """Return the rows of all reference runs, then those of all runs; see `row`."""
        rows = [self.row(place, of_references=True) for place in range(len(self.references.get("status", ())))]
        return rows + [self.row(place) for place in range(len(self))]

    def row(self, place: int, *, of_references: bool = False) -> Row:
        """Return the row of a run, or of a reference run, without axis labels, which follow from the study spec."""
        columns = self.references if of_references else self.runs
        texts: dict[str, Any] = {name: str(columns[name][place]) for name in TEXTS if name in columns}
        values = {name: float(columns[name][place]) for name in self.described if name in columns}
        repeats = columns[REPEATS][place].tolist() if REPEATS in columns else ()
        return Row(**texts, values=values, repeats=tuple(value for value in repeats if not math.isnan(value)))


def _columns(rows: Sequence[Row], numbers: Iterable[str]) -> dict[str, np.ndarray]:
    """Return the columns of rows: texts, axes, numbers, and repeated timings."""
    columns = {name: np.array([getattr(row, name) for row in rows], object) for name in TEXTS}
    for key in dict.fromkeys(key for row in rows for key in row.axes):
        labels = [row.axes.get(key) for row in rows]
        is_text = any(isinstance(label, str) for label in labels)
        columns[key] = np.array(labels, object if is_text else FLOAT)  # None becomes nan
    for name in numbers:
        columns[name] = np.array([row.values.get(name, math.nan) for row in rows], FLOAT)
    if count := max((len(row.repeats) for row in rows), default=0):
        columns[REPEATS] = np.array([[*row.repeats, *[math.nan] * (count - len(row.repeats))] for row in rows])
    return columns


def axis_column(key: str) -> str:
    """Return the name of the column of an axis; HDF5 would interpret a slash in the name of the axis as a group."""
    return key.replace("/", "|")


def quartiles(repeats: Sequence[float]) -> dict[str, float]:
    """Return minimum, quartiles and median of repeated timings, by column; nan if there are none."""
    if not len(repeats):
        return dict.fromkeys(QUARTILES, math.nan)
    return {name: float(np.quantile(repeats, share)) for name, share in QUARTILES.items()}


def write(path: Path, spec: StudySpec, index: Index) -> None:
    """Write an index, and replace the previous one atomically.

    Parameters
    ----------
    path
        Final path; it is replaced when the new index is complete.

    Raises
    ------
    SpecError
        If the index cannot be written, as on a full disk. The previous index then remains unchanged.
    """
    with tables.hdf5_in_memory() as file:
        title = (spec.title or "Study").replace("\0", " ")  # attributes end at a null character
        texts = {"mbdkit": own_version(), "study": spec.canonical_json(), "study_sha256": spec.sha256()}
        tables.write_header(file, FORMAT, FORMAT_VERSION, title, "Table of the runs of a study.", **texts)
        _write_table(file, "runs", "run", index.runs, index)
        if index.references:
            _write_table(file, "references", "reference", index.references, index)
        if len(index.states):
            _write_states(file, index.states)
        seal(file)
        image = tables.file_bytes(file)
    with replacing(path) as temporary:
        temporary.write_bytes(image)


def _write_states(file: h5py.File, states: np.ndarray) -> None:
    file.create_group("blocks")
    for name, size in zip(("block", "property"), states.shape, strict=True):
        tables.write_scale(file, f"blocks/{name}", range(size), f"number of the {name}")
    what = "size, times [ns] and number of the file"
    create(file, Array("blocks/file_state", ("block", "property"), "1", what, INTEGER), states)


def _write_table(file: h5py.File, group: str, dim: str, columns: Mapping[str, np.ndarray], index: Index) -> None:
    """Write a group whose columns have one value for each run or reference run."""
    file.create_group(group)
    tables.write_scale(file, f"{group}/{dim}", range(1, len(columns["status"]) + 1), "number of the run")
    for place, (name, values) in enumerate(columns.items(), start=1):
        is_axis, is_number = name in index.axes, name in index.described
        what = TEXTS.get(name, f"axis of the study: {name} of the run spec")
        units, what = (index.described[name].units, index.described[name].long_name) if is_number else ("1", what)
        array = Array(f"{group}/{axis_column(name)}", (dim,), units, what)
        if name == REPEATS:
            tables.write_scale(file, f"{group}/repeat", range(1, values.shape[1] + 1), "number of the timing")
            create(file, Array(array.path, (dim, "repeat"), "s", "wall time of each serial timing"), values)
        elif values.dtype != object:
            tables.write_column(file, replace(array, dtype=INTEGER if values.dtype.kind == "i" else FLOAT), values)
        elif len(values) <= PLAIN:
            create(file, replace(array, dtype=TEXT), np.array(_texts(values), object))
        elif name in HASHES:
            tables.write_hashes(file, array, _texts(values))
        else:
            tables.write_column(file, replace(array, dtype=TEXT), _texts(values))
        dataset = file[array.path]
        dataset.attrs["place"] = np.int64(place)
        set_text(dataset, "name", name)
        set_text(dataset, "role", "axis" if is_axis else "number" if is_number else "text")


def _texts(values: np.ndarray) -> list[str]:
    return ["" if value is None else str(value) for value in values]


def read(path: Path) -> Index:
    """Read an index.

    Raises
    ------
    SpecError
        If there is no index.
    ArchiveError
        If it is damaged, or this version cannot read it.
    """
    if not path.exists():
        raise SpecError("there is no index.h5; run `mbdkit study` to write it", file=path.parent)
    hint = "run `mbdkit study` to write it again"
    with reading("the index", path, hint=hint), open_hdf5(path, "study index", hint=hint) as file:
        tables.check_header(file, path, FORMAT, FORMAT_VERSION, "the index of a study")
        StoredHashes(file).verify()
        both = [_read_columns(file[group]) if group in file else {} for group in ("runs", "references")]
        if any(len(set(map(len, table.values()))) > 1 for table in both):
            raise ValueError("its columns have different lengths")
        items = {str(item.attrs["name"]): item for item in file["runs"].values() if "role" in item.attrs}
        return Index(
            both[0],
            {
                name: Description(str(items[name].attrs["units"]), str(items[name].attrs["long_name"]))
                for name in both[0]
                if items[name].attrs["role"] == "number"
            },
            both[1],
            axes=frozenset(name for name, item in items.items() if item.attrs["role"] == "axis"),
            states=file["blocks/file_state"][:] if "blocks/file_state" in file else np.zeros((0, 4), np.int64),
            study_sha256=str(file.attrs["study_sha256"]),
            version=str(file.attrs["mbdkit"]),
        )


def _read_columns(group: h5py.Group) -> dict[str, np.ndarray]:
    """Return the columns of a table by name, in the order in which they were written."""
    items = sorted((item for item in group.values() if "role" in item.attrs), key=lambda item: int(item.attrs["place"]))
    return {str(item.attrs["name"]): tables.read_column(item) for item in items}
