"""Commands on run archives: `archive`."""

from __future__ import annotations

import typer

from mbdkit.base import terminal
from mbdkit.base.terminal import say, show, show_json
from mbdkit.cli.common_options import Archive, Archives, AsJson, Debug, Quiet


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
