"""`plot`: one kind of plot of a run, written to a PNG, SVG or PDF file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mbdkit.files import check_suffix
from mbdkit.plot.caption import caption
from mbdkit.plot.chart_images import draw_chart
from mbdkit.plot.downsampling import require_rows
from mbdkit.plot.panel import Panel
from mbdkit.plot.plot_kinds import plot_module
from mbdkit.plot.style import FORMATS, new_figure, save

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_WIDTH = 7.2  # inches
_HEADING_AND_LABELS = 2.1  # inches


def figure(run: Run, kind: str = "trajectory") -> Figure:
    """Return a plot of a run as a Matplotlib figure.

    Parameters
    ----------
    kind
        A key of `mbdkit.plot.plot_kinds.PLOT_KINDS`.

    Raises
    ------
    SpecError
        The kind is unknown, or the run has no rows.
    MbdkitError
        The run did not record the plotted quantities.
    """
    module = plot_module(kind)
    require_rows(run)
    if hasattr(module, "panels"):
        panels: Sequence[Panel] = module.panels(run)
    else:
        panels = [Panel(partial(draw_chart, chart=chart)) for chart in module.charts(run)]
    picture = new_figure(caption(run), _WIDTH, _HEADING_AND_LABELS + sum(panel.height for panel in panels))
    shared: Axes | None = None
    for row, panel in enumerate(panels, start=1):
        axes = picture.add_subplot(len(panels), 1, row, sharex=shared if panel.over_time else None)
        panel.draw(axes)
        if panel.over_time:
            shared = shared or axes
            if row < len(panels):
                axes.set_xlabel("")
                axes.tick_params(labelbottom=False)
    return picture


def plot(run: Run, kind: str, path: str | os.PathLike[str]) -> Path:
    """Write a plot of a run to a file, whose path is returned. An existing file is replaced.

    Parameters
    ----------
    kind
        A key of `mbdkit.plot.plot_kinds.PLOT_KINDS`.
    path
        File to write. Its suffix, .png, .svg or .pdf, selects the format.

    Raises
    ------
    SpecError
        The kind or the suffix is unknown, the run has no rows, or the file cannot be written.
    MbdkitError
        The run did not record the plotted quantities.
    """
    target = check_suffix(path, FORMATS, "a plot")
    save(figure(run, kind), target)
    return target
