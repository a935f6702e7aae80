"""Pairs of bodies of simple shapes that press against each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from mbdkit.mechanism.mechanism import Mechanism

SQUARE = {"polygon": [(-0.2, -0.1), (0.2, -0.1), (0.2, 0.1), (-0.2, 0.1)]}


OCTAGON = [(0.12 * math.cos(k * math.pi / 4 + 0.4), 0.12 * math.sin(k * math.pi / 4 + 0.4)) for k in range(8)]


RUBBER = {"stiffness": 3.0e4, "dissipation": 0.2, "transition_speed": 0.05}


PULL = 2000.0
"""Weight of 1 kg in these tests, so that any overlap at the start is small against what bodies at rest may have."""


def two_bodies(first: Mapping[str, Any], second: Mapping[str, Any], at: tuple[float, float], angle: float) -> Mechanism:
    m = Mechanism(gravity=(0.0, -PULL))
    m.body("a", mass=1.0, inertia=0.2, position=(0.3, 0.1), angle=0.4, velocity=(0.3, -0.2), angular_velocity=0.7)
    x, y = m.to_global("a", at)
    m.body("b", mass=2.0, inertia=0.3, position=(x, y), angle=angle, velocity=(-0.1, 0.4), angular_velocity=-1.1)
    friction = {"static": 0.5, "kinetic": 0.3}
    rolling = 0.02 if "circle" in {*first, *second} else 0.0
    shapes = [first, second]
    m.contact("c", "a", "b", shapes=shapes, friction=friction, rolling_resistance=rolling, compliance=RUBBER)
    return m


STEPS = {"polyline": [(-1.0, 0.0), (0.2, 0.0), (0.2, 0.1), (0.4, 0.08), (0.45, 0.2)]}


PAIRS = {
    "circles": (({"circle": {"center": (0.1, 0), "radius": 0.2}}, {"circle": {"radius": 0.1}}), (0.3, 0.18), 0.2),
    "hole": (({"hole": {"center": (0.1, 0), "radius": 0.3}}, {"circle": {"radius": 0.1}}), (0.15, 0.21), 0.2),
    "circle before hole": (({"circle": {"radius": 0.1}}, {"hole": {"radius": 0.12}}), (0.02, 0.015), 0.2),
    "circle before line": (({"circle": {"radius": 0.1}}, {"line": {"normal": (1, 2)}}), (-0.04, -0.06), 0.4),
    "edge": ((SQUARE, {"circle": {"radius": 0.05}}), (0.1, 0.13), 0.3),
    "corner": ((SQUARE, {"circle": {"radius": 0.05}}), (0.22, 0.125), 0.3),
    "point inside": (({"point": (0.03, 0.0)}, SQUARE), (0.0, 0.08), 0.1),
    "polygons": ((SQUARE, SQUARE), (0.31, 0.16), 0.3),
    "edge on edge": ((SQUARE, SQUARE), (0.15, 0.195), 0.41),
    "end of an edge": ((SQUARE, SQUARE), (-0.15, -0.195), 0.38),
    "side of a polygon": (({"polygon": OCTAGON}, SQUARE), (0.31, 0.02), 0.42),
    "polygon before circle": (({"circle": {"radius": 0.05}}, SQUARE), (0.1, 0.13), 0.3),
    "circle on a segment": ((STEPS, {"circle": {"radius": 0.05}}), (0.1, 0.045), 0.3),
    "circle in a concave corner": ((STEPS, {"circle": {"radius": 0.05}}), (0.16, 0.046), 0.3),
    "circle on a convex corner": ((STEPS, {"circle": {"radius": 0.05}}), (0.19, 0.145), 0.3),
    "point behind a concave corner": ((STEPS, {"point": (0.0, 0.0)}), (0.203, -0.004), 0.3),
    "box on steps": ((STEPS, SQUARE), (0.25, 0.14), 0.2),
    "polyline after circle": (({"circle": {"radius": 0.05}}, STEPS), (0.02, -0.04), 0.4),
    "corners on a line": (({"line": {"normal": (0.2, 1)}}, SQUARE), (0.0, 0.08), 0.5),
}
