"""Muscles in pictures: lines through the points that their paths pass."""

import numpy as np

from mbdkit import Mechanism
from mbdkit_biomech.muscles.muscle_lines import muscle_lines
from mbdkit_report import draw_mechanism


def test_a_muscle_is_drawn_through_its_points_and_beside_its_circles():
    m = Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(1.0, 0.0), angle=0.5)
    m.revolute("pin", m.ground, rod, at=(0.0, 0.0))
    m.coordinate("turn", "pin.angle")
    path = [
        {"body": "ground", "point": (-1.0, 0.0)},
        {"wrap": {"body": "ground", "center": (0.0, -0.2), "radius": 0.1, "side": "left"}},
        {"body": rod, "point": (5.0, 5.0), "when": {"turn": [2.0, 3.0]}},
        {"body": rod, "point": ("0.2*turn", 0.0, 0.3)},
        {"body": rod, "point": (0.0, 0.0)},
    ]
    m.muscle("m", path, max_force=1.0, optimal_length=0.1, tendon_length=0.1)
    (places,) = muscle_lines(m.muscles["m"], m)
    assert [body for body, _ in places] == ["ground", "ground", "rod", "rod"]
    x, y = places[1][1]
    assert np.isclose(np.hypot(x, y + 0.2), 0.1)  # on the circle, above its center: a path to the right has left up
    assert y > -0.2
    np.testing.assert_allclose(places[2][1], (0.1, 0.0), atol=1e-15)
    drawing = draw_mechanism(m)
    (line,) = drawing.muscles
    np.testing.assert_allclose(drawing.local[list(line)], [place for _, place in places], atol=1e-12)
    assert not set(line[:1]) & {index for outline in drawing.outlines for index in outline}
