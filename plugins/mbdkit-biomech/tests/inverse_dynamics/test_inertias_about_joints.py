"""Inertias given about a joint are reported."""

from __future__ import annotations

import pytest

import mbdkit
from mbdkit_biomech.inverse_dynamics.criteria.model_criteria import inertias_about_joints


@pytest.mark.parametrize(
    ("inertia", "mass", "told"),
    [
        # shank of 3.5 kg and 0.42 m: 0.302, 0.528 and 0.643 lengths about centre, knee and ankle (Winter, table 4.1)
        pytest.param(3.5 * (0.302 * 0.42) ** 2, 3.5, False, id="about the centre of mass"),
        pytest.param(3.5 * (0.528 * 0.42) ** 2, 3.5, True, id="about the knee"),
        pytest.param(3.5 * (0.643 * 0.42) ** 2, 3.5, True, id="about the ankle"),
        pytest.param(3.5 * 0.21**2, 3.5, False, id="masses at both ends"),
        pytest.param(3.5 * 0.42**2, 3.5, False, id="larger than its points"),
        pytest.param(0.05 * 0.25**2, 0.05, False, id="light body"),
        pytest.param(None, 3.5, False, id="point mass"),
    ],
)
def test_an_inertia_about_a_joint_is_told(inertia: float | None, mass: float, told: bool) -> None:
    m = mbdkit.Mechanism()
    m.body("thigh", mass=8.0, inertia=0.1)
    m.body("shank", mass=mass, inertia=inertia)
    m.revolute("knee", "thigh", "shank", points=((-0.24, 0), (0.18, 0)))
    m.marker("ankle", "shank", point=(-0.24, 0.0))
    found = [*inertias_about_joints(m)]
    assert len(found) == told
    assert all("of body 'shank' at model.bodies.shank" in text for text in found)
