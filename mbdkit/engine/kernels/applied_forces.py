"""Applied forces: force elements (a law on a pathway), beams, interactions, torques, point forces; tangents, powers,
potentials.

A force element pulls its two bodies together with the tension ``F(s, s', t)`` along a pathway of length ``s``. Its
generalized force is ``Q = -F s_q``. Gravity is not part of these forces: it is a constant acceleration, and the solvers
add it to the free accelerations.
"""

from __future__ import annotations

import math
from math import sqrt

import numpy as np

from mbdkit.engine.kernels import element_kernels as e
from mbdkit.engine.kernels.cross_sections import add_beam_forces, beam_tangents
from mbdkit.engine.kernels.table_rows import (
    COUPLING,
    INPUT,
    INTERACTION,
    LAW_ROW,
    LINEAR,
    LOAD,
    LOAD_VALUE,
    MULTIPLIER,
    PAIR,
    SLOPE,
    SPRING,
    STATE_ROW,
    STATE_USE,
    TENSION,
)
from mbdkit.engine.kernels.vectors import fill
from mbdkit.engine.native.arithmetic import any_of, is_refused, put_in_place, renewed, where
from mbdkit.engine.native.calls import HAS_POTENTIAL, PASSIVE, call_law
from mbdkit.engine.native.functions import inlined, subkernel

PATHWAYS = {name: code for code, name in enumerate(e.PATHWAY_KINDS)}
_TWO_POINTS, _RELATIVE_ANGLE, _PULLEY, _LIFTED, _TRAVEL, _TANGENT, _GUIDED = PATHWAYS.values()
BEHIND = np.pi / 6  #: A string sweeps an angle from minus this to 2 pi minus this about its circle.
#: Beyond this angle, a string would change sides, and its length would jump; a step turns it by less than `BEHIND`.
FARTHEST = 2.0 * np.pi - 2.0 * BEHIND
#: Kinds of inputs of expressions of the state: a coordinate, its velocity; length, rate and tension of a pathway.
POSITION_INPUT, VELOCITY_INPUT, LENGTH_INPUT, RATE_INPUT, TENSION_INPUT = range(5)
#: Kinds of loads. A POINT_FORCE is given in the global frame, a BODY_FORCE in the frame of its body.
TORQUE, POINT_FORCE, BODY_FORCE = range(3)

two_points_gradient, relative_angle_gradient = e.two_points_gradient, e.relative_angle_gradient
pulley_gradient, lifted_gradient, tangent_gradient = e.pulley_gradient, e.lifted_gradient, e.tangent_gradient
travel_gradient, travel_hessian = e.travel_gradient, e.travel_hessian
guided_gradient, guided_hessian = e.guided_gradient, e.guided_hessian
two_points_hessian, lifted_hessian, tangent_hessian = e.two_points_hessian, e.lifted_hessian, e.tangent_hessian


@inlined
def any_forces(top):
    """Return whether `applied_forces` is needed: for force elements, loads, interactions, beams, or the expressions of
    the rates of first-order states.
    """
    return len(top.springs) + len(top.loads) + len(top.interactions) + len(top.sections) + len(top.states) > 0


@subkernel
def pathway_lengths(top, w, q):
    """Write all lengths of pathways into ``w.s`` (S, 1) and the gradients s_q of their segments into ``w.grad`` (S, 6).

    All segments of a spring receive the length of its whole pathway. The kind of pathway is selected by comparisons,
    because Numba loses inlining when it indexes a tuple of functions.
    """
    springs, points, cs, s, grad = top.springs, top.spring_points, w.cs, w.s, w.grad
    for k in range(len(springs)):
        a, b = springs[k, SPRING.first], springs[k, SPRING.second]
        if springs[k, SPRING.pathway] == _TWO_POINTS:
            two_points_gradient(k, a, b, q, cs, points, s, grad)
            if any_of(s[k, 0] == 0.0):  # coincident points define no direction (0/0): the spring then exerts no force
                for i in range(6):
                    grad[k, i] = where(s[k, 0] == 0.0, 0.0, grad[k, i])
        elif springs[k, SPRING.pathway] == _RELATIVE_ANGLE:
            relative_angle_gradient(k, a, b, q, cs, points, s, grad)
        elif springs[k, SPRING.pathway] == _PULLEY:
            pulley_gradient(k, a, b, q, cs, points, s, grad)
        elif springs[k, SPRING.pathway] == _LIFTED:
            lifted_gradient(k, a, b, q, cs, points, s, grad)
            if k >= 2 and springs[k - 1, SPRING.pathway] == _TANGENT:  # a string that may touch a circle
                choose_side_of_circle(k, points, s, grad)
        elif springs[k, SPRING.pathway] == _TRAVEL:
            travel_gradient(k, a, b, q, cs, points, s, grad)
        elif springs[k, SPRING.pathway] == _GUIDED:
            m, angle = springs[k, SPRING.place], q[3 * b + 2] - q[3 * a + 2]
            evaluate_law(top, w, springs[k, SPRING.guide], angle, 0.0 * angle, w.time[0], w.guide, m, 9)
            guided_gradient(k, a, b, m, q, cs, points, w.guide, s, grad)
        else:
            tangent_gradient(k, a, b, q, cs, points, s, grad)
    for k in range(len(springs)):
        # all segments share the length of the whole, so that tension and derivatives need no case distinction
        for other in range(k + 1, k + springs[k, SPRING.segments]):
            s[k, 0] += s[other, 0]
        if springs[k, SPRING.segments] == 0:
            s[k, 0] = s[springs[k, SPRING.leader], 0]


@subkernel
def choose_side_of_circle(k, points, s, grad):
    """Decide whether a string touches a circle, and set the segments that are not part of its path to zero.

    Segment `k` is the straight line. The two segments before it are the tangents, onto the circle and off it; their
    unit vectors and lengths give the vectors from the center to both ends. The length is NaN if the string would have
    to pass the circle on its other side or to wind around it, and if an end is inside of the circle.
    """
    radius, onto, off = points[k - 2, 4], s[k - 2, 0], s[k - 1, 0]
    # vectors from the center to both ends: no arguments beyond the segments are needed
    ux, uy = radius * -grad[k - 2, 4] - onto * grad[k - 2, 3], radius * grad[k - 2, 3] - onto * grad[k - 2, 4]
    vx, vy = off * grad[k - 1, 3] - radius * grad[k - 1, 4], off * grad[k - 1, 4] + radius * grad[k - 1, 3]
    side, size = where(radius > 0.0, 1.0, -1.0), abs(radius)
    # the angle from one end to the other about the center, in the sense in which the string runs; it is counted from
    # -`BEHIND`, because a string that does not touch may sweep a small negative angle
    sweep = -side * math.atan2(ux * vy - uy * vx, ux * vx + uy * vy)
    sweep = where(sweep < -BEHIND, sweep + 2.0 * np.pi, sweep)
    covered = math.atan2(size, onto) + math.atan2(size, off)
    # the tangents cover the angle from each end to its point of contact; the rest lies on the circle
    turn = sweep + covered - np.pi
    touches = (turn > 0.0) & (sweep <= FARTHEST)
    is_free = (turn <= 0.0) & ((sweep >= 0.0) | (covered - sweep <= np.pi))
    s[k - 2, 0] = where(touches, onto + size * turn, where(is_free, 0.0, np.nan))
    s[k - 1, 0] = where(touches, off, 0.0)
    s[k, 0] = where(touches, 0.0, s[k, 0])
    # a segment that is not part of the path must not pull its bodies
    for i in range(6):
        grad[k - 2, i] = where(touches, grad[k - 2, i], 0.0)
        grad[k - 1, i] = where(touches, grad[k - 1, i], 0.0)
        grad[k, i] = where(touches, 0.0, grad[k, i])


@subkernel
def path_rate(k, springs, v, grad):
    """Return the rate ``s' = s_q v`` of the pathway whose first segment is `k`; 0 for other segments."""
    rate = 0.0
    for segment in range(k, k + springs[k, SPRING.segments]):
        a, b = springs[segment, SPRING.first], springs[segment, SPRING.second]
        for i in range(3):
            rate += grad[segment, i] * v[3 * a + i] + grad[segment, 3 + i] * v[3 * b + i]
    return rate


@subkernel
def evaluate_tension(top, w, k, rate):
    """Write F, dF/ds, dF/ds' and the potential of force element `k` into row `k` of ``w.tension`` (S + 1, 4).

    If a law returns a force that is not finite for finite arguments, its row in ``top.laws`` is stored in ``w.faulty``
    (1,) for the error message. If the arguments are not finite, the state has overflowed and the law is not the cause.
    Linear springs are computed here, without a call by address. Only the first segment of a spring is evaluated, with
    the `rate` of the whole pathway; the rows of its other segments are copies.
    """
    length, law, tension = w.s[k, 0], top.springs[k, SPRING.law], w.tension
    if top.springs[k, SPRING.segments] == 0:
        for i in range(4):
            tension[k, i] = tension[top.springs[k, SPRING.leader], i]
    elif law < 0:
        stiffness, damping = top.linear[k, LINEAR.stiffness], top.linear[k, LINEAR.damping]
        stretch = length - top.linear[k, LINEAR.free_length]
        tension[k, TENSION.force] = stiffness * stretch + damping * rate
        tension[k, TENSION.by_length] = stiffness
        tension[k, TENSION.by_rate] = damping
        tension[k, TENSION.potential] = 0.5 * stiffness * stretch * stretch
    else:
        evaluate_law(top, w, law, length, rate, w.time[0], tension, k, 4)
        is_law_at_fault = (abs(length) < np.inf) & (abs(rate) < np.inf) & (not abs(tension[k, TENSION.force]) < np.inf)
        if is_refused(not is_law_at_fault):
            w.faulty[0] = law


@subkernel
def take_states(top, w, z):
    """Use the values `z` (Z,) of first-order states in the forces and rates that are evaluated next."""
    for i in range(len(top.state_places)):
        put_in_place(w.law_values, top.state_places[i, STATE_USE.parameter], z[top.state_places[i, STATE_USE.state]])


@subkernel
def take_multipliers(top, w, lam):
    """Use the multipliers `lam` (P, 2) in the friction of joints that is evaluated next."""
    for i in range(len(top.reactions)):
        value = lam[top.reactions[i, MULTIPLIER.pair], top.reactions[i, MULTIPLIER.row]]
        put_in_place(w.law_values, top.reactions[i, MULTIPLIER.parameter], value)


@inlined
def evaluate_law(top, w, law, length, rate, t, out, row, count):
    """Write the `count` values of the law in row `law` of ``top.laws`` into row `row` of `out`."""
    address, program = top.laws[law, LAW_ROW.address], top.laws[law, LAW_ROW.program]
    call_law(address, program, length, rate, t, w.law_values, top.laws[law, LAW_ROW.parameters], out, row, count)


@subkernel
def law_value(top, w, law, length, rate, t):
    """Return the value of the law in row `law` of ``top.laws`` for its current parameters."""
    spare = len(top.springs)
    evaluate_law(top, w, law, length, rate, t, w.tension, spare, 4)
    return w.tension[spare, TENSION.force]


@subkernel
def state_rates(top, w, v, out):
    """Write the rates of all first-order states to `out` (Z,); requires `take_states` and `applied_forces`."""
    for i in range(len(top.states)):
        k, law = top.states[i, STATE_ROW.segment], top.states[i, STATE_ROW.rate]
        if law < 0:
            out[i] = 0.0
        elif k >= 0:
            out[i] = law_value(top, w, law, w.s[k, 0], path_rate(k, top.springs, v, w.grad), w.time[0])
        else:
            out[i] = expression_value(top, w, law)


@inlined
def expression_value(top, w, law):
    """Return the value of an expression of the state, a law without a pathway whose inputs are among its parameters."""
    unused = 0.0 * w.cs[0, 0]
    return law_value(top, w, law, unused, 0.0, w.time[0])


@subkernel
def evaluate_expressions(top, w, q, v):
    """Evaluate the loads that are expressions of the state into ``w.u``; requires the tensions at the same state.

    The inputs of all expressions are copied to their parameters, also those of expressions for rates of states.
    """
    for i in range(len(top.inputs)):
        kind, k, place = top.inputs[i, INPUT.kind], top.inputs[i, INPUT.source], top.inputs[i, INPUT.parameter]
        if kind == POSITION_INPUT:
            put_in_place(w.law_values, place, q[k])
        elif kind == VELOCITY_INPUT:
            put_in_place(w.law_values, place, v[k])
        elif kind == LENGTH_INPUT:
            put_in_place(w.law_values, place, w.s[k, 0])
        elif kind == RATE_INPUT:
            put_in_place(w.law_values, place, path_rate(k, top.springs, v, w.grad))
        else:
            put_in_place(w.law_values, place, w.tension[k, TENSION.force])
    for i in range(len(top.load_values)):
        law = top.load_values[i, LOAD_VALUE.law]
        value = expression_value(top, w, law)
        w.u[top.load_values[i, LOAD_VALUE.motion], 0] = value
        if is_refused(abs(value) < np.inf):
            w.faulty[0] = law


@subkernel
def load_slope(top, w, v, i):
    """Write -dQ/dq and -dQ/dv of a load by an input of its value into row `i` of ``w.slope_stiff`` and ``slope_damp``.

    The rows belong to the coordinates of the two bodies of the load, the columns to those of the bodies of the input.
    Requires the second derivatives of the pathways.
    """
    load, component, law = top.slopes[i, SLOPE.load], top.slopes[i, SLOPE.component], top.slopes[i, SLOPE.law]
    given, k = top.slopes[i, SLOPE.input], top.slopes[i, SLOPE.segment]
    kind = top.inputs[given, INPUT.kind]
    slope = expression_value(top, w, law)
    stiff, damp = w.slope_stiff[i], w.slope_damp[i]
    for row in range(6):
        along = -slope * load_direction(top, w, load, component, row)
        for column in range(6):
            stiff[6 * row + column] = 0.0
            damp[6 * row + column] = 0.0
            if kind == POSITION_INPUT:
                if column == top.inputs[given, INPUT.source] % 3:
                    stiff[6 * row + column] = along
            elif kind == VELOCITY_INPUT:
                if column == top.inputs[given, INPUT.source] % 3:
                    damp[6 * row + column] = along
            elif kind == LENGTH_INPUT:
                stiff[6 * row + column] = along * w.grad[k, column]
            elif kind == RATE_INPUT:
                stiff[6 * row + column] = along * rate_slope(top, w, v, k, column)
                damp[6 * row + column] = along * w.grad[k, column]
            else:
                by_position = w.tension[k, TENSION.by_length] * w.grad[k, column]
                stiff[6 * row + column] = along * (
                    by_position + w.tension[k, TENSION.by_rate] * rate_slope(top, w, v, k, column)
                )
                damp[6 * row + column] = along * w.tension[k, TENSION.by_rate] * w.grad[k, column]


@subkernel
def rate_slope(top, w, v, k, column):
    """Return the derivative ``(s_q v)_q`` of the rate of segment `k` with respect to a coordinate of its two bodies."""
    a, b = top.springs[k, SPRING.first], top.springs[k, SPRING.second]
    bend = 0.0 * w.cs[0, 0]
    if top.springs[k, SPRING.pathway] != _RELATIVE_ANGLE and top.springs[k, SPRING.pathway] != _PULLEY:
        for i in range(3):
            bend += w.hess[k, 6 * i + column] * v[3 * a + i] + w.hess[k, 6 * (3 + i) + column] * v[3 * b + i]
    return where(w.s[k, 0] != 0.0, bend, 0.0)


@subkernel
def load_direction(top, w, k, component, i):
    """Return the generalized force of a unit of the torque, or of a component of the force, of load `k`, for coordinate
    `i` of its two bodies.
    """
    loads, points, cs = top.loads, top.load_points, w.cs
    body = loads[k, LOAD.body]
    c, sn = cs[body, 0], cs[body, 1]
    px, py = c * points[k, 0] - sn * points[k, 1], sn * points[k, 0] + c * points[k, 1]
    none = 0.0 * c
    if loads[k, LOAD.kind] == TORQUE:
        return none + 1.0 if i == 2 else (none - 1.0 if i == 5 else none)
    if i > 2:
        return none
    x, y = none + (1.0 if component == 0 else 0.0), none + (1.0 if component == 1 else 0.0)
    if loads[k, LOAD.kind] == BODY_FORCE:
        x, y = c * x - sn * y, sn * x + c * y
    if i == 0:
        return x
    return y if i == 1 else px * y - py * x


@subkernel
def applied_forces(top, w, q, v):
    """Write the generalized applied forces without gravity into ``w.force`` (3 (B + 1),).

    Requires `mbdkit.engine.kernels.system.prepare`. No solver reads the three entries of ground.
    """
    springs, loads, grad, force, u = top.springs, top.loads, w.grad, w.force, w.u
    fill(force, 0.0)
    pathway_lengths(top, w, q)
    for k in range(len(springs)):
        a, b = springs[k, SPRING.first], springs[k, SPRING.second]
        evaluate_tension(top, w, k, path_rate(k, springs, v, grad))
        pull = w.tension[k, TENSION.force]
        for i in range(3):
            force[3 * a + i] -= pull * grad[k, i]
            force[3 * b + i] -= pull * grad[k, 3 + i]
    # expressions may contain tensions, which are known from here on
    if len(top.inputs) + len(top.load_values) > 0:
        evaluate_expressions(top, w, q, v)
    for k in range(len(loads)):
        body = loads[k, LOAD.body]
        if loads[k, LOAD.kind] == TORQUE:
            value = u[loads[k, LOAD.x], 0]
            force[3 * body + 2] += value
            force[3 * loads[k, LOAD.reaction_body] + 2] -= value
        else:
            fx, fy, px, py = point_force(top, w, k)
            force[3 * body] += fx
            force[3 * body + 1] += fy
            force[3 * body + 2] += px * fy - py * fx
    for k in range(len(top.interactions)):
        add_interaction(top, w, q, v, k)
    if len(top.sections) > 0:
        add_beam_forces(top, w, q, v)


@subkernel
def add_interaction(top, w, q, v, k):
    """Evaluate the forces and torques of interaction `k` into its row of ``w.interaction`` (C, 6), and add them."""
    law = top.interactions[k, INTERACTION.law]
    place_bodies(top, w, q, v, k)
    evaluate_law(top, w, law, 0.0 * w.cs[0, 0], 0.0, w.time[0], w.interaction, k, 6)
    # one sum shows whether any of the six values is not finite
    total = 0.0
    for i in range(6):
        w.force[3 * top.interactions[k, INTERACTION.first + i // 3] + i % 3] += w.interaction[k, i]
        total += w.interaction[k, i]
    if is_refused(abs(total) < np.inf):
        w.faulty[0] = law


@inlined
def place_bodies(top, w, q, v, k):
    """Store the states of the bodies of interaction `k` as the first parameters of its law: for each body x, y, cosine
    and sine of the angle, and the velocities.
    """
    place = top.laws[top.interactions[k, INTERACTION.law], LAW_ROW.parameters] + 1
    for side in range(2):
        body = top.interactions[k, INTERACTION.first + side]
        put_in_place(w.law_values, place, q[3 * body])
        put_in_place(w.law_values, place + 1, q[3 * body + 1])
        put_in_place(w.law_values, place + 2, w.cs[body, 0])
        put_in_place(w.law_values, place + 3, w.cs[body, 1])
        for i in range(3):
            put_in_place(w.law_values, place + 4 + i, v[3 * body + i])
        place += 7


@subkernel
def interaction_tangents(top, w, q, v, k):
    """Write -dQ/dq and -dQ/dv of interaction `k` into ``w.interaction_stiff`` and ``w.interaction_damp``."""
    law = top.interactions[k, INTERACTION.law] + 1
    place_bodies(top, w, q, v, k)
    evaluate_law(top, w, law, 0.0 * w.cs[0, 0], 0.0, w.time[0], w.interaction_slopes, 0, 72)
    # the law gives derivatives of forces, tangents are those of -Q
    for i in range(36):
        w.interaction_stiff[k, i] = -w.interaction_slopes[0, i]
        w.interaction_damp[k, i] = -w.interaction_slopes[0, 36 + i]


@subkernel
def point_force(top, w, k):
    """Return force [N] and lever arm [m] of load `k`, (F_x, F_y, p_x, p_y), in the global frame.

    The lever arm is the vector from the centre of mass to the point of application.
    """
    loads, points, cs, u = top.loads, top.load_points, w.cs, w.u
    body = loads[k, LOAD.body]
    fx, fy = u[loads[k, LOAD.x], 0], u[loads[k, LOAD.y], 0]
    c, sn = cs[body, 0], cs[body, 1]
    if loads[k, LOAD.kind] == BODY_FORCE:
        fx, fy = c * fx - sn * fy, sn * fx + c * fy
    px, py = c * points[k, 0] - sn * points[k, 1], sn * points[k, 0] + c * points[k, 1]
    return fx, fy, px, py


@subkernel
def pathway_hessian(top, w, k, q):
    """Write s_qq of segment `k` into row `k` of ``w.hess`` (S, 36), and return whether it may differ from zero."""
    springs, points, cs, grad, hess = top.springs, top.spring_points, w.cs, w.grad, w.hess
    a, b = springs[k, SPRING.first], springs[k, SPRING.second]
    curved = True
    if springs[k, SPRING.pathway] == _TWO_POINTS:
        curved = w.s[k, 0] != 0.0
        if any_of(curved):
            two_points_hessian(k, a, b, q, cs, points, hess)
    elif springs[k, SPRING.pathway] == _TRAVEL:
        travel_hessian(k, a, b, q, cs, points, hess)
    elif springs[k, SPRING.pathway] == _GUIDED:
        guided_hessian(k, a, b, springs[k, SPRING.place], q, cs, points, w.guide, hess)
    elif springs[k, SPRING.pathway] == _LIFTED or springs[k, SPRING.pathway] == _TANGENT:
        if springs[k, SPRING.pathway] == _LIFTED:
            lifted_hessian(k, a, b, q, cs, points, hess)
        else:
            tangent_hessian(k, a, b, q, cs, points, hess)
        has_part = (grad[k, 3] != 0.0) | (grad[k, 4] != 0.0)
        for i in range(36):
            hess[k, i] = where(has_part, hess[k, i], 0.0)
    else:
        curved = False
    return curved


@subkernel
def force_tangents(top, w, q, v):
    """Write K = -dQ/dq and C = -dQ/dv of every force element and load into the terms of ``w.source``.

    ``w.spring_stiff`` and ``w.spring_damp`` (S, 36) receive the terms of the force elements:
    ``K = F_s s_q^T s_q + F s_qq + F_s' s_q^T (s_q v)_q`` and ``C = F_s' s_q^T s_q``, with the s_q of one segment;
    ``w.coupled_stiff`` and ``w.coupled_damp`` (X, 36) the products of two segments.
    ``w.load_stiff`` (L, 3) receives the terms of the point forces: entries x-theta and y-theta of forces that turn with
    their body, entry theta-theta of forces with a fixed direction. A torque has no tangent, unless its value is an
    expression of the state; see `load_slope`.
    For beams see `mbdkit.engine.kernels.cross_sections.beam_tangents`.
    """
    springs, loads = top.springs, top.loads
    grad, hess, stiff, damp, load_stiff = w.grad, w.hess, w.spring_stiff, w.spring_damp, w.load_stiff
    pathway_lengths(top, w, q)
    for k in range(len(springs)):
        a, b = springs[k, SPRING.first], springs[k, SPRING.second]
        evaluate_tension(top, w, k, path_rate(k, springs, v, grad))
        pull = w.tension[k, TENSION.force]
        stiffness, damping = w.tension[k, TENSION.by_length], w.tension[k, TENSION.by_rate]
        has_derivatives = (abs(stiffness) < np.inf) & (abs(damping) < np.inf)
        if is_refused(has_derivatives | (not abs(pull) < np.inf)):
            w.faulty[0] = springs[k, SPRING.law]
        curved = pathway_hessian(top, w, k, q)
        for i in range(6):
            for j in range(6):
                stiff[k, 6 * i + j] = stiffness * grad[k, i] * grad[k, j]
                damp[k, 6 * i + j] = damping * grad[k, i] * grad[k, j]
        # a straight pathway has no second derivatives, and most mechanisms have no others
        if any_of(curved):
            for j in range(6):
                bend = 0.0  # column j of (s_q v)_q
                for i in range(3):
                    bend += hess[k, 6 * i + j] * v[3 * a + i] + hess[k, 6 * (3 + i) + j] * v[3 * b + i]
                for i in range(6):
                    more = pull * hess[k, 6 * i + j] + damping * grad[k, i] * bend
                    stiff[k, 6 * i + j] = renewed(stiff[k, 6 * i + j] + more, stiff[k, 6 * i + j], curved)
    # segments of a spring share one tension, which therefore depends on the coordinates of all of them
    for c in range(len(top.couplings)):
        k, other = top.couplings[c, COUPLING.of_force], top.couplings[c, COUPLING.of_coordinates]
        for i in range(6):
            for j in range(6):
                product = grad[k, i] * grad[other, j]
                w.coupled_stiff[c, 6 * i + j] = w.tension[k, TENSION.by_length] * product
                w.coupled_damp[c, 6 * i + j] = w.tension[k, TENSION.by_rate] * product
        if springs[k, SPRING.pathway] != _PULLEY:
            for j in range(6):
                bend = w.tension[k, TENSION.by_rate] * rate_slope(top, w, v, other, j)
                for i in range(6):
                    w.coupled_stiff[c, 6 * i + j] += grad[k, i] * bend
    if len(top.inputs) + len(top.load_values) > 0:
        evaluate_expressions(top, w, q, v)
    for i in range(len(top.slopes)):
        load_slope(top, w, v, i)
    for k in range(len(loads)):
        if loads[k, LOAD.kind] == TORQUE:
            continue
        fx, fy, px, py = point_force(top, w, k)
        if loads[k, LOAD.kind] == BODY_FORCE:  # force and arm turn together, so the moment is constant
            load_stiff[k, 0] = fy
            load_stiff[k, 1] = -fx
        else:
            load_stiff[k, 2] = px * fx + py * fy
    for k in range(len(top.interactions)):
        interaction_tangents(top, w, q, v, k)
    if len(top.sections) > 0:
        beam_tangents(top, w, q, v)


@subkernel
def powers(top, w, v, lam):
    """Return two powers [W]: that of loads, interactions, drivers and active laws, and the dissipated power.

    Requires `applied_forces` and Phi_t at the same state. The bodies supply the power ``F s'`` to a force element. If
    the law has a potential V, the part ``V_s s'`` is stored as potential energy. The rest counts as dissipated if the
    law is declared passive; otherwise, its negative counts as power of an active law. Drivers supply the power
    ``lambda^T Phi_t``.
    """
    springs, laws, loads, pairs, u, tension = top.springs, top.laws, top.loads, top.pairs, w.u, w.tension
    work = 0.0
    lost = 0.0
    for k in range(len(springs)):
        if springs[k, SPRING.segments] == 0:
            continue
        rate = path_rate(k, springs, v, w.grad)
        law = springs[k, SPRING.law]
        if law < 0:
            lost += top.linear[k, LINEAR.damping] * rate * rate
            continue
        # the force at rate zero is -dV/ds: what it supplies is stored, only the rest is power or loss
        rest = tension[k, TENSION.force]
        claims = laws[law, LAW_ROW.claims]
        if claims & HAS_POTENTIAL != 0:
            rest -= law_value(top, w, law, w.s[k, 0], 0.0, w.time[0])
        if claims & PASSIVE != 0:
            lost += rest * rate
        else:
            work -= rest * rate
    for k in range(len(loads)):
        body = loads[k, LOAD.body]
        if loads[k, LOAD.kind] == TORQUE:
            work += u[loads[k, LOAD.x], 0] * (v[3 * body + 2] - v[3 * loads[k, LOAD.reaction_body] + 2])
        else:
            fx, fy, px, py = point_force(top, w, k)
            spin = v[3 * body + 2]
            work += fx * (v[3 * body] - spin * py) + fy * (v[3 * body + 1] + spin * px)
    for k in range(len(top.interactions)):
        for i in range(6):
            work += w.interaction[k, i] * v[3 * top.interactions[k, INTERACTION.first + i // 3] + i % 3]
    for k in range(len(top.sections)):
        lost += w.section_energy[k, 1]
    for k in range(len(pairs)):
        if pairs[k, PAIR.motion] >= 0:
            work += lam[k, 0] * w.phi_t[k, 0] + lam[k, 1] * w.phi_t[k, 1]
    return work, lost


@subkernel
def potential_energy(top, w, q):
    """Return the potential energy of gravity, force elements and beams, and the level of its rounding errors [J].

    The level is the sum of the absolute values from which the energy is computed; coordinates of a body count with at
    least its radius of gyration, because joints round them even if they are zero. The rounding error of the energy is
    a few eps times the level. The potential of gravity is zero at the global origin, and that of a linear spring at its
    free length; other laws define their own zero. Requires `applied_forces` or `force_tangents` at the same state.
    """
    springs, laws, mass, gravity, tension = top.springs, top.laws, top.mass, top.gravity, w.tension
    energy = level = 0.0
    # the radius of gyration stands for coordinates of joints, whose rounding errors a body at the origin has as well
    for b in range(len(mass) - 1):
        x, y = gravity[0] * q[3 * b], gravity[1] * q[3 * b + 1]
        energy -= mass[b, 0] * (x + y)
        level += mass[b, 0] * (abs(x) + abs(y))
        level += sqrt(mass[b, 0] * mass[b, 2]) * (abs(gravity[0]) + abs(gravity[1]))
    for k in range(len(springs)):
        law = springs[k, SPRING.law]
        if springs[k, SPRING.segments] > 0 and (law < 0 or laws[law, LAW_ROW.claims] & HAS_POTENTIAL != 0):
            energy += tension[k, TENSION.potential]
            level += abs(tension[k, TENSION.potential]) + abs(tension[k, TENSION.force] * w.s[k, 0])
    for k in range(len(top.sections)):
        energy += w.section_energy[k, 0]
        level += w.section_energy[k, 0]
        for i in range(4):
            level += abs(w.section_force[k, i] * w.section[k, i])
    return energy, level
