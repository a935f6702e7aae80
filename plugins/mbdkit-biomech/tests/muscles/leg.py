"""A planar leg of two bodies with muscles of all kinds, and poses of it; plain data, which OpenSim reads as well."""

import math

import numpy as np

BODIES = {"thigh": (8.0, 0.12), "shank": (3.5, 0.05)}
"""Mass and moment of inertia."""
HIP = (("ground", (0.0, 0.9)), ("thigh", (0.0, 0.18)))
KNEE = (("thigh", (0.0, -0.24)), ("shank", (0.0, 0.19)))


def muscle(force, optimal, tendon, *path, **more):
    """Return a muscle along points of bodies and around wraps."""
    items = [{"body": item[0], "point": item[1]} if isinstance(item, tuple) else item for item in path]
    return {"path": items, "max_force": force, "optimal_length": optimal, "tendon_length": tendon, **more}


def wrap(center, radius):
    return {"wrap": {"body": "thigh", "center": center, "radius": radius, "side": "left"}}


MILLARD = {"curves": "millard"}
BEND = ["0.05 + 0.012*bend + 0.004*bend**2", "0.2 - 0.01*bend"]
MUSCLES = {
    "straight": muscle(1900.0, 0.15, 0.06, ("ground", [-0.07, 0.86]), ("thigh", [-0.02, -0.05])),
    "via": muscle(
        1500.0, 0.13, 0.19, ("ground", [0.06, 1.0, 0.03]), ("thigh", [0.05, 0.12, 0.05]),
        ("thigh", [0.03, -0.05, 0.02]), pennation=0.14, **MILLARD,
    ),
    "two-joint": muscle(
        2700.0, 0.14, 0.22, ("ground", [-0.09, 0.8, 0.04]), ("shank", [-0.045, 0.14, -0.01]), pennation=0.26, **MILLARD,
    ),
    "wrapped": muscle(
        4500.0, 0.11, 0.28, ("thigh", [0.04, 0.02]), wrap([0.005, -0.24], 0.045), ("shank", [0.04, 0.09]),
        quadrant="+x", pennation=0.05,
    ),
    "wrapped-spatial": muscle(
        1200.0, 0.12, 0.22, ("thigh", [0.03, 0.05, 0.02]), wrap([0.0, -0.24], 0.04), ("shank", [0.035, 0.08, -0.01]),
        quadrant="+x",
    ),
    "conditional": muscle(
        900.0, 0.17, 0.1, ("thigh", [-0.02, 0.0]),
        {"body": "thigh", "point": [-0.03, -0.22], "when": {"knee.angle": [-0.6, 0.2]}}, ("shank", [-0.03, 0.13]),
        **MILLARD,
    ),
    "moving": muscle(
        1100.0, 0.1, 0.22, ("thigh", [0.03, 0.0]), ("shank", BEND), ("shank", [0.03, 0.12]),
        polynomial={"x": [0.004, 0.012, 0.05], "y": [-0.01, 0.2], "z": [0.0]},
    ),
}  # fmt: skip

RATES = [(2.0 * math.cos(1.1 * i), 3.0 * math.sin(i)) for i in range(14)]
ANGLES = [
    (0.5 * math.sin(0.7 * i), -0.05 - 1.5 * (0.5 - 0.5 * math.cos(0.45 * i)), *rates) for i, rates in enumerate(RATES)
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
