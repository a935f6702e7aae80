"""The car axis of the Test Set for IVP Solvers: a mechanism on ground that moves by drivers, against refined digits.

Mazzia and Magherini, Test Set for Initial Value Problem Solvers, release 2.4, Bari 2008, problem "Car axis"; a
problem of S. Schneider, Integration de systemes d'equations differentielles raides et differentielles-algebriques par
des methodes de collocations et methodes generales lineaires, Geneva 1994. The ends of an axis of length L = 1, each of
mass k = M eps^2/2, stand on a left wheel at (0, 0) and a right one at (xb, yb) by springs of stiffness 1 and free
length 1/2; yb = r sin(w t), xb = sqrt(L^2 - yb^2), and

    k pl'' = f_l + lam1 (xb, yb) + 2 lam2 (pl - pr)        g1 = (xb, yb) . pl = 0
    k pr'' = f_r                 - 2 lam2 (pl - pr)        g2 = |pl - pr|^2 - L^2 = 0.

Here the line of the wheels is a body, `road`, pinned at the origin and turned by a driver to asin(yb / L); its x axis
points along (xb, yb) / L. The driver `upright` holds pl on its y axis, which is g1 / L = 0, and the distance joint
`axis` from left to right is g2. A reaction is the force F on the second body of a joint, so that

    upright (road, left):   F = lam1 (xb, yb)       and     lam1 = F . (xb, yb) / L^2
    axis (left, right):     F = 2 lam2 (pr - pl)    and     lam2 = F . (pr - pl) / (2 L^2).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbdkit
from tests.witness.car_axis import L, R, W, car_axis, in_two_coordinates

from .running import gauss, run

#: xl, yl, xr, yr, their rates, lam1 and lam2 at t = 3, refined by an index-1 solution with 34 digits and order 24: two
#: step sizes agree to 1e-29, and a second formulation, in two coordinates, to 3e-26.
END = np.array(
    [
        0.04934557842752409213,
        0.49698946023000810671,
        1.04174252488542611519,
        0.37391102726536581936,
        -0.07705836840359208428,
        0.00744686659206841649,
        0.01755681575354173663,
        0.77034104377960106312,
        -0.00473688659085332652,
        -0.00110468033125956584,
    ]
)
#: The same as the test set prints them. They hold to 5e-12 only.
PUBLISHED = np.array(
    [
        0.0493455784275402809122,
        0.496989460230171153861,
        1.04174252488542151681,
        0.373911027265361256927,
        -0.0770583684040972357970,
        0.00744686658723778553466,
        0.0175568157537232222276,
        0.770341043779251976443,
        -0.00473688659084893324729,
        -0.00110468033125734368808,
    ]
)


def states(result: mbdkit.Run) -> Any:
    """Return positions and rates in the order of the test set, and both multipliers in its scaling, shape (T, 10)."""
    left, right = result["left"], result["right"]
    yb = R * np.sin(W * np.asarray(result.time))
    line = np.column_stack([np.sqrt(L**2 - yb**2), yb])
    lam1 = np.sum(result.joints["upright"].reaction_force * line, axis=1) / L**2
    span = np.asarray(right.position) - left.position
    lam2 = np.sum(result.joints["axis"].reaction_force * span, axis=1) / (2 * L**2)
    return np.column_stack([left.position, right.position, left.velocity, right.velocity, lam1, lam2])


def test_yardstick_refined_digits_agree_with_dop853_in_two_coordinates_and_the_published_ones_to_5e_12() -> None:
    # expected: both, as above
    np.testing.assert_allclose(in_two_coordinates(np.array([0.0, 3.0]))[-1], END, rtol=0, atol=1e-11)
    np.testing.assert_allclose(PUBLISHED, END, rtol=0, atol=7e-12)  # margin: constants on both sides


METHODS: dict[str, tuple[dict[str, Any], float]] = {
    "gauss4": (gauss(4), 0.005),
    "gauss5": (gauss(5), 0.01),
    "gauss6": (gauss(6), 0.02),
    "gauss6-fixed-point": (gauss(6) | {"stage_solver": "fixed-point"}, 0.01),
    "radau-iia5": ({"name": "radau-iia", "stages": 5}, 0.005),
    "rk4": ({"name": "rk4"}, 0.00005),
    "scipy-dop853": ({"name": "scipy-dop853", "rtol": 1e-13, "atol": 1e-15}, 0.001),
}


@pytest.mark.parametrize("name", METHODS)
def test_car_axis_ends_at_the_refined_digits_and_so_do_its_multipliers(name: str) -> None:
    # expected: the refined digits
    integrator, step = METHODS[name]
    result = run(car_axis(), integrator, end=3.0, step=step, every=10**6)
    end = states(result)[-1]
    np.testing.assert_allclose(end[:8], END[:8], rtol=0, atol=1e-10)
    np.testing.assert_allclose(end[8:], END[8:], rtol=0, atol=1e-12)


def test_multipliers_of_the_car_axis_are_those_of_the_rows_scaled() -> None:
    # expected: lam grad g = -lambda grad Phi, from k p'' = f + lam grad g and M a = Q - lambda grad Phi; g1 = L x and
    # g2 = d^2 - L^2 for the rows x = 0 and d - L = 0; lambda comes from the linear system, a reaction from the bodies
    result = run(car_axis(), gauss(6), end=3.0, step=0.01)
    lam1, lam2 = states(result)[:, 8:].T
    rows = result.constraints
    np.testing.assert_allclose(-np.asarray(rows["upright.x"].multiplier) / L, lam1, rtol=0, atol=1e-14)
    np.testing.assert_allclose(-np.asarray(rows["axis.length"].multiplier) / (2 * L), lam2, rtol=0, atol=1e-14)
