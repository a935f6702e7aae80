"""Element kernels, generated from the definitions by ``python -m mbdkit_builder elements``. Do not edit.

Each element kernel writes the values of element `k` into row `k` of its output arrays; each ``constraint_*`` function
calls the kernels of all pairs of constraint rows. Arguments:

k : index of the element; a, b : first and second body; m : index of the motion that drives the element, or of the
    first of the four functions of the relative angle that move its center: x, its derivative, y, and its derivative;
    for a function of the pose, first row of its value and derivatives
pairs : (P, 4) pairs of constraint rows, see `PairRow`
q, v, acc : (3 (B + 1),) coordinates x, y, theta of every body, velocities and accelerations; ground comes last
cs : (B + 1, 2) cosine and sine of every theta
p : (K, 6) parameters, points in body frames first
u : (motions, 3) value, first and second derivative of each motion with respect to time, and of each function that moves
    a center with respect to the angle; then value and derivatives of functions of the pose, see `Scratch.u`
lam : (K, 2) multipliers
z, p : for cross-sections of beams, (G, 10) state, its rates, cosine and sine, and (G, 16) parameters, of which the
    first six are values and derivatives of the shape functions, which these kernels do not read

The columns of a Jacobian are (x_a, y_a, theta_a, x_b, y_b, theta_b). A Jacobian of two rows is stored row by row in 12
columns, a tangent (6, 6) row by row in 36. Entries that are identically zero are never written: the output arrays must
hold zeros there. The ``*_ENTRIES`` tables list the flat indices of all other entries. All entries of gamma are written,
because projections and Baumgarte's terms change them.
"""

# fmt: off
from math import sqrt

from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.native.functions import subkernel



CONSTRAINT_KINDS = ('revolute', 'distance', 'driver_angle', 'driver_travel', 'point_on_line', 'fixed_angle', 'moving_center', 'function')


PATHWAY_KINDS = ('two_points', 'relative_angle', 'pulley', 'lifted', 'travel', 'tangent', 'guided')


JACOBIAN_ENTRIES = {
    "revolute": (0, 2, 3, 5, 7, 8, 10, 11),
    "distance": (0, 1, 2, 3, 4, 5),
    "driver_angle": (2, 5),
    "driver_travel": (0, 1, 2, 3, 4, 5),
    "point_on_line": (0, 1, 2, 3, 4, 5),
    "fixed_angle": (2, 5),
    "moving_center": (0, 2, 3, 5, 7, 8, 10, 11),
    "function": (0, 1, 2, 3, 4, 5),
}


STIFFNESS_ENTRIES = {
    "revolute": (14, 35),
    "distance": (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35),
    "driver_angle": (),
    "driver_travel": (2, 8, 12, 13, 14, 15, 16, 17, 20, 26, 32, 35),
    "point_on_line": (2, 8, 12, 13, 14, 15, 16, 17, 20, 26, 32, 35),
    "fixed_angle": (),
    "moving_center": (14, 17, 32, 35),
    "function": (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35),
}


GAMMA_V_ENTRIES = {
    "revolute": (2, 5, 8, 11),
    "distance": (0, 1, 2, 3, 4, 5),
    "driver_angle": (),
    "driver_travel": (0, 1, 2, 3, 4, 5),
    "point_on_line": (0, 1, 2, 3, 4, 5),
    "fixed_angle": (),
    "moving_center": (2, 5, 8, 11),
    "function": (0, 1, 2, 3, 4, 5),
}


RESIDUAL_Q_ENTRIES = {
    "revolute": (2, 5, 8, 11),
    "distance": (0, 1, 2, 3, 4, 5),
    "driver_angle": (),
    "driver_travel": (0, 1, 2, 3, 4, 5),
    "point_on_line": (0, 1, 2, 3, 4, 5),
    "fixed_angle": (),
    "moving_center": (2, 5, 8, 11),
    "function": (0, 1, 2, 3, 4, 5),
}


GRADIENT_ENTRIES = {
    "two_points": (0, 1, 2, 3, 4, 5),
    "relative_angle": (2, 5),
    "pulley": (2, 5),
    "lifted": (0, 1, 2, 3, 4, 5),
    "travel": (0, 1, 2, 3, 4, 5),
    "tangent": (0, 1, 2, 3, 4, 5),
    "guided": (0, 1, 2, 3, 4, 5),
}


HESSIAN_ENTRIES = {
    "two_points": (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35),
    "relative_angle": (),
    "pulley": (),
    "lifted": (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35),
    "travel": (2, 8, 12, 13, 14, 15, 16, 17, 20, 26, 32, 35),
    "tangent": (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35),
    "guided": (2, 5, 8, 11, 12, 13, 14, 15, 16, 17, 20, 23, 26, 29, 30, 31, 32, 33, 34, 35),
}


@subkernel
def revolute_position(k, a, b, m, q, cs, p, u, phi, phi_t):
    """Phi = p_b - p_a of two points that coincide, and Phi_t."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    phi[k, 0] = gx
    phi[k, 1] = gy


@subkernel
def revolute_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma):
    """Jacobian Phi_q and right-hand side gamma of Phi_q a = gamma."""
    wa, wb = v[3*a+2], v[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    t0 = (wa*wa)
    t1 = (wb*wb)
    jac[k, 0] = jac[k, 7] = -1.0
    jac[k, 2] = ay
    jac[k, 3] = jac[k, 10] = 1.0
    jac[k, 5] = -by
    jac[k, 8] = -ax
    jac[k, 11] = bx
    gamma[k, 0] = -ax*t0 + bx*t1
    gamma[k, 1] = -ay*t0 + by*t1


@subkernel
def revolute_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q):
    """d(Phi_q^T lam)/dq, d gamma/dv and d(Phi_q a - gamma)/dq."""
    wa, wb = v[3*a+2], v[3*b+2]
    ala, alb = acc[3*a+2], acc[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    lam0, lam1 = lam[k, 0], lam[k, 1]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    t0 = 2*wa
    t1 = 2*wb
    t2 = (wa*wa)
    t3 = (wb*wb)
    stiff[k, 14] = ax*lam0 + ay*lam1
    stiff[k, 35] = -bx*lam0 - by*lam1
    gamma_v[k, 2] = -ax*t0
    gamma_v[k, 5] = bx*t1
    gamma_v[k, 8] = -ay*t0
    gamma_v[k, 11] = by*t1
    res_q[k, 2] = ala*ax - ay*t2
    res_q[k, 5] = -alb*bx + by*t3
    res_q[k, 8] = ala*ay + ax*t2
    res_q[k, 11] = -alb*by - bx*t3


@subkernel
def distance_position(k, a, b, m, q, cs, p, u, phi, phi_t):
    """Phi = |p_b - p_a| - length, and Phi_t."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3, p4 = p[k, 0], p[k, 1], p[k, 2], p[k, 3], p[k, 4]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    length = sqrt((gx*gx) + (gy*gy))
    phi[k, 0] = length - p4


@subkernel
def distance_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma):
    """Jacobian Phi_q and right-hand side gamma of Phi_q a = gamma."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    vxa, vya, wa, vxb, vyb, wb = v[3*a+0], v[3*a+1], v[3*a+2], v[3*b+0], v[3*b+1], v[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    length = sqrt((gx*gx) + (gy*gy))
    t0 = (1.0/length)
    t1 = gx*t0
    t2 = gy*t0
    t3 = ax*gy - ay*gx
    t4 = bx*gy - by*gx
    t5 = (1.0/(length*length))
    t6 = -gx*vxa + gx*vxb - gy*vya + gy*vyb - t3*wa + t4*wb
    t7 = -t5*t6
    t8 = ay*wa
    t9 = by*wb
    t10 = t8 - t9 - vxa + vxb
    t11 = t5*t6
    t12 = bx*wb
    t13 = ax*wa
    t14 = -bx*wb + t13 + vya - vyb
    jac[k, 0] = -t1
    jac[k, 1] = -t2
    jac[k, 2] = -t0*t3
    jac[k, 3] = t1
    jac[k, 4] = t2
    jac[k, 5] = t0*t4
    gamma[k, 0] = t0*(vxa*(gx*t7 + t10) - vxb*(ay*wa - gx*t11 - t9 - vxa + vxb) + vya*(gy*t7 + t12 - t13 - vya + vyb) - vyb*(-gy*t11 - t14) - wa*(ax*t14 + ay*t10 + gx*t13 + gy*t8 + t11*t3) + wb*(bx*t14 + by*t10 + gx*t12 + gy*t9 - t4*t7))


@subkernel
def distance_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q):
    """d(Phi_q^T lam)/dq, d gamma/dv and d(Phi_q a - gamma)/dq."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    vxa, vya, wa, vxb, vyb, wb = v[3*a+0], v[3*a+1], v[3*a+2], v[3*b+0], v[3*b+1], v[3*b+2]
    axa, aya, ala, axb, ayb, alb = acc[3*a+0], acc[3*a+1], acc[3*a+2], acc[3*b+0], acc[3*b+1], acc[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    lam0 = lam[k, 0]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    length = sqrt((gx*gx) + (gy*gy))
    t0 = (1.0/(length*length))
    t1 = (gx*gx)*t0 - 1
    t2 = (1.0/length)
    t3 = lam0*t2
    t4 = -t1*t3
    t5 = gx*gy*lam0/(length*length*length)
    t6 = -t5
    t7 = ax*gy - ay*gx
    t8 = gx*t0
    t9 = ay + t7*t8
    t10 = t3*t9
    t11 = -t10
    t12 = t1*t3
    t13 = bx*gy - by*gx
    t14 = by + t13*t8
    t15 = t14*t3
    t16 = (gy*gy)*t0 - 1
    t17 = -t16*t3
    t18 = gy*t0
    t19 = ax - t18*t7
    t20 = t19*t3
    t21 = t16*t3
    t22 = bx - gy*t0*t13
    t23 = -t22*t3
    t24 = ax*gx
    t25 = ay*gy
    t26 = (ax*ax) + (ay*ay) - t0*(t7*t7) + t24 + t25
    t27 = -t19*t3
    t28 = ax*bx + ay*by
    t29 = t3*(t0*t13*t7 - t28)
    t30 = -t15
    t31 = t22*t3
    t32 = bx*gx
    t33 = by*gy
    t34 = -(bx*bx) - (by*by) + t0*(t13*t13) + t32 + t33
    t35 = -t7
    t36 = ay - t35*t8
    t37 = t1*vxb
    t38 = t14*wb
    t39 = t1*vxa
    t40 = gy*vyb
    t41 = gy*vya
    t42 = by*wb
    t43 = ay*wa
    t44 = gx*vxb
    t45 = gx*vxa
    t46 = t13*wb
    t47 = t35*wa + t40 - t41 + t44 - t45 + t46
    t48 = t47*t8
    t49 = t42 - t43 + t48 + vxa - vxb
    t50 = t37 + t38 - t39 + t40*t8 - t41*t8 + t49
    t51 = t16*vyb
    t52 = t16*vya
    t53 = t22*wb
    t54 = t18*t47
    t55 = ax*wa
    t56 = -vyb
    t57 = bx*wb
    t58 = t56 - t57 + vya
    t59 = t55 + t58
    t60 = t54 + t59
    t61 = t18*t44 - t18*t45 + t51 - t52 - t53 + t60
    t62 = ax + t18*t35
    t63 = t0*t13
    t64 = t28 + t35*t63
    t65 = -vxa
    t66 = -t42 + t65 + vxb
    t67 = t43 + t66
    t68 = t0*t7
    t69 = ax*t59 + t24*wa + t25*wa
    t70 = ay*t67 + t47*t68 + t69
    t71 = t62*wa
    t72 = bx*t59 + by*t67 + t32*wb + t33*wb
    t73 = t47*t63 + t72
    t74 = axb*gx
    t75 = ayb*gy
    t76 = alb*t13
    t77 = t7*wa
    t78 = -t40 + t41 - t44 + t45 - t46 + t77
    t79 = -t78
    t80 = t18*t79
    t81 = t60 + 2*t80
    t82 = 2*t79
    t83 = t49 + t8*t82
    t84 = -t83
    t85 = -t47
    t86 = t8*t85
    t87 = -t18*t85
    t88 = t63*t79
    t89 = -t67
    t90 = t0*t85
    t91 = t0*t47
    t92 = ala*t7 + axa*gx + aya*gy - t74 - t75 - t76 + t81*vyb + t84*vxa - vxb*(-2*t48 + t67 + t86) - vya*(2*t54 + t59 + t87) - wa*(-ay*t89 + t35*t90 - 2*t35*t91 + t69) + wb*(t73 + 2*t88)
    t93 = alb*by
    t94 = ala*ay
    t95 = t0*t67
    t96 = t40*t95
    t97 = t41*t95
    t98 = gx*t67 + t47
    t99 = t0*t98*vxb
    t100 = t0*vxa
    t101 = t55 + t67*t68
    t102 = axa - axb + t100*(gx*t89 - t47) + t93 - t94 + t96 - t97 + t99 - wa*(-ay*t91 + t101) + wb*(by*t90 + t57 - t63*t89)
    t103 = t43 - t59*t68
    t104 = bx*t91 - t0*t13*t59 + t42
    t105 = t0*(gy*t59 - t47)
    t106 = alb*bx
    t107 = ala*ax
    t108 = t105*vya
    t109 = t0*t59
    t110 = t109*t44
    t111 = t109*t45
    t112 = -aya + ayb + t106 - t107 - t108 + t110 - t111
    t113 = -t104*wb + t105*vyb + t112 + wa*(ax*t91 + t103)
    t114 = gx*wa
    t115 = t0*t114
    t116 = gy*wa
    t117 = 2*t78
    t118 = ala*t7 + axa*gx + aya*gy - t74 - t75 - t76 - t81*vya - t83*vxa - t84*vxb + vyb*(-t117*t18 + t59 + t80) - wa*(t68*t82 + t70) + wb*(-t117*t63 + t72 + t88)
    t119 = t0*t79
    t120 = -axa + axb + t100*t98 - t93 + t94 - t96 + t97 - t99 + wa*(-ay*t119 + t101) - wb*(-by*t91 + t57 + t63*t67)
    t121 = ax*t119 + t103
    t122 = t104*wb
    t123 = gy*t59 + t78
    t124 = gy*wb
    t125 = t0*t124
    t126 = gx*wb
    t127 = t0*t126
    stiff[k, 0] = stiff[k, 21] = t4
    stiff[k, 1] = stiff[k, 6] = stiff[k, 22] = stiff[k, 27] = t6
    stiff[k, 2] = stiff[k, 12] = t11
    stiff[k, 3] = stiff[k, 18] = t12
    stiff[k, 4] = stiff[k, 9] = stiff[k, 19] = stiff[k, 24] = t5
    stiff[k, 5] = stiff[k, 30] = t15
    stiff[k, 7] = stiff[k, 28] = t17
    stiff[k, 8] = stiff[k, 13] = t20
    stiff[k, 10] = stiff[k, 25] = t21
    stiff[k, 11] = stiff[k, 31] = t23
    stiff[k, 14] = t26*t3
    stiff[k, 15] = stiff[k, 20] = t10
    stiff[k, 16] = stiff[k, 26] = t27
    stiff[k, 17] = stiff[k, 32] = t29
    stiff[k, 23] = stiff[k, 33] = t30
    stiff[k, 29] = stiff[k, 34] = t31
    stiff[k, 35] = -t3*t34
    gamma_v[k, 0] = t2*(t36*wa - t50)
    gamma_v[k, 1] = t2*(-t19*wa - t61)
    gamma_v[k, 2] = t2*(-t19*vya - t26*wa + t36*vxa + t62*vyb + t64*wb - t70 - t9*vxb)
    gamma_v[k, 3] = t2*(t50 - t9*wa)
    gamma_v[k, 4] = t2*(t61 + t71)
    gamma_v[k, 5] = t2*(-t14*vxa + t14*vxb + t22*vya - t22*vyb + t34*wb + t64*wa + t73)
    res_q[k, 0] = t2*(t102 - t8*t92)
    res_q[k, 1] = t2*(-t113 - t18*t92)
    res_q[k, 2] = t2*(-ax*t113 + ax*(ala*gx - t115*t40 + t115*t41 - t37*wa - t38*wa + t39*wa + wa*(t116 + 2*t43 - t48 + t66 + t77*t8)) - ay*t102 - ay*(-ala*gy + gx*gy*t0*vxb*wa - t0*t116*t45 + t16*vyb*wa - t52*wa - t53*wa + wa*(t114 - t18*t77 + t54 + 2*t55 + t58)) - t68*t92)
    res_q[k, 3] = t2*(t118*t8 + t120)
    res_q[k, 4] = t2*(t0*t123*vyb + t112 + t118*t18 + t121*wa - t122)
    res_q[k, 5] = t2*(-bx*(alb*gx - t127*t40 + t127*t41 + t36*wa*wb - t37*wb + t39*wb + wb*(t124 - 2*t42 + t43 - t46*t8 + t65 + t86 + vxb)) + bx*(-aya + ayb + t0*t123*vyb + t106 - t107 - t108 + t110 - t111 + t121*wa - t122) - by*t120 + by*(-alb*gy + t125*t44 - t125*t45 + t51*wb - t52*wb + t71*wb + wb*(t126 + t18*t46 + t55 + t56 - 2*t57 + t87 + vya)) + t118*t63)


@subkernel
def driver_angle_position(k, a, b, m, q, cs, p, u, phi, phi_t):
    """Phi = theta_b - theta_a - u(t), and Phi_t."""
    tha, thb = q[3*a+2], q[3*b+2]
    u_value, u_dot = u[m, 0], u[m, 1]
    phi[k, 0] = -tha + thb - u_value
    phi_t[k, 0] = -u_dot


@subkernel
def driver_angle_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma):
    """Jacobian Phi_q and right-hand side gamma of Phi_q a = gamma."""
    u_ddot = u[m, 2]
    jac[k, 2] = -1.0
    jac[k, 5] = 1.0
    gamma[k, 0] = u_ddot


@subkernel
def driver_angle_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q):
    """d(Phi_q^T lam)/dq, d gamma/dv and d(Phi_q a - gamma)/dq."""


@subkernel
def driver_travel_position(k, a, b, m, q, cs, p, u, phi, phi_t):
    """Phi = coordinate of b's point in a's frame, along a direction, - u(t), and Phi_t."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    u_value, u_dot = u[m, 0], u[m, 1]
    p2, p3, p4, p5 = p[k, 2], p[k, 3], p[k, 4], p[k, 5]
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    t0 = bx - xa + xb
    t1 = by - ya + yb
    phi[k, 0] = p4*(ca*t0 + sa*t1) + p5*(ca*t1 - sa*t0) - u_value
    phi_t[k, 0] = -u_dot


@subkernel
def driver_travel_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma):
    """Jacobian Phi_q and right-hand side gamma of Phi_q a = gamma."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    vxa, vya, wa, vxb, vyb, wb = v[3*a+0], v[3*a+1], v[3*a+2], v[3*b+0], v[3*b+1], v[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    u_ddot = u[m, 2]
    p2, p3, p4, p5 = p[k, 2], p[k, 3], p[k, 4], p[k, 5]
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    t0 = ca*p4 - p5*sa
    t1 = ca*p5 + p4*sa
    t2 = by - ya + yb
    t3 = bx - xa + xb
    t4 = p4*t2 - p5*t3
    t5 = p4*t3 + p5*t2
    t6 = wa - wb
    jac[k, 0] = -t0
    jac[k, 1] = -t1
    jac[k, 2] = ca*t4 - sa*t5
    jac[k, 3] = t0
    jac[k, 4] = t1
    jac[k, 5] = bx*t1 - by*t0
    gamma[k, 0] = t0*vya*wa - t0*vyb*wa - t1*vxa*wa + t1*vxb*wa + u_ddot - wa*(ca*(-p4*vya + p4*vyb + p5*vxa - p5*vxb - t5*wa + wb*(bx*p4 + by*p5)) - sa*(-p4*vxa + p4*vxb - p5*vya + p5*vyb + t4*wa + wb*(bx*p5 - by*p4))) - wb*(bx*t0*t6 + by*t1*t6)


@subkernel
def driver_travel_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q):
    """d(Phi_q^T lam)/dq, d gamma/dv and d(Phi_q a - gamma)/dq."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    vxa, vya, wa, vxb, vyb, wb = v[3*a+0], v[3*a+1], v[3*a+2], v[3*b+0], v[3*b+1], v[3*b+2]
    axa, aya, ala, axb, ayb, alb = acc[3*a+0], acc[3*a+1], acc[3*a+2], acc[3*b+0], acc[3*b+1], acc[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p2, p3, p4, p5 = p[k, 2], p[k, 3], p[k, 4], p[k, 5]
    lam0 = lam[k, 0]
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    t0 = ca*p5 + p4*sa
    t1 = lam0*t0
    t2 = ca*p4 - p5*sa
    t3 = lam0*t2
    t4 = bx - xa + xb
    t5 = by - ya + yb
    t6 = p4*t4 + p5*t5
    t7 = p4*t5
    t8 = -p5*t4 + t7
    t9 = ca*t6 + sa*t8
    t10 = -t1
    t11 = bx*t2
    t12 = by*t0 + t11
    t13 = lam0*t12
    t14 = bx*p4 + by*p5
    t15 = bx*p5 - by*p4
    t16 = ca*t14 - sa*t15
    t17 = 2*wa
    t18 = t0*t17
    t19 = t17*t2
    t20 = t12*wb
    t21 = p4*vya
    t22 = p5*vxb
    t23 = -p4*vyb - p5*vxa - t14*wb + t21 + t22 + t6*wa
    t24 = p4*vxb
    t25 = p5*vyb
    t26 = p4*vxa
    t27 = p5*vya
    t28 = t15*wb + t24 + t25 - t26 - t27
    t29 = wa - wb
    t30 = -t29
    t31 = ala*t0
    t32 = (wa*wa)
    t33 = t2*t32 + t31
    t34 = ala*t2
    t35 = -t0*t32 + t34
    t36 = t29*wa
    stiff[k, 2] = stiff[k, 12] = t1
    stiff[k, 8] = -lam0*t2
    stiff[k, 13] = -t3
    stiff[k, 14] = -lam0*t9
    stiff[k, 15] = stiff[k, 20] = t10
    stiff[k, 16] = stiff[k, 26] = t3
    stiff[k, 17] = t13
    stiff[k, 32] = lam0*t16
    stiff[k, 35] = -t13
    gamma_v[k, 0] = -t18
    gamma_v[k, 1] = t19
    gamma_v[k, 2] = ca*t23 + sa*(t28 + t8*wa) - t0*vxa + t0*vxb + t2*vya - t2*vyb - t20 + t9*wa
    gamma_v[k, 3] = t18
    gamma_v[k, 4] = -t19
    gamma_v[k, 5] = by*t0*t30 - t11*t29 - t16*wa + t20
    res_q[k, 0] = t33
    res_q[k, 1] = -t35
    res_q[k, 2] = -ca*(ala*t6 - alb*t14 - axa*p5 + axb*p5 + aya*p4 - ayb*p4 + t15*t29*wb + t24*wa + t25*wa - t26*wa - t27*wa + wa*(t28 + wa*(-p5*t4 + t7))) - sa*(ala*t8 + alb*t15 - axa*p4 + axb*p4 - aya*p5 + ayb*p5 + p4*vyb*wa + p5*vxa*wa + t14*t29*wb - t21*wa - t22*wa - t23*wa)
    res_q[k, 3] = -t33
    res_q[k, 4] = t35
    res_q[k, 5] = bx*(-alb*t2 - t0*t30*wb - t0*t36 + t34) - by*(alb*t0 + t2*t29*wb - t2*t36 - t31)


@subkernel
def point_on_line_position(k, a, b, m, q, cs, p, u, phi, phi_t):
    """Phi = distance of b's point from the line through a's, and Phi_t."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3, p4, p5 = p[k, 0], p[k, 1], p[k, 2], p[k, 3], p[k, 4], p[k, 5]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    nx, ny = -ca*p5 - p4*sa, ca*p4 - p5*sa
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    phi[k, 0] = gx*nx + gy*ny


@subkernel
def point_on_line_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma):
    """Jacobian Phi_q and right-hand side gamma of Phi_q a = gamma."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    vxa, vya, wa, vxb, vyb, wb = v[3*a+0], v[3*a+1], v[3*a+2], v[3*b+0], v[3*b+1], v[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3, p4, p5 = p[k, 0], p[k, 1], p[k, 2], p[k, 3], p[k, 4], p[k, 5]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    nx, ny = -ca*p5 - p4*sa, ca*p4 - p5*sa
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    t0 = nx*wa
    t1 = ny*wa
    t2 = bx*wb
    t3 = by*wb
    jac[k, 0] = -nx
    jac[k, 1] = -ny
    jac[k, 2] = -ax*ny + ay*nx - gx*ny + gy*nx
    jac[k, 3] = nx
    jac[k, 4] = ny
    jac[k, 5] = bx*ny - by*nx
    gamma[k, 0] = nx*vya*wa + ny*vxb*wa - t0*vyb - t1*vxa - wa*(nx*(t2 - vya + vyb - wa*(ax + gx)) + ny*(t3 + vxa - vxb - wa*(ay + gy))) - wb*(bx*t0 + by*t1 - nx*t2 - ny*t3)


@subkernel
def point_on_line_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q):
    """d(Phi_q^T lam)/dq, d gamma/dv and d(Phi_q a - gamma)/dq."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    vxa, vya, wa, vxb, vyb, wb = v[3*a+0], v[3*a+1], v[3*a+2], v[3*b+0], v[3*b+1], v[3*b+2]
    axa, aya, ala, axb, ayb, alb = acc[3*a+0], acc[3*a+1], acc[3*a+2], acc[3*b+0], acc[3*b+1], acc[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3, p4, p5 = p[k, 0], p[k, 1], p[k, 2], p[k, 3], p[k, 4], p[k, 5]
    lam0 = lam[k, 0]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    nx, ny = -ca*p5 - p4*sa, ca*p4 - p5*sa
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    t0 = lam0*ny
    t1 = lam0*nx
    t2 = -t1
    t3 = ax + gx
    t4 = ay + gy
    t5 = nx*t3 + ny*t4
    t6 = -t0
    t7 = bx*nx
    t8 = by*ny
    t9 = t7 + t8
    t10 = lam0*t9
    t11 = 2*wa
    t12 = ny*t11
    t13 = nx*t11
    t14 = t9*wb
    t15 = bx*wb
    t16 = t15 - t3*wa - vya + vyb
    t17 = by*wb
    t18 = t17 - t4*wa + vxa - vxb
    t19 = (wa*wa)
    t20 = ala*ny + nx*t19
    t21 = ala*nx - ny*t19
    t22 = wa - wb
    t23 = ny*wb
    t24 = nx*wb
    stiff[k, 2] = stiff[k, 12] = t0
    stiff[k, 8] = stiff[k, 13] = t2
    stiff[k, 14] = -lam0*t5
    stiff[k, 15] = stiff[k, 20] = t6
    stiff[k, 16] = stiff[k, 26] = t1
    stiff[k, 17] = stiff[k, 32] = t10
    stiff[k, 35] = -t10
    gamma_v[k, 0] = -t12
    gamma_v[k, 1] = t13
    gamma_v[k, 2] = -nx*t16 + nx*vya - nx*vyb - ny*t18 - ny*vxa + ny*vxb - t14 + t5*wa
    gamma_v[k, 3] = t12
    gamma_v[k, 4] = -t13
    gamma_v[k, 5] = bx*nx*wb + by*ny*wb + t14 - t7*wa - t8*wa - t9*wa
    res_q[k, 0] = t20
    res_q[k, 1] = -t21
    res_q[k, 2] = nx*(-ala*t3 + alb*bx - aya + ayb + t17*t22 + t18*wa + vxa*wa - vxb*wa) - ny*(ala*t4 - alb*by - axa + axb + t15*t22 + t16*wa - vya*wa + vyb*wa)
    res_q[k, 3] = -t20
    res_q[k, 4] = t21
    res_q[k, 5] = bx*t21 + bx*(-alb*nx + t22*t23 + t23*wa) + by*t20 - by*(alb*ny + t22*t24 + t24*wa)


@subkernel
def fixed_angle_position(k, a, b, m, q, cs, p, u, phi, phi_t):
    """Phi = theta_b - theta_a - angle, and Phi_t."""
    tha, thb = q[3*a+2], q[3*b+2]
    p4 = p[k, 4]
    phi[k, 0] = -p4 - tha + thb


@subkernel
def fixed_angle_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma):
    """Jacobian Phi_q and right-hand side gamma of Phi_q a = gamma."""
    jac[k, 2] = -1.0
    jac[k, 5] = 1.0
    gamma[k, 0] = 0.0


@subkernel
def fixed_angle_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q):
    """d(Phi_q^T lam)/dq, d gamma/dv and d(Phi_q a - gamma)/dq."""


@subkernel
def moving_center_position(k, a, b, m, q, cs, p, u, phi, phi_t):
    """Phi = p_b - p_a - c, c in a's frame a function of theta_b - theta_a, and Phi_t."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    cx0, cy0 = u[m, 0], u[m + 2, 0]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    hx0 = ca*cx0 - cy0*sa
    hy0 = ca*cy0 + cx0*sa
    phi[k, 0] = gx - hx0
    phi[k, 1] = gy - hy0


@subkernel
def moving_center_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma):
    """Jacobian Phi_q and right-hand side gamma of Phi_q a = gamma."""
    wa, wb = v[3*a+2], v[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    cx0, cx1, cx2, cy0, cy1, cy2 = u[m, 0], u[m, 1], u[m, 2], u[m + 2, 0], u[m + 2, 1], u[m + 2, 2]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    hx0 = ca*cx0 - cy0*sa
    hx1 = ca*cx1 - cy1*sa
    hx2 = ca*cx2 - cy2*sa
    hy0 = ca*cy0 + cx0*sa
    hy1 = ca*cy1 + cx1*sa
    hy2 = ca*cy2 + cx2*sa
    t0 = hx1 + hy0
    t1 = -hy1
    t2 = hx0 + t1
    t3 = wa - wb
    jac[k, 0] = jac[k, 7] = -1.0
    jac[k, 2] = ay + t0
    jac[k, 3] = jac[k, 10] = 1.0
    jac[k, 5] = -by - hx1
    jac[k, 8] = -ax - t2
    jac[k, 11] = bx + t1
    gamma[k, 0] = -wa*(ax*wa + t2*wa - t3*(hx2 + hy1)) - wb*(-bx*wb + hx2*t3 + hy1*wa)
    gamma[k, 1] = -wa*(ay*wa + t0*wa + t3*(hx1 - hy2)) + wb*(by*wb + hx1*wa - hy2*t3)


@subkernel
def moving_center_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q):
    """d(Phi_q^T lam)/dq, d gamma/dv and d(Phi_q a - gamma)/dq."""
    wa, wb = v[3*a+2], v[3*b+2]
    ala, alb = acc[3*a+2], acc[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    cx0, cx1, cx2, cy0, cy1, cy2, cx3, cy3 = u[m, 0], u[m, 1], u[m, 2], u[m + 2, 0], u[m + 2, 1], u[m + 2, 2], u[m + 1, 2], u[m + 3, 2]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    lam0, lam1 = lam[k, 0], lam[k, 1]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    hx0 = ca*cx0 - cy0*sa
    hx1 = ca*cx1 - cy1*sa
    hx2 = ca*cx2 - cy2*sa
    hx3 = ca*cx3 - cy3*sa
    hy0 = ca*cy0 + cx0*sa
    hy1 = ca*cy1 + cx1*sa
    hy2 = ca*cy2 + cx2*sa
    hy3 = ca*cy3 + cx3*sa
    t0 = hx1 + hy0
    t1 = hx2 + hy1
    t2 = lam0*t1
    t3 = hx0 - hy1
    t4 = -hy2
    t5 = hx1 + t4
    t6 = lam1*t5
    t7 = hx2*lam0 + hy2*lam1
    t8 = wa - wb
    t9 = t1*wa
    t10 = (wa*wa)
    t11 = ala - alb
    t12 = -t8
    t13 = (wb*wb)
    t14 = 2*t12
    t15 = t14*wa
    t16 = (t8*t8)
    stiff[k, 14] = ax*lam0 + ay*lam1 + lam0*t3 + lam1*t0 - t2 + t6
    stiff[k, 17] = -hx1*lam1 + hy1*lam0 + t7
    stiff[k, 32] = t2 - t6
    stiff[k, 35] = -bx*lam0 - by*lam1 - t7
    gamma_v[k, 2] = -ax*wa + t1*t8 - t1*wb - t3*wa - wa*(ax + hx0 - hx2 - 2*hy1)
    gamma_v[k, 5] = bx*wb - hx2*t8 - hy1*wa - t9 + wb*(bx + hx2)
    gamma_v[k, 8] = -ay*wa - t0*wa - t5*t8 + t5*wb - wa*(ay + 2*hx1 + hy0 + t4)
    gamma_v[k, 11] = by*wb + hx1*wa - hy2*t8 + t5*wa + wb*(by + hy2)
    res_q[k, 2] = ala*ax + ala*t3 - ay*t10 - t0*t10 - t1*t11 + 2*t12*t5*wa - t12*t8*(hx3 + hy2)
    res_q[k, 5] = ala*hy1 - alb*bx + by*t13 + hx1*t10 + hx2*t11 - hx3*t16 + hy2*t15
    res_q[k, 8] = ala*ay + ala*t0 + ax*t10 + t10*t3 + t11*t5 + t14*t9 - t16*(hx2 - hy3)
    res_q[k, 11] = -ala*hx1 - alb*by - bx*t13 - hx2*t15 + hy1*t10 + hy2*t11 + hy3*t12*t8


@subkernel
def function_position(k, a, b, m, q, cs, p, u, phi, phi_t):
    """Phi = f(x, y, angle; theta_a, t) of the pose of b's point in a's frame, and Phi_t."""
    f, f4 = u[m + 0, 0], u[m + 1, 2]
    phi[k, 0] = f
    phi_t[k, 0] = f4


@subkernel
def function_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma):
    """Jacobian Phi_q and right-hand side gamma of Phi_q a = gamma."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    vxa, vya, wa, vxb, vyb, wb = v[3*a+0], v[3*a+1], v[3*a+2], v[3*b+0], v[3*b+1], v[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    f0, f1, f2, f3, f00, f01, f02, f03, f04, f11, f12, f13, f14, f22, f23, f24, f33, f34, f44 = u[m + 0, 1], u[m + 0, 2], u[m + 1, 0], u[m + 1, 1], u[m + 2, 0], u[m + 2, 1], u[m + 2, 2], u[m + 3, 0], u[m + 3, 1], u[m + 3, 2], u[m + 4, 0], u[m + 4, 1], u[m + 4, 2], u[m + 5, 0], u[m + 5, 1], u[m + 5, 2], u[m + 6, 0], u[m + 6, 1], u[m + 6, 2]
    p2, p3 = p[k, 2], p[k, 3]
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    in_x, in_y = ca*(bx - xa + xb) + sa*(by - ya + yb), ca*(by - ya + yb) - sa*(bx - xa + xb)
    t0 = ca*f0
    t1 = -f1*sa + t0
    t2 = ca*f1
    t3 = f0*sa
    t4 = t2 + t3
    t5 = bx*ca + by*sa
    t6 = bx*sa - by*ca
    t7 = wa - wb
    t8 = in_y*wa
    t9 = -ca*vxa + ca*vxb - sa*vya + sa*vyb + t6*wb + t8
    t10 = in_x*wa
    t11 = ca*vya - ca*vyb - sa*vxa + sa*vxb + t10 - t5*wb
    t12 = ca*f01
    t13 = f01*sa
    t14 = ca*f14 + f04*sa - f1*sa*wa + t0*wa - t11*(ca*f11 + t13) - t7*(ca*f12 + f02*sa) + t9*(f00*sa + t12) + wa*(ca*f13 + f03*sa)
    t15 = -ca*f04 + f14*sa + t11*(-f11*sa + t12) + t2*wa + t3*wa + t7*(ca*f02 - f12*sa) - t9*(ca*f00 - t13) - wa*(ca*f03 - f13*sa)
    jac[k, 0] = -t1
    jac[k, 1] = -t4
    jac[k, 2] = f0*in_y - f1*in_x - f2 + f3
    jac[k, 3] = t1
    jac[k, 4] = t4
    jac[k, 5] = f0*t6 + f1*t5 + f2
    gamma[k, 0] = -f04*t9 + f14*t11 + f24*t7 - f34*wa - f44 + t14*vya - t14*vyb - t15*vxa + t15*vxb - wa*(ca*(-f0*vya + f0*vyb + f1*vxa - f1*vxb + wb*(bx*f0 + by*f1)) - f0*t10 + f04*in_y - f1*t8 - f14*in_x - f24 + f34 - sa*(-f0*vxa + f0*vxb - f1*vya + f1*vyb + wb*(bx*f1 - by*f0)) - t11*(f01*in_y - f11*in_x - f12 + f13) - t7*(f02*in_y - f12*in_x - f22 + f23) + t9*(f00*in_y - f01*in_x - f02 + f03) + wa*(f03*in_y - f13*in_x - f23 + f33)) - wb*(-bx*t1*wb - by*t4*wb + f0*t5*wa + f04*t6 - f1*t6*wa + f14*t5 + f24 - t11*(f01*t6 + f11*t5 + f12) - t7*(f02*t6 + f12*t5 + f22) + t9*(f00*t6 + f01*t5 + f02) + wa*(f03*t6 + f13*t5 + f23))


@subkernel
def function_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q):
    """d(Phi_q^T lam)/dq, d gamma/dv and d(Phi_q a - gamma)/dq."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    vxa, vya, wa, vxb, vyb, wb = v[3*a+0], v[3*a+1], v[3*a+2], v[3*b+0], v[3*b+1], v[3*b+2]
    axa, aya, ala, axb, ayb, alb = acc[3*a+0], acc[3*a+1], acc[3*a+2], acc[3*b+0], acc[3*b+1], acc[3*b+2]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    f0, f1, f00, f01, f02, f03, f04, f11, f12, f13, f14, f22, f23, f24, f33, f34, f000, f001, f002, f003, f004, f011, f012, f013, f014, f022, f023, f024, f033, f034, f044, f111, f112, f113, f114, f122, f123, f124, f133, f134, f144, f222, f223, f224, f233, f234, f244, f333, f334, f344 = u[m + 0, 1], u[m + 0, 2], u[m + 2, 0], u[m + 2, 1], u[m + 2, 2], u[m + 3, 0], u[m + 3, 1], u[m + 3, 2], u[m + 4, 0], u[m + 4, 1], u[m + 4, 2], u[m + 5, 0], u[m + 5, 1], u[m + 5, 2], u[m + 6, 0], u[m + 6, 1], u[m + 7, 0], u[m + 7, 1], u[m + 7, 2], u[m + 8, 0], u[m + 8, 1], u[m + 8, 2], u[m + 9, 0], u[m + 9, 1], u[m + 9, 2], u[m + 10, 0], u[m + 10, 1], u[m + 10, 2], u[m + 11, 0], u[m + 11, 1], u[m + 11, 2], u[m + 12, 0], u[m + 12, 1], u[m + 12, 2], u[m + 13, 0], u[m + 13, 1], u[m + 13, 2], u[m + 14, 0], u[m + 14, 1], u[m + 14, 2], u[m + 15, 0], u[m + 15, 1], u[m + 15, 2], u[m + 16, 0], u[m + 16, 1], u[m + 16, 2], u[m + 17, 0], u[m + 17, 1], u[m + 17, 2], u[m + 18, 0]
    p2, p3 = p[k, 2], p[k, 3]
    lam0 = lam[k, 0]
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    in_x, in_y = ca*(bx - xa + xb) + sa*(by - ya + yb), ca*(by - ya + yb) - sa*(bx - xa + xb)
    t0 = f01*sa
    t1 = ca*f00 - t0
    t2 = ca*f01
    t3 = -f11*sa + t2
    t4 = ca*t1 - sa*t3
    t5 = lam0*t4
    t6 = f00*sa + t2
    t7 = ca*f11 + t0
    t8 = ca*t6 - sa*t7
    t9 = lam0*t8
    t10 = f01*in_y - f11*in_x - f12 + f13
    t11 = f00*in_y - f01*in_x - f02 + f03
    t12 = ca*f1
    t13 = f0*sa
    t14 = t12 + t13
    t15 = -ca*t11 + sa*t10 + t14
    t16 = -t4
    t17 = lam0*t16
    t18 = -t8
    t19 = lam0*t18
    t20 = bx*ca
    t21 = by*sa
    t22 = t20 + t21
    t23 = bx*sa
    t24 = by*ca
    t25 = t23 - t24
    t26 = f00*t25 + f01*t22 + f02
    t27 = ca*t26
    t28 = f01*t25 + f11*t22 + f12
    t29 = -sa*t28 + t27
    t30 = ca*t3 + sa*t1
    t31 = lam0*t30
    t32 = ca*t7 + sa*t6
    t33 = lam0*t32
    t34 = ca*f0
    t35 = f1*sa
    t36 = t34 - t35
    t37 = ca*t10 + sa*t11 + t36
    t38 = -t31
    t39 = -t33
    t40 = ca*t28
    t41 = sa*t26
    t42 = t40 + t41
    t43 = lam0*t42
    t44 = f13*sa
    t45 = ca*f03
    t46 = ca*f02 - f12*sa
    t47 = in_x*t3 - in_y*t1 + t14 + t44 - t45 + t46
    t48 = ca*f13 + f03*sa
    t49 = -ca*f12 - f02*sa - in_x*t7 + in_y*t6 + t36 + t48
    t50 = f0*in_x
    t51 = f1*in_y
    t52 = f13*in_x
    t53 = -f22
    t54 = f02*in_y - f12*in_x + t53
    t55 = -f03*in_y + 2*f23 - f33 + in_x*t10 - in_y*t11 + t50 + t51 + t52 + t54
    t56 = f0*t22
    t57 = f02*t25
    t58 = f12*t22
    t59 = f03*t25 + f13*t22 + f23
    t60 = -f1*t25 - in_x*t28 + in_y*t26 + t53 + t56 - t57 - t58 + t59
    t61 = t1*t25 + t22*t3 + t46
    t62 = lam0*t61
    t63 = ca*f12 + f02*sa
    t64 = t22*t7 + t25*t6 + t63
    t65 = lam0*t64
    t66 = bx*f0
    t67 = by*f1
    t68 = t66 + t67
    t69 = bx*f1
    t70 = by*f0
    t71 = t69 - t70
    t72 = f23 + t54
    t73 = ca*t68 - sa*t71 + t10*t22 + t11*t25 + t72
    t74 = f22 + t57 + t58
    t75 = -bx*t36 - by*t14 + t22*t28 + t25*t26 + t74
    t76 = -t1
    t77 = -t3
    t78 = vxa*(ca*t76 - sa*t77)
    t79 = t4*vxb
    t80 = t18*vya
    t81 = t8*vyb
    t82 = -t44 + t45
    t83 = t82*wa
    t84 = ca*vxb
    t85 = in_y*wa
    t86 = sa*vyb
    t87 = ca*vxa
    t88 = sa*vya
    t89 = t25*wb + t84 + t85 + t86 - t87 - t88
    t90 = t1*t89
    t91 = t15*wa
    t92 = wa - wb
    t93 = t46*t92
    t94 = ca*vya
    t95 = in_x*wa
    t96 = sa*vxb
    t97 = ca*vyb
    t98 = sa*vxa
    t99 = t22*wb
    t100 = t94 + t95 + t96 - t97 - t98 - t99
    t101 = t100*t3
    t102 = f14*sa
    t103 = ca*f04
    t104 = t12*wa
    t105 = t13*wa
    t106 = -t101 - 2*t102 + 2*t103 - t104 - t105 + t29*wb + t79 + t80 + t81 + t83 + t90 - t91 - t93
    t107 = t30*vxb
    t108 = t32*vyb
    t109 = t37*wa
    t110 = t32*vya
    t111 = ca*f14
    t112 = f04*sa
    t113 = -t100*t7 + t34*wa - t35*wa + t48*wa + t6*t89 - t63*t92
    t114 = t107 + t108 + t109 - t110 + 2*t111 + 2*t112 + t113 + t42*wb
    t115 = 2*f24
    t116 = 2*f04
    t117 = 2*f14
    t118 = f03*in_y - f23 + f33 - t52
    t119 = -f0*vya + f0*vyb + f1*vxa - f1*vxb + t68*wb
    t120 = f0*vxb
    t121 = f1*vyb
    t122 = f0*vxa
    t123 = f1*vya
    t124 = t71*wb
    t125 = bx*wb - vya + vyb
    t126 = ca*t125
    t127 = by*wb + vxa - vxb
    t128 = ala*in_y + alb*t25 - axa*ca + axb*ca - aya*sa + ayb*sa - t94*wa - t96*wa + t97*wa + t98*wa - wb*(t20*wb + t21*wb - t22*wa)
    t129 = t128 - wa*(-sa*t127 - t126 + t95)
    t130 = ca*f001
    t131 = f011*sa
    t132 = t130 - t131
    t133 = sa*t89
    t134 = ca*t89
    t135 = -t100
    t136 = vxa*(ca*t135 - t133) + vxb*(ca*t100 + t133) + vya*(sa*t135 + t134) - vyb*(-sa*t100 + t134) + wa*(in_x*t89 - in_y*t135) - wb*(-t100*t25 + t22*t89)
    t137 = -t136
    t138 = f012*sa
    t139 = ca*f002 - t138
    t140 = -t92
    t141 = -t84*t92 - t86*t92 + t87*t92 + t88*t92 + wb*(-t25*t92 + t89)
    t142 = t141 - wa*(-in_y*t140 + t89)
    t143 = ala*in_x - alb*t22 - axa*sa + axb*sa + aya*ca - ayb*ca - ca*vxa*wa - sa*vya*wa + t84*wa + t86*wa + wa*(-ca*t127 + sa*t125 + t85) + wb*(-t23*wb + t24*wb + t25*wa)
    t144 = -t143
    t145 = ca*f012
    t146 = -f112*sa + t145
    t147 = t92*t97
    t148 = t92*t98
    t149 = -t95
    t150 = t100 + t22*t92
    t151 = -t147 - t148 - t150*wb + t92*t94 + t92*t96 - wa*(in_x*t140 + t149 - t94 - t96 + t97 + t98 + t99)
    t152 = vxa*wa
    t153 = f0*wa + f01*t89 + f13*wa + f14
    t154 = vxb*wa
    t155 = t7*wa
    t156 = wa*wb
    t157 = ala*f1 + f14*wa + t154*t3 - t155*vya + t155*vyb + t156*t28 + wa*(f11*t135 + f12*t140 + t10*wa + t153)
    t158 = t152*t77 + t157
    t159 = ca*f013
    t160 = -f113*sa + t159
    t161 = 2*wa
    t162 = t135*t161
    t163 = (wa*wa)
    t164 = (t92*t92)
    t165 = f001*sa
    t166 = (t89*t89)
    t167 = t6*wa
    t168 = f00*t89 - f01*t100 - f02*t92 + f03*wa + f04 - f1*wa
    t169 = ala*f0 + f04*wa - t1*t152 + t1*t154 + t156*t26 - t167*vya + t167*vyb + wa*(t11*wa + t168)
    t170 = ala - alb
    t171 = 2*t92
    t172 = ca*f014
    t173 = 2*t100
    t174 = f014*sa
    t175 = 2*t89
    t176 = ca*f011
    t177 = t100*t135
    t178 = t140*t161
    t179 = f013*sa
    t180 = t161*t89
    t181 = ala*t82 + ca*f044 - f144*sa - sa*t169 + t161*(ca*f034 - f134*sa) + t163*(ca*f033 - f133*sa) + t164*(ca*f022 - f122*sa) + t166*(ca*f000 - t165) - t170*t46 - t171*(ca*f024 - f124*sa) - t173*(-f114*sa + t172) + t175*(ca*f004 - t174) - t177*(-f111*sa + t176) + t178*(ca*f023 - f123*sa) + t180*(ca*f003 - t179)
    t182 = t165 + t176
    t183 = f002*sa + t145
    t184 = ca*f112 + t138
    t185 = ca*f113 + t179
    t186 = ala*t48 + ca*f144 + ca*t169 + f044*sa + t161*(ca*f134 + f034*sa) + t163*(ca*f133 + f033*sa) + t164*(ca*f122 + f022*sa) + t166*(f000*sa + t130) - t170*t63 - t171*(ca*f124 + f024*sa) - t173*(ca*f114 + t174) + t175*(f004*sa + t172) - t177*(ca*f111 + t131) + t178*(ca*f123 + f023*sa) + t180*(f003*sa + t159)
    t187 = t100*t161
    t188 = t128 - wa*(-sa*t127 - t126 - t149)
    t189 = t141 - wa*(in_y*t92 + t89)
    t190 = ca*t92*vya + sa*t92*vxb - t147 - t148 - t150*wb - wa*(-in_x*t92 - t100)
    t191 = -t152*t3 + t157
    t192 = t125*t6 + t127*t7 + t168
    t193 = -f11*t100 - f12*t92 + t153
    t194 = -t1*t125 - t127*t3 + t193
    t195 = by*f01
    t196 = bx*f01
    t197 = t125*t7 - t127*t6 + t193
    t198 = -t1*t127 + t125*t3 + t168
    stiff[k, 0] = stiff[k, 21] = t5
    stiff[k, 1] = stiff[k, 22] = t9
    stiff[k, 2] = lam0*t15
    stiff[k, 3] = stiff[k, 18] = t17
    stiff[k, 4] = stiff[k, 19] = t19
    stiff[k, 5] = -lam0*t29
    stiff[k, 6] = stiff[k, 27] = t31
    stiff[k, 7] = stiff[k, 28] = t33
    stiff[k, 8] = -lam0*t37
    stiff[k, 9] = stiff[k, 24] = t38
    stiff[k, 10] = stiff[k, 25] = t39
    stiff[k, 11] = -t43
    stiff[k, 12] = lam0*t47
    stiff[k, 13] = -lam0*t49
    stiff[k, 14] = -lam0*t55
    stiff[k, 15] = -lam0*t47
    stiff[k, 16] = lam0*t49
    stiff[k, 17] = lam0*t60
    stiff[k, 20] = -lam0*t15
    stiff[k, 23] = lam0*t29
    stiff[k, 26] = lam0*t37
    stiff[k, 29] = t43
    stiff[k, 30] = -t62
    stiff[k, 31] = -t65
    stiff[k, 32] = lam0*t73
    stiff[k, 33] = t62
    stiff[k, 34] = t65
    stiff[k, 35] = lam0*t75
    gamma_v[k, 0] = t106 + t78
    gamma_v[k, 1] = t114 + vxa*(ca*t77 + sa*t76)
    gamma_v[k, 2] = -ca*t119 - 2*f34 + in_x*t117 - in_y*t116 + sa*(t120 + t121 - t122 - t123 + t124) + t10*t100 - t11*t89 + t115 - t118*wa - t47*vxa + t47*vxb + t49*vya - t49*vyb + t50*wa + t51*wa + t55*wa - t60*wb + t72*t92
    gamma_v[k, 3] = -t106 - t16*vxa
    gamma_v[k, 4] = -t114 + t30*vxa
    gamma_v[k, 5] = bx*t36*wb + by*t14*wb + f1*t25*wa + t100*t28 - t115 - t116*t25 - t117*t22 - t26*t89 - t56*wa - t59*wa + t61*vxa - t61*vxb + t64*vya - t64*vyb - t73*wa + t74*t92 - t75*wb
    res_q[k, 0] = ca*t158 - t1*t129 - t132*t137 - t139*t142 - t144*t3 - t146*t151 - t160*t162 - t181
    res_q[k, 1] = sa*t158 - t129*t6 - t137*t182 - t142*t183 - t144*t7 - t151*t184 - t162*t185 - t186
    res_q[k, 2] = ala*t118 + ca*(alb*t68 + axa*f1 - axb*f1 - aya*f0 + ayb*f0 + f04*t125 + f14*t127 - t192*vya + t192*vyb + t194*vxa - t194*vxb + wa*(t10*t127 + t11*t125 - t120 - t121 + t122 + t123 - t124) + wb*(bx*f04 + by*f14 - t100*(by*f11 + t196) + t125*t26 + t127*t28 - t69*wa + t69*wb + t70*wa - t70*wb + t89*(bx*f00 + t195) - t92*(bx*f02 + by*f12) + wa*(bx*f03 + by*f13))) + f044*in_y - f144*in_x - f244 + f344 - in_x*t169 - in_y*t191 - sa*(alb*t71 - axa*f0 + axb*f0 - aya*f1 + ayb*f1 - f04*t127 + f14*t125 - t197*vya + t197*vyb - t198*vxa + t198*vxb + wa*(t10*t125 - t11*t127 + t119) + wb*(bx*f14 - by*f04 - t100*(bx*f11 - t195) + t125*t28 - t127*t26 + t66*wa - t66*wb + t67*wa - t67*wb + t89*(-by*f00 + t196) - t92*(bx*f12 - by*f02) + wa*(bx*f13 - by*f03))) - t10*t143 + t11*t188 - t136*(f001*in_y - f011*in_x - f012 + f013) + t161*(f034*in_y - f134*in_x - f234 + f334) + t163*(f033*in_y - f133*in_x - f233 + f333) + t164*(f022*in_y - f122*in_x - f222 + f223) + t166*(f000*in_y - f001*in_x - f002 + f003) - t170*t72 - t171*(f024*in_y - f124*in_x - f224 + f234) - t173*(f014*in_y - f114*in_x - f124 + f134) + t175*(f004*in_y - f014*in_x - f024 + f034) - t177*(f011*in_y - f111*in_x - f112 + f113) + t178*(f023*in_y - f123*in_x - f223 + f233) + t180*(f003*in_y - f013*in_x - f023 + f033) - t187*(f013*in_y - f113*in_x - f123 + f133) + t189*(f002*in_y - f012*in_x - f022 + f023) + t190*(f012*in_y - f112*in_x - f122 + f123)
    res_q[k, 3] = -ca*t191 + t1*t188 - t132*t136 + t139*t189 - t143*t3 + t146*t190 - t160*t187 + t181
    res_q[k, 4] = -sa*t191 - t136*t182 - t143*t7 + t183*t189 + t184*t190 - t185*t187 + t186 + t188*t6
    res_q[k, 5] = ala*t59 - bx*(alb*t36 - t102*wb + t103*wb + t78*wb + t79*wb + t80*wb + t81*wb - t91*wb - wb*(sa*t28*wb + t101 + t102 - t103 + t104 + t105 - t14*wb - t27*wb - t83 - t90 + t93)) - by*(alb*t14 + t107*wb + t108*wb + t109*wb - t110*wb + t111*wb + t112*wb - t30*vxa*wb + wb*(t111 + t112 + t113 - t36*wb + t40*wb + t41*wb)) + f044*t25 + f144*t22 + f244 - t136*(f001*t25 + f011*t22 + f012) - t143*t28 + t161*(f034*t25 + f134*t22 + f234) + t163*(f033*t25 + f133*t22 + f233) + t164*(f022*t25 + f122*t22 + f222) + t166*(f000*t25 + f001*t22 + f002) + t169*t22 - t170*t74 - t171*(f024*t25 + f124*t22 + f224) - t173*(f014*t25 + f114*t22 + f124) + t175*(f004*t25 + f014*t22 + f024) - t177*(f011*t25 + f111*t22 + f112) + t178*(f023*t25 + f123*t22 + f223) + t180*(f003*t25 + f013*t22 + f023) - t187*(f013*t25 + f113*t22 + f123) + t188*t26 + t189*(f002*t25 + f012*t22 + f022) + t190*(f012*t25 + f112*t22 + f122) - t191*t25


@subkernel
def constraint_positions(pairs, p, q, cs, u, phi, phi_t):
    """Evaluate Phi and Phi_t of every pair: (P, 2) arrays."""
    for k in range(len(pairs)):
        kind, a, b = pairs[k, PAIR.kind], pairs[k, PAIR.first], pairs[k, PAIR.second]
        m = pairs[k, PAIR.motion]
        if kind == 0:
            revolute_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        elif kind == 1:
            distance_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        elif kind == 2:
            driver_angle_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        elif kind == 3:
            driver_travel_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        elif kind == 4:
            point_on_line_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        elif kind == 5:
            fixed_angle_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        elif kind == 6:
            moving_center_position(k, a, b, m, q, cs, p, u, phi, phi_t)
        else:
            function_position(k, a, b, m, q, cs, p, u, phi, phi_t)


@subkernel
def constraint_accelerations(pairs, p, q, v, cs, u, jac, gamma):
    """Evaluate the Jacobian (P, 12) and the right-hand side gamma (P, 2) of every pair."""
    for k in range(len(pairs)):
        kind, a, b = pairs[k, PAIR.kind], pairs[k, PAIR.first], pairs[k, PAIR.second]
        m = pairs[k, PAIR.motion]
        if kind == 0:
            revolute_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        elif kind == 1:
            distance_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        elif kind == 2:
            driver_angle_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        elif kind == 3:
            driver_travel_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        elif kind == 4:
            point_on_line_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        elif kind == 5:
            fixed_angle_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        elif kind == 6:
            moving_center_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)
        else:
            function_acceleration(k, a, b, m, q, v, cs, p, u, jac, gamma)


@subkernel
def constraint_tangents(pairs, p, q, v, acc, cs, u, lam, stiff, gamma_v, res_q):
    """Evaluate d(Phi_q^T lam)/dq (P, 36), d gamma/dv (P, 12) and d(Phi_q a - gamma)/dq (P, 12) of every pair."""
    for k in range(len(pairs)):
        kind, a, b = pairs[k, PAIR.kind], pairs[k, PAIR.first], pairs[k, PAIR.second]
        m = pairs[k, PAIR.motion]
        if kind == 0:
            revolute_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        elif kind == 1:
            distance_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        elif kind == 2:
            driver_angle_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        elif kind == 3:
            driver_travel_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        elif kind == 4:
            point_on_line_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        elif kind == 5:
            fixed_angle_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        elif kind == 6:
            moving_center_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)
        else:
            function_tangent(k, a, b, m, q, v, acc, cs, p, u, lam, stiff, gamma_v, res_q)


@subkernel
def two_points_gradient(k, a, b, q, cs, p, s, grad):
    """Length s = |p_b - p_a| [m] and its gradient."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    length = sqrt((gx*gx) + (gy*gy))
    t0 = (1.0/length)
    t1 = gx*t0
    t2 = gy*t0
    s[k, 0] = length
    grad[k, 0] = -t1
    grad[k, 1] = -t2
    grad[k, 2] = -t0*(ax*gy - ay*gx)
    grad[k, 3] = t1
    grad[k, 4] = t2
    grad[k, 5] = t0*(bx*gy - by*gx)


@subkernel
def two_points_hessian(k, a, b, q, cs, p, hess):
    """Second derivatives of the length s = |p_b - p_a| [m]."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    length = sqrt((gx*gx) + (gy*gy))
    t0 = (1.0/length)
    t1 = (1.0/(length*length))
    t2 = (gx*gx)*t1 - 1
    t3 = -t0*t2
    t4 = gx*gy/(length*length*length)
    t5 = -t4
    t6 = ax*gy - ay*gx
    t7 = gx*t1
    t8 = t0*(ay + t6*t7)
    t9 = -t8
    t10 = t0*t2
    t11 = bx*gy - by*gx
    t12 = t0*(by + t11*t7)
    t13 = (gy*gy)*t1 - 1
    t14 = -t0*t13
    t15 = ax - gy*t1*t6
    t16 = t0*t15
    t17 = t0*t13
    t18 = bx - gy*t1*t11
    t19 = -t0*t18
    t20 = -t0*t15
    t21 = t0*(-ax*bx - ay*by + t1*t11*t6)
    t22 = -t12
    t23 = t0*t18
    hess[k, 0] = hess[k, 21] = t3
    hess[k, 1] = hess[k, 6] = hess[k, 22] = hess[k, 27] = t5
    hess[k, 2] = hess[k, 12] = t9
    hess[k, 3] = hess[k, 18] = t10
    hess[k, 4] = hess[k, 9] = hess[k, 19] = hess[k, 24] = t4
    hess[k, 5] = hess[k, 30] = t12
    hess[k, 7] = hess[k, 28] = t14
    hess[k, 8] = hess[k, 13] = t16
    hess[k, 10] = hess[k, 25] = t17
    hess[k, 11] = hess[k, 31] = t19
    hess[k, 14] = t0*((ax*ax) + ax*gx + (ay*ay) + ay*gy - t1*(t6*t6))
    hess[k, 15] = hess[k, 20] = t8
    hess[k, 16] = hess[k, 26] = t20
    hess[k, 17] = hess[k, 32] = t21
    hess[k, 23] = hess[k, 33] = t22
    hess[k, 29] = hess[k, 34] = t23
    hess[k, 35] = t0*((bx*bx) - bx*gx + (by*by) - by*gy - t1*(t11*t11))


@subkernel
def relative_angle_gradient(k, a, b, q, cs, p, s, grad):
    """Length s = theta_b - theta_a [rad] and its gradient."""
    tha, thb = q[3*a+2], q[3*b+2]
    s[k, 0] = -tha + thb
    grad[k, 2] = -1.0
    grad[k, 5] = 1.0


@subkernel
def pulley_gradient(k, a, b, q, cs, p, s, grad):
    """Length s = L - r (theta_b - theta_a) [m] and its gradient."""
    tha, thb = q[3*a+2], q[3*b+2]
    p4, p5 = p[k, 4], p[k, 5]
    s[k, 0] = p4*(tha - thb) + p5
    grad[k, 2] = p4
    grad[k, 5] = -p4


@subkernel
def lifted_gradient(k, a, b, q, cs, p, s, grad):
    """Length s = sqrt(|p_b - p_a|^2 + h^2) [m] and its gradient."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3, p4 = p[k, 0], p[k, 1], p[k, 2], p[k, 3], p[k, 4]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    length = sqrt((gx*gx) + (gy*gy))
    t0 = sqrt((length*length) + (p4*p4))
    t1 = (1.0/t0)
    t2 = gx*t1
    t3 = gy*t1
    s[k, 0] = t0
    grad[k, 0] = -t2
    grad[k, 1] = -t3
    grad[k, 2] = -t1*(ax*gy - ay*gx)
    grad[k, 3] = t2
    grad[k, 4] = t3
    grad[k, 5] = t1*(bx*gy - by*gx)


@subkernel
def lifted_hessian(k, a, b, q, cs, p, hess):
    """Second derivatives of the length s = sqrt(|p_b - p_a|^2 + h^2) [m]."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3, p4 = p[k, 0], p[k, 1], p[k, 2], p[k, 3], p[k, 4]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    length = sqrt((gx*gx) + (gy*gy))
    t0 = (length*length) + (p4*p4)
    t1 = (1.0/sqrt(t0))
    t2 = (1.0/t0)
    t3 = (gx*gx)*t2 - 1
    t4 = -t1*t3
    t5 = gx*gy/(t0*sqrt(t0))
    t6 = -t5
    t7 = ax*gy - ay*gx
    t8 = gx*t2
    t9 = t1*(ay + t7*t8)
    t10 = -t9
    t11 = t1*t3
    t12 = bx*gy - by*gx
    t13 = t1*(by + t12*t8)
    t14 = (gy*gy)*t2 - 1
    t15 = -t1*t14
    t16 = ax - gy*t2*t7
    t17 = t1*t16
    t18 = t1*t14
    t19 = bx - gy*t12*t2
    t20 = -t1*t19
    t21 = -t1*t16
    t22 = t1*(-ax*bx - ay*by + t12*t2*t7)
    t23 = -t13
    t24 = t1*t19
    hess[k, 0] = hess[k, 21] = t4
    hess[k, 1] = hess[k, 6] = hess[k, 22] = hess[k, 27] = t6
    hess[k, 2] = hess[k, 12] = t10
    hess[k, 3] = hess[k, 18] = t11
    hess[k, 4] = hess[k, 9] = hess[k, 19] = hess[k, 24] = t5
    hess[k, 5] = hess[k, 30] = t13
    hess[k, 7] = hess[k, 28] = t15
    hess[k, 8] = hess[k, 13] = t17
    hess[k, 10] = hess[k, 25] = t18
    hess[k, 11] = hess[k, 31] = t20
    hess[k, 14] = t1*((ax*ax) + ax*gx + (ay*ay) + ay*gy - t2*(t7*t7))
    hess[k, 15] = hess[k, 20] = t9
    hess[k, 16] = hess[k, 26] = t21
    hess[k, 17] = hess[k, 32] = t22
    hess[k, 23] = hess[k, 33] = t23
    hess[k, 29] = hess[k, 34] = t24
    hess[k, 35] = t1*((bx*bx) - bx*gx + (by*by) - by*gy - (t12*t12)*t2)


@subkernel
def travel_gradient(k, a, b, q, cs, p, s, grad):
    """Length s = coordinate of b's point in a's frame, along a direction [m] and its gradient."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p2, p3, p4, p5 = p[k, 2], p[k, 3], p[k, 4], p[k, 5]
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    t0 = bx - xa + xb
    t1 = by - ya + yb
    t2 = ca*p4 - p5*sa
    t3 = ca*p5 + p4*sa
    s[k, 0] = p4*(ca*t0 + sa*t1) + p5*(ca*t1 - sa*t0)
    grad[k, 0] = -t2
    grad[k, 1] = -t3
    grad[k, 2] = ca*(p4*t1 - p5*t0) - sa*(p4*t0 + p5*t1)
    grad[k, 3] = t2
    grad[k, 4] = t3
    grad[k, 5] = bx*t3 - by*t2


@subkernel
def travel_hessian(k, a, b, q, cs, p, hess):
    """Second derivatives of the length s = coordinate of b's point in a's frame, along a direction [m]."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p2, p3, p4, p5 = p[k, 2], p[k, 3], p[k, 4], p[k, 5]
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    t0 = ca*p5 + p4*sa
    t1 = ca*p4 - p5*sa
    t2 = -t1
    t3 = bx - xa + xb
    t4 = by - ya + yb
    t5 = -t0
    t6 = bx*t1 + by*t0
    hess[k, 2] = hess[k, 12] = t0
    hess[k, 8] = hess[k, 13] = t2
    hess[k, 14] = -ca*(p4*t3 + p5*t4) - sa*(p4*t4 - p5*t3)
    hess[k, 15] = hess[k, 20] = t5
    hess[k, 16] = hess[k, 26] = t1
    hess[k, 17] = t6
    hess[k, 32] = ca*(bx*p4 + by*p5) - sa*(bx*p5 - by*p4)
    hess[k, 35] = -t6


@subkernel
def tangent_gradient(k, a, b, q, cs, p, s, grad):
    """Length s = sqrt(|p_b - p_a|^2 - r^2) [m] of a tangent (derivatives: of s + r psi, psi the angle of its direction) and its gradient."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3, p4 = p[k, 0], p[k, 1], p[k, 2], p[k, 3], p[k, 4]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    straight = sqrt((gx*gx) + (gy*gy) - (p4*p4))
    tangent_x, tangent_y = (gx*straight - gy*p4)/((gx*gx) + (gy*gy)), (gx*p4 + gy*straight)/((gx*gx) + (gy*gy))
    s[k, 0] = straight
    grad[k, 0] = -tangent_x
    grad[k, 1] = -tangent_y
    grad[k, 2] = -ax*tangent_y + ay*tangent_x
    grad[k, 3] = tangent_x
    grad[k, 4] = tangent_y
    grad[k, 5] = bx*tangent_y - by*tangent_x


@subkernel
def tangent_hessian(k, a, b, q, cs, p, hess):
    """Second derivatives of the length s = sqrt(|p_b - p_a|^2 - r^2) [m] of a tangent (derivatives: of s + r psi, psi the angle of its direction)."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    p0, p1, p2, p3, p4 = p[k, 0], p[k, 1], p[k, 2], p[k, 3], p[k, 4]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    straight = sqrt((gx*gx) + (gy*gy) - (p4*p4))
    tangent_x, tangent_y = (gx*straight - gy*p4)/((gx*gx) + (gy*gy)), (gx*p4 + gy*straight)/((gx*gx) + (gy*gy))
    t0 = (1.0/straight)
    t1 = t0*(tangent_y*tangent_y)
    t2 = t0*tangent_y
    t3 = t2*tangent_x
    t4 = -t3
    t5 = ax*tangent_x
    t6 = ay*tangent_y
    t7 = t5 + t6
    t8 = t2*t7
    t9 = -t8
    t10 = -t1
    t11 = bx*tangent_x + by*tangent_y
    t12 = t11*t2
    t13 = t0*(tangent_x*tangent_x)
    t14 = t0*tangent_x
    t15 = t14*t7
    t16 = -t13
    t17 = t11*t14
    t18 = -t17
    t19 = t0*t7
    t20 = -t15
    t21 = -t11*t19
    t22 = -t12
    hess[k, 0] = hess[k, 21] = t1
    hess[k, 1] = hess[k, 6] = hess[k, 22] = hess[k, 27] = t4
    hess[k, 2] = hess[k, 12] = t9
    hess[k, 3] = hess[k, 18] = t10
    hess[k, 4] = hess[k, 9] = hess[k, 19] = hess[k, 24] = t3
    hess[k, 5] = hess[k, 30] = t12
    hess[k, 7] = hess[k, 28] = t13
    hess[k, 8] = hess[k, 13] = t15
    hess[k, 10] = hess[k, 25] = t16
    hess[k, 11] = hess[k, 31] = t18
    hess[k, 14] = t19*t5 + t19*t6 + t7
    hess[k, 15] = hess[k, 20] = t8
    hess[k, 16] = hess[k, 26] = t20
    hess[k, 17] = hess[k, 32] = t21
    hess[k, 23] = hess[k, 33] = t22
    hess[k, 29] = hess[k, 34] = t17
    hess[k, 35] = bx*t0*t11*tangent_x + by*t0*t11*tangent_y - t11


@subkernel
def guided_gradient(k, a, b, m, q, cs, p, guide, s, grad):
    """Length s = f(theta_b - theta_a) + h (p_b - p_a) [m], h in b's frame a function of theta_b - theta_a and its gradient."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    guide0, guide1, guide3, guide4, guide6, guide7 = guide[m, 0], guide[m, 1], guide[m, 3], guide[m, 4], guide[m, 6], guide[m, 7]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    t0 = cb*guide6 + guide3*sb
    t1 = cb*guide3 - guide6*sb
    t2 = guide1 + guide4*(cb*gx + gy*sb) + guide7*(cb*gy - gx*sb)
    s[k, 0] = guide0 + gx*t1 + gy*t0
    grad[k, 0] = -t1
    grad[k, 1] = -t0
    grad[k, 2] = -ax*t0 + ay*t1 - t2
    grad[k, 3] = t1
    grad[k, 4] = t0
    grad[k, 5] = bx*t0 - by*t1 + cb*(guide3*gy - guide6*gx) - sb*(guide3*gx + guide6*gy) + t2


@subkernel
def guided_hessian(k, a, b, m, q, cs, p, guide, hess):
    """Second derivatives of the length s = f(theta_b - theta_a) + h (p_b - p_a) [m], h in b's frame a function of theta_b - theta_a."""
    xa, ya, xb, yb = q[3*a+0], q[3*a+1], q[3*b+0], q[3*b+1]
    ca, sa, cb, sb = cs[a, 0], cs[a, 1], cs[b, 0], cs[b, 1]
    guide2, guide3, guide4, guide5, guide6, guide7, guide8 = guide[m, 2], guide[m, 3], guide[m, 4], guide[m, 5], guide[m, 6], guide[m, 7], guide[m, 8]
    p0, p1, p2, p3 = p[k, 0], p[k, 1], p[k, 2], p[k, 3]
    ax, ay = ca*p0 - p1*sa, ca*p1 + p0*sa
    bx, by = cb*p2 - p3*sb, cb*p3 + p2*sb
    gx, gy = -ax + bx - xa + xb, -ay + by - ya + yb
    t0 = cb*guide4
    t1 = guide7*sb
    t2 = t0 - t1
    t3 = cb*guide6 + guide3*sb
    t4 = -t0 + t1 + t3
    t5 = cb*guide7 + guide4*sb
    t6 = cb*guide3 - guide6*sb
    t7 = t5 + t6
    t8 = -t7
    t9 = cb*gx
    t10 = gy*sb
    t11 = cb*gy - gx*sb
    t12 = guide2 + guide5*(t10 + t9) + guide8*t11
    t13 = guide4*(ax*sb - ay*cb) + guide7*(ax*cb + ay*sb) + t12
    t14 = -t2
    t15 = -t5
    t16 = guide4*gy - guide7*gx
    t17 = guide4*gx + guide7*gy
    t18 = -t4
    t19 = guide4*(bx*sb - by*cb + t11) + guide7*(bx*cb + by*sb - t10 - t9) + t12
    hess[k, 2] = hess[k, 12] = t2
    hess[k, 5] = hess[k, 30] = t4
    hess[k, 8] = hess[k, 13] = t5
    hess[k, 11] = hess[k, 31] = t8
    hess[k, 14] = ax*t5 + ax*t6 - ay*t2 + ay*t3 + t13
    hess[k, 15] = hess[k, 20] = t14
    hess[k, 16] = hess[k, 26] = t15
    hess[k, 17] = -bx*t5 + by*t2 - cb*(ax*guide3 + ay*guide6 + t16) + sb*(ax*guide6 - ay*guide3 + t17) - t13
    hess[k, 23] = hess[k, 33] = t18
    hess[k, 29] = hess[k, 34] = t7
    hess[k, 32] = -ax*t7 - ay*t4 - t19
    hess[k, 35] = -bx*t6 + bx*t7 - by*t3 + by*t4 + cb*(bx*guide3 + by*guide6 - guide3*gx - guide6*gy + t16) - sb*(bx*guide6 - by*guide3 + guide3*gy - guide6*gx + t17) + t19


@subkernel
def section_forces(k, z, p, force, stress, energy):
    """Force conjugate to the state of a cross-section, its stress, its strain energy and its dissipated power."""
    dx, dy, dth, dvx, dvy, w, dw, c, s = z[k, 0], z[k, 1], z[k, 3], z[k, 4], z[k, 5], z[k, 6], z[k, 7], z[k, 8], z[k, 9]
    h, ea, ga, ei, e0, g0, k0, da, ds, db = p[k, 6], p[k, 7], p[k, 8], p[k, 9], p[k, 10], p[k, 11], p[k, 12], p[k, 13], p[k, 14], p[k, 15]
    along = c*dx + dy*s
    across = c*dy - dx*s
    t0 = along - e0
    t1 = ea*t0
    t2 = across - g0
    t3 = ga*t2
    t4 = across*w + c*dvx + dvy*s
    t5 = da*t4
    t6 = along*w - c*dvy + dvx*s
    t7 = ds*t6
    t8 = dth - k0
    t9 = db*dw + ei*t8
    force[k, 0] = h*(c*t1 + c*t5 - s*t3 + s*t7)
    force[k, 1] = h*(c*t3 - c*t7 + s*t1 + s*t5)
    force[k, 2] = h*(across*t1 + across*t5 - along*t3 + along*t7)
    force[k, 3] = h*t9
    stress[k, 0] = t1 + t5
    stress[k, 1] = ga*t2 - t7
    stress[k, 2] = t9
    energy[k, 0] = ((1.0/2.0))*h*(ea*(t0*t0) + ei*(t8*t8) + ga*(t2*t2))
    energy[k, 1] = h*(da*(t4*t4) + db*(dw*dw) + ds*(t6*t6))


@subkernel
def section_tangents(k, z, p, stiffness, damping):
    """Derivatives of the force."""
    dx, dy, dvx, dvy, w, c, s = z[k, 0], z[k, 1], z[k, 4], z[k, 5], z[k, 6], z[k, 8], z[k, 9]
    h, ea, ga, ei, e0, g0, da, ds, db = p[k, 6], p[k, 7], p[k, 8], p[k, 9], p[k, 10], p[k, 11], p[k, 13], p[k, 14], p[k, 15]
    along = c*dx + dy*s
    across = c*dy - dx*s
    t0 = ds*w
    t1 = c*ea + s*t0
    t2 = da*w
    t3 = c*t2 - ga*s
    t4 = c*dvx
    t5 = dvy*s
    t6 = ea*(along - e0)
    t7 = across*w
    t8 = t4 + t5
    t9 = da*(t7 + t8) + t6
    t10 = c*dvy
    t11 = dvx*s
    t12 = ga*(across - g0)
    t13 = -t12
    t14 = along*w
    t15 = -t10 + t11
    t16 = t14 + t15
    t17 = c*ga + s*t2
    t18 = c*t0 - ea*s
    t19 = across*ea + ds*(2*t14 + t15) + t13
    t20 = -along*ga + da*(2*t7 + t8) + t6
    t21 = across*da
    t22 = along*ds
    t23 = (c*c)
    t24 = (s*s)
    t25 = c*h*s*(da - ds)
    t26 = h*(c*t21 + s*t22)
    t27 = h*(-c*t22 + s*t21)
    stiffness[k, 0] = h*(c*t1 - s*t3)
    stiffness[k, 1] = h*(c*t3 + s*t1)
    stiffness[k, 2] = h*(across*t1 - along*t3 - c*(-da*t10 - ds*t11 - ds*t16 - t13) - s*(da*t4 - ds*t5 + t9))
    stiffness[k, 4] = -h*(c*t18 + s*t17)
    stiffness[k, 5] = h*(c*t17 - s*t18)
    stiffness[k, 6] = h*(-across*t18 - along*t17 + c*(da*t5 - ds*t4 + t9) - s*(da*t11 + ds*t10 - ds*t16 + t12))
    stiffness[k, 8] = h*(c*t19 - s*t20)
    stiffness[k, 9] = h*(c*t20 + s*t19)
    stiffness[k, 10] = h*(across*t19 - along*t20 + c*(dvx*t22 + dvy*t21) - s*(dvx*t21 - dvy*t22))
    stiffness[k, 15] = ei*h
    damping[k, 0] = h*(da*t23 + ds*t24)
    damping[k, 1] = damping[k, 4] = t25
    damping[k, 2] = damping[k, 8] = t26
    damping[k, 5] = h*(da*t24 + ds*t23)
    damping[k, 6] = damping[k, 9] = t27
    damping[k, 10] = h*((across*across)*da + (along*along)*ds)
    damping[k, 15] = db*h
