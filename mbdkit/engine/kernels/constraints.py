"""Loops over the constraints of a mechanism, kind by kind.

Constraints are kept in pairs of rows: a kind of one row leaves its second row empty, which the solvers fill with a
unit diagonal. So every block of the Schur complement is 2 x 2, whatever the mechanism.
"""

from __future__ import annotations

from math import cos, sin

from mbdkit.engine.jit.decorators import subkernel
from mbdkit.engine.kernels import element_kernels as e

KINDS = {name: code for code, name in enumerate(e.CONSTRAINT_KINDS)}
(
    _REVOLUTE, _DISTANCE, _DRIVER_ANGLE, _DRIVER_X, _DRIVER_Y, _POINT_ON_LINE, _FIXED_ANGLE,
) = range(len(KINDS))  # fmt: skip

revolute_position, distance_position = e.revolute_position, e.distance_position
driver_angle_position, driver_x_position = e.driver_angle_position, e.driver_x_position
driver_y_position = e.driver_y_position
point_on_line_position, fixed_angle_position = e.point_on_line_position, e.fixed_angle_position
revolute_acceleration, distance_acceleration = e.revolute_acceleration, e.distance_acceleration
driver_angle_acceleration, driver_x_acceleration = e.driver_angle_acceleration, e.driver_x_acceleration
driver_y_acceleration = e.driver_y_acceleration
point_on_line_acceleration, fixed_angle_acceleration = e.point_on_line_acceleration, e.fixed_angle_acceleration
revolute_tangent, distance_tangent = e.revolute_tangent, e.distance_tangent
driver_angle_tangent, driver_x_tangent, driver_y_tangent = (
    e.driver_angle_tangent,
    e.driver_x_tangent,
    e.driver_y_tangent,
)
point_on_line_tangent, fixed_angle_tangent = e.point_on_line_tangent, e.fixed_angle_tangent


@subkernel
def turn_bodies(q, cs):
    """Write cosine and sine of every body's tilt into `cs` (B + 1, 2); ground comes last and keeps (1, 0)."""
    for b in range(len(cs) - 1):
        theta = q[3 * b + 2]
        cs[b, 0] = cos(theta)
        cs[b, 1] = sin(theta)


@subkernel
def constraint_positions(pairs, p, q, cs, u, phi, phi_t):
    """Evaluate Phi and Phi_t of every pair: (P, 2) arrays."""
    for k in range(len(pairs)):
        kind, a, b, m = pairs[k, 0], pairs[k, 1], pairs[k, 2], pairs[k, 3]
        if kind == _REVOLUTE:
            revolute_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        elif kind == _DISTANCE:
            distance_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        elif kind == _DRIVER_ANGLE:
            driver_angle_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        elif kind == _DRIVER_X:
            driver_x_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        elif kind == _DRIVER_Y:
            driver_y_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        elif kind == _POINT_ON_LINE:
            point_on_line_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        else:
            fixed_angle_position(k, a, b, m, q, cs, p, u, phi, phi_t)


@subkernel
def constraint_accelerations(pairs, p, q, v, cs, u, jac, gamma):
    """Evaluate the Jacobian (P, 12) and the right side gamma (P, 2) of every pair."""
    for k in range(len(pairs)):
        kind, a, b, m = pairs[k, 0], pairs[k, 1], pairs[k, 2], pairs[k, 3]
        if kind == _REVOLUTE:
            revolute_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        elif kind == _DISTANCE:
            distance_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        elif kind == _DRIVER_ANGLE:
            driver_angle_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        elif kind == _DRIVER_X:
            driver_x_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        elif kind == _DRIVER_Y:
            driver_y_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        elif kind == _POINT_ON_LINE:
            point_on_line_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        else:
            fixed_angle_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)


@subkernel
def constraint_tangents(pairs, p, q, v, acc, cs, u, lam, stiff, gamma_v, res_q):
    """Evaluate d(Phi_q^T lam)/dq (P, 36), d gamma/dv (P, 12) and d(Phi_q a - gamma)/dq (P, 12) of every pair."""
    for k in range(len(pairs)):
        kind, a, b, m = pairs[k, 0], pairs[k, 1], pairs[k, 2], pairs[k, 3]
        if kind == _REVOLUTE:
            revolute_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        elif kind == _DISTANCE:
            distance_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        elif kind == _DRIVER_ANGLE:
            driver_angle_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        elif kind == _DRIVER_X:
            driver_x_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        elif kind == _DRIVER_Y:
            driver_y_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        elif kind == _POINT_ON_LINE:
            point_on_line_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        else:
            fixed_angle_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
