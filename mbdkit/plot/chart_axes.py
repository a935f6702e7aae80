"""Draws charts on the axes of a user, in the style of Matplotlib's current settings (`rcParams`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np

from mbdkit.figures.curves import require_rows
from mbdkit.plot.chart_images import axis_title, visible_points
from mbdkit.plot.plot_kinds import plot_module

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from mbdkit.archive.run import Run
    from mbdkit.figures.page_model import Figure

DASHES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (8.0, 3.0)), (0, (1.0, 3.0)))
"""Dashes of the lines of a group, which have the same colour."""

_FAINT = "0.4"


def new_axes() -> Axes:
    """Return the axes of a new figure of pyplot, which notebooks show."""
    from matplotlib import pyplot

    layout = None if mpl.rcParams["figure.autolayout"] else "constrained"
    axes: Axes = pyplot.subplots(layout=layout)[1]
    return axes


def draw_run(run: Run, kind: str, axes: Axes | None = None, **options: Any) -> Axes:
    """Draw a kind of plot of a run on axes, or those of a new figure, and return them; see `Run.plot`."""
    require_rows(run)
    return draw_on(axes, plot_module(kind).chart(run, **options))


def draw_on(axes: Axes | None, chart: Figure, legend_title: str = "", *, vary_dashes: bool = False) -> Axes:
    """Draw the lines of a chart with labels of the axes and a legend, and return the axes.

    Parameters
    ----------
    axes
        Where to draw; what is there is kept. None creates a new figure.
    legend_title
        Title of the legend; empty for none.
    vary_dashes
        Whether lines of different colours have different dashes, too, so that lines which coincide are seen.
    """
    if axes is None:
        axes = draw_on(new_axes(), chart, legend_title, vary_dashes=vary_dashes)
        settle_layout(axes)
        return axes
    axes.set_xlabel(axis_title(chart.x))
    axes.set_ylabel(axis_title(chart.y))
    if chart.y.log:
        axes.set_yscale("log")
    _draw_lines(axes, chart, vary_dashes)
    for mark in chart.marks:
        axes.axvline(mark.x, color=_FAINT, linewidth=0.8, linestyle=":", zorder=0.6)
        place: dict[str, Any] = {
            "xytext": (2, -3),
            "textcoords": "offset points",
            "xycoords": ("data", "axes fraction"),
        }
        text = axes.annotate(mark.label, (mark.x, 1.0), size="small", color=_FAINT, rotation=90, va="top", **place)
        text.set_parse_math(False)
    if chart.equal:
        axes.set_aspect("equal", adjustable="datalim")
    if axes.get_legend_handles_labels()[0]:
        for label in axes.legend(title=legend_title or None).get_texts():
            label.set_parse_math(False)
    return axes


def settle_layout(axes: Axes) -> None:
    """Adjust the limits of axes with equal scales, whose tick labels the layout of the next drawing then allows for."""
    if axes.get_aspect() != "auto":
        axes.figure.draw_without_rendering()  # type: ignore[union-attr]


def _draw_lines(axes: Axes, chart: Figure, vary_dashes: bool) -> None:
    """Draw lines in the styles of the property cycle; the lines of a group share a colour and differ in dashes."""
    groups: dict[str, list[Any]] = {}
    vary_dashes &= len({line.group or line.label for line in chart.lines}) == len(chart.lines)
    for line in chart.lines:
        same = groups.setdefault(line.group or line.label, [])
        look: dict[str, Any] = {}
        if same:
            look = {"color": same[0].get_color(), "linestyle": DASHES[len(same) % len(DASHES)]}
        elif vary_dashes:
            look = {"linestyle": DASHES[(len(groups) - 1) % len(DASHES)]}
        seen = visible_points(line, chart)
        if int(np.sum(seen)) == 1:
            look["marker"] = "o"  # a line through one point would be invisible
        # Matplotlib leaves labels that begin with an underscore out of legends.
        label = f" {line.label}" if line.label.startswith("_") else line.label
        same += axes.plot(line.x, np.where(seen, line.y, np.nan), label=label, **look)
        if line.band is not None:
            axes.fill(*line.band.T, color=same[-1].get_color(), alpha=0.25, linewidth=0)
