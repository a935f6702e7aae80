"""Data of an animation: selected rows with their poses, paths of points, and limits of the axes.

Every frame is a recorded row, without interpolation, so that a gap shown in a frame is a gap of the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mbdkit_report.figures.beam_curves import bending_moments
from mbdkit_report.figures.curves import evenly, take
from mbdkit_report.figures.drawing_geometry import Drawing, Trace, traced_paths
from mbdkit_report.figures.mechanism_drawing import Tag, name_tags
from mbdkit_report.figures.plane_geometry import Array, view_box

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_PATH_ROWS = 4_000
_SPEEDS = [digit * 10.0**power for power in range(-9, 10) for digit in (1.0, 2.0, 5.0)]


@dataclass(frozen=True)
class Scene:
    """Data of an animation with F frames.

    Parameters
    ----------
    speed
        Seconds of the run per second of the animation.
    time
        Time of each frame [s], shape (F,).
    poses
        x [m], y [m] and angle [rad] of each body in each frame, shape (F, B, 3).
    traces
        The K points whose paths are shown.
    path_time, paths
        Times [s], shape (R,), and global coordinates [m] of those points, shape (R, K, 2).
    xlim, ylim
        Limits of the axes [m].
    moments
        Bending moments of the elements of all beams in each frame [N m], shape (F, E); None if not recorded.
    tags
        Names that move with the mechanism.
    """

    drawing: Drawing
    speed: float
    time: Array
    poses: Array
    traces: tuple[Trace, ...]
    path_time: Array
    paths: Array
    xlim: tuple[float, float]
    ylim: tuple[float, float]
    moments: Array | None = None
    tags: Sequence[Tag] = ()

    @property
    def pace(self) -> str:
        """The speed as text."""
        if self.speed == 1.0:
            return "real time"
        faster = self.speed > 1.0
        return f"{self.speed if faster else 1.0 / self.speed:g} times {'faster' if faster else 'slower'} than real time"


def scene(run: Run, *, rate: float, most: int, shortest: float, longest: float) -> Scene:
    """Return the data of an animation of a run.

    Parameters
    ----------
    rate
        Frames per second.
    most
        Largest number of frames.
    shortest, longest
        Limits of the duration of the animation [s]. A run between them is shown in real time; a shorter run is slowed
        down, and a longer one accelerated, by a round factor.
    """
    time = np.asarray(run.time, dtype=np.float64)
    duration = float(time[-1] - time[0])
    speed = round_speed(duration, shortest, longest)
    count = int(np.clip(round(duration / speed * rate), 0, most - 1))
    rows = nearest_rows(time, np.linspace(time[0], time[-1], count + 1))
    shown, place = np.unique(rows, return_inverse=True)
    poses = take(run.dataset("trajectory/position"), shown)[place]
    drawing, traces, paths = traced_paths(run, _PATH_ROWS)
    xlim, ylim, _ = view_box(paths, drawing.world(poses[evenly(len(poses), 60)]))
    drawing = drawing.spanning(xlim, ylim, poses)
    moments = bending_moments(run, drawing.beams)
    bending = None if moments is None else moments[rows]
    path_time = time[evenly(len(time), _PATH_ROWS)]
    tags = name_tags(drawing, drawing.world(poses[0]), paths[:0], xlim, ylim)
    return Scene(drawing, speed, time[rows], poses, traces, path_time, paths, xlim, ylim, bending, tags)


def round_speed(duration: float, shortest: float, longest: float) -> float:
    """Return the round speed factor that brings a duration between `shortest` and `longest` [s]."""
    if duration > longest:
        return min(speed for speed in _SPEEDS if duration / speed <= longest)
    return max(speed for speed in _SPEEDS if duration / speed >= shortest) if 0.0 < duration < shortest else 1.0


def nearest_rows(time: Array, wanted: Array | Sequence[float]) -> NDArray[np.intp]:
    """Return the indices (F,) of the rows that are nearest to the times `wanted` (F,). The times of the rows, `time`
    (T,), increase.
    """
    return np.searchsorted((time[1:] + time[:-1]) / 2, wanted)
