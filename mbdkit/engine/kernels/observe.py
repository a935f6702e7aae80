"""What is recorded of a state: index-1 accelerations, multipliers, residuals, reactions and energies."""

from __future__ import annotations

from mbdkit.engine.jit.decorators import kernel, subkernel
from mbdkit.engine.kernels.constraints import constraint_positions, constraint_tangents
from mbdkit.engine.kernels.forces import potential_energy
from mbdkit.engine.kernels.misalignment import raise_misalignments
from mbdkit.engine.kernels.singularity_kernels import singularity_distance
from mbdkit.engine.kernels.system import (
    OK,
    constraint_rate,
    constraint_rows,
    evaluate_powers,
    evaluate_tangents,
    load_engine,
    prepare,
    solve_accelerations,
    spare_direction,
    transferred,
)
from mbdkit.engine.kernels.vectors import copy


@subkernel
def reactions_of(top, w, lam, out):
    """Write force (x, y) and torque of every pair on its second body, at that body's joint point, into `out` (P, 3)."""
    for k in range(len(top.pairs)):
        b = top.pairs[k, 2]
        for d in range(3):
            out[k, d] = -(w.jac[k, 3 + d] * lam[k, 0] + w.jac[k, 9 + d] * lam[k, 1])
        c, s = w.cs[b, 0], w.cs[b, 1]
        px, py = top.pair_parameters[k, 2], top.pair_parameters[k, 3]
        arm_x, arm_y = c * px - s * py, s * px + c * py
        out[k, 2] -= arm_x * out[k, 1] - arm_y * out[k, 0]


@kernel
def observe(
    engine, times, q, v, acc, lam, phi, phi_rate, reactions, kinetic, potential, distance,
    self_stress, its_reactions, near,
):  # fmt: skip
    """Evaluate recorded states in a row.

    Parameters
    ----------
    engine
        Address of an `Engine`: mechanism, working arrays and solver in use.
    times : (T,) array
        Times [s].
    q, v : (T, 3 (B + 1)) arrays
        Positions and velocities, ground last.
    acc : (T, 3 (B + 1)) array
        Receives accelerations.
    lam, phi, phi_rate : (T, P, 2) arrays
        Receive multipliers, residuals Phi and their rates Phi_q v + Phi_t.
    reactions : (T, P, 3) array
        Receives force (x, y) and torque that the first body exerts on the second, at the second's joint point.
    kinetic, potential : (T,) arrays
        Receive energies [J].
    distance : (T,) array
        Receives the distance to singularity.
    self_stress : (T, D, P, 2) array
        Receives, for each redundant direction, the multipliers that go with 1 in it and do not move anything.
    its_reactions : (T, D, P, 3) array
        Receives their reactions.
    near : (P, 11) array
        What `mbdkit.engine.singularity` keeps from row to row.

    Returns
    -------
    status : int
        OK, or why the index-1 system could not be solved.
    row : int
        The row at which it stopped.
    """
    h = load_engine(engine)
    top, w, solver = h.top, h.w, h.solver
    bodies = len(top.mass) - 1
    for r in range(len(times)):
        prepare(top, w, times[r], q[r])
        status = solve_accelerations(top, w, solver, q[r], v[r], acc[r], lam[r], True)
        if status != OK:
            return status, r
        distance[r] = singularity_distance(top, w, solver, near)
        for i in range(len(top.spare)):
            transferred(top, w, solver, i, self_stress[r, i])
            dx, dy = spare_direction(top, w.cs, i)
            for k in range(len(top.pairs)):
                for row in range(2):
                    self_stress[r, i, k, row] = -self_stress[r, i, k, row]
            self_stress[r, i, top.spare[i, 0], 0] += dx
            self_stress[r, i, top.spare[i, 0], 1] += dy
        if len(top.spare) > 0:
            constraint_rows(top, w, q[r], v[r])
        constraint_positions(top.pairs, top.pair_parameters, q[r], w.cs, w.u, w.phi, w.phi_t)
        for k in range(len(top.pairs)):
            for i in range(2):
                phi[r, k, i] = w.phi[k, i]
                phi_rate[r, k, i] = constraint_rate(top.pairs, w.jac, w.phi_t, v[r], k, i)
        reactions_of(top, w, lam[r], reactions[r])
        for i in range(len(top.spare)):
            reactions_of(top, w, self_stress[r, i], its_reactions[r, i])
        energy = 0.0
        for b in range(bodies):
            for d in range(3):
                energy += 0.5 * top.mass[b, d] * v[r, 3 * b + d] * v[r, 3 * b + d]
        kinetic[r] = energy
        potential[r] = potential_energy(top.springs, top.laws, top.mass, top.gravity, q[r], w.tension)
    return OK, len(times)


@kernel
def tangents_at(engine, t, q, v, acc, lam):
    """Solve for accelerations and multipliers and evaluate all tangents there; return a status."""
    h = load_engine(engine)
    top, w, solver = h.top, h.w, h.solver
    prepare(top, w, t, q)
    status = solve_accelerations(top, w, solver, q, v, acc, lam, True)
    if status == OK:
        evaluate_tangents(top, w, t, q, v, acc, lam)
    return status


@kernel
def baumgarte_at(engine, t, q, v):
    """Return the largest of Baumgarte's terms at a state [m/s^2, rad/s^2]; 0 without them."""
    h = load_engine(engine)
    prepare(h.top, h.w, t, q)
    return constraint_rows(h.top, h.w, q, v)


@kernel
def first_order_rates(engine, has_power, t, y, acc, lam, rates):
    """Write the right side of the first-order form, y = (q, v, work, dissipated), into `rates`; return a status.

    `y` and `rates` are (6 B + 2,); `acc` (3, 3 (B + 1)) and `lam` (P, 2) are scratch.
    """
    h = load_engine(engine)
    top, w, solver = h.top, h.w, h.solver
    n3 = 3 * (len(top.mass) - 1)
    q, v, a = acc[0], acc[1], acc[2]
    copy(y[:n3], q)
    copy(y[n3 : 2 * n3], v)
    prepare(top, w, t, q)
    status = solve_accelerations(top, w, solver, q, v, a, lam, True)
    copy(v[:n3], rates)
    copy(a[:n3], rates[n3:])
    rates[2 * n3] = rates[2 * n3 + 1] = 0.0
    if status == OK and has_power:
        rates[2 * n3], rates[2 * n3 + 1] = evaluate_powers(top, w, q, v, lam)
    return status


@kernel
def constraints_at(top, w, t, q, v):
    """Evaluate Phi, Phi_t, the Jacobian and gamma into ``w.phi``, ``w.phi_t``, ``w.jac`` and ``w.gamma``."""
    prepare(top, w, t, q)
    constraint_positions(top.pairs, top.pair_parameters, q, w.cs, w.u, w.phi, w.phi_t)
    constraint_rows(top, w, q, v)


@kernel
def stiffness_at(top, w, t, q, rest, lam):
    """Evaluate d(Phi_q^T lam)/dq of every pair into ``w.stiff``; `rest` (3 (B + 1),) are zeros."""
    prepare(top, w, t, q)
    constraint_tangents(top.pairs, top.pair_parameters, q, rest, rest, w.cs, w.u, lam, w.stiff, w.gamma_v, w.res_q)


@kernel
def note_all(engine, times, q, worst):
    """Raise `worst` (P,) by the squared misalignments of the states `q` (T, 3 (B + 1)) at `times` (T,)."""
    h = load_engine(engine)
    for r in range(len(times)):
        raise_misalignments(h.top, h.w, times[r], q[r], worst)
