"""Pictures of a mechanism in one pose after the other, as arrays of pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_report.figures.drawing_geometry import draw_mechanism
from mbdkit_report.figures.plane_geometry import view_box
from mbdkit_report.figures.pose import draw_pose
from mbdkit_report.plot.caption import Caption
from mbdkit_report.plot.style import dress_plane, new_figure

INCHES = 4.8  #: Width and height of a picture, at 100 dots per inch.


class PosePictures:
    """Draws poses of a mechanism as animations do; a picture shows all places where the mechanism has been so far."""

    def __init__(self, mechanism: Mechanism, title: str = ""):
        self._drawing = draw_mechanism(mechanism)
        self._caption = Caption(title, "")
        self._reached = np.zeros((0, 2))

    def draw(self, pose: np.ndarray) -> NDArray[np.uint8]:
        """Return the picture, (height, width, 3), of the positions and angles (B, 3) of the bodies."""
        points = self._drawing.world(pose)
        known = np.concatenate([self._reached, points])
        self._reached = np.array([known.min(axis=0), known.max(axis=0)])
        xlim, ylim, _ = view_box(self._reached[:, None], points)
        figure = new_figure(self._caption, INCHES, INCHES, dpi=100)
        axes = dress_plane(figure.add_subplot(), xlim, ylim)
        size = float(np.max(np.ptp(self._reached, axis=0)))
        draw_pose(axes, self._drawing.spanning(xlim, ylim, pose[None]), points, size, alpha=1.0)
        canvas: Any = figure.canvas
        canvas.draw()
        return np.array(canvas.buffer_rgba())[..., :3]
