"""Force plates of C3D files."""

from __future__ import annotations

import numpy as np
from tests.inverse_dynamics.c3d_files import Plate


def plate(kind: int, force: np.ndarray, point: np.ndarray, torque: np.ndarray, middle: np.ndarray) -> Plate:
    """Return the plate that shows forces [N] on the foot at points [mm] and free torques [N mm], each (R, 3), by the
    definition of the plates: moments about its sensor in axes that point forward, to the right and down.
    """
    down = np.diag([1.0, -1.0, -1.0])
    corners = middle + np.array([[300, -200, 0], [-300, -200, 0], [-300, 200, 0], [300, 200, 0]])
    origin = np.array([1.0, -2.0, -40.0])
    own, arm, free = force @ down, origin + (point - middle) @ down, torque @ down
    if kind == 1:  # force, point of application and free torque
        return Plate(corners, origin, np.column_stack([own, ((point - middle) @ down)[:, :2], free[:, 2]]), kind=1)
    if kind == 3:  # eight forces of sensors at distances a and b from the middle, and 40 mm below the surface
        a, b, sensors = 120.0, 200.0, np.array([0.0, 0.0, -40.0])
        moment = np.cross(sensors + (point - middle) @ down, own) + free
        x, y, z = own.T
        turn = moment[:, 2] / (2 * b)
        part = np.stack([0 * z, moment[:, 0] / b, moment[:, 1] / a])  # of the sums with signs + + - -, and - + + -
        signs = np.array([[1, 1, -1], [1, 1, 1], [1, -1, 1], [1, -1, -1]])
        vertical = 0.25 * (z[:, None] + part.T @ signs.T)
        sides = np.column_stack([x / 2 - turn, x / 2 + turn, y / 2, y / 2])
        return Plate(corners, np.array([a, b, -40.0]), np.hstack([sides, vertical]), kind=3)
    shown = np.concatenate([own, np.cross(arm, own) + free], axis=1)
    matrix = np.eye(6) + 1e-4 * np.random.default_rng(3).standard_normal((6, 6)) if kind == 4 else None
    return Plate(corners, origin, shown if matrix is None else shown @ np.linalg.inv(matrix).T, matrix, kind)
