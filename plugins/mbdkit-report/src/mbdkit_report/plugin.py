"""What this part adds to mbdkit: plots, animations, reports, exported tables, and what notebooks show."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.plugin import (
    Accessor,
    Command,
    Example,
    GuidePage,
    Item,
    PlotKind,
    ReportSection,
    TableFormat,
    Target,
    hookimpl,
)

_HERE = Path(__file__).parent
_COMMANDS = {
    "plot": (100, "Plot a run, or one quantity of several runs."),
    "animate": (110, "Animate a run."),
    "report": (120, "Write a report on a run, study or design as an HTML page."),
}
_FORMATS = {
    "csv": "Comma-separated values.",
    "parquet": "Parquet.",
    "mat": "MATLAB.",
    "sto": "Storage files of OpenSim.",
    "json": "JSON.",
}
_PLOTS = {
    "trajectory": "paths of free ends and moving joints, first and last pose",
    "drift": "misalignment of the joints on a logarithmic axis",
    "energy": "energies and their balance",
    "reactions": "reaction forces and torques of the joints",
    "torques": "torques of joints, drivers, force elements and actuators",
    "forces": "forces of springs, dampers, laws, loads and actuators",
    "beams": "bending moment, shear and axial force of beams, along them and over time",
}


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return commands, plots, sections of reports and formats of tables."""
    plots = [
        PlotKind(name=name, summary=summary, order=10 * number, module=f"mbdkit_report.plot.{name}_plot")
        for number, (name, summary) in enumerate(_PLOTS.items())
    ]
    commands = [
        Command(name=name, summary=summary, order=order, target=Target(f"mbdkit_report.commands:{name}"))
        for name, (order, summary) in _COMMANDS.items()
    ]
    formats = [
        TableFormat(
            name=name,
            summary=summary,
            order=10 * number,
            suffix=f".{name}",
            write=Target(f"mbdkit_report.table_formats:write_{name}"),
        )
        for number, (name, summary) in enumerate(_FORMATS.items())
    ]
    return [
        *commands,
        Command(
            name="export",
            group="archive",
            summary="Export a run, or the table of the runs of a study.",
            order=40,
            target=Target("mbdkit_report.export_command:archive_export"),
        ),
        *plots,
        *formats,
        Accessor(
            name="plot",
            summary="Draws a kind of plot on axes.",
            of="Run",
            target=Target("mbdkit_report.plot.comparison:drawing"),
        ),
        Accessor(
            name="animate",
            summary="The animation of the run.",
            of="Run",
            target=Target("mbdkit_report.notebook.animation:Animation"),
        ),
        ReportSection(
            name="standard",
            summary="Largest forces, beams and gradients of a run.",
            order=200,
            make=Target("mbdkit_report.pages.answer_section:standard_sections"),
        ),
        *Example.folder(_HERE / "examples", ".py"),
        *GuidePage.folder(_HERE / "guide"),
    ]
