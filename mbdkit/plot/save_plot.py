"""`plot`: one kind of plot of a run, written to a PNG, SVG or PDF file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mbdkit.base.files import check_suffix
from mbdkit.figures.curves import require_rows
from mbdkit.plot.caption import caption
from mbdkit.plot.charts import Panel, draw_chart
from mbdkit.plot.comparison import comparison
from mbdkit.plot.paper_figure import paper_figure
from mbdkit.plot.plot_kinds import plot_module
from mbdkit.plot.style import FORMATS, new_figure, save

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_WIDTH = 7.2  # inches
_HEADING_AND_LABELS = 2.1  # inches


def figure(run: Run, kind: str = "trajectory", **options: Any) -> Figure:
    """Return a plot of a run as a Matplotlib figure.

    Parameters
    ----------
    kind
        A key of `mbdkit.plot.plot_kinds.PLOT_KINDS`.
    **options
        Options of the method of `Run.plot` of this kind. With options, one chart is drawn instead of all panels.

    Raises
    ------
    SpecError
        The kind or an option is unknown, or the run has no rows.
    UnknownNameError
        A name among the options is unknown.
    MbdkitError
        The run did not record the plotted quantities.
    """
    module = plot_module(kind)
    require_rows(run)
    if options:
        chart, _ = comparison([run], kind, **options)
        title = chart.lines[0].label if len(chart.lines) == 1 else ""  # a single line has no legend
        panels: Sequence[Panel] = [Panel(partial(draw_chart, chart=chart, title=title), height=2.7)]
    elif hasattr(module, "panels"):
        panels = module.panels(run)
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


def plot(
    runs: Run | Sequence[Run],
    kind: str,
    path: str | os.PathLike[str],
    *,
    size: tuple[float, float] | None = None,
    **options: Any,
) -> Path:
    """Write a plot of a run, or of several runs, to a file, whose path is returned. An existing file is replaced.

    Parameters
    ----------
    kind
        A key of `mbdkit.plot.plot_kinds.PLOT_KINDS`.
    path
        File to write. Its suffix, .png, .svg or .pdf, selects the format.
    size
        Width and height [mm] of a figure for a paper, which has no heading; so have figures of several runs.
    **options
        As for `figure`.

    Raises
    ------
    SpecError
        The kind, an option or the suffix is unknown, a run has no rows, or the file cannot be written.
    UnknownNameError
        A name among the options is unknown.
    MbdkitError
        A run did not record the plotted quantities.
    """
    target = check_suffix(path, FORMATS, "a plot")
    found = list(runs) if isinstance(runs, Sequence) else [runs]
    if size is None and len(found) == 1:
        save(figure(found[0], kind, **options), target)
    else:
        save(paper_figure(found, kind, size, **options), target)
    return target
