"""Designs, which choose numbers of a spec: `design`; and the state of long work: `watch`."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from mbdkit.base.progress_bars import tally_bar
from mbdkit.base.terminal import STOPPED_EARLY, say, show, show_json, silence
from mbdkit.base.text import listed
from mbdkit.cli.common_options import Printing, Set, grouped, output_to, stem
from mbdkit.spec.spec_kinds import spec_check
from mbdkit_studies import Cluster, Workers

if TYPE_CHECKING:
    from mbdkit.spec.reading import Document
    from mbdkit.spec.run_spec import RunSpec
    from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
    from mbdkit_design.design import Design
    from mbdkit_design.robustness import Deviation


#: Largest number of rows of the table of robustness that are printed: those with the largest first goals.
DEVIATIONS_SHOWN = 12
LOADS_SHOWN = 3  #: Largest number of loads, in addition to the goals, whose change is printed.


@grouped
def design(
    spec: Annotated[
        str,
        typer.Argument(
            metavar="SPEC", help="A YAML, TOML or JSON file, - for stdin, or a packaged design such as gravity-balance."
        ),
    ],
    *,
    output: Annotated[Path | None, output_to("DIR", "The design's folder; by default ./SPEC.")] = None,
    workers: Workers = None,
    cluster: Cluster,
    assignments: Set = None,
    with_report: Annotated[
        bool,
        typer.Option(
            "--report", help="Also write report.html: the mechanism, its loads, and the goals around the best point."
        ),
    ] = False,
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite",
            help="Replace the design in the folder: remove its points, results and report; other files are kept.",
        ),
    ] = False,
    optimum_only: Annotated[
        bool,
        typer.Option(
            "--optimum-only",
            help="Stop when the best point and its errors are known. The same command without this option adds the "
            "comparisons and the robustness later.",
        ),
    ] = False,
    printing: Printing,
) -> None:
    """Choose numbers of a spec so that measures become small.

    Variables, goals and limits are stated in the design spec. The optimum is found first;
    then its errors are estimated, it is compared with the optima of other settings
    (`compare` of the spec), and its robustness is computed. Writes design.json, archives of
    the start and of the best point, and points.jsonl with all points that are evaluated.
    If a call is interrupted, the same command continues from these points. See `mbdkit guide design`.

    Exit status 3 if no point satisfies all limits, or a resource is not available.
    """
    from mbdkit_design.design_loading import load_design_spec
    from mbdkit_design.robustness import robustness
    from mbdkit_design.solve_design import WORKER, evaluating, solved_in
    from mbdkit_design.stages import Stages
    from mbdkit_design.store import DesignFolder

    folder = output if output is not None else Path(stem(spec))
    notify = silence if printing.quiet or printing.as_json else say
    with (
        cluster.engine(workers, folder, notify, program=WORKER) as engine,
        tally_bar(folder.name, printing.quiet) as progress,
    ):
        loaded = load_design_spec(spec, assignments or ())
        there = DesignFolder(folder)
        stages = Stages(loaded, notify, progress, optimum_only=optimum_only, further=0 if optimum_only else 1)
        result = solved_in(there, loaded, engine, stages, overwrite=overwrite)
        deviations: list[Deviation] = []
        if not optimum_only:
            with there.locked(), evaluating(result.spec, there, engine, stages) as evaluator:
                stages.begin("robustness")
                deviations = robustness(evaluator, evaluator.point(result.best.variables))
    page = None
    if with_report:
        from mbdkit_report import write_report

        page, _ = write_report(folder, overwrite=True, workers=engine.workers)
    if printing.as_json:
        show_json(
            {"path": str(folder), **result.to_dict(), "warnings": result.warnings}
            | {"robustness": [deviation.to_dict() for deviation in deviations]}
            | ({} if page is None else {"report": str(page)})
        )
    elif not printing.quiet:
        _show(result, folder, deviations, page)
    if not result.is_feasible:
        raise typer.Exit(STOPPED_EARLY)


def _show(result: Design, folder: Path, deviations: list[Deviation], page: Path | None) -> None:
    """Print the result of a design: costs in other quantities, warnings, robustness and files."""
    from mbdkit.base.errors import MbdkitError
    from mbdkit_design.design_verdict import robustness_table
    from mbdkit_design.gains import costs
    from mbdkit_design.store import runs_of
    from mbdkit_report import table_text

    summary = result.summary()
    show(summary)
    with suppress(MbdkitError), runs_of(result, folder) as pairs:  # archives may have been removed
        for cost in costs(pairs)[:LOADS_SHOWN]:
            show(f"elsewhere: {cost.text()}")
        told = {name: [one for one in pair["best"].warnings if one not in summary] for name, pair in pairs.items()}
        for warning in _of_scenarios(told):
            show(f"warning: {warning}")
    if deviations:
        ranked = sorted(deviations, key=lambda one: -np.max(np.nan_to_num(one.goals[:, 0], nan=np.inf)))
        show(table_text(robustness_table(result.spec, result.best, ranked[:DEVIATIONS_SHOWN])))
        if (rest := len(ranked) - DEVIATIONS_SHOWN) > 0:
            show(f"and {rest} numbers with a smaller effect, which the report has")
    show(f"folder: {folder}{'' if page is None else f', report: {page}'}")


def _of_scenarios(told: Mapping[str, Iterable[str]]) -> Iterator[str]:
    """Yield each warning about the specs of scenarios once, with their names unless it concerns all of them."""
    found: dict[str, list[str]] = {}
    for name, warnings in told.items():
        for warning in warnings:
            found.setdefault(warning, []).append(name)
    for warning, names in found.items():
        where = f"{'scenario' if len(names) == 1 else 'scenarios'} {listed(names, 'and')}: "
        yield f"{'' if len(names) == len(told) else where}{warning}"


def _cautions(spec: RunSpec | InverseSpec) -> Iterable[str]:
    """Return the warnings about a spec before its run."""
    from mbdkit.runs.preparation import caution
    from mbdkit.spec.run_spec import RunSpec
    from mbdkit_biomech.inverse_dynamics.compute import InverseProblem
    from mbdkit_biomech.inverse_dynamics.criteria.data_verdict import doubts_before_computation

    if isinstance(spec, RunSpec):
        return map(str, caution(spec))
    problem = InverseProblem.of(spec)
    return (*problem.warnings, *doubts_before_computation(problem))


@spec_check
def validate_design(source: Document | str, name: str, assignments: list[str]) -> None:
    """Check a design spec, the specs of its scenarios and its expressions, and print
    what would be optimised.
    """
    from mbdkit_design.design_loading import load_design_spec
    from mbdkit_design.evaluation import Evaluator
    from mbdkit_design.gains import limits_in_degrees, measure_units, variable_unit
    from mbdkit_design.search import check_installed
    from mbdkit_report import heading

    spec = load_design_spec(source, assignments)
    check_installed(spec)
    Evaluator(spec)
    of_scenarios = _of_scenarios({one: _cautions(base) for one, base in spec.specs.items()})
    for warning in (*limits_in_degrees(spec), *of_scenarios):
        say(f"warning: {warning}")
    show(f"{name}: this design is valid")
    show(f"variables    {', '.join(heading(name, variable_unit(spec, name)) for name in spec.variables)}")
    units = {measure: unit for (_, measure), unit in measure_units(spec).items()}
    show(f"goals        {', '.join(heading(measure, units[measure]) for measure in spec.goals)}")
    parts = {"limits": [*spec.subject_to], "scenarios": [*spec.scenarios], "compared": [*spec.compare]}
    for word, names in parts.items():
        if names:
            show(f"{word:12} {', '.join(names)}")
    show(f"optimizer    {spec.optimizer.name}")


def watch(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="The folder of a study or design.")],
    *,
    every: Annotated[
        float, typer.Option("--every", min=0.1, metavar="SECONDS", help="Time between two checks of the folder.")
    ] = 10.0,
    once: Annotated[bool, typer.Option("--once", help="Print the state now, and end.")] = False,
) -> None:
    """Show the progress of a study or design of another process.

    Prints a line whenever the state has changed, until the work is complete, or until
    no process computes it. Nothing in the folder is changed.
    """
    from mbdkit_design.watching import work_in

    begin, first, printed = time.monotonic(), work_in(folder), ""
    now = first
    while True:
        if now.text != printed or now.is_complete or not now.owners or once:
            show(now.line(first, time.monotonic() - begin))
            printed = now.text
        if once or now.is_complete or not now.owners:
            return
        time.sleep(every)
        now = work_in(folder)
