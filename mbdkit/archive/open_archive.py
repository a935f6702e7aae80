"""Opens the file of a run archive and checks its format."""

from __future__ import annotations

import os
from pathlib import Path

import h5py

from mbdkit.archive.hdf5_errors import reading
from mbdkit.archive.layout import FORMAT, FORMAT_VERSION
from mbdkit.archive.part_file import part_path
from mbdkit.archive.stranger_file import open_hdf5
from mbdkit.base.errors import SpecError
from mbdkit.base.text import shortened, shown


def open_archive(path: Path) -> h5py.File:
    """Open the file of a run archive for reading, after checking its format and version.

    Raises
    ------
    ResourceError
        If the file is in use, or the system refuses to read it.
    SpecError
        If the file is missing, truncated, not an archive, of an unsupported format version, or refused because reading
        it could do harm.
    """
    if os.path.isdir(path):
        raise SpecError("this is a folder; name a run archive in it", file=path)
    if not os.path.exists(path):
        left = part_path(path)
        hint = f"; {left} holds the data of an unfinished run" if left.exists() else ""
        raise SpecError(f"there is no such file{hint}", file=path)
    file = open_hdf5(path, "run archive")
    try:
        _check_format(file, path)
    except BaseException:
        file.close()
        raise
    return file


def _check_format(file: h5py.File, path: Path) -> None:
    with reading("its format", path):
        kind, version = file.attrs.get("format"), file.attrs.get("format_version")
    if kind != FORMAT:
        what = f"of the format {kind!r}" if isinstance(kind, str) else "an HDF5 file of another kind"
        raise SpecError(f"this is not a run archive but {what}", file=path)
    ours = FORMAT_VERSION.partition(".")[0]
    if not isinstance(version, str) or version.partition(".")[0] != ours:
        raise SpecError(
            f"this archive has format version {shortened(shown(version))}, this mbdkit reads {ours}.x; install a "
            "version that matches",
            file=path,
        )
