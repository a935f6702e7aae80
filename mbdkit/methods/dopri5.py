"""The method of Dormand and Prince of order 5, with an error estimate of order 4 and dense output of order 4.

A step has seven stages; the last one is the first stage of the next step. Dense output is that of Hairer, Norsett and
Wanner (1993), II.6.
"""

from __future__ import annotations

from functools import cache

from mbdkit.base.bibliography import entry
from mbdkit.methods.kinds import ExplicitRungeKutta, integrator_method
from mbdkit.methods.method_options import ControlledOptions, embedded_claims
from mbdkit.methods.tableau import ButcherTableau, EmbeddedPair, nested_polynomials

REFERENCE = entry(__file__, "dormand1980")

_B = ["35/384", 0, "500/1113", "125/192", "-2187/6784", "11/84", 0]
_ERROR = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
_D = (
    -12715105075 / 11282082432,
    0.0,
    87487479700 / 32700410799,
    -10690763975 / 1880347072,
    701980252875 / 199316789632,
    -1453857185 / 822651844,
    69997945 / 29380423,
)


@cache
def tableau() -> ButcherTableau:
    """Return the tableau of the method of order 5."""
    return ButcherTableau(
        "dopri5",
        a=[
            [],
            ["1/5"],
            ["3/40", "9/40"],
            ["44/45", "-56/15", "32/9"],
            ["19372/6561", "-25360/2187", "64448/6561", "-212/729"],
            ["9017/3168", "-355/33", "46732/5247", "49/176", "-5103/18656"],
            _B[:6],
        ],
        b=_B,
        c=[0, "1/5", "3/10", "4/5", "8/9", 1, 1],
        order=5,
        reference=REFERENCE,
    )


@cache
def pair() -> EmbeddedPair:
    """Return the error estimate and the dense output of the method of order 5."""
    import numpy as np

    a, b, c = tableau().floats()
    first, last = np.eye(7)[0], np.eye(7)[6]
    parts = [b, first - b, 2 * b - first - last, np.array(_D)]
    return EmbeddedPair(np.array([_ERROR]), 5, a, c, nested_polynomials(parts))


@integrator_method
def create(options: ControlledOptions) -> ExplicitRungeKutta:
    """Return the method."""
    return ExplicitRungeKutta(tableau(), pair(), options.tolerances())


claims = embedded_claims(order=5, stages=7, dense_order=4)
REFERENCES = (REFERENCE,)
