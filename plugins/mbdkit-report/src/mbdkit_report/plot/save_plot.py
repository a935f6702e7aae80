"""`plot`: one kind of plot written to a PNG, SVG or PDF file, with a heading or at the size of a column of a paper."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mbdkit.archive.run import Run
from mbdkit.base.errors import SpecError
from mbdkit.base.files import check_suffix
from mbdkit_report.figures.curves import require_rows
from mbdkit_report.figures.palette import GRID, INK, PALETTE, PAPER
from mbdkit_report.plot.caption import caption
from mbdkit_report.plot.charts import chart_panel, draw_on, settle_layout
from mbdkit_report.plot.comparison import comparison
from mbdkit_report.plot.plot_kinds import plot_module
from mbdkit_report.plot.style import FORMATS, new_figure, save

_WIDTH = 7.2  # inches
_HEADING_AND_LABELS = 2.1  # inches


def figure(run: Run, kind: str = "trajectory", **options: Any) -> Figure:
    """Return a plot of a run as a Matplotlib figure.

    Parameters
    ----------
    kind
        A key of `mbdkit_report.plot.plot_kinds.plot_kinds`.
    **options
        Options of the method of `Run.plot` of this kind. With options, one chart is drawn instead of all panels.

    Raises
    ------
    SpecError, UnknownNameError, MbdkitError
        If the kind or an option is unknown, a name among the options is, or the run has no rows, or did not record the
        plotted quantities.
    """
    module = plot_module(kind)
    require_rows(run)
    if not options and hasattr(module, "panels"):
        panels = module.panels(run)
    else:  # without anything to draw, `chart` says why
        charts = module.charts(run) if not options else ()
        panels = [chart_panel(chart) for chart in charts or [comparison([run], kind, **options)[0]]]
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
    x_limits: tuple[float, float] | None = None,
    y_limits: tuple[float, float] | None = None,
    **options: object,
) -> Path:
    """Write a plot of one or several runs to a file, and return its path. An existing file is replaced.

    Parameters
    ----------
    kind
        A key of `mbdkit_report.plot.plot_kinds.plot_kinds`.
    path
        File to write. Its suffix, .png, .svg or .pdf, selects the format.
    size
        Width and height [mm] of a figure for a paper, which has no heading. Several runs are always drawn as a figure
        for a paper, by default 183 mm wide.
    x_limits, y_limits
        Limits of the axes, in their units; for plots over time, `x_limits` is a time window [s]. By default, all values
        are shown.
    **options
        See `figure`.

    Raises
    ------
    SpecError
        If the kind, an option or the suffix is unknown, limits are equal or not positive on a logarithmic axis,
        `y_limits` are given for several vertical axes, a run has no rows, or the file cannot be written.
    UnknownNameError
        If a name among the options is unknown.
    MbdkitError
        If a run did not record the plotted quantities.
    """
    target = check_suffix(path, FORMATS, "a plot")
    found = list(runs) if isinstance(runs, Sequence) else [runs]
    if size is None and len(found) == 1:
        picture = figure(found[0], kind, **options)
    else:
        picture = paper_figure(found, kind, size, **options)
    _limit(picture, x_limits, y_limits)
    save(picture, target)
    return target


def _limit(picture: Figure, x: tuple[float, float] | None, y: tuple[float, float] | None) -> None:
    for name, limits in (("x", x), ("y", y)):
        if limits is not None and not (np.all(np.isfinite(limits)) and limits[0] != limits[1]):
            raise SpecError(f"the {name} limits should be two different numbers, not {limits[0]:g} and {limits[1]:g}")
    if y is not None and len(picture.axes) > 1:
        raise SpecError(f"y limits need a figure with one vertical axis, but this one has {len(picture.axes)} panels")
    for axes in picture.axes:
        for name, limits in (("x", x), ("y", y)):
            if limits is not None and getattr(axes, f"get_{name}scale")() == "log" and min(limits) <= 0:
                raise SpecError(f"the {name} axis is logarithmic, so its limits should be positive")
        axes.set(**{f"{name}lim": limits for name, limits in (("x", x), ("y", y)) if limits is not None})


WIDTH = 183.0  #: Default width [mm]; two columns in many journals.
_SHAPE = 0.66  #: Default ratio of height to width.
_SMALLEST, _LARGEST = 30.0, 1000.0  # mm
_INCH = 25.4  # mm
_DPI = 300
_POINTS = 72.0 / _INCH  # in a millimetre
_TEXT = 7.5  # points
_SIZE = re.compile(r"(\d+(?:\.\d+)?) ?mm(?: ?x ?(\d+(?:\.\d+)?) ?mm)?", re.IGNORECASE)

#: Settings of Matplotlib for figures in papers.
STYLE: dict[Any, Any] = {
    **mpl.rc_params_from_file(Path(__file__).with_name("paper.mplstyle"), use_default_template=False),
    **dict.fromkeys(("figure.facecolor", "axes.facecolor"), PAPER),
    "axes.prop_cycle": cycler(color=PALETTE),
    "axes.edgecolor": INK,
    "grid.color": GRID,
}


def size_in_mm(text: str) -> tuple[float, float]:
    """Return width and height [mm] of a size such as ``85mm`` or ``85mmx60mm``.

    Raises
    ------
    SpecError
        If the size is not written in this form, or is too small or too large.
    """
    if (match := _SIZE.fullmatch(text)) is None:
        raise SpecError(f"the size {text!r} is not understood; write a width in mm, or both, as in 85mm or 85mmx60mm")
    width = float(match[1])
    height = float(match[2]) if match[2] else _SHAPE * width
    if not all(_SMALLEST <= side <= _LARGEST for side in (width, height)):
        limits = f"{_SMALLEST:g} to {_LARGEST:g} mm"
        raise SpecError(f"the size {text!r} is {width:g} mm x {height:g} mm; width and height should be {limits}")
    return width, height


def paper_figure(runs: Sequence[Run], kind: str, size: tuple[float, float] | None = None, **options: Any) -> Figure:
    """Return a chart of one or several runs as a figure for a paper, with the legend above the axes.

    Parameters
    ----------
    kind, **options
        See `mbdkit.plot.compare`.
    size
        Width and height [mm]; by default `WIDTH` and 0.66 times `WIDTH`.
    """
    chart, heading = comparison(runs, kind, **options)
    width, height = size or (WIDTH, _SHAPE * WIDTH)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width / _INCH, height / _INCH), dpi=_DPI, layout="constrained")
        FigureCanvasAgg(figure)
        draw_on(figure.add_subplot(), chart, heading, vary_dashes=len(runs) > 1)
        _legend_above(figure, width, heading)
        settle_layout(figure.axes[0])
    return figure


def _legend_above(figure: Figure, width: float, title: str) -> None:
    """Move the legend of the axes above them, in as many columns as fit into a width [mm]."""
    axes = figure.axes[0]
    if (legend := axes.get_legend()) is None:
        return
    legend.remove()
    handles, labels = axes.get_legend_handles_labels()
    columns = _columns([len(label) for label in labels], width * _POINTS / _TEXT)
    box = figure.legend(handles, labels, title=title or None, loc="outside upper left", ncols=columns, alignment="left")
    for text in box.get_texts():
        text.set_parse_math(False)


def _columns(lengths: Sequence[int], room: float) -> int:
    """Return the largest number of columns of a legend that fit into a width, at least 1. `lengths` are the numbers of
    letters in the labels; the width `room` is in units of the font size.

    A letter is about 0.6 font sizes wide, and the line before a label about 4 font sizes.
    """
    for rows in range(1, len(lengths)):
        columns = [lengths[start : start + rows] for start in range(0, len(lengths), rows)]
        if sum(0.6 * max(column) + 4.0 for column in columns) <= room:
            return len(columns)
    return 1
