"""What fully implicit methods share whatever the formulation: coefficients, linear systems, and the ends of a step."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.engine.elimination_order import empty_pattern, new_factors
from mbdkit.engine.jit.decorators import subkernel
from mbdkit.engine.kernels.lu import Factors, Pattern
from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.kernels.system import OK, prepare, solve_accelerations
from mbdkit.stepping.compiled_method import Family
from mbdkit.stepping.dense_output import collocation_polynomials, weights_at
from mbdkit.stepping.run_state import FACTORIZATIONS, RHS, Common
from mbdkit.stepping.stages import extrapolation_weights

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.methods.kinds import ImplicitRungeKutta
    from mbdkit.methods.tableau import ButcherTableau


class Coefficients(NamedTuple):
    """A fully implicit method of s stages, and the eigenvalues of its matrix: real ones, and one of each pair."""

    a: np.ndarray
    a2: np.ndarray
    """(s, s) A and A A: weights of accelerations in velocities and positions of the stages."""
    b: np.ndarray
    b2: np.ndarray
    """(s,) the same of the step."""
    c: np.ndarray
    dense_v: np.ndarray
    dense_q: np.ndarray
    """(s, s) and (s, s + 1) polynomials of dense output (`collocation_polynomials`); zeros where nodes coincide."""
    t_real: np.ndarray
    t_real_inv: np.ndarray
    mu_real: np.ndarray
    t_complex: np.ndarray
    t_complex_inv: np.ndarray
    mu_complex: np.ndarray


def coefficients_of(tableau: ButcherTableau) -> Coefficients:
    """Return the coefficients of a diagonalisable tableau as the kernels take them."""
    a, b, c = tableau.floats()
    a2, b2 = tableau.second_order_floats()
    s = tableau.stages
    distinct = len(set(c.tolist())) == s
    dense_v, dense_q = collocation_polynomials(c) if distinct else (np.zeros((s, s)), np.zeros((s, s + 1)))
    values, vectors = np.linalg.eig(a)
    inverse = np.linalg.inv(vectors)
    real = np.abs(values.imag) < 1e-12
    upper = ~real & (values.imag > 0)
    return Coefficients(
        a, a2, b, b2, c, dense_v, dense_q,
        np.ascontiguousarray(vectors[:, real].real),
        np.ascontiguousarray(inverse[real].real),
        np.ascontiguousarray(values[real].real),
        np.ascontiguousarray(vectors[:, upper].astype(complex)),
        np.ascontiguousarray(inverse[upper].astype(complex)),
        np.ascontiguousarray(values[upper].astype(complex)),
    )  # fmt: skip


class Systems(NamedTuple):
    """The linear systems of simplified Newton, one for each eigenvalue; they share one pattern."""

    pattern: Pattern
    real: Factors
    cplx: Factors
    """Factors of the matrices, stacked."""
    b_real: np.ndarray
    """(n + m,) right side, and solution."""
    x_real: np.ndarray
    b_complex: np.ndarray
    x_complex: np.ndarray


def new_systems(method: Coefficients, pattern: Pattern, unknowns: int) -> Systems:
    """Return room for the systems of a method, of one pattern."""
    real, cplx = (_stacked(pattern, len(x), x.dtype.type) for x in (method.mu_real, method.mu_complex))
    return Systems(pattern, real, cplx, *np.zeros((2, unknowns)), *np.zeros((2, unknowns), dtype=complex))


def _stacked(pattern: Pattern, count: int, dtype: type) -> Factors:
    """Return storage for the factors of `count` matrices of one pattern."""
    one = new_factors(pattern, dtype)
    return Factors(*(np.zeros((count, len(x)), x.dtype) for x in one))


@subkernel
def leading(rk):
    """Return the size of the eigenvalue whose system filters the estimates of the local error."""
    return rk.mu_real[0] if len(rk.mu_real) > 0 else abs(rk.mu_complex[0])


@subkernel
def first_acceleration(c, t, first, known, lam):
    """Solve for the acceleration at the beginning of a step, unless it is `known`; return a status."""
    if known[0] != 0:
        return OK
    prepare(c.top, c.w, t, c.from_q)
    status = solve_accelerations(c.top, c.w, c.solver, c.from_q, c.from_v, first, lam, False)
    if status == OK:
        c.counts[RHS] += 1
        c.counts[FACTORIZATIONS] += 1
        known[0] = 1
    return status


@subkernel
def gap_at_beginning(h, rk, first, acc, weights, out):
    """Write ``h mu`` times what the acceleration at the beginning differs by from the collocation polynomial there.

    `weights` (s, s) is scratch.
    """
    extrapolation_weights(0.0, 0.0, rk.c, weights)  # every row: the polynomial at the beginning
    rate = h * leading(rk)
    for d in range(len(out) - 3):
        gap = first[d]
        for i in range(len(rk.c)):
            gap -= weights[0, i] * acc[i, d]
        out[d] = rate * gap


@subkernel
def add_up(c, h, in_v, in_q, acc):
    """Write the increments of a step, from stage accelerations and their weights in velocities and positions (s,)."""
    c.dq[:] = 0.0
    c.dv[:] = 0.0
    n3 = len(c.q) - 3
    for i in range(len(in_v)):
        w1, w2 = h * in_v[i], h * h * in_q[i]
        for d in range(n3):
            c.dv[d] += w1 * acc[i, d]
            c.dq[d] += w2 * acc[i, d]
    for d in range(n3):
        c.dq[d] += h * c.from_v[d] + h * c.v_low[d]


@subkernel
def state_inside(c, rk, h, theta, acc, weights):
    """Write the state at the share `theta` of the step by its collocation polynomial.

    `weights` (s,) receives those of velocities.
    """
    n3 = len(c.q) - 3
    c.point_q[:] = 0.0
    c.point_v[:] = 0.0
    weights_at(rk.dense_q, theta, weights)
    for i in range(len(rk.c)):
        w = h * h * weights[i]
        for d in range(n3):
            c.point_q[d] += w * acc[i, d]
    weights_at(rk.dense_v, theta, weights)
    for i in range(len(rk.c)):
        w = h * weights[i]
        for d in range(n3):
            c.point_v[d] += w * acc[i, d]
    for d in range(len(c.q)):
        c.point_q[d] += c.from_q[d] + theta * h * c.from_v[d]
        c.point_v[d] += c.from_v[d]


@subkernel
def report_divergence(c, iterations, change, stages):
    """Note the largest change of an acceleration, the coordinate and the iterations, for `stage_divergence`."""
    c.report[0], c.report[2] = 0.0, iterations
    for i in range(stages):
        for d in range(len(c.q) - 3):
            if not abs(change[i, d]) <= c.report[0]:
                c.report[0], c.report[1] = abs(change[i, d]), d


def stage_divergence(workspace: Workspace, report: np.ndarray) -> str:
    """Return where stage equations failed to converge, from a report (3,)."""
    if not np.isfinite(report[0]):
        return ": the stage iteration ran away"
    name = workspace.mechanism.unknown_name(int(report[1]))
    unit = "rad/s^2" if int(report[1]) % 3 == 2 else "m/s^2"
    return (
        f": the stage equations did not converge in {int(report[2])} iterations, "
        f"the last one still changed an acceleration of {name} by {report[0]:.3g} {unit}"
    )


class StageFamily(Family):
    """Base of the families of fully implicit methods; their `begun` (2,) tells of which step stage values stand."""

    carries_stages = True
    begun: np.ndarray

    def __init__(self, method: ImplicitRungeKutta, workspace: Workspace):
        super().__init__(workspace)
        self.rk = coefficients_of(method.tableau)
        self.has_dense_output = method.tableau.is_collocation

    def start(self, common: Common, h: float) -> None:
        """Choose pivots for the stage matrix by its numbers at the state in `common`; make room for all eigenvalues."""
        self.renew(common, self.workspace.t0, h)

    def forget(self) -> None:
        """Begin the next step without stage values from before."""
        self.begun[1] = np.nan

    def describe_divergence(self, report: np.ndarray) -> str:
        """Return the largest change of an acceleration and where it is."""
        return stage_divergence(self.workspace, report)

    def _no_systems(self) -> Systems:
        """Return room for no system yet."""
        return new_systems(self.rk, empty_pattern(), self.workspace.unknowns)

    def _take_tangents(self, common: Common, t: float, acc: np.ndarray, lam: np.ndarray) -> None:
        """Evaluate the tangents at the state in `common`; `acc` and `lam` are scratch. Raises SingularSystemError."""
        for _ in range(2):
            if tangents_at(self.workspace.stepping_engine, t, common.q, common.v, acc, lam) == OK:
                return
            self.workspace.use_pivots()

    def _rate(self, h: float) -> complex:
        """Return ``h mu`` of the eigenvalue by which pivots are chosen: real only where all are."""
        if len(self.rk.mu_complex):
            return complex(h * self.rk.mu_complex[0])
        return float(h * max(self.rk.mu_real, key=abs))
