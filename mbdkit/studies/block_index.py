"""The index of a study in blocks: columns with one value for each run, in an HDF5 file that is written atomically."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
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
from mbdkit.archive.layout import ATTRIBUTES_HASH, COUNTERS, FLOAT, INTEGER, TEXT, TIMINGS, Array
from mbdkit.archive.part_file import LIBVER
from mbdkit.archive.stranger_file import open_hdf5
from mbdkit.errors import MbdkitError, SpecError
from mbdkit.files import replacing
from mbdkit.measures.take import Description
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies.measures import MEASURES
from mbdkit.studies.planned_points import PlannedPoints
from mbdkit.studies.study_blocks import StudyBlocks
from mbdkit.studies.study_folder import StudyFolder
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
    """

    columns: Mapping[str, np.ndarray]
    described: Mapping[str, Description]


def collect(
    spec: StudySpec,
    points: PlannedPoints,
    blocks: StudyBlocks,
    folder: StudyFolder,
    *,
    reasons: Mapping[int, str],
) -> BlockIndex:
    """Return the index of the blocks that a folder contains; the runs of others are missing.

    Parameters
    ----------
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
        try:
            with Block(folder.block(number)) as block:
                if block.study_sha256 != spec.sha256() or len(block.numbers) != len(places):
                    continue
                found = {name: block.runs[name] for name in texts if name in block.runs}
                found["verdict_reasons"] = _joined(found.get("verdict_reasons"), len(places))
                values = {MISALIGNMENT: block.runs[MISALIGNMENT], **block.columns("measures"), **block.columns("stats")}
                described |= {name: Description(*told) for name, told in block.described().items()}
        except (MbdkitError, OSError):
            texts["status_reason"][rows] = reasons.get(number, "")
            continue
        for name, column in found.items():
            texts[name][rows] = column
        for name, column in values.items():
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
    return BlockIndex(columns, {name: described[name] for name in numbers})


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
        set_text(file, "data_sha256", data_sha256(file))
        set_text(file, ATTRIBUTES_HASH, attributes_sha256(file))
        file.flush()
        image = file.id.get_file_image()
    with replacing(path) as temporary:
        temporary.write_bytes(image)


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
        return BlockIndex(columns, described)
