"""The kinds of plot, in a table that the command line, messages and the report use.

To add a kind, add a line to `PLOT_KINDS` and write the module ``plugins/mbdkit-report/src/mbdkit_report/plot/NAME_plot.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol, cast

from mbdkit.base.errors import SpecError

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit_report.figures.page_model import Figure
    from mbdkit_report.plot.charts import Panel

# Modules are imported when they are used, so that the command line can list the kinds without loading Matplotlib.
PLOT_KINDS: dict[str, str] = {
    "trajectory": "paths of free ends and moving joints, first and last pose",
    "drift": "misalignment of the joints on a logarithmic axis",
    "energy": "energies and their balance",
    "reactions": "reaction forces and torques of the joints",
    "torques": "torques of joints, drivers, force elements and actuators",
    "forces": "forces of springs, dampers, laws, loads and actuators",
    "beams": "bending moment, shear and axial force of beams, along them and over time",
}
"""Description of each kind of plot, by name."""


class PlotModule(Protocol):
    """Functions of the module of a kind of plot.

    Only `charts` and `chart` are required. For a kind without `panels`, each of its charts is drawn in a panel.
    """

    def charts(self, run: Run) -> Sequence[Figure]:
        """Return the interactive charts of a report; none if the run did not record the quantities."""

    def chart(self, run: Run, **options: Any) -> Figure:
        """Return the chart for one pair of axes; options, all of which have defaults, select what it shows."""

    def panels(self, run: Run) -> Sequence[Panel]:
        """Return the panels of the plot, from top to bottom."""


def plot_module(kind: str) -> PlotModule:
    """Return the module of a kind of plot.

    Raises
    ------
    SpecError
        If the kind is unknown.
    """
    if kind not in PLOT_KINDS:
        raise SpecError(f"there is no kind of plot {kind!r}; the kinds are {', '.join(PLOT_KINDS)}")
    return cast(PlotModule, import_module(f"mbdkit_report.plot.{kind}_plot"))
