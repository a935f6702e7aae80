"""Radau IIA of order 5, 9 and 13 for mbdkit, with variable steps and order, on equations of index 1, 2 and 3.

Stage i of s, with the matrix A of the method, whose last row has the weights of the step:

    M a_i + Phi_q(q_i)^T lam_i = Q(t_i, q_i, v_i, z_i),    z'_i = rates(t_i, q_i, v_i, z_i)
    v_i = v_n + h sum_j A_ij a_j,    z_i = z_n + h sum_j A_ij z'_j,    q_i = q_n + h sum_j A_ij (v_j - w_j)

and Phi(t_i, q_i) = 0 (index-3), Phi_q v_i + Phi_t = 0 (index-2) or Phi_q a_i = gamma (index-1), each with w = 0, or
both of the first two (ggl) with w_j = M^-1 Phi_q(q_j)^T mu_j. With one tangent for all stages, Newton's method
decouples along the eigenvectors of A into one real and (s - 1) / 2 complex systems of the size of the mechanism.

The estimated error is that of Hairer and Wanner (1996), IV.8: ``h gamma_0`` times the difference of the derivative at
the start from that of the collocation polynomial there, filtered by the matrix of the real eigenvalue gamma_0. The
order follows the rate of convergence of Newton's method (Hairer and Wanner 1999).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np

import mbdkit
from mbdkit.plugin import IterationMatrixWithStates, Orders
from mbdkit.plugin.methods import ControlledOptions, lagrange
from mbdkit.plugin.seams import integrator_claims, integrator_method
from mbdkit_radau.coefficients import coefficients

#: Rates of convergence below and above which the order changes, and the steps after a decrease during which it does not
#: increase; all from Hairer and Wanner (1999) and their code RADAU.
RAISED, LOWERED, WAIT = 0.002, 0.8, 10
STEADY = 0.8, 1.2  #: The order increases only if the last step was of about this size (the same source).
#: Largest error of the iteration over the tolerance, and largest change over the tolerance at which an iteration that
#: does not converge any more has reached rounding; chosen.
ACCURACY, IDLE = 0.01, 1.0
#: The tolerance of the estimate, of order s + 1 in h, is this share of rtol^((s + 1) / (2 s)) for the lowest s: the
#: rule of RADAU5, by which the error, of a higher order, is about proportional to `rtol`. With the s of each step, as
#: in RADAU, steps in which a contact begins may have errors of more than 1000 times `rtol`.
SHARE = 0.1
ROUNDING = 1e-15  #: Tolerance of the iteration in fixed steps.
MOST_ITERATIONS = 12, 50  #: Iterations of controlled and of fixed steps; RADAU allows 7 to 17.
#: Of each formulation, `gamma_v` over r and `residual_q` over r^2 in `EquationsOfMotion.iteration_matrix`, with r the
#: step times an eigenvalue, and the power of r by which changes of accelerations change the constraints.
TANGENTS = {"index-1": (-1.0, 1.0, 0), "index-2": (-0.5, 0.0, 1), "ggl": (-0.5, 0.0, 1), "index-3": (0.0, 0.0, 2)}


class RadauOptions(ControlledOptions):
    """Radau IIA of variable or fixed order."""

    adaptive: bool = True
    """Choose step sizes by an error estimate; `time.step` is then the first step and may be omitted."""
    order: Literal[5, 9, 13] | None = None
    """Order of the method, which has (order + 1) / 2 stages. By default, it varies among 5, 9 and 13 with adaptive
    steps, and is 5 with fixed ones."""


class Stages(NamedTuple):
    """Solved stages: q, v, a (s, n), lam (s, m), z and rates (s, Z), drift w (s, n); the matrix of the real eigenvalue;
    and the last rate of convergence, nan after one iteration.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    z: np.ndarray
    rates: np.ndarray
    w: np.ndarray
    matrix: IterationMatrixWithStates
    rate: float


class Past(NamedTuple):
    """What a step knows of the last one: the number of stages of the next step; and, unless it begins anew, steps
    before the order may increase, size of the last step, and a, lam and rates of its stages.
    """

    stages: int
    wait: int = 0
    h: float = 0.0
    a: Any = None
    lam: Any = None
    rates: Any = None


@integrator_method
class Radau(mbdkit.StepMethod):
    """The method; its memory is the tuple of `Past`."""

    carries_multipliers = True

    def __init__(self, options: RadauOptions):
        given = self.tolerances = options.tolerances()
        self.rtol, self.atol, self.idle = (
            (given.rtol, given.atol, IDLE) if given else (ROUNDING, ROUNDING, 1e-9 / ROUNDING)
        )
        self.fewest, self.most = (3, 7) if options.order is None else ((options.order + 1) // 2,) * 2
        if self.tolerances is None:
            self.most = self.fewest
        self.error_order = float(self.fewest)

    def begin(self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, why: str) -> Any:
        """Keep the stages after a projection, otherwise their number only."""
        return state.memory if why == "projection" or state.memory is None else state.memory[:1]

    def step(self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, h: float) -> mbdkit.Step:
        """Take one step, and choose the order of the next one."""
        past = Past(self.fewest) if state.memory is None else Past(*state.memory)
        s = past.stages
        if past.a is None or state.multipliers is None:
            a, lam, rates = equations.derivatives(t, state.q, state.v, state.z)
            state = replace(state, multipliers=lam)
            past = Past(s, 0, h, a[None], lam[None], rates[None]) if past.a is None else past
        found = self.solve(equations, t, state, h, past)
        later, wait = s, max(past.wait - 1, 0)
        if found.rate >= LOWERED and s > self.fewest:
            later, wait = s - 2, WAIT
        elif found.rate <= RAISED and s < self.most and not wait and STEADY[0] < h / past.h < STEADY[1]:
            later = s + 2
        memory = tuple(Past(later, wait, h, found.a, found.lam, found.rates))
        return self.completed(equations, t, state, h, found, memory)

    def solve(
        self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, h: float, past: Past
    ) -> Stages:
        """Solve the equations of the stages by simplified Newton, from the polynomial of the last step."""
        s = past.stages
        k, values = coefficients(s), (past.a, past.lam, past.rates)
        count = len(past.a)
        weights = lagrange(coefficients(count).c, 1 + k.c * h / past.h) if count > 1 else np.ones((s, 1))
        a, lam, rates = (weights @ x for x in values)
        formulation, times = equations.formulation, t + k.c * h
        mu, w = np.zeros_like(lam), np.zeros_like(a)
        gamma, of_q, power = TANGENTS[formulation]
        factors = [h * k.real, *(h * k.values[1:])]
        atol = self.atol * (min(1.0, equations.length) if self.tolerances and self.tolerances.by_size else 1.0)
        of_h = (1.0, 1.0 / velocity_weight(formulation, h), 1.0)
        scales = [(atol + self.rtol * np.abs(x)) * y for x, y in zip((state.q, state.v, state.z), of_h, strict=True)]

        def moved() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            q = state.q + (h * k.c[:, None] * state.v + h**2 * k.squared @ a - h * k.a @ w)
            return q, state.v + h * k.a @ a, state.z + h * k.a @ rates

        (q, v, z), j = moved(), s // 2
        middle = times[j], q[j], v[j], a[j], lam[j], z[j]
        matrices = [
            equations.iteration_matrix(*middle, damping=r, stiffness=r * r, gamma_v=gamma * r, residual_q=of_q * r * r)
            for r in factors
        ]
        change, rate, theta = math.inf, math.nan, math.nan
        for iteration in range(MOST_ITERATIONS[self.tolerances is None]):
            shift = w
            if formulation == "ggl":
                gaps = np.array([equations.constraints(*x) for x in zip(times, q, strict=True)])
                sides = zip(times, q, k.inverse @ gaps / h, strict=True)
                mu = mu - np.array([equations.solve(at, x, 0 * x, side)[1] for at, x, side in sides])
                w = np.array([equations.constraint_forces(*x) for x in zip(times, q, mu, strict=True)]) / equations.mass
                q, v, z = moved()
            lacks = [residual(equations, *x) for x in zip(times, q, v, a, lam, z, rates, strict=True)]
            force, rows, of_rates = (-(k.to_vectors @ np.array(x)) for x in zip(*lacks, strict=True))
            changes = [
                matrix.solve(*(side if j else side.real for side in (force[j], rows[j] / r**power, of_rates[j])))
                for j, (matrix, r) in enumerate(zip(matrices, factors, strict=True))
            ]
            da, dlam, dr = ((k.vectors @ np.array(x)).real for x in zip(*changes, strict=True))
            a, lam, rates = a + da, lam + dlam, rates + dr
            q, v, z = moved()
            moves = h**2 * k.squared @ da - h * k.a @ (w - shift), h * k.a @ da, h * k.a @ dr
            parts = np.concatenate([move / scale for move, scale in zip(moves, scales, strict=True)], axis=1)
            before, change = change, float(np.sqrt(np.mean(parts**2)))
            if iteration:
                theta, old = change / before, theta
                rate = theta if iteration == 1 else math.sqrt(theta * old)
            is_solved = theta * change <= (1 - theta) * ACCURACY if iteration else change <= 1e-3 * ACCURACY
            if is_solved or (theta >= 0.5 and change <= self.idle):
                return Stages(q, v, a, lam, z, rates, w, matrices[0], rate)
            if iteration > 1 and not theta < (1 if self.tolerances else 10):
                break
        raise mbdkit.StepError(
            "newton-failed", f"the equations of {s} stages were not solved in {iteration + 1} iterations"
        )

    def completed(
        self,
        equations: mbdkit.EquationsOfMotion,
        t: float,
        state: mbdkit.StepState,
        h: float,
        found: Stages,
        memory: Any,
    ) -> mbdkit.Step:
        """Return the step with solved stages: its end, estimated error and dense output."""
        s, formulation = len(found.a), equations.formulation
        k, q, v = coefficients(s), found.q[-1], found.v[-1]
        if formulation in ("index-3", "ggl"):  # removes what the iteration has left
            q = equations.project_positions(t + h, q)
        if formulation in ("index-2", "ggl"):
            v = equations.project_velocities(t + h, q, v)

        def dense(theta: float) -> tuple[np.ndarray, ...]:
            """Return (q, v, z) of the collocation polynomial."""
            powers = theta ** np.arange(1, s + 2)
            first, second = k.first @ powers[:-1], k.second @ powers
            q = state.q + theta * h * state.v + h**2 * second @ found.a - h * first @ found.w
            return q, state.v + h * first @ found.a, state.z + h * first @ found.rates

        return mbdkit.Step(
            mbdkit.StepState(q, v, found.lam[-1], memory, z=found.z[-1]),
            error=self.error(equations, t, state, h, found),
            dense=dense,
            next_order=float(memory[0]),
            stages=(t + k.c * h, h * k.a[-1], (found.q, found.v)),
        )

    def error(
        self, equations: mbdkit.EquationsOfMotion, t: float, state: mbdkit.StepState, h: float, found: Stages
    ) -> np.ndarray | None:
        """Return the estimate of the local error of (q, v, z), scaled so that the tolerance applies to the error of the
        step; None with fixed steps. With index 3, that of velocities normal to the joints is multiplied by h: they are
        the variables of index 2, while those along the joints are of index 1.
        """
        if self.tolerances is None or state.multipliers is None:
            return None
        s = len(found.a)
        k = coefficients(s)
        start, r = lagrange(k.c, np.zeros(1))[0], h * k.real
        gap = r * (state.v - start @ (found.v - found.w))
        at = t, state.q + gap, state.v, start @ found.a, state.multipliers, state.z, start @ found.rates
        force, rows, of_rates = (-x for x in residual(equations, *at))
        x, _, x_z = found.matrix.solve(force, rows / r ** TANGENTS[equations.formulation][2], of_rates)
        of_v = r * x
        if equations.formulation == "index-3":
            along, _ = equations.solve(t, state.q, equations.mass * of_v, np.zeros(equations.m))
            of_v = along + velocity_weight(equations.formulation, h) * (of_v - along)
        error = np.concatenate([r**2 * x + gap, of_v, r * x_z])
        scaled: np.ndarray = self.rtol ** ((self.fewest - 1) / (2 * self.fewest)) / SHARE * error
        return scaled


def velocity_weight(formulation: str, h: float) -> float:
    """Return the weight of errors of velocities of index 2: h, as in RADAU5, with index-3."""
    return min(1.0, h) if formulation == "index-3" else 1.0


def residual(
    equations: mbdkit.EquationsOfMotion,
    t: float,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    lam: np.ndarray,
    z: np.ndarray,
    rates: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the residuals of the equations of motion (n,), the constraints (m,), and the rates of states (Z,)."""
    of_rates = rates - equations.rates(t, q, v, z)
    equations.hold(z)
    force = equations.residual(t, q, v, a, lam)
    if equations.formulation == "index-3":
        return force, equations.constraints(t, q), of_rates
    if equations.formulation == "index-1":
        rows = equations.constraint_rates(t, q, a) - equations.constraint_rates(t, q, 0 * a) - equations.gamma(t, q, v)
        return force, rows, of_rates
    return force, equations.constraint_rates(t, q, v), of_rates


@integrator_claims
def claims(options: RadauOptions) -> mbdkit.Claims:
    """Return the claims of the method (Hairer, Lubich and Roche 1989 for its orders)."""
    method, fixed = Radau(options), not options.adaptive
    s = method.fewest
    p = 2 * s - 1
    orders = {"index-1": Orders(p, p, p), "index-2": Orders(p, p, s), "index-3": Orders(p, s, s - 1)}
    return mbdkit.Claims(
        order=p if fixed else None,
        multiplier_order=s if fixed else None,
        stages=s if method.most == s else None,
        adaptive=not fixed,
        variable_order=method.most > s,
        drift="none with ggl; none of positions with index-3; with index-2 and index-1, drift follows the tolerance",
        constraints_hold=("position", "velocity"),
        needs=("tangents",),
        formulations=("ggl", *orders),
        orders=orders if fixed else {},
        stabilizations=("none", "baumgarte", "projection"),
        states=True,
        dense_order=s - 1,  # of velocities with index-3; otherwise s
        conserves=("linear-momentum",),
        a_stable=True,
        l_stable=True,
    )
