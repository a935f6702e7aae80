"""Applied forces: force elements (pathway x law), torques and point forces, with tangents, powers and potentials.

A force element pulls its bodies together with the tension ``F(s, s', t)`` along its pathway's length ``s``: the
generalized force is ``Q = -F s_q``. Gravity is not here: it is a constant acceleration and enters in the solvers.
"""

from __future__ import annotations

from mbdkit.engine import elements as e
from mbdkit.engine.cache import part

PATHWAYS = {name: code for code, name in enumerate(e.PATHWAY_KINDS)}
_TWO_POINTS, _RELATIVE_ANGLE = range(len(PATHWAYS))
TORQUE, POINT_FORCE = range(2)

two_points_gradient, relative_angle_gradient = e.two_points_gradient, e.relative_angle_gradient
two_points_hessian = e.two_points_hessian


@part
def pathway_lengths(springs, points, q, cs, s, grad):
    """Write every pathway's length into `s` (S, 1) and its gradient into `grad` (S, 6)."""
    for k in range(len(springs)):
        a, b = springs[k, 1], springs[k, 2]
        if springs[k, 0] == _TWO_POINTS:
            two_points_gradient(k, a, b, q, cs, points, s, grad)
            if s[k, 0] == 0.0:  # no direction: the two points coincide
                for i in range(6):
                    grad[k, i] = 0.0
        else:
            relative_angle_gradient(k, a, b, q, cs, points, s, grad)


@part
def path_rate(k, a, b, v, grad):
    """Return the rate s' of pathway `k`."""
    rate = 0.0
    for i in range(3):
        rate += grad[k, i] * v[3 * a + i] + grad[k, 3 + i] * v[3 * b + i]
    return rate


@part
def applied_forces(springs, points, laws, loads, load_points, q, v, cs, u, s, grad, force):
    """Write the generalized applied forces without gravity into `force` (3 (B + 1),)."""
    force[:] = 0.0
    pathway_lengths(springs, points, q, cs, s, grad)
    for k in range(len(springs)):
        a, b = springs[k, 1], springs[k, 2]
        tension = laws[k, 0] * (s[k, 0] - laws[k, 2]) + laws[k, 1] * path_rate(k, a, b, v, grad)
        for i in range(3):
            force[3 * a + i] -= tension * grad[k, i]
            force[3 * b + i] -= tension * grad[k, 3 + i]
    for k in range(len(loads)):
        body, mx = loads[k, 1], loads[k, 3]
        if loads[k, 0] == TORQUE:
            force[3 * body + 2] += u[mx, 0]
            force[3 * loads[k, 2] + 2] -= u[mx, 0]
        else:
            fx, fy = u[mx, 0], u[loads[k, 4], 0]
            c, sn = cs[body, 0], cs[body, 1]
            px, py = c * load_points[k, 0] - sn * load_points[k, 1], sn * load_points[k, 0] + c * load_points[k, 1]
            force[3 * body] += fx
            force[3 * body + 1] += fy
            force[3 * body + 2] += px * fy - py * fx


@part
def force_tangents(springs, points, laws, loads, load_points, q, v, cs, u, s, grad, hess, stiff, damp, load_stiff):
    """Write K = -dQ/dq and C = -dQ/dv of every element.

    `stiff`, `damp`: (S, 36) of the force elements; `load_stiff`: (L, 1), the theta-theta entry of the point forces.
    """
    pathway_lengths(springs, points, q, cs, s, grad)
    for k in range(len(springs)):
        a, b = springs[k, 1], springs[k, 2]
        stiffness, damping = laws[k, 0], laws[k, 1]
        tension = stiffness * (s[k, 0] - laws[k, 2]) + damping * path_rate(k, a, b, v, grad)
        curved = springs[k, 0] == _TWO_POINTS and s[k, 0] != 0.0
        if curved:
            two_points_hessian(k, a, b, q, cs, points, hess)
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
                    stiff[k, 6 * i + j] += tension * hess[k, 6 * i + j] + damping * grad[k, i] * bend
    for k in range(len(loads)):
        if loads[k, 0] == POINT_FORCE:
            body = loads[k, 1]
            c, sn = cs[body, 0], cs[body, 1]
            px, py = c * load_points[k, 0] - sn * load_points[k, 1], sn * load_points[k, 0] + c * load_points[k, 1]
            load_stiff[k, 0] = px * u[loads[k, 3], 0] + py * u[loads[k, 4], 0]


@part
def powers(springs, laws, loads, load_points, pairs, v, cs, u, grad, phi_t, lam):
    """Return (power of loads and drivers, dissipated power) [W]; gradients and Phi_t as left by the last evaluation."""
    work = 0.0
    lost = 0.0
    for k in range(len(springs)):
        rate = path_rate(k, springs[k, 1], springs[k, 2], v, grad)
        lost += laws[k, 1] * rate * rate
    for k in range(len(loads)):
        body, mx = loads[k, 1], loads[k, 3]
        if loads[k, 0] == TORQUE:
            work += u[mx, 0] * (v[3 * body + 2] - v[3 * loads[k, 2] + 2])
        else:
            fx, fy = u[mx, 0], u[loads[k, 4], 0]
            c, sn = cs[body, 0], cs[body, 1]
            px, py = c * load_points[k, 0] - sn * load_points[k, 1], sn * load_points[k, 0] + c * load_points[k, 1]
            w = v[3 * body + 2]
            work += fx * (v[3 * body] - w * py) + fy * (v[3 * body + 1] + w * px)
    for k in range(len(pairs)):
        if pairs[k, 3] >= 0:
            work += lam[k, 0] * phi_t[k, 0] + lam[k, 1] * phi_t[k, 1]
    return work, lost


@part
def potential_energy(springs, points, laws, mass, gravity, q, cs, s, grad):
    """Return the potential energy [J] of gravity and springs; zero at the global origin and at free length."""
    energy = 0.0
    for b in range(len(mass) - 1):
        energy -= mass[b, 0] * (gravity[0] * q[3 * b] + gravity[1] * q[3 * b + 1])
    pathway_lengths(springs, points, q, cs, s, grad)
    for k in range(len(springs)):
        stretch = s[k, 0] - laws[k, 2]
        energy += 0.5 * laws[k, 0] * stretch * stretch
    return energy
