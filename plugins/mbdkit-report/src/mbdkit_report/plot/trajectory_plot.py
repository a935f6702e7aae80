"""The plot `trajectory`: paths of points of the mechanism, with its first and last pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mbdkit.archive.run_views import Names
from mbdkit_report.figures.beam_curves import bending_moments, largest_moment
from mbdkit_report.figures.curves import Array, band_along_path, errors_at, evenly, take
from mbdkit_report.figures.drawing_geometry import Drawing, Trace, choose_traces, draw_run, trace_points, traced_paths
from mbdkit_report.figures.mechanism_drawing import name_tags
from mbdkit_report.figures.page_model import Axis, Figure, Line
from mbdkit_report.figures.palette import FAINT, INK, KIND_COLORS, MUSCLE, body_colors, trace_colors
from mbdkit_report.figures.plane_geometry import view_box
from mbdkit_report.figures.pose import PoseArtists, draw_pose
from mbdkit_report.plot.charts import Panel, named
from mbdkit_report.plot.style import dress_plane, legend

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_ROWS = 20_000
_CHART_ROWS = 4_000
_BROAD = 1.18  # width of the highest axes, as a share of their height


def panels(run: Run) -> list[Panel]:
    """Return the panel of the paths and poses, with a height that suits the motion."""
    drawing, traces, paths = traced_paths(run, _ROWS)
    poses = take(run.dataset("trajectory/position"), evenly(len(run.time), 2))
    (x0, x1), (y0, y1), cut = view_box(paths, drawing.world(poses))
    height = float(np.clip(4.9 * (y1 - y0) / (x1 - x0), 2.4, 5.4)) - 1.0
    lack = max(0.0, _BROAD * (y1 - y0) - (x1 - x0)) / 2
    x0, x1 = x0 - lack, x1 + lack  # the picture of a standing person fills the width, too
    drawing = drawing.spanning((x0, x1), (y0, y1), poses)
    errors = _errors(run, drawing, traces, _ROWS)
    moments = bending_moments(run, drawing.beams)
    last = None if moments is None else moments[-1]
    ends = drawing.world(poses)
    tags = name_tags(drawing, ends[-1], take(paths, evenly(len(paths), 400)), (x0, x1), (y0, y1))

    def draw(axes: Axes) -> None:
        dress_plane(axes, (x0, x1), (y0, y1))
        size = max(x1 - x0, y1 - y0)
        draw_pose(axes, drawing, ends[0], size, alpha=0.35, is_faint=True)
        colors, most = body_colors(drawing), largest_moment(last)
        at_end = PoseArtists(axes, drawing, colors, size, alpha=0.55, largest_moment=most, tags=tags)
        at_end.move(ends[-1], last)
        at_end.show_scale(axes, "at the end")
        handles = []
        for number, color in enumerate(trace_colors(drawing, traces)):
            path = paths[:, number]
            for part in _lines(traces[number].label, path, None if errors is None else errors[:, number]):
                dashes = ":" if part.label != traces[number].label else "-"
                (line,) = axes.plot(part.x, part.y, color=color, linestyle=dashes, linewidth=1.1, zorder=2.5, alpha=0.9)
                if part.band is not None:
                    axes.fill(*part.band.T, color=color, alpha=0.25, linewidth=0, zorder=2.4)
            axes.plot(*path[0], marker="o", markersize=4.5, color=color, markerfacecolor="white", zorder=8)
            axes.plot(*path[-1], marker="o", markersize=4.5, color=color, zorder=8)
            handles.append(Line2D([], [], color=line.get_color(), linewidth=1.1))
        hidden = len(drawing.main_traces) - len(traces)
        labels = [trace.label for trace in traces]
        if hidden:
            handles.append(Line2D([], [], linestyle=""))
            labels.append(f"({hidden} more)")
        handles += [
            Line2D([], [], color=FAINT, alpha=0.5, linewidth=3, marker="o", markersize=4.5, markerfacecolor="white"),
            Line2D([], [], color=INK, alpha=0.7, linewidth=3, marker="o", markersize=4.5),
        ]
        labels += ["at the start", "at the end"]
        for kind, text in drawing.key:
            handles.append(Line2D([], [], color=KIND_COLORS.get(kind, MUSCLE), linewidth=1.3))
            labels.append(text)
        if errors is not None and not np.all(np.isfinite(errors)):
            handles.append(Line2D([], [], color=INK, linewidth=1.1, linestyle=":"))
            labels.append("error unknown")
        legend(axes, handles, labels, "paths and poses")
        if cut:
            axes.set_title("some points lie outside the picture", size=8.5, color=FAINT, loc="left")

    height += 0.0 if last is None else 0.6  # room for the scale of the bending moments
    return [Panel(draw, height, over_time=False)]


def charts(run: Run) -> list[Figure]:
    """Return the chart of the paths, without the poses."""
    return [chart(run)]


def chart(run: Run, *, points: Names = None, most: int = 6) -> Figure:
    """Return the chart of the paths of some points; the options are those of `RunPlots.trajectory`, and at most `most`
    points are shown unless they are named. Raises UnknownNameError if there is no such point.
    """
    names, result = _points(run, points, most, evenly(len(run.time), _CHART_ROWS))
    paths = np.stack([path for path, _ in result], axis=1)
    (left, right), (low, high), cut = view_box(paths, paths[:1])
    x, y = paths[..., 0], paths[..., 1]
    outside = (x < left) | (x > right) | (y < low) | (y > high)
    paths = np.where(outside[..., None], np.nan, paths)
    of_markers = run.records("markers/position") and all(name in run.markers for name in names)
    caption = f"Paths of {'markers' if of_markers else 'points'} in the plane."
    if run.accuracy is not None:
        caption += " Bands show estimated errors; a line hides bands that are narrower than itself."
    lines = [line for k, name in enumerate(names) for line in _lines(name, paths[:, k], result[k][1])]
    caption += " Some points lie outside the picture." if cut else ""
    return Figure("trajectory", "Trajectory", caption, Axis("x", "m"), Axis("y", "m"), tuple(lines), equal=True)


def _points(
    run: Run, wanted: Names, most: int, rows: NDArray[np.intp]
) -> tuple[list[str], list[tuple[Array, Array | None]]]:
    """Return the names of points, their paths (R, 2) [m] and their estimated errors (R,) [m]; None for errors not
    estimated.
    """
    drawing = draw_run(run)
    markers = tuple(run.markers) if run.records("markers/position") else ()
    traces = {name: Trace(name, centre) for name, centre in zip(drawing.bodies, drawing.centres, strict=True)}
    traces |= {trace.label: trace for trace in drawing.traces}
    if wanted is None:
        moving = [name for name in markers if run.markers[name].body in run.bodies]
        names = list(moving or (trace.label for trace in choose_traces(drawing)))[:most]
    else:
        names = named(wanted, dict.fromkeys([*markers, *traces]), "point")
    results = []
    for name in names:
        if name in markers:
            results.append(_marker_path(run, name, rows))
            continue
        fixed, owners = trace_points(drawing, (traces[name],))
        errors = _errors(run, drawing, (traces[name],), _CHART_ROWS)
        path = fixed.world(take(run.dataset("trajectory/position"), rows, owners))[:, 0]
        results.append((path, None if errors is None else errors[:, 0]))
    return names, results


def _marker_path(run: Run, name: str, rows: NDArray[np.intp]) -> tuple[Array, Array | None]:
    marker = run.markers[name]
    path, accuracy = marker.position[rows], run.accuracy
    if accuracy is None or marker.body not in run.bodies:
        return path, None
    error = errors_at(accuracy, accuracy.position_error, np.asarray(run.time)[rows])
    of_body = error[:, list(run.bodies).index(marker.body)]
    arm = np.linalg.norm(marker.position[0] - run[marker.body].position[0])
    return path, np.asarray(np.linalg.norm(of_body[:, :2], axis=-1) + arm * of_body[:, 2])


def _lines(label: str, path: Array, error: Array | None) -> list[Line]:
    """Return the path of a point with its error; the part with unknown errors is a separate line."""
    if error is None:
        return [Line(label, path[:, 0], path[:, 1], group=label)]
    known = int(np.sum(np.isfinite(error)))
    lines = []
    if known:
        part = path[:known]
        lines.append(Line(label, part[:, 0], part[:, 1], group=label, band=band_along_path(part, error[:known])))
    if known < len(path):
        part = path[max(known - 1, 0) :]
        lines.append(Line(f"{label}, error unknown", part[:, 0], part[:, 1], group=label))
    return lines


def _errors(run: Run, drawing: Drawing, traces: tuple[Trace, ...], rows: int) -> Array | None:
    """Return the estimated errors of the points of the paths [m], (R, K); nan where unknown, None if not estimated.

    The error of a point is that of the centre of mass of its body, plus the error of the angle times the distance of
    the point from the centre of mass.
    """
    if (accuracy := run.accuracy) is None:
        return None
    error = errors_at(accuracy, accuracy.position_error, np.asarray(run.time)[evenly(len(run.time), rows)])
    points = [trace.point for trace in traces]
    of_points, arm = error[:, drawing.owner[points]], np.linalg.norm(drawing.local[points], axis=-1)
    return np.asarray(np.linalg.norm(of_points[..., :2], axis=-1) + arm * of_points[..., 2])
