"""Designs, which choose numbers of a spec: `design`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbdkit.cli.common_options import AsJson, Debug, Overwrite, Quiet, Set
from mbdkit.cli.output_paths import stem
from mbdkit.terminal import STOPPED_EARLY, say, show, show_json, silence

if TYPE_CHECKING:
    from mbdkit.spec.source_document import Document


def design(
    spec: Annotated[
        str,
        typer.Argument(
            metavar="SPEC", help="A YAML, TOML or JSON file, - for stdin, or a packaged design such as gravity-balance."
        ),
    ],
    *,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="The folder; by default ./SPEC.")
    ] = None,
    assignments: Set = None,
    with_report: Annotated[
        bool, typer.Option("--report", help="Also write report.html, with the device, its loads and what is around it.")
    ] = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Choose numbers of a spec so that measures become small.

    Writes design.json, and archives of the start and of the best point. See
    `mbdkit guide design`. Exit status 3 if no point satisfies all limits.
    """
    from mbdkit.designs.design import solve
    from mbdkit.designs.store import check_folder_of, write
    from mbdkit.spec import load_design_spec

    checked = load_design_spec(spec, assignments or ())
    folder = output if output is not None else Path(stem(spec))
    check_folder_of(checked, folder, overwrite=overwrite, with_report=with_report)
    result = solve(checked, silence if quiet or as_json else say)
    files = write(result, folder, overwrite=overwrite)
    if with_report:
        from mbdkit.report.design_report import write_design_report

        files.append(write_design_report(result, folder, overwrite=overwrite))
    if as_json:
        show_json({"path": str(folder), **result.to_dict()})
    elif not quiet:
        show(result.summary())
        show(f"files: {', '.join(map(str, files))}")
    if not result.is_feasible:
        raise typer.Exit(STOPPED_EARLY)


def validate_design(source: Document, name: str, assignments: list[str]) -> None:
    """Check a design spec, the specs of its scenarios and its expressions, and tell what it would search."""
    from mbdkit.designs.evaluation import Evaluator
    from mbdkit.spec import load_design_spec

    spec = load_design_spec(source, assignments)
    Evaluator(spec)
    show(f"{name}: this design is valid")
    show(f"variables    {', '.join(spec.variables)}")
    show(f"goals        {', '.join(spec.goals)}")
    if spec.subject_to:
        show(f"limits       {', '.join(spec.subject_to)}")
    if spec.scenarios:
        show(f"scenarios    {', '.join(spec.scenarios)}")
    show(f"optimizer    {spec.optimizer.name}")
