"""Pictures of the state of an environment, drawn as animations draw the mechanism."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbdkit.plugin.reports import PosePictures
from mbdkit_gym.definition import Definition


class Frames:
    """Draws states of the mechanism of an environment; adds the poses of the bodies to what is read."""

    def __init__(self, definition: Definition):
        mechanism = definition.spec.mechanism()
        self._pictures = PosePictures(mechanism, definition.spec.title or "")
        self._columns = []
        for number, (name, body) in enumerate(mechanism.bodies.items()):
            axes = ("x", "y") if body.inertia is None else ("x", "y", "angle")
            for axis, coordinate in enumerate(axes):
                self._columns.append((number, axis, len(definition.expressions)))
                definition.expressions.append(f'bodies["{name}"].{coordinate}')
        self._bodies = len(mechanism.bodies)

    def picture(self, values: np.ndarray) -> NDArray[np.uint8]:
        """Return the picture of a state, (height, width, 3), from the values of all expressions that are read."""
        pose = np.zeros((self._bodies, 3))
        for body, axis, column in self._columns:
            pose[body, axis] = values[column]
        return self._pictures.draw(pose)
