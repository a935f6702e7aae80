"""The model `hinged-beam`: a clamped elastic beam as a chain of rigid links with springs in its hinges."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from mbdkit.base.bibliography import entry
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import model_builder

REFERENCES = (entry(__file__, "hairer1996solving"),)


class HingedBeamOptions(StrictModel):
    """Parameters of `hinged-beam`. The beam has unit length, mass and bending stiffness, and no weight."""

    n: Annotated[int, Field(ge=2, le=1000)] = 40
    """Number of links."""
    force: tuple[str, str] = ("-1.5*sin(min(t, pi))**2", "1.5*sin(min(t, pi))**2")
    """Force on the free end (x, y) [N], as expressions of t."""


@model_builder
def build(options: HingedBeamOptions) -> Mechanism:
    """Return a chain of n links on the x axis, with hinges `J1` (the clamp) to `Jn`.

    The equations of the source are those of the angles of links without mass between point masses of h = 1/n, and h/2
    at the free end, with springs of stiffness n between links and 2 n at the clamp. Here, each link carries half of the
    mass at each of its ends, so that it has the mass h and the moment of inertia h^3/4; the mass at the clamp does not
    move.
    """
    h = 1.0 / options.n
    mechanism = Mechanism((0.0, 0.0), name="hinged-beam")
    before = mechanism.ground
    for k in range(1, options.n + 1):
        link = mechanism.body(f"link{k}", mass=h, inertia=h**3 / 4, position=((k - 0.5) * h, 0.0))
        start = (0.0, 0.0) if k == 1 else (0.5 * h, 0.0)
        mechanism.revolute(f"J{k}", before, link, points=(start, (-0.5 * h, 0.0)))
        mechanism.torsion_spring(f"spring{k}", before, link, stiffness=options.n * (2.0 if k == 1 else 1.0))
        before = link
    mechanism.force("load", before, point=(0.5 * h, 0.0), value=options.force)
    return mechanism
