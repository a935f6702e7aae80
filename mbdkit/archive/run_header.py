"""Opens the file of a run archive and checks its header, so that later reads cannot fail because of missing entries."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.fingerprint import is_text
from mbdkit.archive.hdf5_errors import closed_on_error, reading
from mbdkit.archive.layout import FORMAT, FORMAT_VERSION
from mbdkit.archive.part_file import PART, checkpoint_path, part_path
from mbdkit.archive.part_stream import complete_flush
from mbdkit.archive.read_only_dict import ReadOnlyDict
from mbdkit.archive.untrusted_file import open_hdf5
from mbdkit.base.errors import ArchiveError, FormatVersionError, SpecError
from mbdkit.base.plain_data import LONGEST_NAME, LONGEST_TITLE, json_data
from mbdkit.base.text import shortened, shown
from mbdkit.quantities.array import GROWING, TEXT, Kind
from mbdkit.quantities.names import AXES, COORDINATES
from mbdkit.registry.feature_items import FileFormat
from mbdkit.registry.manager import registry


def open_archive(path: Path) -> h5py.File:
    """Open the file of a run archive for reading, after checking its format and version.

    Raises ResourceError if the file is in use, or the system refuses to read it. Raises SpecError if the file is
    missing. Raises ArchiveError if it is truncated, not an archive, of an unsupported format version, or refused
    because reading it could do harm.
    """
    if os.path.isdir(path):
        raise SpecError("this is a folder; name a run archive in it", file=path)
    if not os.path.exists(path):
        left = part_path(path)
        hint = "" if path.suffix else f"; the archive of a run is a file such as {path.name}.h5"
        hint = f"; {left} holds the data of an unfinished run" if left.exists() else hint
        raise SpecError(f"there is no such file{hint}", file=path)
    hint = ""
    if path.suffix == PART:
        complete_flush(path)
        if checkpoint_path(path).exists():
            hint = f"`mbdkit run --resume {shown(path.name)}` completes the run from its checkpoint"
        elif path.is_file() and not h5py.is_hdf5(path):
            hint = "the run was killed before it wrote any rows"
    file = open_hdf5(path, "run archive", hint=hint)
    with closed_on_error(file):
        _check_format(file, path)
    return file


def _check_format(file: h5py.File, path: Path) -> None:
    with reading("its format", path):
        kind, version = file.attrs.get("format"), file.attrs.get("format_version")
    ours = FORMAT_VERSION.partition(".")[0]
    is_read = isinstance(version, str) and version.partition(".")[0] == ours
    # also files of our other formats, so that a later version is not taken for a damaged file or for one of others
    if not is_read and (kind == FORMAT or (str(kind).startswith("mbdkit-") and isinstance(version, str))):
        what = "archive" if kind == FORMAT else f"file of the format {shown(kind)}"
        raise FormatVersionError(
            f"this {what} has format version {shortened(shown(version))}, this mbdkit reads {ours}.x; install a "
            "version that matches",
            file=path,
        )
    if kind != FORMAT:
        raise ArchiveError(f"this is not a run archive but {_words(kind)}", file=path)


def _words(kind: object) -> str:
    """Return a phrase for HDF5 files with the attribute `format`."""
    if not isinstance(kind, str):
        return "an HDF5 file of another kind"
    formats = (cast(FileFormat, item.plugin) for item in registry().of_kind("file-format"))
    summary = next((known.summary for known in formats if known.format and known.format == kind), "")
    known = f"{summary[:1].lower()}{summary[1:].rstrip('.')}; `mbdkit report` writes a page about it"
    return known if summary else f"of the format {kind!r}"


#: Sections of a spec that are mappings if they are present.
_MAPPINGS = ("model", "integrator", "time", "output")

#: Sections of a spec that may also be null.
_OPTIONAL_MAPPINGS = ("limits", "events")

#: Longest name that is read [characters]. Some names, such as those of constraints, are composed of several names.
LONGEST = 4 * LONGEST_NAME


def check_shapes(file: h5py.File, kinds: Iterable[Kind]) -> None:
    """Raise ValueError if an array of the kinds of an archive has a type or shape that contradicts its axes."""
    lengths: dict[str, int] = {}
    # if the run crashed between two flushes, its arrays may have different numbers of rows
    crashed = file.attrs.get("status") == "running"
    for path in ("trajectory/body", "joints/joint"):
        if path not in file:
            raise ValueError(f"{path} is missing")
    for path, array in ((array.path, array) for kind in kinds for array in kind.arrays):
        if path not in file:
            continue
        dataset = file[path]
        if not isinstance(dataset, h5py.Dataset):
            raise ValueError(f"{path} is not an array")
        if (TEXT if is_text(dataset) else dataset.dtype.str) != array.dtype:
            raise ValueError(f"{path} has the type {dataset.dtype}, not {array.dtype}")
        if len(dataset.shape) != len(array.dims):
            raise ValueError(f"{path} has {len(dataset.shape)} axes, not {len(array.dims)}")
        for dim, length in zip(array.dims, dataset.shape, strict=True):
            if crashed and dim in GROWING:
                continue
            # All groups have the same rows, bodies and joints, except that events and impacts have their own times.
            axis = f"events/{dim}" if array.group in ("events", "impacts") and dim in GROWING else dim
            if lengths.setdefault(axis, length) != length:
                raise ValueError(f"axis {dim} of {path} has the length {length}, elsewhere {lengths[axis]}")
    for dim, fixed in (("coordinate", len(COORDINATES)), ("axis", len(AXES))):
        if lengths.get(dim, fixed) != fixed:
            raise ValueError(f"the axis {dim} has the length {lengths[dim]}")


def plain_attributes(group: h5py.Group) -> Mapping[str, Any]:
    """Return the attributes of a group as strings and numbers; raise ValueError if one is neither."""
    values = {name: value.item() if isinstance(value, np.generic) else value for name, value in group.attrs.items()}
    if strange := [name for name, value in values.items() if not isinstance(value, str | int | float)]:
        raise ValueError(f"{strange[0]} of {group.name.lstrip('/')} is neither a string nor a number")
    return ReadOnlyDict(values)


def numbers(group: h5py.Group) -> Mapping[str, Any]:
    """Return the attributes of the group ``/stats``; raise ValueError if a counter or a time is not a number."""
    values = plain_attributes(group)
    for name in layout.STATS:
        if isinstance(values.get(name, 0), str):
            raise ValueError(f"{name} of {group.name.lstrip('/')} is not a number")
    return values


def names(file: h5py.File, path: str) -> tuple[str, ...]:
    """Return an array of names; raise ValueError if one is too long to be shown."""
    texts = tuple(file[path].asstr()[:])
    if any(len(name) > LONGEST for name in texts):
        raise ValueError(f"{path} has a name of more than {LONGEST:,} characters")
    return texts


def misalignments(file: h5py.File) -> np.ndarray | None:
    """Return the largest misalignment of each joint, or None if it is not stored; raise ValueError if it is invalid."""
    largest = file["joints"].attrs.get("misalignment_max")
    if largest is not None and (
        largest.shape != file["joints/joint"].shape or not np.issubdtype(largest.dtype, np.floating)
    ):
        raise ValueError("misalignment_max does not hold a number for each joint")
    return None if largest is None else np.asarray(largest)


def spec_of(text: str) -> dict[str, Any]:
    """Return a spec from its canonical JSON; raise ValueError if it is not the spec of a run."""
    spec = json_data(text, parse_int=_integer)
    if not isinstance(spec, dict):
        raise ValueError("it is not a mapping")
    for name in (*_MAPPINGS, *_OPTIONAL_MAPPINGS):
        section = spec.get(name, {})
        if not isinstance(section, dict) and not (section is None and name in _OPTIONAL_MAPPINGS):
            raise ValueError(f"{name} is not a mapping")
    for name in ("model", "integrator"):
        if name in spec and not isinstance(spec[name].get("name"), str):
            raise ValueError(f"{name} has no name")
    if not isinstance(spec.get("title") or "", str) or len(spec.get("title") or "") > LONGEST_TITLE:
        raise ValueError(f"title is not a string of at most {LONGEST_TITLE:,} characters")
    step = spec.get("time", {}).get("step")
    if step is not None and not (isinstance(step, int | float) and math.isfinite(step)):
        raise ValueError("time.step is not a finite number")
    return spec


def _integer(digits: str) -> int:
    if math.isinf(float(digits)):
        raise ValueError(f"it has an integer of {len(digits)} digits")
    return int(digits)
