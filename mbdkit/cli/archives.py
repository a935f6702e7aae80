"""Commands on run archives: `archive`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from mbdkit.base import terminal
from mbdkit.base.terminal import say, show, show_json
from mbdkit.cli.common_options import Archive, Archives, AsJson, Debug, Overwrite, Quiet, output_to


def archive_info(archives: Archives, as_json: AsJson = False, debug: Debug = False) -> None:
    """Describe run archives.

    With --json, prints one object with a list "archives".
    """
    from mbdkit.archive.info import describe, text

    descriptions = [describe(archive) for archive in archives]
    if as_json:
        show_json({"archives": descriptions})
    else:
        show("\n\n".join(text(description) for description in descriptions))


def archive_check(archives: Archives, quiet: Quiet = False, debug: Debug = False) -> None:
    """Check the structure and contents of run archives.

    Exit status 2 if an archive is damaged.
    """
    from mbdkit.archive.archive_check import examine
    from mbdkit.archive.layout import ATTRIBUTES_HASH

    sound = True
    for archive in archives:
        checked = examine(archive)
        sound = sound and not checked.problems
        for problem in checked.problems:
            say(f"{archive}: {problem}")
        if not checked.problems and not quiet:
            without = (
                ""
                if checked.covers_attributes
                else f" (changed attributes cannot be detected, because the archive has no {ATTRIBUTES_HASH})"
            )
            show(f"{archive}: sound{without}")
    if not sound:
        raise typer.Exit(terminal.WRONG_INPUT)


def archive_diff(first: Archive, second: Archive, as_json: AsJson = False, debug: Debug = False) -> None:
    """Compare the data of two run archives.

    Exit status 1 if the data differ; prints the largest relative difference of each
    array. If one archive has an earlier format, the arrays that both have are compared.
    """
    from mbdkit.archive.compare import compare
    from mbdkit.archive.reader import load

    with load(first) as one, load(second) as two:
        found = compare(one, two)
    if as_json:
        told = {"same_data": found.same_data, "same_spec": found.same_spec, "differences": found.differences}
        more = {"left_out": found.left_out, "falsified": found.falsified, "versions": found.versions}
        show_json({**told, **more})
    else:
        show(found)
    if not found.same_data or found.falsified:
        raise typer.Exit(terminal.DIFFERS)


def archive_export(
    archive: Annotated[Path, typer.Argument(metavar="FILE.h5|DIR", help="A run archive, or the folder of a study.")],
    to: Annotated[
        str,
        typer.Option(
            "--to", metavar="FORMAT", help="csv; parquet (needs the package pyarrow); mat: MATLAB; sto: OpenSim; json."
        ),
    ],
    output: Annotated[
        Path | None,
        output_to("DIR", "Folder of the files, which is created; by default FILE-FORMAT, such as knee-csv."),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Export a run, or the table of the runs of a study.

    Writes several files into a folder: each group of a run gives a file GROUP.FORMAT.
    Groups are trajectory, joints, forces, markers, constraints, energy, steps, events and
    accuracy, as far as the archive contains them. Columns are named as in expressions of
    events, such as knee.force_x. The folder of a study gives one file, runs.FORMAT, with
    one row for each run: its values, status, verdict with reasons, measures and cost.
    Prints the names of the files.
    """
    from mbdkit.archive.changed_contents import opened
    from mbdkit.archive.export import export
    from mbdkit.registry.feature_items import FileFormat
    from mbdkit.registry.manager import registry

    folder = output if output is not None else archive.with_name(f"{archive.stem}-{to}")
    formats = [cast(FileFormat, item.plugin) for item in registry().of_kind("file-format")]
    kind = FileFormat.of_folder(archive, formats) if archive.is_dir() else None
    if kind is not None and kind.export is not None:
        files = kind.export()(archive, folder, to, overwrite=overwrite)
    else:
        with opened(archive) as loaded:
            files = export(loaded, folder, to, overwrite=overwrite)
    if not quiet:
        for file in files:
            show(file)
