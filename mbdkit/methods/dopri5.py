"""The method of Dormand and Prince of order 5, with an error estimate of order 4 and dense output of order 4.

A step has seven stages; the last one is the first stage of the next step. Dense output is that of Hairer, Norsett and
Wanner (1993), II.6. The coefficients lie in ``dopri5.json``: those of the tableau, and the weights of the stages in the
error estimate and in the last part of dense output; see `nested_polynomials`.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache

from mbdkit.base.bibliography import entry
from mbdkit.methods.kinds import ExplicitRungeKutta, integrator_method
from mbdkit.methods.method_options import ControlledOptions, embedded_claims
from mbdkit.methods.tableau import ButcherTableau, EmbeddedPair, coefficients, nested_polynomials

REFERENCE = entry(__file__, "dormand1980")


@cache
def tableau() -> ButcherTableau:
    """Return the tableau of the method of order 5."""
    known = coefficients(__file__)
    return ButcherTableau("dopri5", known["a"], known["b"], known["c"], order=5, reference=REFERENCE)


@cache
def pair() -> EmbeddedPair:
    """Return the error estimate and the dense output of the method of order 5."""
    import numpy as np

    a, b, c = tableau().floats()
    first, last = np.eye(7)[0], np.eye(7)[6]
    error, dense = (np.array([float(Fraction(x)) for x in coefficients(__file__)[name]]) for name in ("error", "dense"))
    parts = [b, first - b, 2 * b - first - last, dense]
    return EmbeddedPair(error[None], 5, a, c, nested_polynomials(parts))


@integrator_method
def create(options: ControlledOptions) -> ExplicitRungeKutta:
    """Return the method."""
    return ExplicitRungeKutta(tableau(), pair(), options.tolerances())


claims = embedded_claims(order=5, stages=7, dense_order=4)
REFERENCES = (REFERENCE,)
