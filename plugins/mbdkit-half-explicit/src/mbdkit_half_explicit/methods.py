"""Coefficients, claims and references of the half-explicit methods."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

import mbdkit
from mbdkit.plugin import Method
from mbdkit.plugin.methods import ControlledOptions
from mbdkit.plugin.seams import integrator_claims, integrator_method
from mbdkit_half_explicit.half_explicit import HalfExplicit, HalfExplicitTableau

REFERENCES_OF_HEM4, REFERENCES_OF_HEM5, REFERENCES_OF_PHEM56 = (
    tuple(Path(__file__).with_name(f"{name}.bib").read_text(encoding="utf-8").strip().split("\n\n"))
    for name in ("hem4", "hem5", "phem56")
)
R6 = 6**0.5

# Brasey and Hairer (1993); the weights are those of Radau IIA with three stages.
HEM4_ROWS = (
    (3 / 10,),
    ((1 + R6) / 30, (11 - 4 * R6) / 30),
    ((-79 - 31 * R6) / 150, (-1 - 4 * R6) / 30, (24 + 11 * R6) / 25),
    ((14 + 5 * R6) / 6, (-8 + 7 * R6) / 6, (-9 - 7 * R6) / 4, (9 - R6) / 4),
    (0.0, 0.0, (16 - R6) / 36, (16 + R6) / 36, 1 / 9),
)
# Brasey's code HEM5, version of June 8, 1994, which gives them to sixteen digits.
HEM5_ROWS = (
    (1 / 10,),
    (3 / 80, 9 / 80),
    (0.3222169236216038, -1.188883322987607, 1.228145134023366),
    (-0.03501123898129943, 0.3725420601086163, -0.2721053535582034, 0.01993037578575077),
    (-0.5576547055042005, 1.367307289645883, -1.732236360460725, 0.4587772007467548, 0.963806575572288),
    (
        0.08654517193566155, -0.08810082847945416, 0.1981275547329404, -0.4645422679331083, 0.1615170091109488,
        0.9064533606330119,
    ),
    (0.0, 0.0, 0.0, 3.624477248753816, -0.4617724189181256, -3.198024628164272, 1.03531979832874),
    (
        0.0, 0.0, 0.0, 0.2467760667636791, 0.2106594087489728, 0.1769218149125021, 0.3064446444147922,
        0.05919806516005373,
    ),
)  # fmt: skip
# Murua (1997), as in his code PHEM56 of November 1995: the first six stages of Dormand and Prince's method of order 5.
PHEM56_ROWS = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
)
PHEM56_CONSISTENT = (
    (0.0,),
    (3 / 40, 9 / 40),
    (21 / 256, 45 / 256, 15 / 128),
    (19235 / 98784, -225 / 392, 6235 / 6174, 2755 / 32928),
    (-293 / 1152, 85 / 48, -2275 / 1908, 35 / 32, -2835 / 6784),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)


def triangle(*rows: tuple[float, ...]) -> np.ndarray:
    """Return a square matrix with these rows, filled up with zeros."""
    return np.array([(*row, *(0.0,) * (len(rows) - len(row))) for row in rows])


HEM4 = HalfExplicitTableau(4, triangle((), *HEM4_ROWS[:-1]), triangle(*HEM4_ROWS))
HEM5 = HalfExplicitTableau(5, triangle((), *HEM5_ROWS[:-1]), triangle(*HEM5_ROWS))
PHEM56 = HalfExplicitTableau(5, triangle((), *PHEM56_ROWS), triangle(*PHEM56_CONSISTENT))


def _create(tableau: HalfExplicitTableau) -> Callable[[ControlledOptions], Method]:
    @integrator_method
    def create(options: ControlledOptions) -> HalfExplicit:
        return HalfExplicit(tableau, options.tolerances())

    return create


def _claims(tableau: HalfExplicitTableau) -> Callable[[ControlledOptions], mbdkit.Claims]:
    @integrator_claims
    def claims(options: ControlledOptions) -> mbdkit.Claims:
        text = "the tolerance" if options.adaptive else f"order {tableau.order}"
        return mbdkit.Claims(
            order=None if options.adaptive else tableau.order,
            multiplier_order=None if options.adaptive else tableau.order,
            adaptive=options.adaptive,
            stages=len(tableau.a),
            drift=f"velocities satisfy the constraints to rounding; positions drift by an error of {text}",
            constraints_hold=("velocity",),
            needs=("accelerations",),
            formulations=("index-2",),
            stabilizations=("none", "projection"),
            conserves=("linear-momentum",),
            states=True,
            dense_order=3,  # of first-order states; with order 5, that of motions is 4
        )

    return claims


create_hem4, create_hem5, create_phem56 = map(_create, (HEM4, HEM5, PHEM56))
claims_of_hem4, claims_of_hem5, claims_of_phem56 = map(_claims, (HEM4, HEM5, PHEM56))
