"""What follows from the coefficients of a Runge-Kutta method alone, to 60 digits."""

from __future__ import annotations

import mpmath
import numpy as np

from mbdkit.methods.tableau import ButcherTableau, TableauError
from mbdkit.testing.check import check
from mbdkit.testing.integrator_under_test import IntegratorSubject
from mbdkit.testing.outcome import Finding, failed, passed, warned


@check("tableau.row-sums")
def row_sums(subject: IntegratorSubject) -> Finding:
    """Each row of its matrix sums to its node."""
    a, _, c = subject.tableau.floats()
    defect = float(np.max(np.abs(a.sum(axis=1) - c)))
    if defect > 1e-12:
        return failed("a row does not sum to its node", defect=defect)
    return passed(defect=defect)


@check("tableau.trees")
def trees(subject: IntegratorSubject) -> Finding:
    """It meets the order condition of every rooted tree up to the order that it claims, and of no order beyond."""
    tableau, order = subject.tableau, int(subject.order)
    try:
        tableau.check_trees(order)
    except TableauError as error:
        return failed(str(error))
    try:
        tableau.check_trees(order + 1)
    except TableauError:
        return passed(order=order)
    return warned(f"it claims order {order}, but meets the conditions of order {order + 1}", order=order + 1)


@check("tableau.symmetry")
def symmetry(subject: IntegratorSubject) -> Finding:
    """It is its own adjoint where it claims to be symmetric: a step back undoes a step."""
    return _held("symmetric", subject.claims.symmetric, subject.tableau.is_symmetric)


@check("tableau.symplecticity")
def symplecticity(subject: IntegratorSubject) -> Finding:
    """It meets the condition for conserving quadratic invariants where it claims to, or to be symplectic."""
    claimed = subject.claims.symplectic or subject.claims.quadratic_invariants
    return _held("symplectic", claimed, subject.tableau.is_symplectic)


def _held(word: str, claimed: bool, true: bool) -> Finding:
    if claimed and not true:
        return failed(f"it claims to be {word}, which its coefficients are not")
    if true and not claimed:
        return warned(f"its coefficients are {word}, which it does not claim")
    return passed(**{word: "yes" if true else "no"})


@check("tableau.stages")
def stages(subject: IntegratorSubject) -> Finding:
    """It has as many stages as it claims."""
    tableau = subject.tableau
    if subject.claims.stages is None:
        return warned(f"it claims no number of stages, and has {tableau.stages}", stages=tableau.stages)
    if subject.claims.stages != tableau.stages:
        return failed(f"it claims {subject.claims.stages} stages, and has {tableau.stages}")
    return passed(stages=tableau.stages)


@check("tableau.stability")
def stability(subject: IntegratorSubject) -> Finding:
    """Its stability function at infinity, and its largest modulus on the imaginary axis; measured, never judged."""
    tableau = subject.tableau
    axis = max(abs(stability_function(tableau, 1j * 10.0**x)) for x in np.linspace(-2, 3, 101))
    return passed(at_infinity=at_infinity(tableau), on_imaginary_axis=float(axis))


def stability_function(tableau: ButcherTableau, z: complex) -> complex:
    """Return ``R(z) = det(I - z A + z 1 b^T) / det(I - z A)``."""
    a, b, _ = tableau.floats()
    s = tableau.stages
    one = np.eye(s)
    top = np.linalg.det(one - z * a + z * np.outer(np.ones(s), b))
    return complex(top / np.linalg.det(one - z * a))


def at_infinity(tableau: ButcherTableau) -> float:
    """Return the modulus of the stability function far out on the negative axis; infinity if it grows."""
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
