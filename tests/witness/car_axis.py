"""The car axis in two coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.witness import ode

EPS, M, L, L0, R, W = 0.01, 10.0, 1.0, 0.5, 0.1, 10.0


K = M * EPS**2 / 2


def car_axis() -> dict[str, Any]:
    """Return the problem as a free-form model."""
    spring = {"type": "spring-damper", "stiffness": 1.0, "free_length": L0}
    return {
        "name": "mechanism",
        "gravity": [0.0, -1.0],
        "bodies": {
            # the road's motion is prescribed, so its mass and inertia have no effect
            "road": {"mass": 1.0, "inertia": 1.0, "angular_velocity": R * W / L},
            "left": {"mass": K, "position": [0.0, 0.5], "velocity": [-0.5, 0.0]},
            "right": {"mass": K, "position": [1.0, 0.5], "velocity": [-0.5, 0.0]},
        },
        "joints": {
            "pivot": {"type": "revolute", "bodies": ["ground", "road"], "points": [[0.0, 0.0], [0.0, 0.0]]},
            "bumps": {
                "type": "driver",
                "bodies": ["ground", "road"],
                "coordinate": "angle",
                "motion": f"asin({R}*sin({W}*t)/{L})",
            },
            "upright": {"type": "driver", "bodies": ["road", "left"], "coordinate": "x", "motion": 0.0},
            "axis": {"type": "distance", "bodies": ["left", "right"], "points": [[0, 0], [0, 0]], "length": L},
        },
        "forces": {
            "left spring": spring | {"bodies": ["road", "left"], "points": [[0.0, 0.0], [0.0, 0.0]]},
            "right spring": spring | {"bodies": ["road", "right"], "points": [[L, 0.0], [0.0, 0.0]]},
        },
    }


def in_two_coordinates(times: Any) -> Any:
    """Return what `states` returns at `times`, by DOP853 in two coordinates, s of pl over the road, and the axis' tilt.

    With e, n the unit vectors along and across the road and u, w along and across the axis, pl = s n, pr = pl + L u.
    Newton's law of both ends, projected on n and w, leaves s'' and the tilt's phi''; what it leaves of each end is the
    force of its constraints.
    """

    def both(time: Any, state: Any) -> Any:
        s, phi, ds, dphi = state
        sine = R / L * np.sin(W * time)
        cosine = np.sqrt(1 - sine**2)
        rate = R / L * W * np.cos(W * time) / cosine  # of the road's angle asin(sine)
        acceleration = (-R / L * W**2 * np.sin(W * time) + sine * rate**2) / cosine
        e, n = np.array([cosine, sine]), np.array([-sine, cosine])
        u, w = np.array([np.cos(phi), np.sin(phi)]), np.array([-np.sin(phi), np.cos(phi)])
        left, right = s * n, s * n + L * u
        left_rate = ds * n - s * rate * e
        weight, along = np.array([0.0, -K]), right - L * e
        on_left = (L0 - abs(s)) * left / abs(s) + weight
        on_right = (L0 / np.hypot(*along) - 1) * along + weight
        drift_left = -(2 * ds * rate + s * acceleration) * e - s * rate**2 * n  # acceleration but for s'' and phi''
        drift_right = drift_left - L * dphi**2 * u
        matrix = K * np.array([[2.0, L * (n @ w)], [n @ w, L]])
        force = np.array(
            [(on_left + on_right) @ n - K * (drift_left + drift_right) @ n, (on_right - K * drift_right) @ w]
        )
        dds, ddphi = np.linalg.solve(matrix, force)
        pull = K * (dds * n + L * ddphi * w + drift_right) - on_right  # on the right end: 2 lam2 (pr - pl)
        push = K * (dds * n + drift_left) - on_left + pull  # on the left end: lam1 (xb, yb), the axis taken off
        lam1, lam2 = push @ e / L, pull @ u / (2 * L)
        return np.array([ds, dphi, dds, ddphi]), [*left, *right, *left_rate, *(left_rate + L * dphi * w), lam1, lam2]

    solution = ode.dop853(lambda time, state: both(time, state)[0], np.array([0.5, 0.0, 0.0, 0.0]), times)
    return np.array([both(time, state)[1] for time, state in zip(times, solution, strict=True)])
