"""Applied forces: force elements (pathway x law), torques and point forces, with tangents, powers and potentials.

A force element pulls its bodies together with the tension ``F(s, s', t)`` along its pathway's length ``s``: the
generalized force is ``Q = -F s_q``. Gravity is not here: it is a constant acceleration and enters in the solvers.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.jit.decorators import subkernel
from mbdkit.engine.jit.law_calls import HAS_POTENTIAL, PASSIVE, call_law
from mbdkit.engine.kernels import element_kernels as e

PATHWAYS = {name: code for code, name in enumerate(e.PATHWAY_KINDS)}
_TWO_POINTS, _RELATIVE_ANGLE, _COORDINATE_X, _COORDINATE_Y = range(len(PATHWAYS))
TORQUE, POINT_FORCE, BODY_FORCE = range(3)
"""Kinds of loads; the force of a POINT_FORCE is given in the global frame, that of a BODY_FORCE in the body's own."""

two_points_gradient, relative_angle_gradient = e.two_points_gradient, e.relative_angle_gradient
coordinate_x_gradient, coordinate_y_gradient = e.coordinate_x_gradient, e.coordinate_y_gradient
two_points_hessian = e.two_points_hessian
coordinate_x_hessian, coordinate_y_hessian = e.coordinate_x_hessian, e.coordinate_y_hessian


@subkernel
def pathway_lengths(springs, points, q, cs, s, grad):
    """Write every pathway's length into `s` (S, 1) and its gradient into `grad` (S, 6)."""
    for k in range(len(springs)):
        a, b = springs[k, 1], springs[k, 2]
        if springs[k, 0] == _TWO_POINTS:
            two_points_gradient(k, a, b, q, cs, points, s, grad)
            if s[k, 0] == 0.0:  # no direction: the two points coincide
                for i in range(6):
                    grad[k, i] = 0.0
        elif springs[k, 0] == _RELATIVE_ANGLE:
            relative_angle_gradient(k, a, b, q, cs, points, s, grad)
        elif springs[k, 0] == _COORDINATE_X:
            coordinate_x_gradient(k, a, b, q, cs, points, s, grad)
        else:
            coordinate_y_gradient(k, a, b, q, cs, points, s, grad)


@subkernel
def path_rate(k, a, b, v, grad):
    """Return the rate s' of pathway `k`."""
    rate = 0.0
    for i in range(3):
        rate += grad[k, i] * v[3 * a + i] + grad[k, 3 + i] * v[3 * b + i]
    return rate


@subkernel
def evaluate_tension(k, springs, linear, laws, parameters, time, length, rate, tension, faulty):
    """Write F, dF/ds, dF/ds' and the potential of force element `k` into its row of `tension` (S + 1, 4).

    A law that has no finite force where its arguments are finite is noted in `faulty` (1,).
    """
    law = springs[k, 3]
    if law < 0:
        stiffness, damping, stretch = linear[k, 0], linear[k, 1], length - linear[k, 2]
        tension[k, 0] = stiffness * stretch + damping * rate
        tension[k, 1] = stiffness
        tension[k, 2] = damping
        tension[k, 3] = 0.5 * stiffness * stretch * stretch
    else:
        call_law(laws[law, 0], length, rate, time[0], parameters, laws[law, 1], tension, k)
        if not abs(tension[k, 0]) < np.inf and abs(length) < np.inf and abs(rate) < np.inf:
            faulty[0] = law


@subkernel
def applied_forces(
    springs, points, linear, laws, parameters, loads, load_points, q, v, cs, u, time, s, grad, tension, faulty, force
):
    """Write the generalized applied forces without gravity into `force` (3 (B + 1),)."""
    force[:] = 0.0
    pathway_lengths(springs, points, q, cs, s, grad)
    for k in range(len(springs)):
        a, b = springs[k, 1], springs[k, 2]
        rate = path_rate(k, a, b, v, grad)
        evaluate_tension(k, springs, linear, laws, parameters, time, s[k, 0], rate, tension, faulty)
        pull = tension[k, 0]
        for i in range(3):
            force[3 * a + i] -= pull * grad[k, i]
            force[3 * b + i] -= pull * grad[k, 3 + i]
    for k in range(len(loads)):
        body = loads[k, 1]
        if loads[k, 0] == TORQUE:
            value = u[loads[k, 3], 0]
            force[3 * body + 2] += value
            force[3 * loads[k, 2] + 2] -= value
        else:
            fx, fy, px, py = point_force(k, loads, load_points, cs, u)
            force[3 * body] += fx
            force[3 * body + 1] += fy
            force[3 * body + 2] += px * fy - py * fx


@subkernel
def point_force(k, loads, load_points, cs, u):
    """Return the force of load `k` and its arm from the centre of mass, (F_x, F_y, p_x, p_y), in the global frame."""
    body = loads[k, 1]
    fx, fy = u[loads[k, 3], 0], u[loads[k, 4], 0]
    c, sn = cs[body, 0], cs[body, 1]
    if loads[k, 0] == BODY_FORCE:
        fx, fy = c * fx - sn * fy, sn * fx + c * fy
    px, py = c * load_points[k, 0] - sn * load_points[k, 1], sn * load_points[k, 0] + c * load_points[k, 1]
    return fx, fy, px, py


@subkernel
def force_tangents(
    springs, points, linear, laws, parameters, loads, load_points, q, v, cs, u, time,
    s, grad, hess, tension, faulty, stiff, damp, load_stiff,
):  # fmt: skip
    """Write K = -dQ/dq and C = -dQ/dv of every element.

    `stiff`, `damp`: (S, 36) of the force elements; `load_stiff`: (L, 3), of the point forces: the entries x-theta and
    y-theta of those that turn with their bodies, and theta-theta of those that do not.
    """
    pathway_lengths(springs, points, q, cs, s, grad)
    for k in range(len(springs)):
        a, b = springs[k, 1], springs[k, 2]
        evaluate_tension(
            k, springs, linear, laws, parameters, time, s[k, 0], path_rate(k, a, b, v, grad), tension, faulty
        )
        pull, stiffness, damping = tension[k, 0], tension[k, 1], tension[k, 2]
        if not (abs(stiffness) < np.inf and abs(damping) < np.inf) and abs(pull) < np.inf:
            faulty[0] = springs[k, 3]
        curved = True
        if springs[k, 0] == _TWO_POINTS:
            curved = s[k, 0] != 0.0
            if curved:
                two_points_hessian(k, a, b, q, cs, points, hess)
        elif springs[k, 0] == _COORDINATE_X:
            coordinate_x_hessian(k, a, b, q, cs, points, hess)
        elif springs[k, 0] == _COORDINATE_Y:
            coordinate_y_hessian(k, a, b, q, cs, points, hess)
        else:
            curved = False
        for i in range(6):
            for j in range(6):
                stiff[k, 6 * i + j] = stiffness * grad[k, i] * grad[k, j]
                damp[k, 6 * i + j] = damping * grad[k, i] * grad[k, j]
        if curved:
            for j in range(6):
                bend = 0.0  # column j of (s_q v)_q
                for i in range(3):
                    bend += hess[k, 6 * i + j] * v[3 * a + i] + hess[k, 6 * (3 + i) + j] * v[3 * b + i]
                for i in range(6):
                    stiff[k, 6 * i + j] += pull * hess[k, 6 * i + j] + damping * grad[k, i] * bend
    for k in range(len(loads)):
        if loads[k, 0] == TORQUE:
            continue
        fx, fy, px, py = point_force(k, loads, load_points, cs, u)
        if loads[k, 0] == BODY_FORCE:  # turns with its arm, so that its moment stays
            load_stiff[k, 0] = fy
            load_stiff[k, 1] = -fx
        else:
            load_stiff[k, 2] = px * fx + py * fy


@subkernel
def powers(springs, linear, laws, parameters, loads, load_points, pairs, v, cs, u, time, s, grad, tension, phi_t, lam):
    """Return (power of loads, drivers and active laws, dissipated power) [W]; all else as the last evaluation left it.

    Of a law's power ``F s'``, the part ``V_s s'`` goes into its potential; of the rest the law says what becomes.
    """
    work = 0.0
    lost = 0.0
    for k in range(len(springs)):
        rate = path_rate(k, springs[k, 1], springs[k, 2], v, grad)
        law = springs[k, 3]
        if law < 0:
            lost += linear[k, 1] * rate * rate
            continue
        rest = tension[k, 0]
        claims = laws[law, 2]
        if claims & HAS_POTENTIAL != 0:
            spare = len(springs)
            call_law(laws[law, 0], s[k, 0], 0.0, time[0], parameters, laws[law, 1], tension, spare)
            rest -= tension[spare, 0]
        if claims & PASSIVE != 0:
            lost += rest * rate
        else:
            work -= rest * rate
    for k in range(len(loads)):
        body = loads[k, 1]
        if loads[k, 0] == TORQUE:
            work += u[loads[k, 3], 0] * (v[3 * body + 2] - v[3 * loads[k, 2] + 2])
        else:
            fx, fy, px, py = point_force(k, loads, load_points, cs, u)
            w = v[3 * body + 2]
            work += fx * (v[3 * body] - w * py) + fy * (v[3 * body + 1] + w * px)
    for k in range(len(pairs)):
        if pairs[k, 3] >= 0:
            work += lam[k, 0] * phi_t[k, 0] + lam[k, 1] * phi_t[k, 1]
    return work, lost


@subkernel
def potential_energy(springs, laws, mass, gravity, q, tension):
    """Return the potential energy [J] of gravity and force elements, the latter as the last evaluation left it.

    It is zero at the global origin and at the free length of a linear spring; a law chooses its own zero.
    """
    energy = 0.0
    for b in range(len(mass) - 1):
        energy -= mass[b, 0] * (gravity[0] * q[3 * b] + gravity[1] * q[3 * b + 1])
    for k in range(len(springs)):
        law = springs[k, 3]
        if law < 0 or laws[law, 2] & HAS_POTENTIAL != 0:
            energy += tension[k, 3]
    return energy
