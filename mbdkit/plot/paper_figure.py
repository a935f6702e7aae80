"""`paper_figure`: a chart of one or several runs at the size of a column, without a heading, to be put into a paper."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mbdkit.base.errors import SpecError
from mbdkit.figures.palette import GRID, INK, PALETTE, PAPER
from mbdkit.plot.charts import draw_on, settle_layout
from mbdkit.plot.comparison import comparison

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

WIDTH = 183.0
"""Default width [mm]: two columns of many journals."""
_SHAPE = 0.66
"""Default height over width."""
_SMALLEST, _LARGEST = 30.0, 1000.0  # mm
_INCH = 25.4  # mm
_DPI = 300
_POINTS = 72.0 / _INCH  # in a millimetre
_TEXT = 7.5  # points
_SIZE = re.compile(r"(\d+(?:\.\d+)?) ?mm(?: ?x ?(\d+(?:\.\d+)?) ?mm)?", re.IGNORECASE)

STYLE: dict[Any, Any] = {
    "font.size": _TEXT,
    "axes.labelsize": _TEXT,
    "xtick.labelsize": _TEXT,
    "ytick.labelsize": _TEXT,
    "legend.fontsize": _TEXT,
    "legend.title_fontsize": _TEXT,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "axes.prop_cycle": cycler(color=PALETTE),
    "axes.edgecolor": INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.use_mathtext": True,
    "axes.formatter.limits": (-3, 4),
    "axes.xmargin": 0.01,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.0,
    "figure.facecolor": PAPER,
    "axes.facecolor": PAPER,
}
"""Settings of Matplotlib for figures of this size."""


def size_in_mm(text: str) -> tuple[float, float]:
    """Return width and height [mm] of a size such as ``85mm`` or ``85mmx60mm``.

    Raises
    ------
    SpecError
        The size is not written like this, or is not sensible.
    """
    match = _SIZE.fullmatch(text)
    if match is None:
        raise SpecError(f"the size {text!r} is not understood; write a width in mm, or both, as in 85mm or 85mmx60mm")
    width = float(match[1])
    height = float(match[2]) if match[2] else _SHAPE * width
    if not all(_SMALLEST <= side <= _LARGEST for side in (width, height)):
        limits = f"{_SMALLEST:g} to {_LARGEST:g} mm"
        raise SpecError(f"the size {text!r} is {width:g} mm x {height:g} mm; width and height should be {limits}")
    return width, height


def paper_figure(runs: Sequence[Run], kind: str, size: tuple[float, float] | None = None, **options: Any) -> Figure:
    """Return a chart of one or several runs as a figure with the legend above it.

    Parameters
    ----------
    kind, **options
        As for `mbdkit.plot.compare`.
    size
        Width and height [mm].
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
    legend = axes.get_legend()
    if legend is None:
        return
    legend.remove()
    handles, labels = axes.get_legend_handles_labels()
    columns = _columns([len(label) for label in labels], width * _POINTS / _TEXT)
    box = figure.legend(handles, labels, title=title or None, loc="outside upper left", ncols=columns, alignment="left")
    for text in box.get_texts():
        text.set_parse_math(False)


def _columns(lengths: Sequence[int], room: float) -> int:
    """Return the number of columns of a legend that fit into a width in units of the font size.

    Parameters
    ----------
    lengths
        Numbers of letters of the labels; a letter is about 0.6 wide, and the line before a label 4.
    """
    for rows in range(1, len(lengths)):
        columns = [lengths[start : start + rows] for start in range(0, len(lengths), rows)]
        if sum(0.6 * max(column) + 4.0 for column in columns) <= room:
            return len(columns)
    return 1
