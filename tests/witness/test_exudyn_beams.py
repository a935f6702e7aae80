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


def spaghetti(elements: int, bending: float) -> list[np.ndarray]:
    """Return where both ends of the flying spaghetti are after 2.5 and 5 s in Exudyn, (2, 2) each."""
    beam = straight_beam(((6.0, 0.0), (0.0, 8.0)), elements, (1e4, 1e4, bending), (1.0, 10.0))
    loads = beam.push(0, (8.0, 0.0), -80.0)
    beam.system.Assemble()
    ends = []
    for start in (0.0, 2.5):
        beam.run(start, start + 2.5, 1000)
        ends.append(np.array([beam.place(0), beam.place(-1)]))
        for load in loads:
            beam.system.SetLoadParameter(load, "loadVector", [0.0, 0.0, 0.0])
    return ends


@pytest.mark.parametrize("bending", [500.0, 100.0])
def test_the_flying_spaghetti_moves_as_in_exudyn(bending: float) -> None:
    # expected: Exudyn; the sudden load makes waves that no mesh resolves, so that errors of both decrease slowly
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    stiffness = {"axial": 1e4, "shear": 1e4, "bending": bending}
    m.beam(
        "rod", a=(6, 0), b=(0, 8), elements=32, nodes=3, stiffness=stiffness, mass_per_length=1.0, rotary_inertia=10.0
    )
    until = {"interpolation": "linear"}
    m.force("push", "rod.0", value=({"table": [[0, 2.5, 2.5 + 1e-9, 100], [8, 8, 0, 0]], **until}, 0.0))
    m.torque("twist", "rod.0", value={"table": [[0, 2.5, 2.5 + 1e-9, 100], [-80, -80, 0, 0]], **until})
    run = mbdkit.run(m, integrator={"name": "gauss", "stages": 2}, time={"end": 5.0, "step": 0.005})
    run.check()
    ours = [[run[node].position[i] for node in ("rod.0", "rod.64")] for i in (500, 1000)]
    np.testing.assert_allclose(ours, spaghetti(64, bending), rtol=0, atol=3e-3)
