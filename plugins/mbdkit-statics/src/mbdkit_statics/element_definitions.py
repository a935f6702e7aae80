"""Position-level definitions of all elements in SymPy, from which all derivatives in the kernels are generated.

A planar body has the coordinates ``q = (x, y, theta)``: centre of mass and orientation. A body-fixed point ``s`` of
body ``b`` has the global position ``r_b + R(theta_b) s``. An element connects a first body ``a`` with a second body
``b``. Ground is a body fixed at ``q = 0``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import sympy as sp

xa, ya, tha, xb, yb, thb = BODY_COORDINATES = sp.symbols("xa ya tha xb yb thb", real=True)
BODY_VELOCITIES = sp.symbols("vxa vya wa vxb vyb wb", real=True)
BODY_ACCELERATIONS = sp.symbols("axa aya ala axb ayb alb", real=True)
u, u_dot, u_ddot = MOTION = sp.symbols("u_value u_dot u_ddot", real=True)
#: Element parameters; points first: ``p0, p1`` in the frame of the first body, ``p2, p3`` in that of the second.
PARAMETERS = sp.symbols("p0:6", real=True)


ca, sa, cb, sb = sp.symbols("ca sa cb sb", real=True)  #: Cosine and sine of ``theta_a`` and ``theta_b``.
#: Global components of the vectors from the centres of mass to the two points.
ax, ay, bx, by = sp.symbols("ax ay bx by", real=True)
#: Global components of the normal of a line. The direction of the line in the frame of the first body is ``(p4,
#: p5)``.
nx, ny = sp.symbols("nx ny", real=True)
#: The vector ``p_b - p_a`` between the two points, and its norm.
gx, gy, length = sp.symbols("gx gy length", positive=True)
straight = sp.Symbol("straight", positive=True)
#: Length of the tangent from one point to a circle around the other point, and components of its direction. The signed
#: radius of the circle is ``p4``.
tangent_x, tangent_y = sp.symbols("tangent_x tangent_y", real=True)
#: Displacement (x, y) of a moving point in the frame of the first body, and its first three derivatives with respect to
#: the relative angle ``theta_b - theta_a``.
CENTER = (sp.symbols("cx0:4", real=True), sp.symbols("cy0:4", real=True))
#: Global components of the vectors in `CENTER`.
_TURNED = (sp.symbols("hx0:4", real=True), sp.symbols("hy0:4", real=True))

#: Variables of a function of the pose: x, y and angle of the second body's point in the frame of the first body, the
#: angle of the first body, and the time.
VARIABLES = 5
TIME = VARIABLES - 1
#: Value of a function of the pose and its derivatives up to third order, by the indices of the variables.
FUNCTION = {
    chosen: sp.Symbol("f" + "".join(map(str, chosen)), real=True)
    for order in range(4)
    for chosen in combinations_with_replacement(range(VARIABLES), order)
}
#: Length of a guide, and components in the frame of the second body of its derivative with respect to ``p_b - p_a``, as
#: functions of ``theta_b - theta_a``, each with its first two derivatives.
GUIDE = sp.symbols("guide0:9", real=True)
arc, pull_x, pull_y = GUIDE[::3]
#: Position of the second body's point relative to the first body's centre of mass, in the frame of the first body.
in_x, in_y = sp.symbols("in_x in_y", real=True)

#: State of a cross-section of a beam: derivatives of its position (x, y) with respect to the arc length, its angle, and
#: the derivative of the angle with respect to the arc length. Position and angle are interpolated between the nodes.
SECTION = sp.symbols("dx dy th dth", real=True)
SECTION_RATES = sp.symbols("dvx dvy w dw", real=True)
c, s = sp.symbols("c s", real=True)  #: Cosine and sine of the angle of the cross-section.
#: Length of the part of the beam that an integration point represents [m].
SECTION_LENGTH = sp.Symbol("h", real=True)
SECTION_STIFFNESS = sp.symbols("ea ga ei", real=True)
#: Stiffness and damping of axial strain, shear strain and curvature.
SECTION_DAMPING = sp.symbols("da ds db", real=True)
#: Axial strain plus 1, shear strain and curvature of the stress-free beam.
SECTION_REFERENCE = sp.symbols("e0 g0 k0", real=True)
#: Components of the derivative of the position: along the normal of the cross-section, and in the plane of the
#: cross-section.
along, across = sp.symbols("along across", real=True)
_dx, _dy, _th, _dth = SECTION

#: Intermediate quantities by symbol, each as an expression in coordinates, parameters and earlier quantities.
INTERMEDIATES: dict[sp.Symbol, sp.Expr] = {
    ax: ca * PARAMETERS[0] - sa * PARAMETERS[1],
    ay: sa * PARAMETERS[0] + ca * PARAMETERS[1],
    bx: cb * PARAMETERS[2] - sb * PARAMETERS[3],
    by: sb * PARAMETERS[2] + cb * PARAMETERS[3],
    nx: -sa * PARAMETERS[4] - ca * PARAMETERS[5],
    ny: ca * PARAMETERS[4] - sa * PARAMETERS[5],
    gx: xb + bx - xa - ax,
    gy: yb + by - ya - ay,
    in_x: ca * (xb + bx - xa) + sa * (yb + by - ya),
    in_y: ca * (yb + by - ya) - sa * (xb + bx - xa),
    length: sp.sqrt(gx**2 + gy**2),
    straight: sp.sqrt(gx**2 + gy**2 - PARAMETERS[4] ** 2),
    tangent_x: (straight * gx - PARAMETERS[4] * gy) / (gx**2 + gy**2),
    tangent_y: (straight * gy + PARAMETERS[4] * gx) / (gx**2 + gy**2),
    along: c * _dx + s * _dy,
    across: c * _dy - s * _dx,
    **{hx: ca * cx - sa * cy for hx, cx, cy in zip(_TURNED[0], *CENTER, strict=True)},
    **{hy: sa * cx + ca * cy for hy, cx, cy in zip(_TURNED[1], *CENTER, strict=True)},
}

# These rules express derivatives in the intermediate quantities themselves. For example, the derivative of a rotated
# vector with respect to its angle is the vector rotated by another 90 degrees.
_DERIVATIVES: dict[sp.Symbol, dict[sp.Symbol, sp.Expr]] = {
    ca: {tha: -sa},
    sa: {tha: ca},
    cb: {thb: -sb},
    sb: {thb: cb},
    ax: {tha: -ay},
    ay: {tha: ax},
    bx: {thb: -by},
    by: {thb: bx},
    nx: {tha: -ny},
    ny: {tha: nx},
    gx: {xb: sp.Integer(1), xa: sp.Integer(-1), tha: ay, thb: -by},
    gy: {yb: sp.Integer(1), ya: sp.Integer(-1), tha: -ax, thb: bx},
    c: {_th: -s},
    s: {_th: c},
    along: {_dx: c, _dy: s, _th: across},
    across: {_dx: -s, _dy: c, _th: -along},
}
#: Derivatives of the first four variables of functions of the pose.
_POSE = (
    {xa: -ca, ya: -sa, tha: in_y, xb: ca, yb: sa, thb: sa * bx - ca * by},
    {xa: sa, ya: -ca, tha: -in_x, xb: -sa, yb: ca, thb: ca * bx + sa * by},
    {tha: sp.Integer(-1), thb: sp.Integer(1)},
    {tha: sp.Integer(1)},
)
_DERIVATIVES[in_x], _DERIVATIVES[in_y] = _POSE[:2]
for _chosen, _symbol in FUNCTION.items():
    if len(_chosen) < 3:
        _next = [FUNCTION[tuple(sorted((*_chosen, _i)))] for _i in range(TIME)]
        _DERIVATIVES[_symbol] = {
            q: sum(_f * _rules.get(q, 0) for _f, _rules in zip(_next, _POSE, strict=True)) for q in BODY_COORDINATES
        }
for _root in (length, straight):
    _DERIVATIVES[_root] = {
        q: (gx * _DERIVATIVES[gx].get(q, 0) + gy * _DERIVATIVES[gy].get(q, 0)) / _root for q in BODY_COORDINATES
    }
_turning = {  # derivatives of the angle of the tangent
    q: (tangent_x * _DERIVATIVES[gy].get(q, 0) - tangent_y * _DERIVATIVES[gx].get(q, 0)) / straight
    for q in BODY_COORDINATES
}
_DERIVATIVES[tangent_x] = {q: -tangent_y * _turning[q] for q in BODY_COORDINATES}
_DERIVATIVES[tangent_y] = {q: tangent_x * _turning[q] for q in BODY_COORDINATES}
for _i in (0, 1, 3, 4, 6, 7):
    _DERIVATIVES[GUIDE[_i]] = {tha: -GUIDE[_i + 1], thb: GUIDE[_i + 1]}
for _i in range(3):  # each vector rotates with the first body and depends on the relative angle
    (_hx, _hy), (_next_hx, _next_hy) = ((_TURNED[0][_k], _TURNED[1][_k]) for _k in (_i, _i + 1))
    _DERIVATIVES[_hx] = {tha: -_hy - _next_hx, thb: _next_hx}
    _DERIVATIVES[_hy] = {tha: _hx - _next_hy, thb: _next_hy}


def differentiate(expr: sp.Expr, symbol: sp.Symbol) -> sp.Expr:
    """Return the total derivative of `expr` with respect to `symbol`, in which the intermediate quantities depend on
    the coordinates.
    """
    total = expr.diff(symbol)
    for inner, rules in _DERIVATIVES.items():
        if symbol in rules and expr.has(inner):
            total += expr.diff(inner) * rules[symbol]
    return total


def jacobian(exprs: Sequence[sp.Expr], symbols: Sequence[sp.Symbol]) -> sp.Matrix:
    """Return the matrix of total derivatives, one row per expression."""
    return sp.Matrix([[differentiate(e, s) for s in symbols] for e in exprs])


@dataclass(frozen=True)
class ConstraintKind:
    """A kinematic constraint of one or two rows, ``Phi(q_a, q_b, u(t)) = 0``."""

    name: str
    rows: tuple[sp.Expr, ...]
    note: str
    #: Name and LaTeX of the parameters ``p4`` and ``p5``, which follow the points.
    constants: tuple[tuple[str, str], ...] = ()


_ARM = (xb + bx - xa, yb + by - ya)
#: Position of the second body's point relative to the first body's centre of mass, in the frame of the first body.
_IN_A = (ca * _ARM[0] + sa * _ARM[1], ca * _ARM[1] - sa * _ARM[0])
_TRAVEL = PARAMETERS[4] * _IN_A[0] + PARAMETERS[5] * _IN_A[1]
#: Name and LaTeX of the components of a unit vector in the frame of the first body.
_DIRECTION = (("e_x", "e^{x}"), ("e_y", "e^{y}"))

CONSTRAINTS = (
    ConstraintKind("revolute", (gx, gy), "Phi = p_b - p_a of two points that coincide"),
    ConstraintKind("distance", (length - PARAMETERS[4],), "Phi = |p_b - p_a| - length", (("L", "L"),)),
    ConstraintKind("driver_angle", (thb - tha - u,), "Phi = theta_b - theta_a - u(t)"),
    ConstraintKind(
        "driver_travel",
        (_TRAVEL - u,),
        "Phi = coordinate of b's point in a's frame, along a direction, - u(t)",
        _DIRECTION,
    ),
    ConstraintKind(
        "point_on_line",
        (nx * gx + ny * gy,),
        "Phi = distance of b's point from the line through a's",
        _DIRECTION,
    ),
    ConstraintKind(
        "fixed_angle", (thb - tha - PARAMETERS[4],), "Phi = theta_b - theta_a - angle", (("phi", r"\varphi"),)
    ),
    ConstraintKind(
        "moving_center",
        (gx - _TURNED[0][0], gy - _TURNED[1][0]),
        "Phi = p_b - p_a - c, c in a's frame a function of theta_b - theta_a",
    ),
    ConstraintKind(
        "function", (FUNCTION[()],), "Phi = f(x, y, angle; theta_a, t) of the pose of b's point in a's frame"
    ),
)


@dataclass(frozen=True)
class PathwayKind:
    """A generalised length ``s(q_a, q_b)``. A law gives a scalar force F along it, whose generalized force is ``-F
    s_q``.

    A pathway over several joints has several segments; its length is the sum of their lengths.
    """

    name: str
    length: sp.Expr
    note: str
    #: Name and LaTeX of the parameters ``p4`` and ``p5``, which follow the points.
    constants: tuple[tuple[str, str], ...] = ()
    #: Derivatives with respect to `gx` and `gy` that are used instead of those of `length`.
    slopes: tuple[sp.Expr, sp.Expr] | None = None


PATHWAYS = (
    PathwayKind("two_points", length, "s = |p_b - p_a| [m]"),
    PathwayKind("relative_angle", thb - tha, "s = theta_b - theta_a [rad]"),
    PathwayKind(
        "pulley",
        PARAMETERS[5] - PARAMETERS[4] * (thb - tha),
        "s = L - r (theta_b - theta_a) [m]",
        (("r", "r"), ("L", "L")),
    ),
    PathwayKind("lifted", sp.sqrt(length**2 + PARAMETERS[4] ** 2), "s = sqrt(|p_b - p_a|^2 + h^2) [m]", (("h", "h"),)),
    PathwayKind("travel", _TRAVEL, "s = coordinate of b's point in a's frame, along a direction [m]", _DIRECTION),
    # The slopes are the derivatives of the length of the tangent plus r times the angle of its direction. The length of
    # a string around a circle is the sum of two such terms with opposite r, up to multiples of 2 pi r. Each term
    # depends on only two bodies.
    PathwayKind(
        "tangent",
        straight,
        "s = sqrt(|p_b - p_a|^2 - r^2) [m] of a tangent (derivatives: of s + r psi, psi the angle of its direction)",
        (("r", "r"),),
        (tangent_x, tangent_y),
    ),
    # Both points are the center of a joint, where what leads the path around the joint pulls the second body.
    PathwayKind(
        "guided",
        arc + (cb * pull_x - sb * pull_y) * gx + (sb * pull_x + cb * pull_y) * gy,
        "s = f(theta_b - theta_a) + h (p_b - p_a) [m], h in b's frame a function of theta_b - theta_a",
    ),
)


#: Axial strain, shear strain and curvature of a planar beam (E. Reissner, J. Appl. Math. Phys. 23, 1972; J. C. Simo and
#: L. Vu-Quoc, J. Appl. Mech. 53, 1986).
SECTION_STRAINS = tuple(
    strain - reference for strain, reference in zip((along, across, _dth), SECTION_REFERENCE, strict=True)
)


def derive_section() -> dict[str, sp.Matrix]:
    """Derive the forces of a cross-section of a beam from its strain energy and its dissipation.

    The strain energy is ``h/2 (EA axial^2 + GA shear^2 + EI curvature^2)``. The material is a Kelvin-Voigt material: a
    part of the stress is proportional to the strain rates. This part follows from a dissipation function of the same
    form as the strain energy.

    Returns
    -------
    dict
        ``force`` (4, 1), conjugate to `SECTION`; its derivatives ``stiffness`` and ``damping`` (4, 4) with respect to
        `SECTION` and `SECTION_RATES`; ``stress`` (3, 1), which are axial force, shear force and bending moment; and
        ``energy`` (2, 1), which are strain energy and dissipated power.
    """
    rates = jacobian(SECTION_STRAINS, SECTION) * sp.Matrix(SECTION_RATES)
    energy = sum(k * e**2 for k, e in zip(SECTION_STIFFNESS, SECTION_STRAINS, strict=True)) * SECTION_LENGTH / 2
    dissipation = sum(d * e**2 for d, e in zip(SECTION_DAMPING, rates, strict=True)) * SECTION_LENGTH / 2
    force = jacobian([energy], SECTION).T + sp.Matrix([dissipation]).jacobian(SECTION_RATES).T
    stress = [
        k * e + d * rate
        for k, d, e, rate in zip(SECTION_STIFFNESS, SECTION_DAMPING, SECTION_STRAINS, rates, strict=True)
    ]
    return {
        "force": force,
        "stiffness": jacobian(list(force), SECTION),
        "damping": force.jacobian(SECTION_RATES),
        "stress": sp.Matrix(stress),
        "energy": sp.Matrix([energy, 2 * dissipation]),
    }


def derive_constraint(kind: ConstraintKind) -> dict[str, sp.Matrix]:
    """Derive the Jacobian, the right-hand side and the tangents of a constraint.

    Parameters
    ----------
    kind
        The constraint, which has ``r`` rows.

    Returns
    -------
    dict
        ``phi`` (r, 1), ``phi_t`` (r, 1), ``jacobian`` (r, 6), ``gamma`` (r, 1) with
        ``gamma = -(Phi_q v)_q v - 2 Phi_qt v - Phi_tt``, and the tangents at given ``v``, ``a`` and ``lambda``:
        ``stiffness`` (6, 6) = d(Phi_q^T lambda)/dq, ``gamma_v`` (r, 6), ``residual_q`` (r, 6) = (Phi_q a - gamma)_q.
    """
    q, v, a = BODY_COORDINATES, sp.Matrix(BODY_VELOCITIES), sp.Matrix(BODY_ACCELERATIONS)
    lam = sp.Matrix(sp.symbols(f"lam0:{len(kind.rows)}", real=True))
    phi_q = jacobian(kind.rows, q)
    phi_t = sp.Matrix(kind.rows).applyfunc(_by_time)
    rate = phi_q * v + phi_t
    gamma = -(jacobian(rate, q) * v + rate.applyfunc(_by_time))
    return {
        "phi": sp.Matrix(kind.rows),
        "phi_t": phi_t,
        "jacobian": phi_q,
        "gamma": gamma,
        "stiffness": jacobian(phi_q.T * lam, q),
        "gamma_v": gamma.jacobian(v),
        "residual_q": jacobian(phi_q * a - gamma, q),
    }


def _by_time(expr: sp.Expr) -> sp.Expr:
    """Return the partial derivative by time, on which motions and functions of the pose depend."""
    total = expr.diff(u) * u_dot + expr.diff(u_dot) * u_ddot
    for chosen, symbol in FUNCTION.items():
        if len(chosen) < 3 and expr.has(symbol):
            total += expr.diff(symbol) * FUNCTION[tuple(sorted((*chosen, TIME)))]
    return total


def derive_pathway(kind: PathwayKind) -> dict[str, sp.Matrix]:
    """Derive ``length`` (1, 1), its ``gradient`` (1, 6) and its ``hessian`` (6, 6) with respect to ``q_a, q_b``."""
    gradient = jacobian([kind.length], BODY_COORDINATES)
    if kind.slopes is not None:
        gradient = sp.Matrix([kind.slopes]) * jacobian([gx, gy], BODY_COORDINATES)
    return {"length": sp.Matrix([kind.length]), "gradient": gradient, "hessian": jacobian(gradient.T, BODY_COORDINATES)}
