"""Families of runs: `study`."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from mbdkit.cli.options import AsJson, Debug, Quiet, StudyName
from mbdkit.cli.targets import stem
from mbdkit.terminal import count_bar, say, silence


def study(
    spec: StudyName,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="The study's folder; by default ./SPEC.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", min=1, metavar="N", help="How many processes compute; by default one a core."),
    ] = None,
    shard: Annotated[
        str | None, typer.Option("--shard", metavar="i/N", help="Compute only part i of N of the runs.")
    ] = None,
    executor: Annotated[
        Literal["local"], typer.Option("--executor", help="Where the processes are: on this machine.")
    ] = "local",
    with_report: Annotated[
        bool, typer.Option("--report", help="Write report.html and figures/ as well, anew.")
    ] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Run a family of specs and collect what comes out.

    The folder gets one archive a run and index.h5, one row a run. A second call
    computes only what is missing; runs that failed are results like others.
    """
    from mbdkit.studies.execute import Shard
    from mbdkit.studies.study import study as carry_out
    from mbdkit.studies.summary import outcome, summary

    part = None if shard is None else Shard.parse(shard)
    path = output if output is not None else Path(stem(spec))
    notify = silence if quiet else say
    with count_bar(path.name, quiet) as progress:
        result = carry_out(spec, out=path, workers=workers or _cores(), shard=part, progress=progress, notify=notify)
    page = None
    if with_report:
        from mbdkit.report.report import report as write

        page = write(path, overwrite=True)
    if as_json:
        print(json.dumps(outcome(result) | ({} if page is None else {"report": str(page)})))
    elif not quiet:
        print(summary(result))
        if page is not None:
            print(f"report     {page}")


def _cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
