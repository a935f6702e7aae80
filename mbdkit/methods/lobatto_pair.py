"""Lobatto IIIA-IIIB pairs: symplectic, symmetric, order 2 s - 2.

Positions and velocities satisfy the constraints at the end of every step. The pair with two stages is RATTLE (Andersen
1983), or velocity Verlet without constraints. Jay (1996) proved the orders on constrained Hamiltonian systems.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from mbdkit.base.bibliography import entry
from mbdkit.methods.kinds import LobattoPair, integrator_method
from mbdkit.methods.method_options import Options
from mbdkit.registry.items import Claims, integrator_claims

JAY = entry(__file__, "jay1996")
ANDERSEN = entry(__file__, "andersen1983")

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


class RattleOptions(Options):
    """Options of the iteration that solves for positions on the constraints."""

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("max_iterations",)

    tolerance: Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] | None = None
    """Stop when the expected relative change of positions is below this value; by default, stop when it no longer
    decreases."""
    max_iterations: Annotated[int, Field(ge=2, le=10_000)] | None = None
    """Largest number of iterations in one step, after which the step fails. By default 50; with fixed steps, the
    iteration may go on up to 500 while it converges steadily."""


class PairOptions(RattleOptions):
    """A pair of Lobatto IIIA and IIIB."""

    stages: Literal[2, 3] = 3
    """Number of stages s; the order is 2 s - 2. With two stages, the method is RATTLE."""


def _claims(stages: int) -> Claims:
    """Return the claims of a pair, with the orders that Jay (1996) proved for constrained Hamiltonian systems."""
    return Claims(
        order=2 * stages - 2,
        multiplier_order=stages - 1,
        symmetric=True,
        symplectic=True,
        stages=stages,
        drift="at the end of every step, positions and velocities satisfy the constraints up to rounding errors",
        constraints_hold=("position", "velocity"),
        needs=("accelerations",),
        formulations=("index-3",),
        conserves=("linear-momentum", "angular-momentum"),
    )


@integrator_method
def create(options: PairOptions) -> LobattoPair:
    """Return the method."""
    return LobattoPair(options.stages, options.tolerance, options.max_iterations)


@integrator_claims
def claims(options: PairOptions) -> Claims:
    """Return the claims of the method."""
    return _claims(options.stages)


@integrator_method
def create_rattle(options: RattleOptions) -> LobattoPair:
    """Return RATTLE."""
    return LobattoPair(2, options.tolerance, options.max_iterations)


@integrator_claims
def claims_of_rattle(options: RattleOptions) -> Claims:
    """Return the claims of RATTLE."""
    return _claims(2)


REFERENCES = (JAY,)
REFERENCES_OF_RATTLE = (ANDERSEN, JAY)
