"""Charts of a report drawn by Matplotlib: on axes, or as PNG and SVG files.

A chart is a `mbdkit.figures.page_model.Figure`: lines, axes and a caption, independent of how it is drawn.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from mbdkit.base.errors import file_error
from mbdkit.figures.page_model import Axis, Figure, Line
from mbdkit.figures.palette import FAINT, GRID, PALETTE, PAPER, color_number
from mbdkit.plot.caption import Caption
from mbdkit.plot.style import dress, legend, new_figure, powers_of_ten, save

_DASHES: tuple[str | tuple[float, tuple[float, ...]], ...] = ("-", "--", ":", "-.", (0, (8.0, 3.0)))
_MARKERS = ("o", "s", "D", "^", "P", "X")
_FORMATS = (".png", ".svg")


def image_files(charts: Iterable[Figure], folder: Path) -> list[Path]:
    """Return the files that `write_chart_images` writes into a folder."""
    return [folder / f"{chart.name}{suffix}" for chart in charts for suffix in _FORMATS]


def write_chart_images(charts: Iterable[Figure], folder: Path) -> list[Path]:
    """Write charts into a folder, each as PNG and SVG, and return the files.

    Raises
    ------
    SpecError, ResourceError
        The folder or a file cannot be written.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise file_error(error.errno, f"cannot be created: {error.strerror or error}", file=folder) from error
    written = []
    for chart in charts:
        picture = chart_image(chart)
        for file in image_files([chart], folder):
            save(picture, file)
            written.append(file)
            picture.set_layout_engine("none")  # the layout takes longer than the drawing, and is the same for SVG
    return written


def chart_image(chart: Figure, width: float = 7.2, height: float = 4.6) -> Picture:
    """Return a chart as a Matplotlib figure of `width` x `height` inches, with its title and caption as heading."""
    picture = new_figure(Caption(chart.title, chart.caption), width, height)
    draw_chart(picture.add_subplot(), chart)
    return picture


def draw_chart(axes: Axes, chart: Figure) -> None:
    """Draw a chart on empty axes, without its title and caption."""
    dress(axes, axis_title(chart.x), axis_title(chart.y))
    axes.xaxis.label.set_parse_math(False)
    axes.yaxis.label.set_parse_math(False)
    for band in chart.bands:
        axes.axhspan(band.low, band.high, color=GRID, zorder=0.5)
        place: dict[str, Any] = {
            "xycoords": ("axes fraction", "data"),
            "xytext": (0, -2),
            "textcoords": "offset points",
        }
        label = axes.annotate(band.label, (0.01, band.high), size=7.5, color=FAINT, va="top", **place)
        label.set_parse_math(False)
    for mark in chart.marks:
        axes.axvline(mark.x, color=FAINT, linewidth=0.8, linestyle=":", zorder=0.6)
        if mark.label:
            beside: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
            name = axes.annotate(
                mark.label, (mark.x, 1.0), xytext=(2, -3), size=7, color=FAINT, rotation=90, va="top", **beside
            )
            name.set_parse_math(False)
    _draw_lines(axes, chart)
    for guide in chart.guides:
        axes.plot(guide.x, guide.y, color=FAINT, linewidth=1.0, linestyle=(0, (1.0, 2.0)))
        x, y = (
            float(np.sqrt(np.prod(ends)) if axis.log else np.mean(ends))
            for ends, axis in ((guide.x, chart.x), (guide.y, chart.y))
        )
        patch: dict[str, Any] = {"facecolor": PAPER, "edgecolor": "none", "pad": 0.5}
        axes.text(x, y, guide.label, size=7.5, color=FAINT, ha="center", va="center", bbox=patch, parse_math=False)
    if chart.equal:
        axes.set_aspect("equal", adjustable="datalim")


def line_styles(chart: Figure) -> list[tuple[str, int]]:
    """Return the colour and the index of the dashes of each line.

    Lines of a group share a colour; a line without a group forms its own. If there are more groups than colours, the
    colours repeat. Lines of the same colour differ in their dashes.
    """
    groups = dict.fromkeys(line.group or line.label for line in chart.lines if not line.color)
    colors = {group: PALETTE[place % len(PALETTE)] for place, group in enumerate(groups)}
    found: list[tuple[str, int]] = []
    for line in chart.lines:
        color = line.color or colors[line.group or line.label]
        found.append((color, sum(color == other for other, _ in found)))
    return found


def visible_points(line: Line, chart: Figure) -> np.ndarray:
    """Return a mask (K,) of the points of a line that can be drawn: finite, and positive on logarithmic axes."""
    seen: np.ndarray = np.isfinite(line.x) & np.isfinite(line.y)
    if chart.x.log:
        seen &= np.nan_to_num(line.x) > 0
    if chart.y.log:
        seen &= np.nan_to_num(line.y) > 0
    return seen


def axis_title(axis: Axis) -> str:
    """Return the label of an axis with its unit."""
    return f"{axis.label} [{axis.unit}]" if axis.unit else axis.label


def _draw_lines(axes: Axes, chart: Figure) -> None:
    handles, labels = [], []
    wide = chart.equal and len(chart.lines) < 5  # different widths keep coinciding paths apart
    for number, (line, (color, style)) in enumerate(zip(chart.lines, line_styles(chart), strict=True)):
        seen = visible_points(line, chart)
        points = line.kind != "line" or int(np.sum(seen)) == 1
        (artist,) = axes.plot(
            line.x,
            np.where(seen, line.y, np.nan),
            color=color,
            linestyle="" if line.kind == "points" else _DASHES[style % len(_DASHES)],
            linewidth=1.3 + 1.1 * wide * (len(chart.lines) - 1 - number),
            marker=_MARKERS[color_number(color) % len(_MARKERS)] if points else "",
            markersize=4.5,
        )
        if line.band is not None:
            axes.fill(*line.band.T, color=color, alpha=0.25, linewidth=0)
        handles.append(artist)
        labels.append(line.label)
    if chart.needs_key:
        legend(axes, handles, labels)
    for log, set_scale in ((chart.x.log, axes.set_xscale), (chart.y.log, axes.set_yscale)):
        if log:
            set_scale("log")
    if not chart.y.log:
        powers_of_ten(axes)
