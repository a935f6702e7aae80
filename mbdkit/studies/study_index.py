"""The index of a study: an HDF5 file with one row per run, readable as netCDF-4 and written atomically."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from mbdkit.archive.fingerprint import data_sha256
from mbdkit.archive.hdf5 import create, set_text
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.layout import COUNTERS, TIMINGS
from mbdkit.archive.part_file import LIBVER
from mbdkit.archive.stranger_file import open_hdf5
from mbdkit.base.errors import SpecError
from mbdkit.base.files import replacing
from mbdkit.measures.take import Description
from mbdkit.quantities.array import FLOAT, INTEGER, TEXT, Array
from mbdkit.studies.measures import MEASURES, OF_CHECKED_RUNS, SECOND
from mbdkit.studies.planned_points import Label

FORMAT = "mbdkit-study"
FORMAT_VERSION = "1.4"
STATUSES = ("complete", "failed", "missing", "left-out")

#: Value of the attribute `role` of the column of a measure that the study defines.
DEFINED = "measure"

#: Minimum, quartiles and median of the repeated timings.
QUARTILES = {"wall_min_s": 0.0, "wall_q1_s": 0.25, "wall_median_s": 0.5, "wall_q3_s": 0.75}

TEXTS = {
    "family": "family of the run",
    "run_id": "identifier of the run, and name of its file in runs/",
    "reference_id": "reference run for its errors",
    "status": "complete, failed, missing or left-out",
    "status_reason": "why it is not complete",
    "verdict": "good, unknown, doubtful or bad; empty without an archive",
    "verdict_reasons": "reasons for the verdict, joined by spaces",
    "second_run": "complete if a second run for measures was made, or the reason why it has no result; else empty",
    "worst_joint": "joint with the largest misalignment",
    "data_sha256": "hash of the recorded data",
    "file_sha256": "hash of the bytes of the archive",
}

#: Columns of numbers; each exists if a run of the study has a value.
NUMBERS = (*MEASURES, *OF_CHECKED_RUNS, *SECOND, *COUNTERS, *TIMINGS, *QUARTILES)

#: All columns but those of the axes.
COLUMNS = frozenset((*TEXTS, *NUMBERS, "run", "reference", "repeat", "wall_repeats_s"))


@dataclass(frozen=True)
class Row:
    """One run in the index.

    Parameters
    ----------
    status
        ``complete``, ``failed``, ``missing``, or ``left-out`` if it needs a distribution that is not installed.
    reason
        Reason why it is not complete: a code and a sentence.
    family, axes, reference_id
        Family, axis labels and reference run; empty for a reference.
    worst_joint, data_sha256
        Joint with the largest misalignment, and hash of the recorded data, from the archive.
    values
        Measures, counters and timings by column.
    repeats
        Wall times of the serial timings, s.
    file_sha256
        Hash of the bytes of its archive; empty if there is none.
    second_run
        ``complete`` if a second run for measures was made, or the reason why it has no result; empty if none was made.
    verdict, verdict_reasons
        Verdict on the run and its reasons, from the archive; empty without an archive.
    """

    run_id: str
    status: str
    reason: str = ""
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


@dataclass(frozen=True)
class Index:
    """All rows of a study.

    Parameters
    ----------
    study_json, study_sha256
        Canonical JSON of the study spec, and its hash.
    version
        Version of mbdkit that wrote the index.
    runs, references
        One row per point, in the order of the study, and one row per reference run.
    defined
        Units and descriptions of the columns of measures that the study defines.
    """

    study_json: str
    study_sha256: str
    version: str
    runs: tuple[Row, ...]
    references: tuple[Row, ...]
    defined: Mapping[str, Description] = field(default_factory=dict)

    def described(self, name: str) -> Description:
        """Return what describes a numeric column: a measure, a counter or a timing.

        Raises
        ------
        KeyError
            If there is no such column.
        """
        return self.defined[name] if name in self.defined else describe_column(name)


def axis_column(key: str) -> str:
    """Return the column of an axis; HDF5 would take a slash in its name for a group."""
    return key.replace("/", "|")


def quartiles(repeats: Sequence[float]) -> dict[str, float]:
    """Return minimum, quartiles and median of repeated timings, by column; nan if there are none."""
    if not len(repeats):
        return dict.fromkeys(QUARTILES, math.nan)
    return {name: float(np.quantile(repeats, share)) for name, share in QUARTILES.items()}


def write(path: Path, index: Index) -> None:
    """Write an index, and replace the previous one atomically.

    Parameters
    ----------
    path
        Final path; it is replaced when the new index is complete.

    Raises
    ------
    SpecError
        If the index cannot be written, as on a full disk; the previous one is unchanged then.
    """
    # Made in memory: HDF5 crashes the interpreter if the disk is full when it closes a file.
    with h5py.File(f"index-{id(index)}", "w", driver="core", backing_store=False, libver=LIBVER) as file:
        set_text(file, "format", FORMAT)
        set_text(file, "format_version", FORMAT_VERSION)
        set_text(file, "mbdkit", index.version)
        set_text(file, "study", index.study_json)
        set_text(file, "study_sha256", index.study_sha256)
        _write_rows(file, "runs", "run", index.runs, index)
        _write_rows(file, "references", "reference", index.references, index)
        set_text(file, "data_sha256", data_sha256(file))
        file.flush()
        image = file.id.get_file_image()
    with replacing(path) as temporary:
        temporary.write_bytes(image)


def _write_rows(file: h5py.File, group: str, dim: str, rows: Sequence[Row], index: Index) -> None:
    file.create_group(group)
    texts: dict[str, list[str]] = {
        "family": [row.family for row in rows],
        "run_id": [row.run_id for row in rows],
        "reference_id": [row.reference_id for row in rows],
        "status": [row.status for row in rows],
        "status_reason": [row.reason for row in rows],
        "verdict": [row.verdict for row in rows],
        "verdict_reasons": [row.verdict_reasons for row in rows],
        "second_run": [row.second_run for row in rows],
        "worst_joint": [row.worst_joint for row in rows],
        "data_sha256": [row.data_sha256 for row in rows],
        "file_sha256": [row.file_sha256 for row in rows],
    }

    def add(name: str, values: Any, dtype: str, units: str, what: str, dims: tuple[str, ...] = (dim,)) -> h5py.Dataset:
        array = Array(f"{group}/{name}", dims, units, what, dtype)
        return create(file, array, np.array(values, object if dtype == TEXT else dtype))

    add(dim, range(1, len(rows) + 1), INTEGER, "1", "number of the run")
    for name, text in texts.items():
        add(name, text, TEXT, "1", TEXTS[name])
    for key in dict.fromkeys(key for row in rows for key in row.axes):
        labels = [row.axes.get(key) for row in rows]
        numeric = not any(isinstance(label, str) for label in labels)
        filled = [(math.nan if numeric else "") if label is None else label for label in labels]
        values = filled if numeric else list(map(str, filled))
        dataset = add(
            axis_column(key), values, FLOAT if numeric else TEXT, "1", f"axis of the study: {key} of the run spec"
        )
        set_text(dataset, "role", "axis")
    for name in dict.fromkeys(name for row in rows for name in row.values):
        column = index.described(name)
        numbers = [row.values.get(name, math.nan) for row in rows]
        dataset = add(name, numbers, FLOAT, column.units, column.long_name)
        if name in index.defined:
            set_text(dataset, "role", DEFINED)
    count = max((len(row.repeats) for row in rows), default=0)
    if count:
        add("repeat", range(1, count + 1), INTEGER, "1", "number of the timing", ("repeat",))
        padded = [[*row.repeats, *[math.nan] * (count - len(row.repeats))] for row in rows]
        add("wall_repeats_s", padded, FLOAT, "s", "wall time of each serial timing", (dim, "repeat"))


def describe_column(name: str) -> Description:
    """Return what describes a numeric column that any study may have; raises KeyError if there is no such column."""
    if name in MEASURES:
        return Description(MEASURES[name].units, MEASURES[name].long_name)
    if name in OF_CHECKED_RUNS:
        return Description(OF_CHECKED_RUNS[name].units, OF_CHECKED_RUNS[name].long_name)
    if name in SECOND:
        return Description(*SECOND[name])
    if name in COUNTERS:
        return Description("1", f"counter of the run: {name.replace('_', ' ')}")
    if name in QUARTILES:
        return Description("s", f"wall time of the steps, {name.split('_')[1]} of the serial timings")
    if name in TIMINGS:
        return Description("s", f"time of the run: {name.removesuffix('_s')}")
    raise KeyError(name)


def read(path: Path) -> Index:
    """Read an index without the axis labels, which follow from the study spec.

    Raises
    ------
    SpecError
        If there is no index that this version can read.
    """
    if not path.exists():
        raise SpecError("there is no index.h5; run `mbdkit study` to write it", file=path.parent)
    hint = "run `mbdkit study` to write it again"
    with reading("the index", path, hint=hint), open_hdf5(path, "study index", hint=hint) as file:
        if file.attrs.get("format") != FORMAT:
            raise SpecError("this is not the index of a study", file=path)
        version = str(file.attrs["format_version"])
        if version.partition(".")[0] != FORMAT_VERSION.partition(".")[0]:
            ours = FORMAT_VERSION.partition(".")[0]
            raise SpecError(f"this index has format version {version}, this mbdkit reads {ours}.x", file=path)
        if file.attrs["data_sha256"] != data_sha256(file):
            raise ValueError("data_sha256 does not match")
        defined = {
            name: Description(str(dataset.attrs["units"]), str(dataset.attrs["long_name"]))
            for name, dataset in file["runs"].items()
            if dataset.attrs.get("role") == DEFINED
        }
        return Index(
            str(file.attrs["study"]),
            str(file.attrs["study_sha256"]),
            str(file.attrs["mbdkit"]),
            _read_rows(file["runs"], "run", defined),
            _read_rows(file["references"], "reference", defined),
            defined,
        )


def _read_rows(group: h5py.Group, dim: str, defined: Iterable[str]) -> tuple[Row, ...]:
    empty = [""] * len(group[dim])  # for columns that earlier versions of the format lack
    texts = {name: list(group[name].asstr()[:]) if name in group else empty for name in TEXTS}
    values = {name: group[name][:] for name in (*defined, *NUMBERS) if name in group}
    repeats = group["wall_repeats_s"][:] if "wall_repeats_s" in group else np.empty((len(empty), 0))
    return tuple(
        Row(
            texts["run_id"][number],
            texts["status"][number],
            texts["status_reason"][number],
            texts["family"][number],
            {},
            texts["reference_id"][number],
            texts["worst_joint"][number],
            texts["data_sha256"][number],
            {name: float(column[number]) for name, column in values.items()},
            tuple(float(value) for value in repeats[number] if not math.isnan(value)),
            texts["file_sha256"][number],
            texts["second_run"][number],
            texts["verdict"][number],
            texts["verdict_reasons"][number],
        )
        for number in range(len(group[dim]))
    )
