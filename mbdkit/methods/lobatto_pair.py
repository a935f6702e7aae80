"""Lobatto IIIA-IIIB pairs: symplectic, symmetric, order 2 s - 2.

Positions and velocities satisfy the constraints at the end of every step. The pair with two stages is RATTLE (Andersen
1983), or velocity Verlet without constraints. Jay (1996) proved the orders on constrained Hamiltonian systems.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Literal

from mbdkit.methods.common_claims import JAY, lobatto_pair_claims
from mbdkit.methods.kinds import LobattoPair
from mbdkit.methods.rattle import RattleOptions
from mbdkit.registry.items import IntegratorPlugin

Row = tuple[Fraction, ...]

_IIIA: dict[int, tuple[tuple[str, ...], ...]] = {
    2: (("0", "0"), ("1/2", "1/2")),
    3: (("0", "0", "0"), ("5/24", "1/3", "-1/24"), ("1/6", "2/3", "1/6")),
}


def coefficients(stages: int) -> tuple[tuple[Row, ...], tuple[Row, ...], Row, Row]:
    """Return a of IIIA, a' of IIIB, b and c of the pair with 2 or 3 `stages`, exact.

    IIIB follows from IIIA by the condition under which a pair is symplectic, ``b_i a'_ij + b_j a_ji = b_i b_j``.
    """
    a = tuple(tuple(Fraction(x) for x in row) for row in _IIIA[stages])
    b = a[-1]
    s = range(stages)
    partner = tuple(tuple(b[j] * (1 - a[j][i] / b[i]) for j in s) for i in s)
    return a, partner, b, tuple(sum(row, Fraction(0)) for row in a)


class PairOptions(RattleOptions):
    """A pair of Lobatto IIIA and IIIB."""

    stages: Literal[2, 3] = 3
    """Number of stages s; the order is 2 s - 2. Two stages make RATTLE."""


FAMILY = "partitioned"
INTEGRATORS = (
    IntegratorPlugin(
        name="lobatto-pair",
        summary="Lobatto IIIA-IIIB: 2 or 3 stages, order 2 s - 2, symmetric, symplectic, holds joints, fixed steps.",
        options=PairOptions,
        create=lambda options: LobattoPair(options.stages, options.tolerance, options.max_iterations),
        claims=lambda options: lobatto_pair_claims(options.stages),
        references=(JAY,),
    ),
)
