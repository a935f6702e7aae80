"""Claims and references that several methods share."""

from __future__ import annotations

from collections.abc import Callable

from mbdkit.methods.method_options import ControlledOptions, ExplicitOptions
from mbdkit.registry.items import Claims

ORDER_DRIFT = "constraints hold at acceleration level only: drift of the method's order, growing with time"
"""Drift of methods in fixed steps on the index-1 equations."""

TOLERANCE_DRIFT = "constraints hold at acceleration level only: drift follows the tolerance and grows with time"
"""Drift of methods in adaptive steps on the index-1 equations."""

HAIRER_NORSETT_WANNER = """@book{hairer1993,
  author = {Hairer, Ernst and N{\\o}rsett, Syvert P. and Wanner, Gerhard},
  title = {Solving Ordinary Differential Equations {I}: Nonstiff Problems},
  edition = {2}, publisher = {Springer}, year = {1993}, doi = {10.1007/978-3-540-78862-1}}"""

HAIRER_WANNER = """@book{hairer1996,
  author = {Hairer, Ernst and Wanner, Gerhard},
  title = {Solving Ordinary Differential Equations {II}: Stiff and Differential-Algebraic Problems},
  edition = {2}, publisher = {Springer}, year = {1996}, doi = {10.1007/978-3-642-05221-7}}"""

JAY = """@article{jay1996,
  author = {Jay, Laurent},
  title = {Symplectic partitioned {R}unge-{K}utta methods for constrained {H}amiltonian systems},
  journal = {SIAM Journal on Numerical Analysis}, volume = {33}, number = {1}, pages = {368--387}, year = {1996},
  doi = {10.1137/0733019}}"""


def explicit_claims(order: int, stages: int) -> Callable[[ExplicitOptions], Claims]:
    """Return the claims of an explicit method in fixed steps."""
    return lambda options: Claims(order=order, stages=stages, drift=ORDER_DRIFT, needs=("accelerations",))


def embedded_claims(order: int, stages: int) -> Callable[[ControlledOptions], Claims]:
    """Return the claims of an explicit method with an error estimate, in fixed or adaptive steps."""

    def claims(options: ControlledOptions) -> Claims:
        return Claims(
            order=None if options.adaptive else order,
            stages=stages,
            adaptive=options.adaptive,
            drift=TOLERANCE_DRIFT if options.adaptive else ORDER_DRIFT,
            needs=("accelerations",),
        )

    return claims


def lobatto_pair_claims(stages: int) -> Claims:
    """Return the claims of a Lobatto IIIA-IIIB pair: Jay (1996) on constrained Hamiltonian systems."""
    return Claims(
        order=2 * stages - 2,
        multiplier_order=stages - 1,
        symmetric=True,
        symplectic=True,
        stages=stages,
        drift="positions and velocities satisfy the joints to round-off at the end of every step",
        constraints_hold=("position", "velocity"),
        needs=("accelerations",),
        formulations=("index-3",),
    )
