"""Specs of a measured motion with an orthosis of the knee, and the motion of two limbs in closed form."""

from __future__ import annotations

import numpy as np

import mbdkit

TISSUE = {
    "stiffness": {"normal": 2e4, "tangential": 1e4, "rotation": 200.0},
    "damping": {"normal": 60.0, "tangential": 40.0, "rotation": 0.2},
}


def brace(**keys: object) -> dict[str, object]:
    """Return a hinge orthosis on a leg of a person of 75 kg and 1.8 m."""
    attach = {
        "upper": {"limb": "thigh", "at": [0.0, -0.25 + 0.162], "cuff": TISSUE},
        "lower": {"limb": "shank", "at": [0.0, 0.192 - 0.162], "cuff": TISSUE},
    }
    return {"mechanism": {"name": "hinge-orthosis", "height": 1.8, "stiffness": 20.0}, "attach": attach} | keys


def leg(**device: object) -> dict[str, object]:
    """Return the model of a leg with a free trunk, which wears the orthosis."""
    return {"name": "leg", "root": "trunk", "body_mass": 75, "height": 1.8, "devices": {"brace": brace(**device)}}


SQUAT = {"hip_x": -0.15, "hip_y": -0.2, "trunk_tilt": 0.5, "hip_flexion": 1.4, "knee_flexion": 1.4,
         "ankle_dorsiflexion": 0.5}  # fmt: skip
"""Changes of the coordinates of the leg in a slow squat [m, rad]."""


def squat_spec(follows: str | None = "dynamics", plates: bool = True, **device: object) -> dict[str, object]:
    """Return a spec of inverse dynamics of a slow squat on one leg, with 600 N from the ground."""
    t = np.linspace(0.0, 4.0, 41)
    down = (1 - np.cos(np.pi * t / 2)) / 2
    data = {name: (size * down + 0.95 * (name == "hip_y")).tolist() for name, size in SQUAT.items()}
    data |= {"time": t.tolist(), "force": [600.0] * len(t), "point": [0.05] * len(t)}
    columns = {name: {"column": name, "deviation": 0.001} for name in SQUAT}
    load = {"body": "foot", "force": [0.0, "force"], "point": ["point", 0.0], "kind": "plate"}
    spec = {"mbdkit": 1, "model": leg(**device), "motion": {"data": data, "columns": columns, "smooth": "quintic"}}
    spec["motion"]["errors"] = "none"
    return spec | {"loads": {"ground": load} if plates else {}, "accept": ["residuals"], "follows": follows}


def two_limbs(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, velocities and accelerations (T, 6) of a thigh and a shank that walk, in closed form."""
    w = 2 * np.pi
    lean = [0.4 * np.sin(w * t / 2 + 0.3), 0.2 * w * np.cos(w * t / 2 + 0.3), -0.1 * w**2 * np.sin(w * t / 2 + 0.3)]
    bend = [0.5 - 0.5 * np.cos(w * t), 0.5 * w * np.sin(w * t), 0.5 * w**2 * np.cos(w * t)]
    knee = [np.column_stack([0.8 * t, 0.02 * np.cos(4 * t)]), np.column_stack([0.8 + 0 * t, -0.08 * np.sin(4 * t)]),
            np.column_stack([0 * t, -0.32 * np.cos(4 * t)])]  # fmt: skip
    parts = []
    for angle, arm in ((lean, 0.25), ([a - b for a, b in zip(lean, bend, strict=True)], -0.192)):
        along = np.column_stack([-np.sin(angle[0]), np.cos(angle[0])])
        across = np.column_stack([-np.cos(angle[0]), -np.sin(angle[0])])
        rate, bending = angle[1][:, None], angle[2][:, None]
        moves = [along, across * rate, across * bending - along * rate**2]
        parts.append([np.column_stack([k + arm * m, a]) for k, m, a in zip(knee, moves, angle, strict=True)])
    return tuple(np.hstack([parts[0][i], parts[1][i]]) for i in range(3))  # type: ignore[return-value]


def driven_limbs() -> mbdkit.Mechanism:
    """Return the same limbs as `two_limbs`, moved by drivers."""
    lean, bend = "0.4*sin(pi*t + 0.3)", "(0.5 - 0.5*cos(2*pi*t))"
    m, (q, v, _) = mbdkit.Mechanism(), two_limbs(np.zeros(1))
    for k, (name, arm, angle) in enumerate((("thigh", 0.25, lean), ("shank", -0.192, f"({lean} - {bend})"))):
        (x, y, turn), (vx, vy, spin) = q[0, 3 * k : 3 * k + 3].tolist(), v[0, 3 * k : 3 * k + 3].tolist()
        m.body(name, mass=1.0, inertia=0.1, position=(x, y), angle=turn, velocity=(vx, vy), angular_velocity=spin)
        motions = {"x": f"0.8*t - {arm}*sin({angle})", "y": f"0.02*cos(4*t) + {arm}*cos({angle})", "angle": angle}
        for axis, motion in motions.items():
            if name == "thigh" or axis == "angle":
                m.driver(f"{name}_{axis}", m.ground, name, coordinate=axis, motion=motion)
    m.revolute("knee", "thigh", "shank", points=((0.0, -0.25), (0.0, 0.192)))
    return m
