"""A figure of a verdict as a picture: PNG and SVG."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from mbdkit.analysis.verdict import Figure
from mbdkit.errors import SpecError
from mbdkit.plot.caption import Caption
from mbdkit.plot.style import FAINT, GRID, PALETTE, dress, legend, new_figure, powers_of_ten, save
from mbdkit.report.interactive import axis_title, shown, styles

_DASHES: tuple[str | tuple[float, tuple[float, ...]], ...] = ("-", "--", ":", "-.", (0, (8.0, 3.0)))
_MARKERS = ("o", "s", "D", "^", "P", "X")
_FORMATS = (".png", ".svg")


def still_files(figures: Iterable[Figure], folder: Path) -> list[Path]:
    """Return the files that figures go to in a folder."""
    return [folder / f"{figure.name}{suffix}" for figure in figures for suffix in _FORMATS]


def write_stills(figures: Iterable[Figure], folder: Path) -> list[Path]:
    """Write figures into a folder, each as PNG and SVG, and return the files.

    Raises
    ------
    SpecError
        The folder or a file cannot be written.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise SpecError(f"cannot be created: {error.strerror or error}", file=folder) from error
    written = []
    for figure in figures:
        picture = still(figure)
        for file in still_files([figure], folder):
            save(picture, file)
            written.append(file)
            picture.set_layout_engine("none")  # stays as it is laid out, which takes longer than to draw it
    return written


def still(figure: Figure) -> Picture:
    """Return a figure as a picture of Matplotlib."""
    picture = new_figure(Caption(figure.title, figure.caption), 7.2, 4.6)
    axes = dress(picture.add_subplot(), axis_title(figure.x), axis_title(figure.y))
    axes.xaxis.label.set_parse_math(False)
    axes.yaxis.label.set_parse_math(False)
    for band in figure.bands:
        axes.axhspan(band.low, band.high, color=GRID, zorder=0.5)
        place: dict[str, Any] = {
            "xycoords": ("axes fraction", "data"),
            "xytext": (0, -2),
            "textcoords": "offset points",
        }
        label = axes.annotate(band.label, (0.01, band.high), size=7.5, color=FAINT, va="top", **place)
        label.set_parse_math(False)
    for mark in figure.marks:
        axes.axvline(mark.x, color=FAINT, linewidth=0.8, linestyle=":", zorder=0.6)
        if mark.label:
            beside: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
            name = axes.annotate(
                mark.label, (mark.x, 1.0), xytext=(2, -3), size=7, color=FAINT, rotation=90, va="top", **beside
            )
            name.set_parse_math(False)
    _draw_lines(axes, figure)
    if figure.equal:
        axes.set_aspect("equal", adjustable="datalim")
    return picture


def _draw_lines(axes: Axes, figure: Figure) -> None:
    handles, labels = [], []
    wide = figure.equal and len(figure.lines) < 5  # paths that coincide are told apart by their width
    for number, (line, (color, style)) in enumerate(zip(figure.lines, styles(figure), strict=True)):
        seen = shown(line, figure)
        points = line.kind != "line" or int(np.sum(seen)) == 1
        (artist,) = axes.plot(
            line.x,
            np.where(seen, line.y, np.nan),
            color=PALETTE[color],
            linestyle="" if line.kind == "points" else _DASHES[style % len(_DASHES)],
            linewidth=1.3 + 1.1 * wide * (len(figure.lines) - 1 - number),
            marker=_MARKERS[color % len(_MARKERS)] if points else "",
            markersize=4.5,
        )
        handles.append(artist)
        labels.append(line.label)
    if len(handles) > 1:
        legend(axes, handles, labels)
    for log, set_scale in ((figure.x.log, axes.set_xscale), (figure.y.log, axes.set_yscale)):
        if log:
            set_scale("log")
    if not figure.y.log:
        powers_of_ten(axes)
