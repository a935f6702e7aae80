"""Arguments and options that several commands share."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from mbdkit.base import terminal

CONTEXT = {"help_option_names": ["-h", "--help"]}
PLAIN: dict[str, Any] = {"context_settings": CONTEXT, "rich_markup_mode": None, "no_args_is_help": True}


def _set_debug(context: typer.Context, value: bool) -> bool:
    if value:
        context.meta[terminal.DEBUG] = True
    return value


_RUN_SPEC: Any = typer.Argument(
    metavar="SPEC", help="A YAML, TOML or JSON file, - for stdin, or a packaged example such as knee."
)
SpecName = Annotated[str, _RUN_SPEC]
SpecNameOrNone = Annotated[str | None, _RUN_SPEC]
InverseSpecName = Annotated[
    str,
    typer.Argument(
        metavar="SPEC", help="A YAML, TOML or JSON file, - for stdin, or a packaged example such as walking."
    ),
]
AnySpecName = Annotated[
    str,
    typer.Argument(
        metavar="SPEC", help="A YAML, TOML or JSON file, - for stdin, or a packaged example or study, such as knee."
    ),
]
StudyName = Annotated[
    str,
    typer.Argument(metavar="SPEC", help="A YAML, TOML or JSON file, - for stdin, or a packaged study such as paper."),
]
Archive = Annotated[Path, typer.Argument(metavar="FILE.h5", help="A run archive.")]
Archives = Annotated[list[Path], typer.Argument(metavar="FILE.h5", help="Run archives.")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set a key of the spec, such as time.step=0.005; may be repeated."),
]
BaseSet = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Set a key in the base of every run, such as time.end=5, or of the sample (sample.n=64); may be repeated.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing file when the new one is complete.")]
Debug = Annotated[bool, typer.Option("--debug", callback=_set_debug, help="Show the traceback of an error.")]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        min=1,
        metavar="N",
        help="Number of processes, by default one per core; with submitit, of jobs, by default up to 100.",
    ),
]
ExecutorName = Annotated[
    Literal["local", "dask", "submitit"],
    typer.Option(
        "--executor",
        help="Where runs are computed: by processes of this machine, a Dask cluster, or jobs of Slurm (submitit).",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help=(
            "With dask: the address of the scheduler, or its scheduler file. With submitit: slurm (default), or "
            "local, to test with jobs on this machine."
        ),
    ),
]
Slurm = Annotated[
    list[str] | None,
    typer.Option(
        "--slurm", metavar="K=V", help="With submitit: an option of sbatch, such as time=60. Can be repeated."
    ),
]


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
