"""Exports a run: writes each group of arrays over time to its own file, in a format that other programs read."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import cast

from mbdkit.archive.run import Run
from mbdkit.base.errors import SpecError, file_error
from mbdkit.base.files import check_folder, check_output, check_suffix, replacing
from mbdkit.base.text import did_you_mean, listed
from mbdkit.registry.feature_items import TableFormat
from mbdkit.registry.manager import registry, use
from mbdkit_report.group_table import group_names, group_table
from mbdkit_report.table_formats import ExportedTable, table_writer, workbook_writer


def export(run: Run, folder: Path, to: str, *, overwrite: bool = False) -> list[Path]:
    """Write each group of a run to a file ``GROUP.FORMAT`` in a folder, or all to one workbook, and return the files.

    If one file cannot be written, none is.

    Parameters
    ----------
    folder
        Folder of the files; it is created if its parent exists. The file, for a workbook.
    to
        Format: ``csv``, ``parquet``, ``xlsx``, ``mat``, ``sto`` or ``json``. Events are not written as ``sto``, a
        format that does not allow two rows with the same time.
    overwrite
        Whether existing files may be replaced.

    Raises
    ------
    SpecError
        If the format is unknown, the run has no rows, or a file exists or cannot be written.
    ResourceError
        If the disk is full or writing is not permitted.
    MbdkitError
        If the format needs a package that is not installed.
    """
    table_format(to)
    if not len(run.time):
        raise SpecError("this run recorded no rows, so there is nothing to export", file=run.path)
    shown = [group for group in group_names(run) if not (to == "sto" and group == "events")]
    tables = {group: group_table(run, group) for group in shown}
    return write_tables(tables, folder, to, overwrite=overwrite, source=run.path)


def table_format(to: str) -> TableFormat:
    """Return a format; raise SpecError if there is none of this name."""
    names = registry().names("table-format")
    if to not in names:
        hint = " (OpenSim reads sto wherever it reads mot)" if to == "mot" else did_you_mean(to, names)
        raise SpecError(f"there is no format {to!r}{hint}; the formats are {listed(names)}")
    return cast(TableFormat, registry().get("table-format", to).plugin)


def default_output(path: Path, to: str) -> Path:
    """Return where the tables of a file or folder are written unless a name is given."""
    one = table_format(to)
    return path.with_name(f"{path.stem}{one.suffix if one.write_all else f'-{to}'}")


def write_tables(
    tables: Mapping[str, ExportedTable], folder: Path, to: str, *, overwrite: bool, source: Path | None = None
) -> list[Path]:
    """Write tables to files ``NAME.FORMAT`` in a folder, or all to one workbook, and return the files; if one cannot be
    written, none is.

    Parameters
    ----------
    tables
        Tables by name.
    folder
        Folder of the files; it is created if its parent exists. The file, for a workbook.
    to
        Name of the format.
    overwrite
        Whether existing files may be replaced.
    source
        The file with the data, which is never replaced.

    Raises
    ------
    SpecError
        If the format is unknown, or a file exists or cannot be written.
    ResourceError
        If the disk is full or writing is not permitted.
    MbdkitError
        If the format needs a package that is not installed.
    """
    own, item = table_format(to), registry().get("table-format", to)
    if own.write_all is not None:
        check_suffix(folder, (own.suffix,), "a workbook")
        check_output(folder, overwrite=overwrite)
        with replacing(folder, overwrite=overwrite, source=source) as temporary:
            use(item, lambda write=own.write_all: workbook_writer.of(write)(tables, temporary))  # type: ignore[misc]
        return [folder]
    assert own.write is not None
    write = own.write
    files = {folder / f"{name}{own.suffix}": table for name, table in tables.items()}
    is_new = _prepare(folder, list(files), overwrite)
    try:
        with ExitStack() as stack:
            for path, table in files.items():
                temporary = stack.enter_context(replacing(path, overwrite=overwrite, source=source))
                use(item, lambda table=table, file=temporary: table_writer.of(write)(table, file))  # type: ignore[misc]
                with temporary.open("rb+") as written:
                    os.fsync(written.fileno())  # a full disk is noticed before the first file has its name
    except BaseException:
        if is_new:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    return list(files)


def _prepare(folder: Path, files: list[Path], overwrite: bool) -> bool:
    if folder.is_dir():
        for file in files:
            check_output(file, overwrite=overwrite)
        return False
    if os.path.lexists(folder):
        raise SpecError("this is a file, not a folder; choose another name with -o", file=folder)
    check_folder(folder.parent, folder)
    try:
        folder.mkdir()
    except OSError as error:
        raise file_error(error.errno, f"cannot be created: {error.strerror or error}", file=folder) from error
    return True
