"""Charts drawn by Matplotlib, in the house style or in that of a user: on axes, in panels, or as PNG and SVG files.

A chart is a `mbdkit_report.figures.page_model.Figure`: lines, axes and a caption, independent of how it is drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatterSciNotation

from mbdkit.base.errors import UnknownNameError, file_error
from mbdkit_report.figures.page_model import TIME, Figure
from mbdkit_report.figures.palette import FAINT, GRID, INK, PAPER, color_number, line_styles
from mbdkit_report.plot.caption import Caption
from mbdkit_report.plot.style import dress, legend, new_figure, powers_of_ten, save

_DASHES: tuple[object, ...] = ("-", "--", ":", "-.", (0, (8.0, 3.0)))
_DASHES_OF_GROUPS: tuple[object, ...] = (*_DASHES, (0, (1.0, 3.0)))
_MARKERS = ("o", "s", "D", "^", "P", "X")
_FORMATS = (".png", ".svg")

Look = dict[str, Any]  #: Keyword arguments of Matplotlib for a line or a text.


@dataclass(frozen=True)
class Panel:
    """A part of a plot with its own axes: a function that draws it on empty axes, and their approximate height [inch].

    Panels whose x axis is time (`over_time`) share this axis, which is labelled at the lowest panel only.
    """

    draw: Callable[[Axes], None]
    height: float = 1.85
    over_time: bool = True


@dataclass(frozen=True)
class HeadedChart(Figure):
    """A chart with its largest value and bar as a text, which is the title of its panel, and the id of the value."""

    headline: tuple[str, str] = ("", "")


def named(wanted: str | Iterable[str], known: Collection[str], what: str) -> list[str]:
    """Return the wanted names, each once.

    Raises
    ------
    UnknownNameError
        If a name is not known; `what` is the kind of the elements, such as ``joint``.
    """
    names = [wanted] if isinstance(wanted, str) else list(dict.fromkeys(wanted))
    for name in names:
        if name not in known:
            raise UnknownNameError(what, name, list(known))
    return names


def image_files(charts: Iterable[Figure], folder: Path) -> list[Path]:
    """Return the files that `write_chart_images` writes into a folder."""
    return [folder / f"{chart.name}{suffix}" for chart in charts for suffix in _FORMATS]


def write_chart_images(charts: Iterable[Figure], folder: Path) -> list[Path]:
    """Write charts into a folder, each as PNG and SVG, and return the files.

    Raises
    ------
    SpecError, ResourceError
        If the folder or a file cannot be written.
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
            picture.set_layout_engine("none")  # SVG reuses the layout, which takes long to compute
    return written


def chart_image(chart: Figure, width: float = 7.2, height: float = 4.6) -> Picture:
    """Return a chart as a Matplotlib figure of `width` x `height` inches, with its title and caption as heading."""
    picture = new_figure(Caption(chart.title, chart.caption), width, height)
    draw_chart(picture.add_subplot(), chart)
    return picture


def chart_panel(chart: Figure, height: float = Panel.height) -> Panel:
    """Return the panel of a chart, whose title is the headline of the chart, or names its only line."""
    title = chart.title if len(chart.lines) > 1 else f"{chart.title}: {chart.lines[0].label}"
    text, key = chart.headline if isinstance(chart, HeadedChart) else (title, "")

    def draw(axes: Axes) -> None:
        draw_chart(axes, chart, text or title)
        axes.title.set_gid(key or None)
        if chart.x == TIME:
            axes.margins(x=0.01)

    return Panel(draw, height, chart.x == TIME)


def draw_chart(axes: Axes, chart: Figure, title: str = "") -> None:
    """Draw a chart on empty axes in the house style.

    Parameters
    ----------
    title
        Title of a panel; the title and caption of the chart are not drawn.
    """
    dress(axes)
    handles = _draw(axes, chart, _house_looks(chart), {"size": 9, "color": INK}, {"size": 7, "color": FAINT})
    axes.set_title(title, size=8.5, color=INK, loc="left", parse_math=False)
    if chart.needs_key:
        legend(axes, handles, [line.label for line in chart.lines])
    if not chart.y.log:
        powers_of_ten(axes)


def draw_on(axes: Axes | None, chart: Figure, legend_title: str = "", *, vary_dashes: bool = False) -> Axes:
    """Draw a chart in the style of Matplotlib's current settings (`rcParams`), and return the axes.

    Parameters
    ----------
    axes
        Axes to draw on, in addition to their present content. None creates a new figure.
    legend_title
        Title of the legend; empty for none.
    vary_dashes
        Whether lines of different colours have different dashes, too, so that coinciding lines remain visible.
    """
    if axes is None:
        from matplotlib import pyplot

        layout = None if mpl.rcParams["figure.autolayout"] else "constrained"
        axes = draw_on(pyplot.subplots(layout=layout)[1], chart, legend_title, vary_dashes=vary_dashes)
        settle_layout(axes)
        return axes
    _draw(axes, chart, _user_looks(chart, vary_dashes), {}, {"size": "small", "color": "0.4"})
    if axes.get_legend_handles_labels()[0]:
        for label in axes.legend(title=legend_title or None).get_texts():
            label.set_parse_math(False)
    return axes


def settle_layout(axes: Axes) -> None:
    """Apply the limits of axes with equal scales now, so that the next drawing leaves room for their tick labels."""
    if axes.get_aspect() != "auto":
        axes.figure.draw_without_rendering()  # type: ignore[union-attr]


def _house_looks(chart: Figure) -> list[Look]:
    wide = chart.equal and len(chart.lines) < 5  # different widths keep coinciding paths apart
    return [
        {
            "color": color,
            "linestyle": "" if line.kind == "points" else _DASHES[style % len(_DASHES)],
            "linewidth": 1.3 + 1.1 * wide * (len(chart.lines) - 1 - number),
            "marker": _MARKERS[(color_number(color) + style) % len(_MARKERS)] if line.kind != "line" else "",
            "markersize": 4.5,
        }
        for number, (line, (color, style)) in enumerate(zip(chart.lines, line_styles(chart), strict=True))
    ]


def _user_looks(chart: Figure, vary_dashes: bool) -> list[Look]:
    """Return line styles from the property cycle; the lines of a group share a colour and differ in dashes."""
    groups = [line.group or line.label for line in chart.lines]
    vary_dashes &= len(set(groups)) == len(groups)
    own = [style for _, style in line_styles(chart)]
    dashes = [number if vary_dashes else own[number] for number in range(len(groups))]
    return [{"linestyle": _DASHES_OF_GROUPS[k % len(_DASHES_OF_GROUPS)]} if k or vary_dashes else {} for k in dashes]


def _draw(axes: Axes, chart: Figure, looks: Sequence[Look], labels: Look, notes: Look) -> list[Line2D]:
    """Draw a chart without its legend, and return its lines. The look `labels` is that of the labels of the axes, and
    `notes` that of the marks and of the texts at the marks.
    """
    axes.set_xlabel(chart.x.title, parse_math=False, **labels)
    axes.set_ylabel(chart.y.title, parse_math=False, **labels)
    for band in chart.bands:
        axes.axhspan(band.low, band.high, color=GRID, zorder=0.5)
        _note(axes, band.label, (0.01, band.high), ("axes fraction", "data"), (0, -2), size=7.5, color=FAINT)
    for mark in chart.marks:
        axes.axvline(mark.x, color=notes["color"], linewidth=0.8, linestyle=":", zorder=0.6)
        _note(axes, mark.label, (mark.x, 1.0), ("data", "axes fraction"), (2, -3), rotation=90, **notes)
    ds = _draw_lines(axes, chart, looks)
    for guide in chart.guides:
        axes.plot(guide.x, guide.y, color=FAINT, linewidth=1.0, linestyle=(0, (1.0, 2.0)))
        x, y = (
            float(np.sqrt(np.prod(ends)) if axis.log else np.mean(ends))
            for ends, axis in ((guide.x, chart.x), (guide.y, chart.y))
        )
        patch: Look = {"facecolor": PAPER, "edgecolor": "none", "pad": 0.5}
        axes.text(x, y, guide.label, size=7.5, color=FAINT, ha="center", va="center", bbox=patch, parse_math=False)
    if chart.equal:
        axes.set_aspect("equal", adjustable="datalim")
    if chart.x.log:
        axes.set_xscale("log")
        # labels between powers of ten stand side by side, so that more than a few would overlap
        axes.xaxis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(0.5, 0.25)))
    if chart.y.log:
        axes.set_yscale("log")
    return ds


def _draw_lines(axes: Axes, chart: Figure, looks: Sequence[Look]) -> list[Line2D]:
    """Draw the lines of a chart with their bands; a line without its own colour has that of its group."""
    ds: list[Line2D] = []
    colors: dict[str, object] = {}
    for line, look in zip(chart.lines, looks, strict=True):
        group, seen = line.group or line.label, chart.visible(line)
        if int(np.sum(seen)) == 1 and not look.get("marker"):
            look["marker"] = "o"  # a line through one point would be invisible
        if group in colors:
            look.setdefault("color", colors[group])
        # Matplotlib leaves labels that begin with an underscore out of legends.
        label = f" {line.label}" if line.label.startswith("_") else line.label
        (artist,) = axes.plot(line.x, np.where(seen, line.y, np.nan), label=label, **look)
        colors.setdefault(group, artist.get_color())
        if line.band is not None:
            axes.fill(*line.band.T, color=artist.get_color(), alpha=0.25, linewidth=0)
        ds.append(artist)
    return ds


def _note(
    axes: Axes,
    text: str,
    place: tuple[float, float],
    coordinates: tuple[str, str],
    beside: tuple[float, float],
    **look: Any,
) -> None:
    """Write a text below a point, shifted by `beside` (x, y) [points]. The text is not interpreted as mathematics."""
    note = axes.annotate(text, place, xycoords=coordinates, xytext=beside, textcoords="offset points", va="top", **look)
    note.set_parse_math(False)
