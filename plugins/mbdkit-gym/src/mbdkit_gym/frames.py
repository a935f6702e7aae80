"""Pictures of the state of an environment, drawn as animations draw the mechanism."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdkit_gym.definition import Definition
from mbdkit_report import Caption, draw_mechanism, draw_pose, dress, new_figure, view_box

INCHES = 4.8  #: Width and height of a picture, at 100 dots per inch.


class Frames:
    """Draws states of the mechanism of an environment; adds the poses of the bodies to what is read.

    The picture shows all places where the mechanism has been so far.
    """

    def __init__(self, definition: Definition):
        mechanism = definition.spec.mechanism()
        self._drawing = draw_mechanism(mechanism)
        self._columns = []
        for number, (name, body) in enumerate(mechanism.bodies.items()):
            axes = ("x", "y") if body.inertia is None else ("x", "y", "angle")
            for axis, coordinate in enumerate(axes):
                self._columns.append((number, axis, len(definition.expressions)))
                definition.expressions.append(f'bodies["{name}"].{coordinate}')
        self._caption = Caption(definition.spec.title or "", "")
        self._reached = np.zeros((0, 2))

    def picture(self, values: np.ndarray) -> NDArray[np.uint8]:
        """Return the picture of a state, (height, width, 3), from the values of all expressions that are read."""
        pose = np.zeros((len(self._drawing.bodies), 3))
        for body, axis, column in self._columns:
            pose[body, axis] = values[column]
        points = self._drawing.world(pose)
        known = np.concatenate([self._reached, points])
        self._reached = np.array([known.min(axis=0), known.max(axis=0)])
        xlim, ylim, _ = view_box(self._reached[:, None], points)
        figure = new_figure(self._caption, INCHES, INCHES, dpi=100)
        axes = dress(figure.add_subplot(), "x [m]", "y [m]")
        axes.set_aspect("equal", adjustable="box")
        axes.set(xlim=xlim, ylim=ylim)
        size = float(np.max(np.ptp(self._reached, axis=0)))
        draw_pose(axes, self._drawing.spanning(xlim, ylim, pose[None]), points, size, alpha=1.0)
        canvas: Any = figure.canvas
        canvas.draw()
        return np.array(canvas.buffer_rgba())[..., :3]
