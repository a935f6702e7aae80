"""The method of Dormand and Prince of order 8 with error estimates of orders 5 and 3 and dense output of order 7.

A step has twelve stages; dense output evaluates four more. The coefficients are those published with the code DOP853 of
Hairer, Norsett and Wanner (1993), II.5 and II.6, to 30 digits. They lie in ``dop853.json``:

nodes
    c of the 16 stages.
stages
    Rows of a; the 13th row has the weights b of the step.
order_3
    Weights of the formula of order 3; its difference from b is the second error estimate.
error_5
    Weights of the first error estimate.
dense
    Weights of the stages in the last four parts of dense output; see `nested_polynomials`.
"""

from __future__ import annotations

from functools import cache

from mbdkit.methods.kinds import ExplicitRungeKutta, integrator_method
from mbdkit.methods.method_options import HAIRER_NORSETT_WANNER, ControlledOptions, embedded_claims
from mbdkit.methods.tableau import ButcherTableau, EmbeddedPair, coefficients, nested_polynomials

STAGES = 12


@cache
def tableau() -> ButcherTableau:
    """Return the tableau of the method of order 8."""
    rows, nodes = (coefficients(__file__)[name] for name in ("stages", "nodes"))
    return ButcherTableau(
        "dop853", rows[:STAGES], rows[STAGES], nodes[:STAGES], order=8, reference=HAIRER_NORSETT_WANNER
    )


@cache
def pair() -> EmbeddedPair:
    """Return the error estimates and the dense output of the method of order 8."""
    import numpy as np

    known = coefficients(__file__)
    unit = np.eye(len(known["nodes"]))
    a, (fine, rough), dense = (
        np.array([[*row, *[0.0] * (len(unit) - len(row))] for row in rows])
        for rows in (known["stages"], (known["error_5"], known["order_3"]), known["dense"])
    )
    b, first, last = a[STAGES], unit[0], unit[STAGES]
    parts = [b, first - b, 2 * b - first - last, *dense]
    error = np.array([fine[:STAGES], (b - rough)[:STAGES]])
    return EmbeddedPair(error, 8, a, np.array(known["nodes"]), nested_polynomials(parts))


@integrator_method
def create(options: ControlledOptions) -> ExplicitRungeKutta:
    """Return the method."""
    return ExplicitRungeKutta(tableau(), pair(), options.tolerances())


claims = embedded_claims(order=8, stages=12, dense_order=7)
REFERENCES = (HAIRER_NORSETT_WANNER,)
