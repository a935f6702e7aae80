"""What this part adds to mbdkit: plots, animations, reports, and what notebooks show of results."""

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
    Target,
    hookimpl,
)

_HERE = Path(__file__).parent
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
    return [
        Command(
            name="plot",
            summary="Plot a run, or one quantity of several runs.",
            order=100,
            target=Target("mbdkit_report.commands:plot"),
        ),
        Command(name="animate", summary="Animate a run.", order=110, target=Target("mbdkit_report.commands:animate")),
        Command(
            name="report",
            summary="Write a report on a run, study or design as an HTML page.",
            order=120,
            target=Target("mbdkit_report.commands:report"),
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
            make=Target("mbdkit_report.pages.standard_sections:standard_sections"),
        ),
        *Example.folder(_HERE / "examples", ".py"),
        *GuidePage.folder(_HERE / "guide"),
    ]
