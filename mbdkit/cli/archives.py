"""Commands on run archives: `archive`."""

from __future__ import annotations

import json
import math

import typer

from mbdkit import terminal
from mbdkit.cli.common_options import PLAIN, Archive, Archives, AsJson, Debug, Quiet
from mbdkit.terminal import say

archive_app = typer.Typer(help="Describe, check and compare run archives.", **PLAIN)


@archive_app.command("info")
def archive_info(archives: Archives, as_json: AsJson = False, debug: Debug = False) -> None:
    """Describe run archives.

    With --json, prints one object with a list "archives".
    """
    from mbdkit.archive.info import describe, text

    descriptions = [describe(archive) for archive in archives]
    if as_json:
        print(json.dumps({"archives": descriptions}))
    else:
        print("\n\n".join(text(description) for description in descriptions))


@archive_app.command("check")
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
            print(f"{archive}: sound")
    if not sound:
        raise typer.Exit(terminal.WRONG_INPUT)


@archive_app.command("diff")
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
        differences = {path: value if math.isfinite(value) else None for path, value in found.differences.items()}
        told = {"same_data": found.same_data, "same_spec": found.same_spec, "differences": differences}
        print(json.dumps({**told, "left_out": found.left_out, "versions": found.versions}))
    else:
        print(found)
    if not found.same_data:
        raise typer.Exit(terminal.DIFFERS)
