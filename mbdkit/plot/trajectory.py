"""The paths of a mechanism's points with its first and last pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mbdkit.plot.caption import caption
from mbdkit.plot.drawing_geometry import Drawing, Trace, choose_traces, draw_spec, trace_points
from mbdkit.plot.pose import Pose, body_colors
from mbdkit.plot.series import evenly, take
from mbdkit.plot.shapes import view_box
from mbdkit.plot.style import FAINT, INK, PALETTE, dress, legend, new_figure

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_ROWS = 20_000


def trace_colors(drawing: Drawing, traces: Sequence[Trace]) -> list[str]:
    """Return a colour for each trace: that of its body where bodies have colours of their own, else one each."""
    owners = [int(drawing.owner[trace.point]) for trace in traces]
    if len(drawing.bodies) <= len(PALETTE) and len(set(owners)) == len(owners):
        return [PALETTE[owner] for owner in owners]
    return [PALETTE[index % len(PALETTE)] for index in range(len(traces))]


def trajectory_figure(run: Run) -> Figure:
    """Return the figure of the paths that the mechanism's free ends and moving joints take."""
    drawing = draw_spec(run.spec, tuple(run.bodies))
    traces = choose_traces(drawing)
    positions = run.dataset("trajectory/position")
    fixed, owners = trace_points(drawing, traces)
    paths = fixed.world(take(positions, evenly(len(run.time), _ROWS), owners))
    ends = drawing.world(take(positions, evenly(len(run.time), 2)))
    (x0, x1), (y0, y1), cut = view_box(paths, ends)
    width, height = x1 - x0, y1 - y0
    figure = new_figure(caption(run), 7.2, float(np.clip(4.9 * height / width, 2.4, 5.4)) + 1.1)
    axes = dress(figure.add_subplot(), "x [m]", "y [m]")
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=(x0, x1), ylim=(y0, y1))
    size = max(width, height)
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
        axes.set_title("some points lie outside of the picture", size=8.5, color=FAINT, loc="left")
    return figure
