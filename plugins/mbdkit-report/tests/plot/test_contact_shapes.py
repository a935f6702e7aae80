"""Outlines of contacts as they are drawn."""

from __future__ import annotations

import numpy as np

import mbdkit
from mbdkit_report.figures.element_places import contact_places


def test_lines_and_polylines_are_drawn_beyond_the_bodies_by_half_of_their_extent() -> None:
    m = mbdkit.Mechanism()
    ball = m.body("ball", mass=1.0, inertia=0.1, position=(3.0, 1.0))
    round_shape = {"circle": {"radius": 0.1}}
    m.contact("floor", m.ground, ball, shapes=[{"line": {"normal": [0, 1]}}, round_shape])
    m.contact("steps", m.ground, ball, shapes=[{"polyline": [[-1, 0], [0, 0], [0, 0.5], [1, 0.5]]}, round_shape])
    floor, steps = ([point for _, point in contact_places(m, "ground", one.shapes[0])] for one in m.contacts.values())
    np.testing.assert_allclose(floor, [[-3.0, 0.0], [5.0, 0.0]], atol=1e-15)  # bodies and points are 4 m apart
    np.testing.assert_allclose(steps, [[-3.0, 0.0], [-1, 0], [0, 0], [0, 0.5], [1, 0.5], [5.0, 0.5]], atol=1e-15)
