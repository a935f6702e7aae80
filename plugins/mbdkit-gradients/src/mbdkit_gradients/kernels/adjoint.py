"""Adjoint derivatives: from derivatives with respect to results back to those with respect to states and parameters.

Accelerations a and multipliers lambda of a state solve ``M a + Phi_q^T lambda = Q``, ``Phi_q a = gamma``. If a scalar
has the derivatives ``a_bar`` and ``lam_bar`` with respect to them, the same symmetric matrix gives

    [ M      Phi_q^T ] [ mu ]   [ a_bar   ]
    [ Phi_q  0       ] [ nu ] = [ lam_bar ]

and the derivatives with respect to anything else are those of ``mu (Q - M a - Phi_q^T lambda) + nu (gamma - Phi_q a)``
at constant a, lambda, mu and nu. Those with respect to positions and velocities are products with the tangents; those
with respect to numbers of the mechanism are local to its elements.

Friction in joints ``T = F(lambda)``, a part of Q, adds ``F_lambda^T T_bar`` to the second right side, where T_bar are
the derivatives with respect to the frictions: those of results minus ``grad mu``. They satisfy the transposed equations
of Newton's method for the frictions.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from mbdkit.engine.kernels import accelerations, constraints, lu, schur
from mbdkit.engine.kernels import applied_forces as forces
from mbdkit.engine.kernels.bundle_types import IntMatrix, IntVector, RealCube, RealMatrix, RealVector, example_of
from mbdkit.engine.kernels.dual_observe import load_dual_states
from mbdkit.engine.kernels.engine_bundles import load_engine
from mbdkit.engine.kernels.system import DIVERGED, OK, constraint_rows, evaluate_tangents, prepare
from mbdkit.engine.kernels.table_rows import INTERACTION, LAW_ROW, LINEAR, LOAD, MULTIPLIER, PAIR, SPRING, TENSION
from mbdkit.engine.kernels.vectors import copy, fill, fill_rows
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import kernel, separate, subkernel
from mbdkit_gradients.kernels.kept_stages import keep_stage, pass_factors, take_stage

POINTS, LAWS = range(2)  #: Indices of `Adjoint.wants`.
LINEAR_LAW, TABLE_LAW, OTHER_LAW = range(3)  #: Kinds of laws in `Adjoint.kinds`.
LENGTH, RATE, FORCE, POTENTIAL = range(4)  #: Columns of derivatives with respect to the values of a force element.

PIN = constraints.KINDS["revolute"]  #: Kind of the pairs of pins.
OF_BODIES = 14  #: Number of parameters of laws of forces between bodies that hold the states of these.

#: Numbers in a cache line, and in a block of memory that is fetched at once and stays in the cache.
LINE, BLOCK = 8, 1024
MOST_ITERATIONS = 60
SMALL = 1e-15
#: Solutions are refined if the residual of a constraint row is larger than this, relative to the terms of such a row;
#: those of chains of rods have 1e-16, those of a four-bar knee up to 2e-14.
REFINED = 1e-13
#: An iteration ends when the relative change is below `SMALL`; is below `NEARLY`, and the next one is expected to be
#: below `SMALL`; or is round-off: below `NEGLIGIBLE`, and above the share `STALLED` of the last change.
NEARLY, STALLED, NEGLIGIBLE = 1e-13, 0.5, 1e-11


class Adjoint(NamedTuple):
    """Derivatives with respect to numbers of a mechanism, and working arrays; S segments of springs, P pairs."""

    only_pins: IntVector  #: (1,) whether all joints are pins.
    #: (N, 3) terms of the tangents, except those of pins: index in ``Scratch.source``, row, column. Derivatives with
    #: respect to positions come first, then those with respect to velocities.
    terms: Annotated[IntMatrix, 3]
    by_positions: IntVector  #: (1,) number of the former.
    #: (2,) whether derivatives by points of springs and of joints but pins, and by parameters of laws, are computed.
    wants: IntVector
    laws_wanted: IntVector  #: (N,) whether they are with respect to each of the parameters of laws.
    kinds: IntVector  #: (S,) kind of the law of each segment.
    mu: RealVector  #: (3 (B + 1),) solution of the adjoint system, and (P, 2).
    nu: Annotated[RealMatrix, 2]
    right: RealVector  #: (n + m,) right side in the order of the unknowns.
    lam_bar: Annotated[RealMatrix, 2]
    #: (S, 4) derivatives with respect to the values of the springs; those of the first segment count.
    pull_bar: RealMatrix
    by_reaction: RealVector  #: (N,) derivatives of frictions with respect to the multipliers in ``Topology.reactions``.
    #: (F, F + 2) matrix and right side of the equations of the derivatives by frictions, and these without those of
    #: results.
    friction: RealMatrix
    unused: Annotated[RealMatrix, 6]  #: (P, 6) derivatives with respect to points of pins that are not read.
    #: Derivatives with respect to arrays of the mechanism, which are added up: these and the following.
    mass: Annotated[RealMatrix, 3]
    gravity: RealVector
    pair_parameters: Annotated[RealMatrix, 6]
    spring_points: Annotated[RealMatrix, 6]
    linear: Annotated[RealMatrix, 3]
    law_parameters: RealVector
    load_points: Annotated[RealMatrix, 2]
    jac: RealCube  #: Numbers in the memory of the arrays of dual numbers, (P, 12, 13).
    gamma: RealCube
    s: RealCube
    grad: RealCube
    tension: RealCube
    interaction: RealCube
    values: RealMatrix
    rate: RealMatrix  #: (1, 13) a dual number for rates.


class Given(NamedTuple):
    """Derivatives of a scalar with respect to what follows from T states, which are in `Steps`."""

    reactions: RealCube  #: (T, P, 3) to forces and torques of pairs on their second bodies.
    forces: RealCube  #: (T, S, 4) to length, rate, tension and potential of the springs.
    kinetic: RealVector  #: (T,) to the kinetic energy, and to the potential energy of gravity.
    gravity: RealVector
    multipliers: RealCube  #: (T, P, 2) to the multipliers.


class Steps(NamedTuple):
    """N steps of a Runge-Kutta method of S stages, and the derivatives that are carried through them.

    Functions of one state have the number of a stage. PULL uses T states as stages, at the times `time`; derivatives
    with respect to their accelerations are in `to_acc`, and results in `to_q` and `to_v`.
    """

    #: (1,) whether stages depend on later ones; they are then found by fixed-point iteration, and so are the
    #: derivatives with respect to them.
    is_implicit: IntVector

    a: RealMatrix
    b: RealVector
    c: RealVector
    time: RealVector  #: (N,) beginnings of the steps, and their sizes [s].
    size: RealVector
    q: RealMatrix  #: (N, 3 (B + 1)) states at the beginnings.
    v: RealMatrix
    #: (N + 1, 3 (B + 1)) derivatives with respect to the states between the steps; the first row is the result.
    q_bar: RealMatrix
    v_bar: RealMatrix
    stage_q_bar: RealMatrix  #: (N S or 0, 3 (B + 1)) derivatives with respect to the states of the stages.
    stage_v_bar: RealMatrix
    #: (S, 3 (B + 1)) work arrays: states of the stages of a step, and derivatives with respect to them.
    q_stage: RealMatrix
    v_stage: RealMatrix
    acc: RealMatrix
    lam: RealCube
    rows: RealMatrix  #: (N S, W) stages kept by explicit steps, or (S, W) those of a step; see `keep_stage`.
    #: (2,) whether they are the former, and whether positions of stages are left out: with factors that are kept, only
    #: tangents of other joints than pins, and forces, need them.
    is_kept: IntVector
    guess: RealMatrix  #: (N S or 0, 3 (B + 1)) accelerations of the stages of implicit steps from which to iterate.
    touched: RealVector  #: (1,) result of `_touch`, without meaning.
    source: RealMatrix  #: (S, ...) first values of ``Scratch.source`` at the stages of an implicit step: those in use.
    to_q: RealMatrix
    to_v: RealMatrix
    to_acc: RealMatrix
    by_q: RealMatrix
    by_v: RealMatrix
    next: RealVector
    kept: RealMatrix


load_adjoint = bundle_loader(lambda: example_of(Adjoint))
load_given = bundle_loader(lambda: example_of(Given))
load_steps = bundle_loader(lambda: example_of(Steps))


@separate
def _accelerations(h, t, q, v, acc, lam, refine):
    """Solve for accelerations and multipliers of a state; return a status."""
    prepare(h.top, h.w, t, q)
    return accelerations.solve_accelerations(h.top, h.w, h.solver, q, v, acc, lam, refine)


@subkernel
def _pin_rows(top, w):
    """Evaluate what changes in the Jacobian of pins from the cosines and sines of the angles of their bodies."""
    for k in range(len(top.pairs)):
        for side in range(2):
            body, sign = top.pairs[k, PAIR.first + side], 2.0 * side - 1.0
            cos, sin = sign * w.cs[body, 0], sign * w.cs[body, 1]
            x, y = top.pair_parameters[k, 2 * side], top.pair_parameters[k, 2 * side + 1]
            w.jac[k, 2 + 3 * side] = -sin * x - cos * y
            w.jac[k, 8 + 3 * side] = cos * x - sin * y


@separate
def _tangents_of_all(h, s, i, t):
    evaluate_tangents(h.top, h.w, t, s.q_stage[i], s.v_stage[i], s.acc[i], s.lam[i])


@separate
def _tangents_of_forces(h, s, i, t):
    prepare(h.top, h.w, t, s.q_stage[i])
    forces.take_multipliers(h.top, h.w, s.lam[i])
    forces.force_tangents(h.top, h.w, s.q_stage[i], s.v_stage[i])


@subkernel
def _tangents(h, g, s, i, t):
    """Evaluate the tangents at stage `i`, whose solution or factors are the last ones; those of joints are not needed
    if all joints are pins, see `_pins`.
    """
    if g.only_pins[0] == 0:
        _tangents_of_all(h, s, i, t)
    else:
        _pin_rows(h.top, h.w)
        if forces.any_forces(h.top):
            _tangents_of_forces(h, s, i, t)


@subkernel
def _write_unknowns(h, g):
    """Write ``g.mu`` and the rows ``g.nu`` into ``g.right`` in the order of the unknowns."""
    for d in range(len(g.mu) - 3):
        g.right[d] = g.mu[d]
    for k in range(len(h.top.pairs)):
        for r in range(h.top.rows[k]):
            g.right[h.solver.row_index[k, r]] = g.nu[k, r]


@subkernel
def _substitute(h, g, s, i):
    """Solve for ``g.mu`` and ``g.nu``, given the right sides ``s.to_acc[i]`` and ``Scratch.gamma``, with the last
    factors.
    """
    top, w, mu, nu, acc_bar = h.top, h.w, g.mu, g.nu, s.to_acc[i]
    if h.solver.pivoted[0] != 0:
        for k in range(len(nu)):
            copy(w.gamma[k], nu[k])
        copy(acc_bar, mu)
        _write_unknowns(h, g)
        lu.solve_refined(h.solver.pattern, h.solver.factors, g.right, w.solution, w.correction)
        for d in range(len(mu)):
            mu[d] = w.solution[d] if d < len(mu) - 3 else 0.0
        for k in range(len(nu)):
            for r in range(top.rows[k]):
                nu[k, r] = w.solution[h.solver.row_index[k, r]]
        return
    for b in range(len(top.weight)):
        for i in range(3):
            mu[3 * b + i] = top.weight[b, i] * acc_bar[3 * b + i]
    accelerations.joint_right_side(top, w, mu, nu)
    schur.solve(h.solver.schur, nu)
    accelerations.apply_multipliers(top, w, nu, mu, True)
    if _misfit(top, w, mu) > REFINED:
        accelerations.refine_multipliers(top, w, h.solver.schur, mu, nu, True)


@subkernel
def _misfit(top, w, mu):
    """Return the largest residual of ``Phi_q mu = gamma``, relative to the largest sum of the terms of a row."""
    worst = size = 0.0
    for k in range(len(top.pairs)):
        a, b = 3 * top.pairs[k, PAIR.first], 3 * top.pairs[k, PAIR.second]
        for r in range(2):
            x = y = 0.0
            for i in range(3):
                x += w.jac[k, 6 * r + i] * mu[a + i]
                y += w.jac[k, 6 * r + 3 + i] * mu[b + i]
            worst = max(worst, abs(x + y - w.gamma[k, r]))
            size = max(size, abs(x) + abs(y) + abs(w.gamma[k, r]))
    return worst / size if worst > 0.0 else 0.0


@separate
def _by_reactions(h, c, g, s, stage, t):
    """Evaluate the derivatives of frictions with respect to multipliers; requires `evaluate_tangents`."""
    top, spare, v, lam = h.top, len(h.top.springs), s.v_stage[stage], s.lam[stage]
    for i in range(len(top.reactions)):
        g.values[top.reactions[i, MULTIPLIER.parameter], 0] = lam[
            top.reactions[i, MULTIPLIER.pair], top.reactions[i, MULTIPLIER.row]
        ]
    for i in range(len(top.reactions)):
        k, place = top.frictions[top.reactions[i, MULTIPLIER.friction]], top.reactions[i, MULTIPLIER.parameter]
        g.values[place, 1] = 1.0
        g.rate[0, 0] = h.w.s[k, 0]
        g.rate[1, 0] = forces.path_rate(k, top.springs, v, h.w.grad)
        forces.evaluate_law(c.top, c.w, top.springs[k, SPRING.law], c.v[0, 0], c.v[0, 1], t, c.w.tension, spare, 4)
        g.values[place, 1] = 0.0
        g.by_reaction[i] = g.tension[spare, TENSION.force, 1]


@subkernel
def _along(h, f, mu):
    """Return the product of `mu` with the gradient of the pathway of friction `f`."""
    k, total = h.top.frictions[f], 0.0
    a, b = 3 * h.top.springs[k, SPRING.first], 3 * h.top.springs[k, SPRING.second]
    for i in range(3):
        total += h.w.grad[k, i] * mu[a + i] + h.w.grad[k, 3 + i] * mu[b + i]
    return total


@subkernel
def _couple_frictions(h, g):
    """Change the right side ``Scratch.gamma`` by frictions, for the present ``g.mu``: a transposed step of Newton's
    method.
    """
    top, room, count = h.top, g.friction, len(h.top.frictions)
    for f in range(count):
        room[f, count] = _along(h, f, g.mu) - room[f, count + 1]
        for j in range(count):
            room[f, j] = 1.0 if f == j else 0.0
        for i in range(len(top.reactions)):
            # by symmetry, a unit of the second right side moves along the pathway by the negative of this response
            room[f, top.reactions[i, MULTIPLIER.friction]] -= h.w.response[i, f] * g.by_reaction[i]
    for f in range(count):  # the pivots are those of Newton's method, which are positive
        for other in range(f + 1, count):
            share = room[other, f] / room[f, f]
            for j in range(f, count + 1):
                room[other, j] -= share * room[f, j]
    for f in range(count - 1, -1, -1):
        for j in range(f + 1, count):
            room[f, count] -= room[f, j] * room[j, count]
        room[f, count] /= room[f, f]
        room[f, count + 1] += room[f, count]
    for i in range(len(top.reactions)):
        change = room[top.reactions[i, MULTIPLIER.friction], count] * g.by_reaction[i]
        h.w.gamma[top.reactions[i, MULTIPLIER.pair], top.reactions[i, MULTIPLIER.row]] -= change


@subkernel
def _solve_adjoint(h, g, s, stage):
    """Solve for ``g.mu`` and ``g.nu``; ``g.lam_bar`` has the derivatives by multipliers. Overwrites gamma."""
    top, gamma = h.top, h.w.gamma
    for k in range(len(top.pairs)):
        for r in range(2):
            gamma[k, r] = g.lam_bar[k, r] if r < top.rows[k] else 0.0
    if len(top.frictions) > 0:
        for i in range(len(top.reactions)):
            own = g.pull_bar[top.frictions[top.reactions[i, MULTIPLIER.friction]], FORCE] * g.by_reaction[i]
            gamma[top.reactions[i, MULTIPLIER.pair], top.reactions[i, MULTIPLIER.row]] += own
        for f in range(len(top.frictions)):
            g.friction[f, len(top.frictions) + 1] = 0.0
        for _ in range(2):
            _substitute(h, g, s, stage)
            _couple_frictions(h, g)
    _substitute(h, g, s, stage)


@subkernel
def _pins(h, g, s, i, points, q_bar, v_bar):
    """Add the derivatives of the equations of pins with respect to their points and to the states of their bodies.

    Those with respect to angles are those with respect to the arms, the vectors from the centers of mass to the pin.
    """
    top, jac, cs, nu, mu = h.top, h.w.jac, h.w.cs, g.nu, g.mu
    v, acc, lam = s.v_stage[i], s.acc[i], s.lam[i]
    rate, square = 2.0 * top.baumgarte[0], top.baumgarte[1] * top.baumgarte[1]
    for k in range(len(top.pairs)):
        if top.pairs[k, PAIR.kind] != PIN:
            continue
        for side in range(2):
            body, sign = top.pairs[k, PAIR.first + side], 2.0 * side - 1.0
            angle, cos, sin = 3 * body + 2, cs[body, 0], cs[body, 1]
            n0, n1, w = sign * nu[k, 0], sign * nu[k, 1], v[angle]
            inward, turn, along = w * w - square, acc[angle] + rate * w, sign * mu[angle]
            # derivatives by the arm, and the arm from the columns of the angle in the Jacobian
            x = n0 * inward - n1 * turn - lam[k, 1] * along
            y = n1 * inward + n0 * turn + lam[k, 0] * along
            arm_x, arm_y = sign * jac[k, 8 + 3 * side], -sign * jac[k, 2 + 3 * side]
            q_bar[angle] += y * arm_x - x * arm_y
            v_bar[angle] += 2.0 * w * (n0 * arm_x + n1 * arm_y) + rate * (n0 * arm_y - n1 * arm_x)
            points[k, 2 * side] += cos * x + sin * y
            points[k, 2 * side + 1] += cos * y - sin * x
            if rate != 0.0 or square != 0.0:
                q_bar[3 * body] -= square * n0
                q_bar[3 * body + 1] -= square * n1
                v_bar[3 * body] -= rate * n0
                v_bar[3 * body + 1] -= rate * n1


@subkernel
def _to_state(h, g, s, i, points, q_bar, v_bar):
    """Add the products of mu and nu with the tangents to the derivatives with respect to positions and velocities, and
    for pins to those with respect to their `points`.
    """
    _pins(h, g, s, i, points, q_bar, v_bar)
    source, terms, unknown = h.w.source, g.terms, g.right
    if len(terms) == 0:
        return
    _write_unknowns(h, g)
    for e in range(g.by_positions[0]):
        q_bar[terms[e, 2]] -= source[terms[e, 0]] * unknown[terms[e, 1]]
    for d in range(
        len(g.mu) - 3, len(unknown)
    ):  # gamma_v is on the right side of its equation, and damping on the left
        unknown[d] = -unknown[d]
    for e in range(g.by_positions[0], len(terms)):
        v_bar[terms[e, 2]] -= source[terms[e, 0]] * unknown[terms[e, 1]]


@subkernel
def _law_slopes(h, c, g, t, k, length, rate, by_force, by_potential):
    """Add the derivatives with respect to the parameters of the law of spring `k`, at rate `rate`."""
    law = h.top.springs[k, SPRING.law]
    begin = h.top.laws[law, LAW_ROW.parameters]
    count = int(h.top.law_parameters[begin])
    if g.kinds[k] == TABLE_LAW:
        p, out = h.top.law_parameters, g.law_parameters
        pieces, first = int(p[begin + 2]), begin + 3
        low, high = 0, pieces
        while high - low > 1:
            middle = (low + high) // 2
            if p[first + middle] <= length:
                low = middle
            else:
                high = middle
        inside = min(max(length, p[first + low]), p[first + low + 1])
        x, beyond = inside - p[first + low], length - inside
        row = first + pieces + 1 + 5 * low
        out[begin + 1] += by_force * rate
        power = 1.0
        for j in range(4):
            slope = 0.0 if j == 0 else j * power
            power = 1.0 if j == 0 else power * x
            out[row + j] += by_force * (power + beyond * slope)
            potential = power * x / (j + 1.0) + beyond * (power + 0.5 * beyond * slope)
            out[row + j] += by_potential * potential
        out[row + 4] += by_potential
        return
    for i in range(count):
        if g.laws_wanted[begin + 1 + i] == 0:
            continue
        # one parameter after the other: laws have few of them
        g.values[begin + 1 + i, 1] = 1.0
        spare = len(h.top.springs)
        g.rate[0, 0] = length
        g.rate[1, 0] = rate
        forces.evaluate_law(c.top, c.w, law, c.v[0, 0], c.v[0, 1], t, c.w.tension, spare, 4)
        g.values[begin + 1 + i, 1] = 0.0
        g.law_parameters[begin + 1 + i] += by_force * g.tension[spare, TENSION.force, 1]
        g.law_parameters[begin + 1 + i] += by_potential * g.tension[spare, TENSION.potential, 1]


@subkernel
def _springs(h, c, g, s, stage, t):
    """Add what depends on springs: derivatives with respect to their parameters, and of their own values."""
    top, w, v, q_bar, v_bar = h.top, h.w, s.v_stage[stage], s.to_q[stage], s.to_v[stage]
    for k in range(len(top.springs)):
        if top.springs[k, SPRING.segments] == 0:
            continue
        law, rate, along = top.springs[k, SPRING.law], forces.path_rate(k, top.springs, v, w.grad), 0.0
        for segment in range(k, k + top.springs[k, SPRING.segments]):
            a, b = 3 * top.springs[segment, SPRING.first], 3 * top.springs[segment, SPRING.second]
            for i in range(3):
                along += w.grad[segment, i] * g.mu[a + i] + w.grad[segment, 3 + i] * g.mu[b + i]
        own = g.pull_bar[k, FORCE]
        by_potential = g.pull_bar[k, POTENTIAL]
        length, pull = w.s[k, 0], w.tension[k, TENSION.force]
        by_length = g.pull_bar[k, LENGTH] + own * w.tension[k, TENSION.by_length]
        by_rate = g.pull_bar[k, RATE] + own * w.tension[k, TENSION.by_rate]
        if law < 0:
            stretch = length - top.linear[k, LINEAR.free_length]
            g.linear[k, LINEAR.stiffness] += (own - along) * stretch + by_potential * 0.5 * stretch * stretch
            g.linear[k, LINEAR.damping] += (own - along) * rate
            slope = top.linear[k, LINEAR.stiffness]
            g.linear[k, LINEAR.free_length] -= slope * (own - along + by_potential * stretch)
            by_length += by_potential * slope * stretch
        else:
            if by_potential != 0.0:
                by_length += by_potential * forces.law_value(top, w, law, length, 0.0, t)
            if g.wants[LAWS] != 0:
                _law_slopes(h, c, g, t, k, length, rate, own - along, by_potential)
        if by_length != 0.0 or by_rate != 0.0:
            for segment in range(k, k + top.springs[k, SPRING.segments]):
                a, b = 3 * top.springs[segment, SPRING.first], 3 * top.springs[segment, SPRING.second]
                for i in range(6):
                    d = a + i if i < 3 else b + i - 3
                    q_bar[d] += by_length * w.grad[segment, i] + by_rate * forces.rate_slope(top, w, v, segment, i)
                    v_bar[d] += by_rate * w.grad[segment, i]
        if g.wants[POINTS] != 0 and top.springs[k, SPRING.segments] == 1:
            # the residual has the derivatives of the force and of its direction
            total = by_length - along * w.tension[k, TENSION.by_length]
            at_rate = by_rate - along * w.tension[k, TENSION.by_rate]
            a, b = 3 * top.springs[k, SPRING.first], 3 * top.springs[k, SPRING.second]
            for j in range(6):
                add = total * g.s[k, 0, 7 + j]
                for i in range(3):
                    first, second = g.grad[k, i, 7 + j], g.grad[k, 3 + i, 7 + j]
                    add += at_rate * (first * v[a + i] + second * v[b + i])
                    add -= pull * (first * g.mu[a + i] + second * g.mu[b + i])
                g.spring_points[k, j] += add


@subkernel
def _other_joints(h, g, s, stage):
    """Add the derivatives with respect to the parameters of joints that are not pins."""
    acc, lam = s.acc[stage], s.lam[stage]
    for k in range(len(h.top.pairs)):
        if h.top.pairs[k, PAIR.kind] == PIN:
            continue
        a, b = 3 * h.top.pairs[k, PAIR.first], 3 * h.top.pairs[k, PAIR.second]
        for j in range(6):
            add = 0.0
            for r in range(2):
                add += g.nu[k, r] * g.gamma[k, r, 1 + j]
                for i in range(3):
                    first, second = g.jac[k, 6 * r + i, 1 + j], g.jac[k, 6 * r + 3 + i, 1 + j]
                    add -= first * (g.mu[a + i] * lam[k, r] + g.nu[k, r] * acc[a + i])
                    add -= second * (g.mu[b + i] * lam[k, r] + g.nu[k, r] * acc[b + i])
            g.pair_parameters[k, j] += add


@subkernel
def _interactions(h, c, g, t):
    """Add the derivatives with respect to the parameters of forces between bodies; requires `evaluate_tangents`."""
    top, slots = h.top, len(g.rate[0]) - 1
    for k in range(len(top.interactions)):
        law = top.interactions[k, INTERACTION.law]
        begin = top.laws[law, LAW_ROW.parameters] + 1
        end, first = begin + int(top.law_parameters[begin - 1]), begin + OF_BODIES
        for i in range(begin, first):
            g.values[i, 0] = h.w.law_values[i]
        for left in range(first, end, slots):
            is_wanted = False
            for i in range(left, min(left + slots, end)):
                is_wanted = is_wanted or g.laws_wanted[i] != 0
                g.values[i, 1 + i - left] = 1.0
            if is_wanted:
                forces.evaluate_law(c.top, c.w, law, c.v[0, 0], c.v[0, 1], t, c.w.interaction, k, 6)
            for i in range(left, min(left + slots, end)):
                g.values[i, 1 + i - left] = 0.0
                for d in range(6 if is_wanted else 0):
                    body = top.interactions[k, INTERACTION.first + d // 3]
                    g.law_parameters[i] += g.mu[3 * body + d % 3] * g.interaction[k, d, 1 + i - left]


@subkernel
def _bodies_and_loads(h, g, s, stage):
    """Add the derivatives with respect to masses, gravity and points of loads."""
    top, w, acc = h.top, h.w, s.acc[stage]
    for b in range(len(top.mass) - 1):
        for i in range(3):
            pull = top.gravity[i] - acc[3 * b + i] if i < 2 else -acc[3 * b + i]
            g.mass[b, i] += g.mu[3 * b + i] * pull
        for i in range(2):
            g.gravity[i] += g.mu[3 * b + i] * top.mass[b, i]
    for k in range(len(top.loads)):
        if top.loads[k, LOAD.kind] != forces.TORQUE:
            fx, fy, _, _ = forces.point_force(top, w, k)
            body = top.loads[k, LOAD.body]
            cos, sin, turn = w.cs[body, 0], w.cs[body, 1], g.mu[3 * body + 2]
            g.load_points[k, 0] += turn * (cos * fy - sin * fx)
            g.load_points[k, 1] -= turn * (sin * fy + cos * fx)


@separate
def _by_points(c, g, s, i, t):
    """Evaluate Jacobian, gamma and lengths of pathways with their derivatives with respect to points."""
    top, w, own_q, own_v, q, v = c.top, c.w, c.q[0], c.v[1], s.q_stage[i], s.v_stage[i]
    for d in range(len(q)):
        own_q[d] = q[d]
        own_v[d] = v[d]
    prepare(top, w, t, own_q)
    constraint_rows(top, w, own_q, own_v)
    forces.pathway_lengths(top, w, own_q)


@separate
def _pull_back(h, c, g, s, i, t):
    """Add the derivatives with respect to the state of stage `i` and to numbers of the mechanism to ``s.to_q`` and
    ``s.to_v``, given those with respect to accelerations ``s.to_acc``, multipliers ``g.lam_bar`` and springs
    ``g.pull_bar``; requires `_tangents` and `_by_points`.
    """
    if len(h.top.reactions) > 0:
        _by_reactions(h, c, g, s, i, t)
    _solve_adjoint(h, g, s, i)
    _to_state(h, g, s, i, g.pair_parameters, s.to_q[i], s.to_v[i])
    _bodies_and_loads(h, g, s, i)
    _springs(h, c, g, s, i, t)
    if g.wants[LAWS] != 0:
        _interactions(h, c, g, t)
    if g.wants[POINTS] != 0:
        _other_joints(h, g, s, i)


@subkernel
def _reactions(h, g, bars, lam, q_bar):
    """Add what follows from derivatives `bars` (P, 3) with respect to forces and torques of the pairs."""
    top, w = h.top, h.w
    for k in range(len(top.pairs)):
        if top.pairs[k, PAIR.kind] == PIN:  # the forces are the multipliers, and there is no torque
            for r in range(2):
                g.lam_bar[k, r] -= bars[k, r]
            continue
        b = top.pairs[k, PAIR.second]
        cos, sin = w.cs[b, 0], w.cs[b, 1]
        px, py = top.pair_parameters[k, 2], top.pair_parameters[k, 3]
        arm_x, arm_y = cos * px - sin * py, sin * px + cos * py
        fx = -(w.jac[k, 3] * lam[k, 0] + w.jac[k, 9] * lam[k, 1])
        fy = -(w.jac[k, 4] * lam[k, 0] + w.jac[k, 10] * lam[k, 1])
        turn = bars[k, 2]
        x, y = -turn * fy, turn * fx  # derivatives with respect to the arm
        q_bar[3 * b + 2] += y * arm_x - x * arm_y
        g.pair_parameters[k, 2] += x * cos + y * sin
        g.pair_parameters[k, 3] += y * cos - x * sin
        e0, e1 = bars[k, 0] + turn * arm_y, bars[k, 1] - turn * arm_x
        a = top.pairs[k, PAIR.first]
        for r in range(2):
            g.lam_bar[k, r] -= e0 * w.jac[k, 6 * r + 3] + e1 * w.jac[k, 6 * r + 4] + turn * w.jac[k, 6 * r + 5]
        for i in range(6):
            product = e0 * w.stiff[k, 18 + i] + e1 * w.stiff[k, 24 + i] + turn * w.stiff[k, 30 + i]
            q_bar[3 * a + i if i < 3 else 3 * b + i - 3] -= product
        if g.wants[POINTS] != 0:
            for j in range(6):
                for r in range(2):
                    g.pair_parameters[k, j] -= lam[k, r] * (
                        e0 * g.jac[k, 6 * r + 3, 1 + j]
                        + e1 * g.jac[k, 6 * r + 4, 1 + j]
                        + turn * g.jac[k, 6 * r + 5, 1 + j]
                    )


@subkernel
def _energies(h, g, kinetic, potential, q, v, q_bar, v_bar):
    top = h.top
    for b in range(len(top.mass) - 1):
        for i in range(3):
            v_bar[3 * b + i] += kinetic * top.mass[b, i] * v[3 * b + i]
            g.mass[b, i] += 0.5 * kinetic * v[3 * b + i] * v[3 * b + i]
        for i in range(2):
            q_bar[3 * b + i] -= potential * top.mass[b, 0] * top.gravity[i]
            g.mass[b, 0] -= potential * top.gravity[i] * q[3 * b + i]
            g.gravity[i] -= potential * top.mass[b, 0] * q[3 * b + i]


@subkernel
def _pull_states(h, c, g, x, s, first, end):
    for r in range(first, end):
        t, q, v, lam, to_q, to_v = s.time[r], s.q_stage[r], s.v_stage[r], s.lam[r], s.to_q[r], s.to_v[r]
        status = _accelerations(h, t, q, v, s.acc[r], lam, True)
        if status != OK:
            return status, r
        _tangents(h, g, s, r, t)
        if g.wants[POINTS] != 0:
            _by_points(c, g, s, r, t)
        for k in range(len(lam)):
            copy(x.multipliers[r, k], g.lam_bar[k])
        for k in range(len(h.top.springs)):
            for i in range(4):
                g.pull_bar[k, i] = x.forces[r, k, i]
        _reactions(h, g, x.reactions[r], lam, to_q)
        _energies(h, g, x.kinetic[r], x.gravity[r], q, v, to_q, to_v)
        _pull_back(h, c, g, s, r, t)
    return OK, end


@subkernel
def _add(x, y, factor, to_x, to_y):
    """Add `factor` times `x` and `y`, without those of ground, to two other vectors.

    Three numbers at once, which are few: a longer loop first finds out whether the vectors overlap.
    """
    for b in range(0, len(x) - 3, 3):
        for d in range(3):
            to_x[b + d] += factor * x[b + d]
            to_y[b + d] += factor * y[b + d]


@subkernel
def _add_one(x, factor, to_x):
    """Add `factor` times `x`, without that of ground, to another vector."""
    for b in range(0, len(x) - 3, 3):
        for d in range(3):
            to_x[b + d] += factor * x[b + d]


@subkernel
def _place_stage(s, n, i, count):
    """Write the state of stage `i` of step `n` from the rates of the first `count` stages."""
    v = s.v_stage[i]
    copy(s.v[n], v)
    for j in range(count):
        if s.a[i, j] != 0.0:
            _add_one(s.acc[j], s.size[n] * s.a[i, j], v)
    if s.is_kept[1] == 0:
        _place_positions(s, n, i, count)


@subkernel
def _place_positions(s, n, i, count):
    """Write the positions of stage `i` of step `n` from the velocities of the first `count` stages."""
    q = s.q_stage[i]
    copy(s.q[n], q)
    for j in range(count):
        if s.a[i, j] != 0.0:
            _add_one(s.v_stage[j], s.size[n] * s.a[i, j], q)


@subkernel
def _row(s, n, i):
    """Return the number of the row of stage `i` of step `n`."""
    return n * len(s.b) + i if s.is_kept[0] != 0 else i


@subkernel
def _touch(s, n):
    """Read a number of each cache line of the kept stages of step `n` and some before it, if it begins such a block.

    Memory is fetched forward, while steps are taken back: without this, a quarter of the time is spent waiting for it.
    """
    count = BLOCK // (len(s.b) * len(s.rows[0])) + 1
    if (n + 1) % count != 0:
        return
    total = 0.0
    for r in range((n + 1 - count) * len(s.b), (n + 1) * len(s.b)):
        row = s.rows[r]
        for d in range(0, len(row), LINE):
            total += row[d]
    s.touched[0] = total


@subkernel
def _take_stages(h, s, n):
    """Evaluate the stages of step `n` unless they are kept; return a status."""
    if s.is_implicit[0] != 0:
        return _iterate_stages(h, s, n)
    if s.is_kept[0] != 0:
        _touch(s, n)
    for i in range(len(s.b)):
        _place_stage(s, n, i, i)
        if s.is_kept[0] != 0:
            take_stage(s.acc[i], s.lam[i], s.rows[_row(s, n, i)])
            continue
        t = s.time[n] + s.c[i] * s.size[n]
        status = _accelerations(h, t, s.q_stage[i], s.v_stage[i], s.acc[i], s.lam[i], False)
        if status != OK:
            return status
        keep_stage(h.w, h.solver, s.acc[i], s.lam[i], s.rows[i])
    return OK


@subkernel
def _has_converged(change, largest, before, rounding):
    """Return whether an iteration ends; see `NEARLY`."""
    is_stalled = change >= STALLED * before and change <= max(NEGLIGIBLE * largest, rounding)
    # the next change would be smaller by the same factor; a first one so small confirms a solution that was kept
    is_small = change <= NEARLY * largest and change * change <= SMALL * largest * before
    return change <= SMALL * largest or is_stalled or is_small


@subkernel
def _iterate_stages(h, s, n):
    """Solve for the accelerations of the stages of step `n`; return a status.

    The iteration begins with those of `Steps.guess`, or else with those of the step after this one.
    """
    stages, before = len(s.b), np.inf
    # forces that cancel leave their round-off in accelerations, which may be small; so do positions
    far = 0.0
    for d in range(len(s.next)):
        far = max(far, abs(s.q[n, d]))
    rounding = SMALL * far / (s.size[n] * s.size[n])
    for i in range(stages if len(s.guess) > 0 else 0):
        copy(s.guess[n * stages + i], s.acc[i])
    for _ in range(MOST_ITERATIONS):
        # velocities first: positions depend on those of all stages
        for _ in range(2):
            for i in range(stages):
                _place_stage(s, n, i, stages)
        change = largest = 0.0
        for i in range(stages):
            t = s.time[n] + s.c[i] * s.size[n]
            copy(s.acc[i], s.next)
            status = _accelerations(h, t, s.q_stage[i], s.v_stage[i], s.next, s.lam[i], False)
            if status != OK:
                return status
            keep_stage(h.w, h.solver, s.next, s.lam[i], s.rows[i])
            for d in range(len(s.next)):
                change = max(change, abs(s.next[d] - s.acc[i, d]))
                largest = max(largest, abs(s.next[d]))
            copy(s.next, s.acc[i])
        if _has_converged(change, largest, before, rounding):
            return OK
        if not change < np.inf:
            return DIVERGED
        before = change
    return DIVERGED


@subkernel
def _take_factors(h, s, n, i, t):
    """Restore the factors of the system of stage `i` of step `n`; return a status."""
    if h.solver.pivoted[0] != 0:
        if s.is_kept[1] != 0:
            _place_positions(s, n, i, i)
        return _accelerations(h, t, s.q_stage[i], s.v_stage[i], s.acc[i], s.lam[i], False)
    pass_factors(h.w, h.solver, s.acc[i], s.lam[i], s.rows[_row(s, n, i)], True)
    return OK


@subkernel
def _write_stages(h, s, first, end):
    stages = len(s.b)
    for n in range(first, end):
        status = _take_stages(h, s, n)
        if status != OK:
            return status, n
        for i in range(stages):
            copy(s.q_stage[i], s.stage_q_bar[n * stages + i])
            copy(s.v_stage[i], s.stage_v_bar[n * stages + i])
    return OK, end


@subkernel
def _begin_stage(s, n, i):
    """Write the derivatives with respect to stage `i` of step `n` that do not come from other stages."""
    factor, row, q_bar, v_bar = s.size[n] * s.b[i], n * len(s.b) + i, s.q_bar[n + 1], s.v_bar[n + 1]
    to_q, to_v, to_acc = s.to_q[i], s.to_v[i], s.to_acc[i]
    for d in range(len(to_q)):
        to_q[d] = 0.0
        to_v[d] = factor * q_bar[d]
        to_acc[d] = factor * v_bar[d]
    if len(s.stage_q_bar) > 0:
        _add(s.stage_q_bar[row], s.stage_v_bar[row], 1.0, to_q, to_v)


@subkernel
def _iterate_derivatives(h, c, g, s, n):
    """Solve for the derivatives with respect to the stages of an implicit step; return a status.

    The iteration begins with those of the step after this one.
    """
    stages, size, before = len(s.b), s.size[n], np.inf
    for i in range(stages):
        t = s.time[n] + s.c[i] * size
        status = _take_factors(h, s, n, i, t)
        if status != OK:
            return status
        _tangents(h, g, s, i, t)
        copy(h.w.source[: len(s.source[i])], s.source[i])
    for _ in range(MOST_ITERATIONS):
        change = largest = 0.0
        for i in range(stages):
            _begin_stage(s, n, i)
            _add(s.by_q[i], s.by_v[i], 1.0, s.to_q[i], s.to_v[i])
        for i in range(stages):
            for j in range(stages):
                _add_one(s.to_q[j], size * s.a[j, i], s.to_v[i])
        for i in range(stages):
            for j in range(stages):
                _add_one(s.to_v[j], size * s.a[j, i], s.to_acc[i])
        for i in range(stages):
            t = s.time[n] + s.c[i] * size
            status = _take_factors(h, s, n, i, t)
            if status != OK:
                return status
            if len(h.top.frictions) > 0:
                _tangents(h, g, s, i, t)
                _by_reactions(h, c, g, s, i, t)
            else:
                copy(s.source[i], h.w.source)
            copy(s.by_v[i], s.next)
            fill(s.by_q[i], 0.0)
            fill(s.by_v[i], 0.0)
            _solve_adjoint(h, g, s, i)
            _to_state(h, g, s, i, g.unused, s.by_q[i], s.by_v[i])
            for d in range(len(s.next)):
                # derivatives by positions count as those by velocities, over the step
                change = max(change, abs(s.by_v[i, d] - s.next[d]), size * abs(s.by_q[i, d] - s.kept[i, d]))
                largest = max(largest, abs(s.to_v[i, d]), size * abs(s.by_q[i, d]))
            copy(s.by_q[i], s.kept[i])
        if _has_converged(change, largest, before, 0.0):
            return OK
        if not change < np.inf:
            return DIVERGED
        before = change
    return DIVERGED


@subkernel
def _through_stage(h, c, g, s, n, i):
    """Add what follows from the derivatives with respect to the accelerations of stage `i`; return a status."""
    t = s.time[n] + s.c[i] * s.size[n]
    status = _take_factors(h, s, n, i, t)
    if status != OK:
        return status
    _tangents(h, g, s, i, t)
    if g.wants[POINTS] != 0:
        _by_points(c, g, s, i, t)
    _pull_back(h, c, g, s, i, t)
    return OK


@subkernel
def _sweep_back(h, c, g, s, first, before):
    is_explicit = s.is_implicit[0] == 0
    fill_rows(g.lam_bar, 0.0)
    fill_rows(g.pull_bar, 0.0)
    if first < before:  # writes what is constant in the Jacobian
        _accelerations(h, s.time[first], s.q[first], s.v[first], s.next, s.lam[0], False)
    for n in range(before - 1, first - 1, -1):
        status = _take_stages(h, s, n)
        if status == OK and not is_explicit:
            status = _iterate_derivatives(h, c, g, s, n)
        if status != OK:
            return status, n + 1
        for i in range(len(s.b) if is_explicit else 0):
            _begin_stage(s, n, i)
        q_bar, v_bar = s.q_bar[n], s.v_bar[n]
        _add(s.q_bar[n + 1], s.v_bar[n + 1], 1.0, q_bar, v_bar)
        for i in range(len(s.b) - 1, -1, -1):
            to_q, to_v = s.to_q[i], s.to_v[i]
            if not is_explicit:  # these contain what follows from their accelerations already
                _add(to_q, to_v, 1.0, q_bar, v_bar)
            status = _through_stage(h, c, g, s, n, i)
            if status != OK:
                return status, n + 1
            if is_explicit:
                for j in range(i):
                    if s.a[i, j] != 0.0:
                        _add(to_q, to_v, s.size[n] * s.a[i, j], s.to_v[j], s.to_acc[j])
                _add(to_q, to_v, 1.0, q_bar, v_bar)
        for i in range(len(q_bar) - 3, len(q_bar)):
            q_bar[i] = v_bar[i] = 0.0
    return OK, first


PULL, STAGES, SWEEP = range(3)  #: Tasks of `differentiate_back`.


@kernel
def differentiate_back(
    engine: int, duals: int, adjoint: int, given: int, steps: int, task: int, first: int, end: int
) -> tuple[int, int]:
    """Do a task for states or steps, whose numbers are from `first` to ``end - 1``; return a status and a number.

    PULL adds what follows from the derivatives in `Given` to the results in `Steps`, and STAGES writes the states of
    the stages of `Steps` into their arrays of derivatives; the number is that of the next state or step.
    SWEEP carries derivatives back through `Steps`; the number is that of the first step passed.
    """
    h, c, g, s = load_engine(engine), load_dual_states(duals), load_adjoint(adjoint), load_steps(steps)
    if task == PULL:
        return _pull_states(h, c, g, load_given(given), s, first, end)
    if task == STAGES:
        return _write_stages(h, s, first, end)
    return _sweep_back(h, c, g, s, first, end)
