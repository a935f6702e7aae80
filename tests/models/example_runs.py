"""Packaged examples, run once, and quantities of their runs."""

from __future__ import annotations

from functools import cache

import numpy as np

import mbdkit
from mbdkit.spec import load_spec


@cache
def ran(name):
    """Return the run of an example, which is simulated once for all of its tests."""
    return mbdkit.run(name)


def of_all_bodies(run, name, history):
    """Return a vector of bodies over time (T, 2), summed with their masses as weights [kg]."""
    bodies = load_spec(name).mechanism().bodies
    return sum(body.mass * getattr(run[key], history) for key, body in bodies.items())


def length(run, mechanism, name):
    """Return the distance of a force's two points over time [m]."""
    ends = []
    for body, (x, y) in zip(mechanism.forces[name].bodies, mechanism.forces[name].points, strict=True):
        place, angle = ((0.0, 0.0), 0.0) if body == "ground" else (run[body].position, run[body].angle)
        c, s = np.cos(angle), np.sin(angle)
        ends.append(np.asarray(place) + np.stack([c * x - s * y, s * x + c * y], axis=-1))
    return np.hypot(*(ends[1] - ends[0]).T)
