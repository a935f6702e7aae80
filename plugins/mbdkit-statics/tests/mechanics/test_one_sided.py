"""Stability where a force has a corner: judged on all sides, and alike for equal forces in other words."""

from __future__ import annotations

import math

import numpy as np
import pytest

import mbdkit
from mbdkit_statics.equilibrium import Equilibrium

X = "(r.angle-pi/2)"


def upright(*values: str) -> Equilibrium:
    """Return the equilibrium of a rod on its end, 1 kg and 1 m, under torques that are functions of its angle."""
    m = mbdkit.Mechanism(gravity=(0, -9.81))
    rod = m.body("r", mass=1.0, inertia=1 / 12, position=(0, 0.5), angle=math.pi / 2)
    m.revolute("p", m.ground, rod, at=(0, 0))
    for k, value in enumerate(values):
        m.torque(f"u{k}", rod, value=value)
    return mbdkit.equilibrium(m)


@pytest.mark.parametrize(
    ("values", "left", "right"),
    [
        ([f"-8*max({X},0)"], 0.0, 8.0),
        ([f"-8*({X}+abs({X}))/2"], 0.0, 8.0),
        ([f"-8*max({X},0)-8*min({X},0)"], 8.0, 8.0),
        ([f"-8*max({X},0)", f"-6*min({X},0)"], 6.0, 8.0),
        ([f"-5*abs({X})"], -5.0, 5.0),
        ([f"-2*max({X},0)", f"-3*min({X},0)"], 3.0, 2.0),
    ],
)
def test_a_rod_on_its_end_is_stable_if_the_torque_of_each_side_exceeds_that_of_the_weight(values, left, right):
    found = upright(*values)
    of_weight = 9.81 * 0.5
    assert found.stability == ("stable" if min(left, right) > of_weight else "unstable")
    assert found.stiffness == pytest.approx((min(left, right) - of_weight) / (1 / 3), rel=1e-4)
    assert any("corner" in warning for warning in found.warnings) is (left != right)


def test_drawn_one_sided_springs_are_judged_by_the_least_potential_of_any_direction():
    """The potential of a block in the plane on one-sided springs is a sum of c max(n.x, 0)^2, which angles scan."""
    rng = np.random.default_rng(1)
    seen = set()
    for _ in range(12):
        normals = rng.standard_normal((4, 2))
        stiffness, soft = rng.uniform(0.5, 3.0, 4), rng.uniform(0.0, 1.5)
        m = mbdkit.Mechanism(gravity=(0, 0))
        block = m.body("b", mass=1.0, position=(0, 0))
        m.force("soft", block, value=[f"{soft!r}*b.x", f"{soft!r}*b.y"])
        for k, ((nx, ny), c) in enumerate(zip(normals.tolist(), stiffness.tolist(), strict=True)):
            pushed = f"-{c!r}*max({nx!r}*b.x+{ny!r}*b.y,0)"
            m.force(f"f{k}", block, value=[f"{pushed}*{nx!r}", f"{pushed}*{ny!r}"])
        angles = np.linspace(0, 2 * np.pi, 20001)
        along = np.maximum(normals @ np.array([np.cos(angles), np.sin(angles)]), 0.0)
        least = float(np.min(stiffness @ along**2 - soft))
        if abs(least) < 0.02:
            continue
        found = mbdkit.equilibrium(m).stability
        assert found in (("stable", "corner") if least > 0 else ("unstable",)), least
        seen.add(found)
    assert seen > {"unstable"}
