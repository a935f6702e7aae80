"""The index of a study in blocks: columns with one value for each run, in an HDF5 file that is written atomically."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import h5py
import numpy as np

from mbdkit.archive.blocks import Block
from mbdkit.archive.columns import read_column, write_column, write_hashes
from mbdkit.archive.fingerprint import attributes_sha256, data_sha256
from mbdkit.archive.hdf5 import create, set_text
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.layout import ATTRIBUTES_HASH, COUNTERS, TIMINGS
from mbdkit.archive.part_file import LIBVER
from mbdkit.archive.stranger_file import open_hdf5
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.files import replacing
from mbdkit.measures.take import Description
from mbdkit.quantities.array import FLOAT, INTEGER, TEXT, Array
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies.measures import MEASURES
from mbdkit.studies.planned_points import PlannedPoints
from mbdkit.studies.study_blocks import StudyBlocks
from mbdkit.studies.study_index import FORMAT, axis_column
from mbdkit.studies.study_index import TEXTS as DESCRIPTIONS

FORMAT_VERSION = "2.0"
"""Earlier versions of mbdkit read 1.x, with a file for each run, and say so."""

TEXTS = ("status", "status_reason", "verdict", "verdict_reasons", "worst_joint")
HASHES = ("run_id", "data_sha256")
MISALIGNMENT = "misalignment_max"

_HINT = "run `mbdkit study` to write it again"


@dataclass(frozen=True, eq=False)
class BlockIndex:
    """The columns of a study.

    Parameters
    ----------
    columns
        (N,) values by name, in the order of the table: families and axes, results, measures, counters, hashes.
    described
        Unit and description of each column of numbers that is no axis.
    states
        (B, 4) size, times [ns] and number of the file of each block, see `mbdkit.studies.known_blocks`; zero for
        unknown ones.
    version
        Version of mbdkit that wrote the index.
    """

    columns: Mapping[str, np.ndarray]
    described: Mapping[str, Description]
    states: np.ndarray
    version: str = ""

    def rows(self, places: range) -> BlockRows:
        """Return the rows of some runs, by their places from 0."""
        rows = slice(places.start, places.stop)
        texts = {name: self.columns[name][rows] for name in (*TEXTS, *HASHES)}
        return BlockRows(texts, {name: self.columns[name][rows] for name in self.described}, self.described)


@dataclass(frozen=True, eq=False)
class BlockRows:
    """The columns of the runs of one block: texts and hashes, numbers, and what the numbers are."""

    texts: Mapping[str, np.ndarray]
    numbers: Mapping[str, np.ndarray]
    described: Mapping[str, Description]


def read_rows(path: Path, study_sha256: str, count: int) -> BlockRows | None:
    """Return the columns of a block of `count` runs of a study; None if the file does not exist or cannot be read."""
    try:
        with Block(path) as block:
            if block.study_sha256 != study_sha256 or len(block.numbers) != count:
                return None
            texts = {name: block.runs[name] for name in (*TEXTS, *HASHES) if name in block.runs}
            texts["verdict_reasons"] = _joined(texts.get("verdict_reasons"), count)
            numbers = {MISALIGNMENT: block.runs[MISALIGNMENT], **block.columns("measures"), **block.columns("stats")}
            return BlockRows(texts, numbers, {name: Description(*told) for name, told in block.described().items()})
    except (MbdkitError, OSError):
        return None


def collect(
    points: PlannedPoints,
    blocks: StudyBlocks,
    rows_of: Callable[[int], BlockRows | None],
    *,
    reasons: Mapping[int, str],
) -> tuple[dict[str, np.ndarray], dict[str, Description]]:
    """Return the columns of a study, and what those of numbers are; the runs of blocks without rows are missing.

    Parameters
    ----------
    rows_of
        Returns the rows of a block by its number.
    reasons
        Why blocks could not be computed, by their number.
    """
    count = len(points)
    texts = {name: np.full(count, "", object) for name in (*TEXTS, *HASHES)}
    texts["status"][:] = "missing"
    numbers = {MISALIGNMENT: np.full(count, np.nan)}
    described = {MISALIGNMENT: Description(MEASURES[MISALIGNMENT].units, MEASURES[MISALIGNMENT].long_name)}
    for number in range(blocks.count):
        places = blocks.places(number)
        rows = slice(places.start, places.stop)
        found = rows_of(number)
        if found is None:
            texts["status_reason"][rows] = reasons.get(number, "")
            continue
        described |= found.described
        for name, column in found.texts.items():
            texts[name][rows] = column
        for name, column in found.numbers.items():
            numbers.setdefault(name, np.full(count, np.nan))[rows] = column
    described |= {name: Description("1", f"counter of the run: {name.replace('_', ' ')}") for name in COUNTERS}
    described |= {name: Description("s", f"time of the run: {name.removesuffix('_s')}") for name in TIMINGS}
    families = points.families()
    columns = {
        **({"family": families} if any(families) else {}),
        **points.labels(),
        **{name: texts[name] for name in ("run_id", *TEXTS)},
        **{name: numbers[name] for name in _ordered(numbers)},
        "data_sha256": texts["data_sha256"],
    }
    return columns, {name: described[name] for name in numbers}


def _joined(texts: np.ndarray | None, count: int) -> np.ndarray:
    """Return the reasons for verdicts as texts, from lists of them in JSON."""
    if texts is None:
        return np.full(count, "", object)
    known = {text: " ".join(json.loads(text)) for text in dict.fromkeys(texts)}
    return np.array([known[text] for text in texts], object)


def _ordered(names: Iterable[str]) -> list[str]:
    """Return names with measures before counters, and counters before times."""
    last = (*COUNTERS, *TIMINGS)
    return [*(name for name in names if name not in last), *(name for name in last if name in names)]


def write(path: Path, spec: StudySpec, index: BlockIndex, axes: Iterable[str]) -> None:
    """Write an index, and replace the previous one atomically.

    Parameters
    ----------
    axes
        Names of the columns that are axes of the study.

    Raises
    ------
    SpecError
        If the index cannot be written, as on a full disk; the previous one is unchanged then.
    """
    axes = set(axes)
    # Made in memory: HDF5 crashes the interpreter if the disk is full when it closes a file.
    with h5py.File(f"index-{id(index)}", "w", driver="core", backing_store=False, libver=LIBVER) as file:
        for name, text in (
            ("format", FORMAT),
            ("format_version", FORMAT_VERSION),
            ("mbdkit", version("mbdkit")),
            ("study", spec.canonical_json()),
            ("study_sha256", spec.sha256()),
        ):
            set_text(file, name, text)
        file.create_group("runs")
        count = len(index.columns["status"])
        create(file, Array("runs/run", ("run",), "1", "number of the run", INTEGER), np.arange(1, count + 1))
        for place, (name, values) in enumerate(index.columns.items(), start=1):
            _write(file, name, place, values, index.described.get(name), is_axis=name in axes)
        file.create_group("blocks")
        states = Array(
            "blocks/file_state", ("block", "property"), "1", "size, times [ns] and number of the file", INTEGER
        )
        _scale(file, "block", len(index.states))
        _scale(file, "property", index.states.shape[1])
        create(file, states, index.states)
        set_text(file, "data_sha256", data_sha256(file))
        set_text(file, ATTRIBUTES_HASH, attributes_sha256(file))
        file.flush()
        image = file.id.get_file_image()
    with replacing(path) as temporary:
        temporary.write_bytes(image)


def _scale(file: h5py.File, name: str, size: int) -> None:
    create(file, Array(f"blocks/{name}", (name,), "1", f"number of the {name}", INTEGER), np.arange(size))


def _write(
    file: h5py.File, name: str, place: int, values: np.ndarray, described: Description | None, *, is_axis: bool
) -> None:
    told = Description("1", DESCRIPTIONS.get(name, f"axis of the study: {name} of the run spec"))
    told = described or told
    units, what = told.units, told.long_name
    path = f"runs/{axis_column(name)}"
    if name in HASHES:
        write_hashes(file, Array(path, ("run",), units, what), [str(value) for value in values])
    elif values.dtype == object:
        texts = ["" if value is None else str(value) for value in values]
        write_column(file, Array(path, ("run",), units, what, TEXT), texts)
    else:
        dtype = INTEGER if values.dtype.kind == "i" else FLOAT
        write_column(file, Array(path, ("run",), units, what, dtype), values)
    dataset = file[path]
    dataset.attrs["place"] = np.int64(place)
    set_text(dataset, "name", name)
    set_text(dataset, "role", "axis" if is_axis else "text" if described is None else "number")


def read(path: Path, study_sha256: str) -> BlockIndex:
    """Read an index.

    Raises
    ------
    SpecError
        If there is no index of this study that this version can read.
    """
    if not path.exists():
        raise SpecError("there is no index.h5; run `mbdkit study` to write it", file=path.parent)
    with reading("the index", path, hint=_HINT), open_hdf5(path, "study index", hint=_HINT) as file:
        if file.attrs.get("format") != FORMAT:
            raise SpecError("this is not the index of a study", file=path)
        told = str(file.attrs["format_version"])
        if told.partition(".")[0] != FORMAT_VERSION.partition(".")[0]:
            raise SpecError(f"this index has format {told}, but this study needs format 2.x; {_HINT}", file=path)
        if file.attrs["data_sha256"] != data_sha256(file) or file.attrs[ATTRIBUTES_HASH] != attributes_sha256(file):
            raise ValueError("its hashes do not match")
        if file.attrs["study_sha256"] != study_sha256:
            raise SpecError(f"the index does not match study.yaml; {_HINT}", file=path.parent)
        items = [item for item in file["runs"].values() if "role" in item.attrs]
        items.sort(key=lambda item: int(item.attrs["place"]))
        columns = {str(item.attrs["name"]): read_column(item) for item in items}
        described = {
            str(item.attrs["name"]): Description(str(item.attrs["units"]), str(item.attrs["long_name"]))
            for item in items
            if item.attrs["role"] == "number"
        }
        states = file["blocks/file_state"][:] if "blocks/file_state" in file else np.zeros((0, 4), np.int64)
        return BlockIndex(columns, described, states, str(file.attrs["mbdkit"]))
