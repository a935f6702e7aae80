"""Panels: the parts of a plot, each drawn on Matplotlib axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.axes import Axes

from mbdkit.figures.curves import Array
from mbdkit.figures.palette import INK
from mbdkit.plot.style import dress

TIME = "time [s]"


@dataclass(frozen=True)
class Panel:
    """A part of a plot with axes of its own.

    Parameters
    ----------
    draw
        Draws the panel on empty axes.
    height
        Height of the axes, approximately [inch].
    over_time
        Whether the x axis is time. Such panels share it, and only the lowest one labels it.
    """

    draw: Callable[[Axes], None]
    height: float = 1.85
    over_time: bool = True


def dress_over_time(axes: Axes, ylabel: str) -> Axes:
    """Give `axes` the common look with time as x axis, and return it."""
    dress(axes, TIME, ylabel)
    axes.margins(x=0.01)
    return axes


def panel_title(axes: Axes, text: str) -> None:
    """Write a title above the upper left corner of `axes`, its text taken literally."""
    axes.set_title(text, size=8.5, color=INK, loc="left", parse_math=False)


def single_row_marker(time: Array) -> str:
    """Return the marker of a curve: a line through a single row would be invisible."""
    return "o" if len(time) == 1 else ""
