"""The kinds of plot, which the command line, messages and the report use: items of the registry."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol, cast

from mbdkit.base.errors import SpecError
from mbdkit.registry.feature_items import PlotKind
from mbdkit.registry.manager import registry

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit_report.figures.page_model import Figure
    from mbdkit_report.plot.charts import Panel


def plot_kinds() -> dict[str, str]:
    """Return the description of each kind of plot, by name."""
    return {item.name: item.plugin.summary for item in registry().of_kind("plot-kind")}


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
    known = plot_kinds()
    if kind not in known:
        raise SpecError(f"there is no kind of plot {kind!r}; the kinds are {', '.join(known)}")
    module = cast(PlotKind, registry().get("plot-kind", kind).plugin).module
    return cast(PlotModule, import_module(module))
