"""The kinds of plot, which the command line, messages and the report use: items of the registry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import wraps
from importlib import import_module
from types import SimpleNamespace
from typing import TYPE_CHECKING, Protocol, cast

from mbdkit.base.errors import SpecError
from mbdkit.registry.feature_items import PlotKind
from mbdkit.registry.manager import registry, use

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit_report.figures.page_model import Figure
    from mbdkit_report.plot.charts import Panel


def plot_kinds() -> dict[str, str]:
    """Return the description of each kind of plot, by name; the id of one whose name another distribution uses."""
    return {registry().accepted(item)[0]: item.plugin.summary for item in registry().of_kind("plot-kind")}


class PlotModule(Protocol):
    """Functions of the module of a kind of plot.

    Only `charts` and `chart` are required. For a kind without `panels`, each of its charts is drawn in a panel.
    """

    def charts(self, run: Run) -> Sequence[Figure]:
        """Return the interactive charts of a report; none if the run did not record the quantities."""

    def chart(self, run: Run, **options: object) -> Figure:
        """Return the chart for one pair of axes; options, all of which have defaults, select what it shows.

        The option `most`, if it has one, is the largest number of lines; several runs are compared by means of it.
        """

    def panels(self, run: Run) -> Sequence[Panel]:
        """Return the panels of the plot, from top to bottom."""


def plot_module(kind: str) -> PlotModule:
    """Return the functions of a kind of plot; errors of other distributions name them.

    Raises
    ------
    SpecError
        If the kind is unknown.
    """
    known = plot_kinds()
    if kind not in known:
        raise SpecError(f"there is no kind of plot {kind!r}; the kinds are {', '.join(known)}")
    item = registry().get("plot-kind", kind)
    name = cast(PlotKind, item.plugin).module
    use(item, item.plugin.check_targets)
    module = import_module(name)

    def checked(chart: object) -> Figure:
        from mbdkit_report.figures.page_model import Figure

        return cast(Figure, use(item, lambda: chart, of=Figure))

    def chart(run: Run, **options: object) -> Figure:
        return checked(use(item, lambda: module.chart(run, **options)))

    def charts(run: Run) -> list[Figure]:
        return [checked(one) for one in use(item, lambda: list(module.charts(run)))]

    # with the signature of the function, which names the options
    plot = SimpleNamespace(chart=wraps(module.chart)(chart), charts=charts)
    if hasattr(module, "panels"):
        plot.panels = lambda run: use(item, lambda: list(module.panels(run)))
    return cast(PlotModule, plot)
