"""Commands on run archives: `archive`."""

from __future__ import annotations

import typer

from mbdkit.base import terminal
from mbdkit.base.terminal import say, show, show_result
from mbdkit.cli.common_options import Archive, Archives, AsJson, Debug, Quiet


def archive_info(archives: Archives, as_json: AsJson = False, debug: Debug = False) -> None:
    """Describe run archives.

    With --json, prints one object with a list "archives".
    """
    from mbdkit.archive.info import describe, text

    descriptions = [describe(archive) for archive in archives]
    texts = "\n\n".join(text(description) for description in descriptions)
    show_result({"archives": descriptions}, texts, as_json=as_json)


def archive_check(archives: Archives, quiet: Quiet = False, debug: Debug = False) -> None:
    """Check the structure and contents of run archives.

    Exit status 2 if an archive is damaged.
    """
    from mbdkit.archive.archive_check import check

    sound = True
    for archive in archives:
        problems = check(archive)
        sound = sound and not problems
        for problem in problems:
            say(f"{archive}: {problem}")
        if not problems and not quiet:
            show(f"{archive}: sound")
    if not sound:
        raise typer.Exit(terminal.WRONG_INPUT)


def archive_diff(first: Archive, second: Archive, as_json: AsJson = False, debug: Debug = False) -> None:
    """Compare the data of two run archives.

    Exit status 1 if the data differ; prints the largest relative difference of each
    array, the keys whose values differ in the specs, and the main numbers of both runs.
    """
    from mbdkit.archive.compare import compare
    from mbdkit.archive.reader import load

    with load(first) as one, load(second) as two:
        comparison = compare(one, two)
    names = ("same_data", "same_spec", "settings", "answers", "differences", "versions")
    show_result({name: getattr(comparison, name) for name in names}, comparison, as_json=as_json)
    if not comparison.same_data:
        raise typer.Exit(terminal.DIFFERS)
