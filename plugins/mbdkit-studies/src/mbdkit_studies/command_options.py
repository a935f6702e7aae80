"""Options of commands that compute many runs: the source of a study, workers and clusters."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from mbdkit_studies.compute.executor_pool import Engine

StudyName = Annotated[
    str,
    typer.Argument(metavar="SPEC", help="A YAML, TOML or JSON file, - for stdin, or a packaged study such as paper."),
]
BaseSet = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Set a key in the base of every run, such as time.end=5, or of the sample (sample.n=64); may be repeated.",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        min=1,
        metavar="N",
        help="Number of processes (by default one per core) or, with submitit, of jobs (by default up to 100).",
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
            "With dask: address of the scheduler, or its scheduler file; by default, Dask runs on this machine. "
            "With submitit: slurm (default), or local, which runs the jobs on this machine for tests."
        ),
    ),
]
Slurm = Annotated[
    list[str] | None,
    typer.Option(
        "--slurm", metavar="K=V", help="With submitit: an option of sbatch, such as time=60. Can be repeated."
    ),
]


@dataclass
class Cluster:
    """Options of a command whose runs may be computed on other machines."""

    executor: ExecutorName = "local"
    scheduler: Scheduler = None
    slurm: Slurm = None

    @contextlib.contextmanager
    def engine(
        self, workers: int | None, folder: Path, notify: Callable[[str], None], **program: str
    ) -> Iterator[Engine]:
        """Yield what computes tasks: processes of this machine, by default one per core, or the chosen executor.

        The parameters are those of `mbdkit_studies.compute.executors.opened`, and `program` of `Engine`.
        """
        from mbdkit_studies.compute.executor_pool import Engine
        from mbdkit_studies.compute.executors import opened

        scheduler, slurm = self.scheduler, self.slurm or ()
        with opened(self.executor, workers, folder, notify, scheduler=scheduler, slurm=slurm) as executor:
            yield Engine(workers or _cores(), executor, **program)


def _cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
