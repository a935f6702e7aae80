"""Beams beside Exudyn's `ObjectBeamGeometricallyExact2D`: at rest on the same mesh, and in motion."""

from __future__ import annotations

import numpy as np
import pytest

import mbdkit

from .extrapolation import limit

pytest.importorskip("exudyn", reason="Exudyn, the outside witness of these tests, is not installed")

from .exudyn_beams import straight_beam
from .swinging_rod import exudyn_rod, rod


@pytest.mark.parametrize("elements", [4, 16])
def test_a_cantilever_is_bent_as_in_exudyn_on_the_same_mesh(elements: int) -> None:
    # expected: Exudyn's static solver; both elements are Simo and Vu-Quoc's, with one-point integration
    stiffness, force = (2e4, 1e4, 100.0), 200.0
    theirs = straight_beam(((0.0, 0.0), (2.0, 0.0)), elements, stiffness)
    theirs.hold(0, 1, 2)
    theirs.push(-1, (-50.0, -force), 30.0)
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    given = dict(zip(("axial", "shear", "bending"), stiffness, strict=True))
    m.beam("link", a=(0, 0), b=(2, 0), elements=elements, stiffness=given, mass_per_length=1.0)
    m.weld("clamp", m.ground, "link.0", at=(0, 0))
    m.force("force", f"link.{elements}", value=(-50.0, -force))
    m.torque("moment", f"link.{elements}", value=30.0)
    found = mbdkit.equilibrium(m)
    np.testing.assert_allclose(found.position[-1, :2], theirs.rest(), rtol=0, atol=1e-8)


def swung(elements: int, steps: int) -> np.ndarray:
    """Return where the tip of the rod is after one second in Exudyn."""
    beam = exudyn_rod(elements)
    beam.run(0.0, 1.0, steps)
    return beam.place(-1)


def test_a_swinging_rod_moves_as_in_exudyn() -> None:
    # expected: Exudyn, which distributes the masses otherwise, without most of the errors of its meshes and steps
    found = []
    for elements in (8, 16):
        run = mbdkit.run(rod(elements, 3), integrator={"name": "gauss", "stages": 3}, time={"end": 1.0, "step": 1e-3})
        run.check()
        found.append(run[f"rod.{2 * elements}"].position[-1])
    theirs = limit([limit([swung(n, steps) for steps in (1000, 2000)], 2) for n in (8, 16, 32)], 2)
    np.testing.assert_allclose(limit(found, 4), theirs, rtol=0, atol=5e-6)
