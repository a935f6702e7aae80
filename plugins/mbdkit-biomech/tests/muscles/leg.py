"""A planar leg of two bodies with muscles of all kinds, and poses of it; plain data, which OpenSim reads as well."""

import math

import numpy as np

BODIES = {"thigh": (8.0, 0.12), "shank": (3.5, 0.05)}
"""Mass and moment of inertia."""
HIP = (("ground", (0.0, 0.9)), ("thigh", (0.0, 0.18)))
KNEE = (("thigh", (0.0, -0.24)), ("shank", (0.0, 0.19)))

MUSCLES = {
    "straight": {
        "path": [{"body": "ground", "point": [-0.07, 0.86]}, {"body": "thigh", "point": [-0.02, -0.05]}],
        "max_force": 1900.0,
        "optimal_length": 0.15,
        "tendon_length": 0.06,
    },
    "via": {
        "path": [
            {"body": "ground", "point": [0.06, 1.0, 0.03]},
            {"body": "thigh", "point": [0.05, 0.12, 0.05]},
            {"body": "thigh", "point": [0.03, -0.05, 0.02]},
        ],
        "max_force": 1500.0,
        "optimal_length": 0.13,
        "tendon_length": 0.19,
        "pennation": 0.14,
        "curves": "millard",
    },
    "two-joint": {
        "path": [
            {"body": "ground", "point": [-0.09, 0.8, 0.04]},
            {"body": "shank", "point": [-0.045, 0.14, -0.01]},
        ],
        "max_force": 2700.0,
        "optimal_length": 0.14,
        "tendon_length": 0.22,
        "pennation": 0.26,
        "curves": "millard",
    },
    "wrapped": {
        "path": [
            {"body": "thigh", "point": [0.04, 0.02]},
            {"wrap": {"body": "thigh", "center": [0.005, -0.24], "radius": 0.045, "side": "left"}},
            {"body": "shank", "point": [0.04, 0.09]},
        ],
        "quadrant": "+x",
        "max_force": 4500.0,
        "optimal_length": 0.11,
        "tendon_length": 0.28,
        "pennation": 0.05,
    },
    "wrapped-spatial": {
        "path": [
            {"body": "thigh", "point": [0.03, 0.05, 0.02]},
            {"wrap": {"body": "thigh", "center": [0.0, -0.24], "radius": 0.04, "side": "left"}},
            {"body": "shank", "point": [0.035, 0.08, -0.01]},
        ],
        "quadrant": "+x",
        "max_force": 1200.0,
        "optimal_length": 0.12,
        "tendon_length": 0.22,
    },
    "conditional": {
        "path": [
            {"body": "thigh", "point": [-0.02, 0.0]},
            {"body": "thigh", "point": [-0.03, -0.22], "when": {"knee.angle": [-0.6, 0.2]}},
            {"body": "shank", "point": [-0.03, 0.13]},
        ],
        "max_force": 900.0,
        "optimal_length": 0.17,
        "tendon_length": 0.1,
        "curves": "millard",
    },
    "moving": {
        "path": [
            {"body": "thigh", "point": [0.03, 0.0]},
            {"body": "shank", "point": ["0.05 + 0.012*bend + 0.004*bend**2", "0.2 - 0.01*bend"]},
            {"body": "shank", "point": [0.03, 0.12]},
        ],
        "polynomial": {"x": [0.004, 0.012, 0.05], "y": [-0.01, 0.2], "z": [0.0]},
        "max_force": 1100.0,
        "optimal_length": 0.1,
        "tendon_length": 0.22,
    },
}

ANGLES = [
    (
        0.5 * math.sin(0.7 * i),
        -0.05 - 1.5 * (0.5 - 0.5 * math.cos(0.45 * i)),
        2.0 * math.cos(1.1 * i),
        3.0 * math.sin(i),
    )
    for i in range(14)
]
"""Angles of hip and knee [rad], and their rates."""


HOLDING = ("via", "conditional")
"""Muscles that hold the leg at rest alone."""
POSTURES = [(0.3, -1.0), (0.5, -1.3), (0.7, -1.6), (0.4, -0.9)]
"""Angles of hip and knee at which they do [rad]."""

RECRUITED = ("straight", "via", "two-joint", "wrapped", "conditional")
"""Muscles of which OpenSim's static optimization is compared."""


def motion():
    """Return times (T,) and angles (T, 2) of a motion."""
    time = np.linspace(0.0, 0.8, 81)
    phase = 2 * np.pi * time / 0.8
    return time, np.stack([0.25 * np.sin(phase) + 0.1, -0.75 + 0.45 * np.cos(phase)], axis=1)
