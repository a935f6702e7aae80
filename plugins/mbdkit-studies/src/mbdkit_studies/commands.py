"""Studies, which are families of runs: `study`; options of all commands that compute many runs."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand

from mbdkit.base.progress_bars import count_bar
from mbdkit.base.terminal import STOPPED_EARLY, say, show, show_json, silence
from mbdkit.cli.common_options import PLAIN, Call, Printing, grouped, output_to, stem
from mbdkit.spec.reading import Document
from mbdkit.spec.spec_kinds import spec_check

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


class StudyCommand(TyperCommand):
    """The command `study`, whose help is followed by the names of the installed studies."""

    def format_epilog(self, ctx: object, formatter: Any) -> None:
        """Write the names of the packaged studies."""
        from mbdkit_studies.spec.study_loading import study_names

        formatter.write_paragraph()
        formatter.write_text(f"Packaged studies: {', '.join(study_names())}.")


@dataclass
class Stored:
    """Options for what a study computes in its folder, and what it stores there."""

    store: Annotated[
        Literal["files", "all", "histories", "summary", "hashes"] | None,
        typer.Option(
            "--store",
            help=(
                "What is stored of each run: one archive per run, `files` (about 140 kB); or, in files of many runs, "
                "`all` arrays (84 kB), `histories`: positions and reactions over time (26 kB), `summary`: counters, "
                "times and misalignments (0.8 kB), or `hashes`. Every choice keeps spec, verdict and measures of each "
                "run, so that the run can be computed again (`study.remake`). The default is `files` for up to 500 "
                "runs and for studies with a `reference` or `repeats`, and otherwise `all`."
            ),
        ),
    ] = None
    assignments: BaseSet = None
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "--with",
            metavar="METHOD",
            help=(
                "Compare one more method, in a study of methods such as paper or drift: the name of an integrator, or "
                "a mapping such as '{name: gauss, stages: 4}'; may be repeated."
            ),
        ),
    ] = None
    quick: Annotated[
        bool, typer.Option("--quick", help="Run the short form of a packaged study that has one, such as methods.")
    ] = False
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite",
            help="Replace the study in the folder: remove its spec, runs, report and figures; other files are kept.",
        ),
    ] = False


@contextlib.contextmanager
def _saying_how_to_continue(overwrite: bool) -> Iterator[None]:
    """After an interrupt, say how to continue the study."""
    try:
        yield
    except KeyboardInterrupt:
        how = "call the same command again, without --overwrite" if overwrite else "call the same command again"
        say(f"to continue, {how}: it keeps complete runs, and continues others from their last checkpoint")
        raise


study_app = typer.Typer(add_completion=False, **PLAIN)


@study_app.command(cls=StudyCommand)
@grouped
def study(
    spec: StudyName,
    *,
    output: Annotated[Path | None, output_to("DIR", "The study's folder; by default ./SPEC.")] = None,
    workers: Workers = None,
    shard: Annotated[
        str | None,
        typer.Option("--shard", metavar="i/N", help="Compute only part i of N of the runs, or of the blocks."),
    ] = None,
    cluster: Cluster,
    stored: Stored,
    with_report: Annotated[
        bool,
        typer.Option(
            "--report", help="Also write report.html and figures/, replacing old ones, and print the main table."
        ),
    ] = False,
    call: Call = False,
    printing: Printing,
) -> None:
    """Run a study: many variants of one spec.

    Writes an archive for each run, or blocks of many runs, and index.h5, a table with
    one row for each run. A second call computes only missing runs; failed runs are not
    repeated.

    --set changes the base of every run, like the overrides of the study; keys that an
    axis or a sample varies cannot be set. --set check=true estimates the errors of
    every run, which takes 4 to 15 times as long, or more.

    --with adds a method to a study that compares methods, with its own formulation; an
    adaptive one has tolerances where the others have steps. The report shows it beside
    the methods of the study.

    For a study with a sample, --report shows histograms, Sobol indices and quantiles
    over time; `mbdkit guide studies` explains these. A study with `tolerances` answers with
    the smallest and the largest value of each measure within them.

    With --executor dask or submitit, workers on other machines compute the runs and
    write them into the folder, which must have the same path there.

    Exit status 3 if runs are missing, for example because the disk is full or a process
    died; a second call tries again.
    """
    from mbdkit_studies.compute.carry_out import study as carry_out
    from mbdkit_studies.folder.folder_lock import Shard
    from mbdkit_studies.report.study_summary import outcome, summary

    part = None if shard is None else Shard.parse(shard)
    path = output if output is not None else Path(stem(spec))
    notify = silence if printing.quiet else say
    with (
        _saying_how_to_continue(stored.overwrite),
        cluster.engine(workers, path, notify) as engine,
        count_bar(path.name, printing.quiet) as progress,
    ):
        result = carry_out(
            spec,
            out=path,
            workers=engine.workers,
            executor=engine.executor,
            shard=part,
            progress=progress,
            notify=notify,
            assignments=stored.assignments or (),
            with_=stored.methods or (),
            overwrite=stored.overwrite,
            store=stored.store,
            quick=stored.quick,
            call=call,
        )
    page, told, values = None, "", {}
    if with_report:
        from mbdkit_report import json_values, terminal_text, write_report

        page, verdict = write_report(path, overwrite=True)
        told, values = terminal_text(verdict), json_values(verdict)
    if printing.as_json:
        more = {} if page is None else {"report": str(page)} | ({"verdict": values} if values else {})
        show_json(outcome(result) | more)
    elif not printing.quiet:
        show(summary(result))
        if page is not None:
            show(f"report     {page}")
        if told:
            show(f"\n{told}")
    if result.unfinished:
        if printing.as_json or printing.quiet:
            say(f"unfinished: {result.unfinished[0]}")
        raise typer.Exit(STOPPED_EARLY)


@spec_check
def validate_study(source: str | Document, name: str, assignments: list[str]) -> None:
    """Check a study spec, the expressions of its measures and the specs of its runs, and print what it defines."""
    from mbdkit_studies.compute.study_plan import plan_study
    from mbdkit_studies.report.study_summary import plan_summary
    from mbdkit_studies.spec.study_loading import load_study_spec
    from mbdkit_studies.store.storage import is_for_blocks

    study = load_study_spec(source, assignments)
    plan = plan_study(study.stored_as(study.store or "all") if is_for_blocks(study) else study)
    for warning in plan.warnings():
        say(f"warning: {warning}")
    show(f"{name}: this study is valid\n{plan_summary(plan)}")
