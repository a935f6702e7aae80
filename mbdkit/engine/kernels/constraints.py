"""Constraints of a mechanism: codes of their kinds, sines and cosines, and the generated loops over all pairs.

Constraints are kept in pairs of rows: a kind with one row leaves the second row of its pair empty, and the solvers put
a unit diagonal there. Every block of the Schur complement is therefore 2 x 2, whatever the mechanism.
"""

from __future__ import annotations

from math import cos, sin

from mbdkit.engine.jit.decorators import subkernel
from mbdkit.engine.kernels.element_kernels import (
    CONSTRAINT_KINDS,
    constraint_accelerations,
    constraint_positions,
    constraint_tangents,
)

__all__ = ["KINDS", "constraint_accelerations", "constraint_positions", "constraint_tangents", "turn_bodies"]

KINDS = {name: code for code, name in enumerate(CONSTRAINT_KINDS)}
"""Code of each kind of constraint, as ``Topology.pairs`` holds it in its first column."""


@subkernel
def turn_bodies(q, cs):
    """Write cosine and sine of every body's tilt into `cs` (B + 1, 2); ground comes last and keeps (1, 0)."""
    for b in range(len(cs) - 1):
        theta = q[3 * b + 2]
        cs[b, 0] = cos(theta)
        cs[b, 1] = sin(theta)
