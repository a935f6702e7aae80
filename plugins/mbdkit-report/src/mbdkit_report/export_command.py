"""The command `archive export`."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, cast

import typer

from mbdkit.archive.archive_check import blaming_damage
from mbdkit.archive.run import Run
from mbdkit.base.terminal import show
from mbdkit.cli.common_options import Archives, Debug, Overwrite, Quiet, output_to


def archive_crate(
    archives: Archives,
    output: Annotated[Path, output_to("FOLDER", "The crate, a new folder.")],
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Write run archives as a crate for catalogues (RO-Crate).

    The folder follows the RO-Crate profile Process Run Crate: copies of the archives, and
    of each the spec, a report with figures and the evidence of its method, with digests,
    versions of the software, references (BibTeX) and CodeMeta. Creator and licence are
    those of `meta` in the spec. `mbdkit archive check FOLDER` verifies it.
    """
    from mbdkit_report.crate import write_crate

    write_crate(archives, output)
    if not quiet:
        show(output)


def archive_export(
    archive: Annotated[Path, typer.Argument(metavar="FILE.h5|DIR", help="A run archive, or the folder of a study.")],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="FORMAT",
            help="csv; parquet (needs the package pyarrow); xlsx: Excel (needs XlsxWriter); mat: MATLAB; sto: OpenSim; "
            "json; or a format of a plugin.",
        ),
    ],
    output: Annotated[
        Path | None,
        output_to(
            "DIR",
            "Folder of the files, which is created, or the workbook; by default knee-csv or knee.xlsx for knee.h5.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Export a run, or the table of the runs of a study.

    Writes several files into a folder: each group of a run gives a file GROUP.FORMAT or,
    in a workbook (xlsx), a sheet.
    Groups are trajectory, joints, forces, markers, constraints, energy, steps, events and
    accuracy, as far as the archive contains them. Columns are named as in expressions of
    events, such as knee.force_x. The folder of a study gives one file, runs.FORMAT, with
    one row for each run: its values, status, verdict with reasons, measures and cost.
    Prints the names of the files.
    """
    from mbdkit.archive.result_seams import exported_files
    from mbdkit.registry.feature_items import FileFormat
    from mbdkit.registry.manager import registry
    from mbdkit_report.export import default_output, export

    folder = output if output is not None else default_output(archive, to)
    formats = [cast(FileFormat, item.plugin) for item in registry().of_kind("file-format")]
    kind = FileFormat.of_folder(archive, formats) if archive.is_dir() else None
    if kind is not None and kind.export is not None:
        files = exported_files.of(kind.export)(archive, folder, to, overwrite=overwrite)
    else:
        with opened(archive) as loaded:
            files = export(loaded, folder, to, overwrite=overwrite)
    if not quiet:
        for file in files:
            show(file)


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Run]:
    """Open an archive for a command, as `load` does.

    Raises SpecError if `path` is not an archive that this version can read, or if the body fails because the archive is
    damaged. Raises ResourceError if a run is still writing the file, or the system refuses to read it.
    """
    with blaming_damage(path), Run.open(path) as run:
        yield run
