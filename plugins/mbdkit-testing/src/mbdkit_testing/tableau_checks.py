"""Checks of the coefficients of a Runge-Kutta method: order conditions, symmetry, symplecticity and stability."""

from __future__ import annotations

import mpmath
import numpy as np

from mbdkit.methods.tableau import ButcherTableau, TableauError
from mbdkit_testing.check import check
from mbdkit_testing.check_result import Result, at_most, failed, passed, unclaimed, warned
from mbdkit_testing.integrator_under_test import IntegratorUnderTest


@check("tableau.row-sums")
def row_sums(integrator: IntegratorUnderTest) -> Result:
    """Each row of the method's matrix sums to the node of this row."""
    a, _, c = integrator.tableau.floats()
    return at_most(1e-12, "a row does not sum to its node", defect=float(np.max(np.abs(a.sum(axis=1) - c))))


@check("tableau.trees")
def trees(integrator: IntegratorUnderTest) -> Result:
    """The method satisfies the order conditions of all rooted trees up to the claimed order, but not those of the next
    order.
    """
    tableau, order = integrator.tableau, int(integrator.order)
    try:
        tableau.check_trees(order)
    except TableauError as error:
        return failed(str(error))
    try:
        tableau.check_trees(order + 1)
    except TableauError:
        return passed(order=order)
    return warned(f"it claims order {order}, but satisfies the conditions of order {order + 1}", order=order + 1)


@check("tableau.symmetry")
def symmetry(integrator: IntegratorUnderTest) -> Result:
    """The method is symmetric (its own adjoint) if and only if it claims to be; adaptive methods need not claim it."""
    claims = integrator.claims
    # steps whose sizes depend on earlier ones are not symmetric, whatever the coefficients are
    is_symmetric = integrator.tableau.is_symmetric and (claims.symmetric or not claims.adaptive)
    return _held("symmetric", claims.symmetric, is_symmetric)


@check("tableau.symplecticity")
def symplecticity(integrator: IntegratorUnderTest) -> Result:
    """The symplecticity condition holds if the method claims to be symplectic or to conserve quadratic invariants."""
    claimed = integrator.claims.symplectic or integrator.claims.quadratic_invariants
    return _held("symplectic", claimed, integrator.tableau.is_symplectic)


def _held(word: str, claimed: bool, true: bool) -> Result:
    if claimed and not true:
        return failed(f"it claims to be {word}, but its coefficients are not")
    if true and not claimed:
        return warned(f"its coefficients are {word}, but it does not claim it")
    return passed(**{word: "yes"}) if claimed else unclaimed(**{word: "no"})


@check("tableau.stages")
def stages(integrator: IntegratorUnderTest) -> Result:
    """The method has the claimed number of stages."""
    tableau = integrator.tableau
    if integrator.claims.stages is None:
        return warned(f"it claims no number of stages; it has {tableau.stages}", stages=tableau.stages)
    if integrator.claims.stages != tableau.stages:
        return failed(f"it claims {integrator.claims.stages} stages, but has {tableau.stages}")
    return passed(stages=tableau.stages)


@check("tableau.stability")
def stability(integrator: IntegratorUnderTest) -> Result:
    """The modulus of the stability function of an A-stable method is at most 1 on the imaginary axis, and the function
    has no pole to the left of it; that of an L-stable method vanishes at infinity.
    """
    tableau, claims = integrator.tableau, integrator.claims
    axis = max(abs(stability_function(tableau, 1j * 10.0**x)) for x in np.linspace(-2, 3, 101))
    left = float(np.min(np.linalg.eigvals(tableau.floats()[0]).real))  # the poles are the inverse eigenvalues
    figures = {"at_infinity": at_infinity(tableau), "on_imaginary_axis": float(axis)}
    if claims.a_stable and (axis > 1 + ROUNDING or left < -ROUNDING):
        return failed(
            "it claims to be A-stable, but its stability function exceeds 1 in the left half-plane", **figures
        )
    if claims.l_stable and figures["at_infinity"] > ROUNDING:
        return failed("it claims to be L-stable, but its stability function does not vanish at infinity", **figures)
    return passed(**figures)


ROUNDING = 1e-9  #: Excess of the stability function, and real part of eigenvalues, that counts as rounding.


def stability_function(tableau: ButcherTableau, z: complex) -> complex:
    """Return ``R(z) = det(I - z A + z 1 b^T) / det(I - z A)``."""
    a, b, _ = tableau.floats()
    s = tableau.stages
    one = np.eye(s)
    return complex(np.linalg.det(one - z * a + z * np.outer(np.ones(s), b)) / np.linalg.det(one - z * a))


def at_infinity(tableau: ButcherTableau) -> float:
    """Return the modulus of the stability function at minus infinity; inf if it is unbounded there."""
    with mpmath.workdps(60):
        a, b, _ = (mpmath.matrix(x.tolist()) for x in tableau.floats())
        s = tableau.stages
        values = []
        for z in (-(mpmath.mpf(10) ** 9), -(mpmath.mpf(10) ** 10)):
            low = mpmath.eye(s) - z * a
            values.append(abs(mpmath.det(low + z * mpmath.ones(s, 1) * b.T) / mpmath.det(low)))
        grows, falls = values[1] > 5 * values[0], values[1] < values[0] / 5
        return float("inf") if grows else 0.0 if falls else float(round(values[1], 6))


CHECKS = (row_sums, trees, symmetry, symplecticity, stages, stability)
