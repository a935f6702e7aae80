"""Constraints of a mechanism: codes of their kinds, cosines and sines, and the generated loops over pairs of rows.

Constraints are stored in pairs of rows. A constraint with one row leaves the second row of its pair zero, and the Schur
solver puts a unit diagonal there. All blocks of the Schur complement are therefore 2 x 2 for any mechanism, and the
solver needs no code for other block sizes.
"""

from __future__ import annotations

from mbdkit.engine.kernels.angles import cosines_and_sines
from mbdkit.engine.kernels.element_kernels import (
    CONSTRAINT_KINDS,
    constraint_accelerations,
    constraint_positions,
    constraint_tangents,
)
from mbdkit.engine.native.functions import subkernel

__all__ = ["KINDS", "constraint_accelerations", "constraint_positions", "constraint_tangents", "turn_bodies"]

#: Code of each kind of constraint; it is stored in the first column of ``Topology.pairs``.
KINDS = {name: code for code, name in enumerate(CONSTRAINT_KINDS)}


@subkernel
def turn_bodies(q, cs):
    """Write cosine and sine of every body's angle into `cs` (B + 1, 2); ground comes last and keeps (1, 0).

    They are computed once per position, because every element on a body needs them.
    """
    cosines_and_sines(q, cs)
