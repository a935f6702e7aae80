"""What this part adds to mbdkit: plots, animations, reports, exported tables, and what notebooks show."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mbdkit.registry.feature_items import Accessor, Example, FileFormat, GuidePage, PlotKind, ReportSection, TableFormat
from mbdkit.registry.hookspecs import hookimpl
from mbdkit.registry.item import Item
from mbdkit.registry.items import Command
from mbdkit.registry.target import Target

_HERE = Path(__file__).parent

#: Commands: name, group, order, function and summary.
_COMMANDS = (
    ("export", "archive", 40, "export_command:archive_export", "Export a run, or the table of the runs of a study."),
    (
        "crate",
        "archive",
        55,
        "export_command:archive_crate",
        "Write run archives as a crate for catalogues (RO-Crate).",
    ),
    ("plot", "", 100, "commands:plot", "Plot a run, or one quantity of several runs."),
    ("animate", "", 110, "commands:animate", "Animate a run."),
    ("report", "", 120, "commands:report", "Write a report on a run, study or design as an HTML page."),
)
_PLOTS = {
    "trajectory": "paths of free ends and moving joints, first and last pose",
    "drift": "misalignment of the joints on a logarithmic axis",
    "energy": "energies and their balance",
    "reactions": "reaction forces and torques of the joints",
    "torques": "torques of joints, drivers, force elements and actuators",
    "forces": "forces of springs, dampers, laws, loads and actuators",
    "beams": "bending moment, shear and axial force of beams, along them and over time",
}
_TABLES = {
    "csv": "Comma-separated values.",
    "parquet": "Parquet.",
    "mat": "MATLAB.",
    "sto": "Storage files of OpenSim.",
    "json": "JSON.",
}
_WRITE = "mbdkit_report.table_formats:write_"


@hookimpl
def mbdkit_items() -> Iterable[Item]:
    """Return commands, plots, sections of reports and formats of tables."""
    plots = [
        PlotKind(name=name, summary=summary, order=10 * number, module=f"mbdkit_report.plot.{name}_plot")
        for number, (name, summary) in enumerate(_PLOTS.items())
    ]
    tables = [
        TableFormat(name=name, summary=summary, order=10 * number, suffix=f".{name}", write=Target(f"{_WRITE}{name}"))
        for number, (name, summary) in enumerate(_TABLES.items())
    ]
    return [
        *(
            Command(name=name, summary=summary, target=Target(f"mbdkit_report.{target}"), group=group, order=order)
            for name, group, order, target, summary in _COMMANDS
        ),
        FileFormat(
            name="crate",
            summary="A crate of archives for catalogues.",
            order=500,
            file="ro-crate-metadata.json",
            problems=Target("mbdkit_report.crate:crate_problems"),
        ),
        *tables,
        TableFormat(
            name="xlsx",
            summary="Excel workbook with a sheet for each group.",
            order=15,
            suffix=".xlsx",
            write_all=Target("mbdkit_report.workbook:write_xlsx"),
            needs="xlsxwriter",
        ),
        *plots,
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
        *Example.folder(_HERE / "examples", suffix=".py"),
        *GuidePage.folder(_HERE / "guide", {"Start": "notebooks", "Analyse": "plots"}),
    ]
