"""The plot `trajectory`: paths of points of the mechanism, with its first and last pose."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mbdkit.analysis.verdict import Axis, Figure, Line
from mbdkit.plot.downsampling import Array, evenly, take
from mbdkit.plot.drawing_geometry import Drawing, Trace, choose_traces, draw_spec, trace_points
from mbdkit.plot.panel import Panel
from mbdkit.plot.plane_geometry import view_box
from mbdkit.plot.pose import Pose, body_colors, trace_colors
from mbdkit.plot.style import FAINT, INK, dress, legend

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_ROWS = 20_000
_CHART_ROWS = 4_000


def panels(run: Run) -> list[Panel]:
    """Return the panel of the paths and poses, as high as the motion asks for."""
    drawing, traces, paths = _paths(run, _ROWS)
    ends = drawing.world(take(run.dataset("trajectory/position"), evenly(len(run.time), 2)))
    (x0, x1), (y0, y1), _ = view_box(paths, ends)
    height = float(np.clip(4.9 * (y1 - y0) / (x1 - x0), 2.4, 5.4)) - 1.0
    draw = partial(_draw, drawing=drawing, traces=traces, paths=paths, ends=ends)
    return [Panel(draw, height, over_time=False)]


def charts(run: Run) -> list[Figure]:
    """Return the chart of the paths, without the poses."""
    _, traces, paths = _paths(run, _CHART_ROWS)
    (left, right), (low, high), cut = view_box(paths, paths[:1])
    x, y = paths[..., 0], paths[..., 1]
    outside = (x < left) | (x > right) | (y < low) | (y > high)
    paths = np.where(outside[..., None], np.nan, paths)
    caption = "Paths of free ends and moving joints in the plane."
    return [
        Figure(
            "trajectory",
            "Trajectory",
            f"{caption} Some points lie outside the picture." if cut else caption,
            Axis("x", "m"),
            Axis("y", "m"),
            tuple(Line(trace.label, paths[:, k, 0], paths[:, k, 1]) for k, trace in enumerate(traces)),
            equal=True,
        )
    ]


def _paths(run: Run, rows: int) -> tuple[Drawing, tuple[Trace, ...], Array]:
    """Return the drawing, the traced points, and their paths [m] of at most so many rows, shape (R, K, 2)."""
    drawing = draw_spec(run.spec, tuple(run.bodies))
    traces = choose_traces(drawing)
    fixed, owners = trace_points(drawing, traces)
    return drawing, traces, fixed.world(take(run.dataset("trajectory/position"), evenly(len(run.time), rows), owners))


def _draw(axes: Axes, drawing: Drawing, traces: tuple[Trace, ...], paths: Array, ends: Array) -> None:
    """Draw paths (R, K, 2) and the first and last pose `ends` (2, P, 2)."""
    (x0, x1), (y0, y1), cut = view_box(paths, ends)
    dress(axes, "x [m]", "y [m]")
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=(x0, x1), ylim=(y0, y1))
    size = max(x1 - x0, y1 - y0)
    grey = [FAINT] * len(drawing.bodies)
    Pose(axes, drawing, grey, size, alpha=0.35).move(ends[0])
    Pose(axes, drawing, body_colors(drawing), size, alpha=0.55).move(ends[-1])
    handles = []
    for number, color in enumerate(trace_colors(drawing, traces)):
        path = paths[:, number]
        (line,) = axes.plot(path[:, 0], path[:, 1], color=color, linewidth=1.1, zorder=2.5, alpha=0.9)
        axes.plot(*path[0], marker="o", markersize=4.5, color=color, markerfacecolor="white", zorder=8)
        axes.plot(*path[-1], marker="o", markersize=4.5, color=color, zorder=8)
        handles.append(line)
    hidden = len(drawing.traces) - len(traces)
    labels = [trace.label for trace in traces]
    if hidden:
        handles.append(Line2D([], [], linestyle=""))
        labels.append(f"({hidden} more)")
    handles += [
        Line2D([], [], color=FAINT, alpha=0.5, linewidth=3, marker="o", markersize=4.5, markerfacecolor="white"),
        Line2D([], [], color=INK, alpha=0.7, linewidth=3, marker="o", markersize=4.5),
    ]
    legend(axes, handles, [*labels, "at the start", "at the end"], "paths and poses")
    if cut:
        axes.set_title("some points lie outside the picture", size=8.5, color=FAINT, loc="left")
