"""The table of members (runs) of a study: an HDF5 file with a column of values for each key that varies."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mbdkit.archive.fingerprint import StoredHashes, seal
from mbdkit.archive.hdf5 import set_text
from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.untrusted_file import open_hdf5
from mbdkit.base.errors import SpecError
from mbdkit.base.files import replacing
from mbdkit.quantities.array import FLOAT, INTEGER, TEXT, Array
from mbdkit_studies.folder import tables
from mbdkit_studies.spec.study_spec import StudySpec

FILE = "members.h5"  #: Name of the table in the folder of a study; see `StudySpec.members`.

_FORMAT, _VERSION = "mbdkit-members", "1.0"


def image(columns: Mapping[str, np.ndarray]) -> tuple[bytes, str]:
    """Return the bytes of a table and its hash.

    Parameters
    ----------
    columns
        (N,) numbers or strings by dotted key.
    """
    with tables.hdf5_in_memory() as file:
        what = "Table of the values that vary, one row for each run."
        tables.write_header(file, _FORMAT, _VERSION, "Values of a study", what)
        file.create_group("members")
        count = len(next(iter(columns.values())))
        tables.write_scale(file, "members/run", range(1, count + 1), "number of the run")
        for number, (key, values) in enumerate(columns.items(), start=1):
            dtype = TEXT if values.dtype == object else INTEGER if values.dtype.kind == "i" else FLOAT
            array = Array(f"members/value_{number:04d}", ("run",), "1", f"value of {key}", dtype)
            set_text(tables.write_column(file, array, values), "key", key)
        seal(file)
        return tables.file_bytes(file), str(file.attrs["data_sha256"])


def read_members(spec: StudySpec) -> dict[str, np.ndarray]:
    """Return the columns of the table of members of a study by dotted key; object arrays of strings for texts.

    Raises
    ------
    SpecError
        If the table is missing or damaged, or is not the one that the study names.
    """
    assert spec.members is not None
    if spec._columns is None:
        spec._columns = _read(spec._folder / spec.members.file, spec.members.runs, spec.members.sha256)
    return spec._columns


def _read(path: Path, runs: int, sha256: str) -> dict[str, np.ndarray]:
    if not path.is_file():
        raise SpecError("there is no such file, which the study names as the table of its members", file=path)
    hint = "restore it, or create the study again"
    with reading("its columns", path, hint=hint), open_hdf5(path, "table of members", hint=hint) as file:
        tables.check_header(file, path, _FORMAT, _VERSION, "a table of members")
        StoredHashes(file).verify()
        if file.attrs["data_sha256"] != sha256:
            raise SpecError("this is not the table of this study: its hash differs", file=path)
        items = [item for item in file["members"].values() if "key" in item.attrs]
        columns = {str(item.attrs["key"]): tables.read_column(item) for item in items}
        if not columns or any(column.shape != (runs,) for column in columns.values()):
            raise SpecError(f"the columns of this table do not have the {runs} rows that the study names", file=path)
        return columns


def write_members(spec: StudySpec, folder: Path) -> None:
    """Write the table of members of a study into its folder."""
    content, _ = image(read_members(spec))
    with replacing(folder / FILE) as temporary:
        temporary.write_bytes(content)
