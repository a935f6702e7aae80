"""Kernels that evaluate given states: accelerations, multipliers, residuals, reactions, forces, energies, tangents."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.engine.kernels.accelerations import solve_accelerations, transferred
from mbdkit.engine.kernels.acting import force_values, joint_values, marker_values
from mbdkit.engine.kernels.applied_forces import potential_energy, state_rates, take_states
from mbdkit.engine.kernels.bundle_types import RealCube, RealMatrix, RealTensor, RealVector, example_of
from mbdkit.engine.kernels.constraints import constraint_positions, constraint_tangents
from mbdkit.engine.kernels.cross_sections import beam_values
from mbdkit.engine.kernels.engine_bundles import Scratch, Topology, load_engine
from mbdkit.engine.kernels.singularity_kernels import singularity_distance
from mbdkit.engine.kernels.system import (
    OK,
    constraint_rows,
    evaluate_powers,
    evaluate_tangents,
    prepare,
    spare_direction,
)
from mbdkit.engine.kernels.table_rows import PAIR, SECTION, SPARE, SPRING
from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.native.bundle import bundle_loader
from mbdkit.engine.native.functions import kernel, subkernel


@subkernel
def reactions_of(top, w, lam, out):
    """Write force (x, y) and torque of every pair on its second body, at its joint point, into `out` (P, 3) [N, N m].

    The generalized constraint force ``-Phi_q^T lam`` acts at the centre of mass; its moment is shifted to the point.
    """
    for k in range(len(top.pairs)):
        b = top.pairs[k, PAIR.second]
        for d in range(3):
            out[k, d] = -(w.jac[k, 3 + d] * lam[k, 0] + w.jac[k, 9 + d] * lam[k, 1])
        c, s = w.cs[b, 0], w.cs[b, 1]
        px, py = top.pair_parameters[k, 2], top.pair_parameters[k, 3]
        arm_x, arm_y = c * px - s * py, s * px + c * py
        out[k, 2] -= arm_x * out[k, 1] - arm_y * out[k, 0]


@subkernel
def residuals_of(top, w, q, v, phi, rate):
    """Write Phi and its rate of every row of the joints into `phi` and `rate` (P, 2); requires ``w.jac``."""
    constraint_positions(top.pairs, top.pair_parameters, q, w.cs, w.u, w.phi, w.phi_t)
    for k in range(len(top.pairs)):
        a, b = top.pairs[k, PAIR.first], top.pairs[k, PAIR.second]
        for i in range(2):
            change = w.phi_t[k, i]
            for d in range(3):
                change += w.jac[k, 6 * i + d] * v[3 * a + d] + w.jac[k, 6 * i + 3 + d] * v[3 * b + d]
            phi[k, i] = w.phi[k, i]
            rate[k, i] = change


@subkernel
def kinetic_energy(top, v):
    """Return the kinetic energy [J]."""
    energy = 0.0
    for b in range(len(top.mass) - 1):
        for d in range(3):
            energy += 0.5 * top.mass[b, d] * v[3 * b + d] * v[3 * b + d]
    return energy


class Observed(NamedTuple):
    """Quantities computed from T states; P is the number of pairs of constraint rows, F of force elements."""

    acc: RealMatrix
    """(T, 3 (B + 1)) accelerations of the index-1 system [m/s^2, rad/s^2], ground last."""
    lam: RealCube
    """(T, P, 2) multipliers [N, N m]."""
    phi: RealCube
    """(T, P, 2) constraint residuals Phi."""
    phi_rate: RealCube
    """(T, P, 2) rates of the residuals, Phi_q v + Phi_t."""
    reactions: RealCube
    """(T, P, 3) force (x, y) and torque of the first body on the second, at the joint point of the second."""
    kinetic: RealVector
    """(T,) kinetic energy [J]."""
    potential: RealVector
    """(T,) potential energy of gravity and springs [J]."""
    singularity_distance: RealVector
    """(T,) distance to singularity, see `mbdkit.engine.singularity`."""
    forces: RealCube
    """(T, F, 5) length, rate, value, power and potential of each force element; see `force_values`."""
    joints: RealCube
    """(T, J, 6) coordinate, power of the driver, and reaction force (x, y) in the frames of both bodies."""
    markers: RealCube
    """(T, K, 4) position (x, y) and velocity (x, y) of each marker."""
    beams: RealCube
    """(T, E, 4) axial force, shear force and bending moment in the middle of each element, and its strain energy."""
    state_rates: RealMatrix
    """(T, Z) derivatives of the first-order states of force elements with respect to time."""

    @staticmethod
    def zeros(states: int, top: Topology) -> Observed:
        """Return arrays for T = `states` of a mechanism, filled with zeros."""
        pairs = len(top.pairs)
        return Observed(
            acc=np.zeros((states, 3 * len(top.mass))),
            lam=np.zeros((states, pairs, 2)),
            phi=np.zeros((states, pairs, 2)),
            phi_rate=np.zeros((states, pairs, 2)),
            reactions=np.zeros((states, pairs, 3)),
            kinetic=np.zeros(states),
            potential=np.zeros(states),
            singularity_distance=np.zeros(states),
            forces=np.zeros((states, len(top.loads) + np.count_nonzero(top.springs[:, SPRING.segments]), 5)),
            joints=np.zeros((states, len(top.joints), 6)),
            markers=np.zeros((states, len(top.markers), 4)),
            beams=np.zeros((states, int(top.sections[-1, SECTION.element]) + 1 if len(top.sections) else 0, 4)),
            state_rates=np.zeros((states, len(top.states))),
        )

    def rows(self, part: slice) -> Observed:
        """Return views of the states in the slice `part`."""
        return Observed(*(values[part] for values in self))


@subkernel
def describe(top, w, q, v, out, r):
    """Write the quantities that follow from a state, its forces and its multipliers into row `r` of `out`.

    `out` is an `Observed`. Values of joints are not written, because redundant reactions have to be distributed first.
    """
    force_values(top, w, q, v, out.forces[r])
    marker_values(top, w, q, v, out.markers[r])
    beam_values(top, w, out.beams[r])
    residuals_of(top, w, q, v, out.phi[r], out.phi_rate[r])
    reactions_of(top, w, out.lam[r], out.reactions[r])
    out.kinetic[r] = kinetic_energy(top, v)
    out.potential[r], _ = potential_energy(top, w, q)


class SelfStress(NamedTuple):
    """Constraint forces that cause no acceleration, for T states and D redundant directions."""

    lam: RealTensor
    """(T, D, P, 2) multipliers; 1 in the redundant direction itself."""
    reactions: RealTensor
    """(T, D, P, 3) reactions of these multipliers, as in `Observed`."""

    @staticmethod
    def zeros(states: int, directions: int, pairs: int) -> SelfStress:
        """Return arrays for T = `states`, filled with zeros."""
        return SelfStress(np.zeros((states, directions, pairs, 2)), np.zeros((states, directions, pairs, 3)))

    def rows(self, part: slice) -> SelfStress:
        """Return views of the states in the slice `part`."""
        return SelfStress(*(values[part] for values in self))


@subkernel
def _evaluate(h, times, q, v, z, out, stress, near):
    """Evaluate states one after another; see `observe`."""
    top, w, solver = h.top, h.w, h.solver
    for r in range(len(times)):
        prepare(top, w, times[r], q[r])
        lam = out.lam[r]
        take_states(top, w, z[r])
        status = solve_accelerations(top, w, solver, q[r], v[r], out.acc[r], lam, True)
        if status != OK:
            return status, r
        state_rates(top, w, v[r], out.state_rates[r])
        # The order matters: the next two calculations use the factors and the Jacobian of this solution for the
        # accelerations.
        out.singularity_distance[r] = singularity_distance(top, w, solver, near)
        # Self-stress: a unit multiplier of the redundant direction minus the equivalent multipliers of all other rows.
        for i in range(len(top.spare)):
            transferred(top, w, solver, i, stress.lam[r, i])
            dx, dy = spare_direction(top, w.cs, i)
            for k in range(len(top.pairs)):
                for row in range(2):
                    stress.lam[r, i, k, row] = -stress.lam[r, i, k, row]
            stress.lam[r, i, top.spare[i, SPARE.pair], 0] += dx
            stress.lam[r, i, top.spare[i, SPARE.pair], 1] += dy
        if len(top.spare) > 0:  # restore the rows that the solution combined
            constraint_rows(top, w, q[r], v[r])
        describe(top, w, q[r], v[r], out, r)
        if len(top.spare) == 0:  # otherwise, `observe_joints` evaluates the joints once the reactions are distributed
            joint_values(top, w, q[r], lam, out.reactions[r], out.joints[r])
        for i in range(len(top.spare)):
            reactions_of(top, w, stress.lam[r, i], stress.reactions[r, i])
    return OK, len(times)


@kernel
def observe(
    engine: int, times: RealVector, q: RealMatrix, v: RealMatrix, z: RealMatrix, out: Observed, stress: SelfStress,
    near: RealMatrix,
) -> tuple[int, int]:  # fmt: skip
    """Evaluate states one after another.

    Parameters
    ----------
    engine
        Address of an `Engine`: mechanism, working arrays and solver in use.
    times : (T,) array
        Times [s].
    q, v : (T, 3 (B + 1)) arrays
        Positions and velocities, ground last.
    z : (T, Z) array
        First-order states of force elements.
    out : Observed
        Receives the values.
    stress : SelfStress
        Receives the self-stresses of a mechanism with redundant constraints.
    near : (P, 11) array
        Vectors of the inverse iteration in `mbdkit.engine.kernels.singularity_kernels`, reused for the next state.

    Returns
    -------
    status : int
        OK, or the reason why the index-1 system could not be solved.
    row : int
        Number of states evaluated; on failure, the index of the state that failed.
    """
    return _evaluate(load_engine(engine), times, q, v, z, out, stress, near)


class PinnedStates(NamedTuple):
    """States that are evaluated again and again; see `observe` for the arrays."""

    time: RealVector
    q: RealMatrix
    v: RealMatrix
    z: RealMatrix
    out: Observed
    stress: SelfStress
    near: RealMatrix


load_states = bundle_loader(lambda: example_of(PinnedStates))


@kernel
def observe_pinned(engine: int, states: int) -> tuple[int, int]:
    """Evaluate the `PinnedStates` at an address; see `observe`, whose call takes five times as long."""
    s = load_states(states)
    return _evaluate(load_engine(engine), s.time, s.q, s.v, s.z, s.out, s.stress, s.near)


@kernel
def observe_joints(engine: int, times: RealVector, q: RealMatrix, out: Observed) -> None:
    """Evaluate ``out.joints`` of states with known multipliers and reactions; the arguments are as in `observe`."""
    h = load_engine(engine)
    top, w = h.top, h.w
    for r in range(len(times)):
        prepare(top, w, times[r], q[r])
        constraint_positions(top.pairs, top.pair_parameters, q[r], w.cs, w.u, w.phi, w.phi_t)
        joint_values(top, w, q[r], out.lam[r], out.reactions[r], out.joints[r])


@kernel
def tangents_at(
    engine: int, t: float, q: RealVector, v: RealVector, acc: RealVector, lam: RealMatrix
) -> int:  # fmt: skip
    """Solve for accelerations and multipliers of a state and evaluate all tangents; return a status."""
    h = load_engine(engine)
    top, w, solver = h.top, h.w, h.solver
    prepare(top, w, t, q)
    status = solve_accelerations(top, w, solver, q, v, acc, lam, True)
    if status == OK:
        evaluate_tangents(top, w, t, q, v, acc, lam)
    return status


@kernel
def baumgarte_at(engine: int, t: float, q: RealVector, v: RealVector) -> float:
    """Return the largest Baumgarte term of a state [m/s^2, rad/s^2]; 0 without Baumgarte stabilization."""
    h = load_engine(engine)
    prepare(h.top, h.w, t, q)
    return constraint_rows(h.top, h.w, q, v)


@kernel
def first_order_rates(
    engine: int, has_power: bool, t: float, y: RealVector, acc: RealMatrix, lam: RealMatrix, rates: RealVector
) -> int:  # fmt: skip
    """Write the right-hand side of the first-order form into `rates`; return a status.

    `y` and `rates` are (6 B + 2 + Z,): positions, velocities, work, dissipated energy, first-order states. `acc`
    (3, 3 (B + 1)) and `lam` (P, 2) are scratch arrays. If `has_power` is false, the rates of work and dissipation are
    zero.
    """
    h = load_engine(engine)
    top, w, solver = h.top, h.w, h.solver
    n3 = 3 * (len(top.mass) - 1)
    q, v, a = acc[0], acc[1], acc[2]
    # the kernels expect ground behind the bodies
    copy(y[:n3], q)
    copy(y[n3 : 2 * n3], v)
    prepare(top, w, t, q)
    take_states(top, w, y[2 * n3 + 2 :])
    status = solve_accelerations(top, w, solver, q, v, a, lam, True)
    state_rates(top, w, v, rates[2 * n3 + 2 :])
    copy(v[:n3], rates)
    copy(a[:n3], rates[n3:])
    rates[2 * n3] = rates[2 * n3 + 1] = 0.0
    if status == OK and has_power:
        rates[2 * n3], rates[2 * n3 + 1] = evaluate_powers(top, w, q, v, lam)
    return status


@kernel
def constraints_at(top: Topology, w: Scratch, t: float, q: RealVector, v: RealVector) -> None:
    """Evaluate Phi, Phi_t, the Jacobian and gamma into ``w.phi``, ``w.phi_t``, ``w.jac`` and ``w.gamma``."""
    prepare(top, w, t, q)
    constraint_positions(top.pairs, top.pair_parameters, q, w.cs, w.u, w.phi, w.phi_t)
    constraint_rows(top, w, q, v)


@kernel
def stiffness_at(
    top: Topology, w: Scratch, t: float, q: RealVector, rest: RealVector, lam: RealMatrix
) -> None:  # fmt: skip
    """Evaluate d(Phi_q^T lam)/dq of every pair into ``w.stiff``.

    `rest` (3 (B + 1),) is a vector of zeros, used for velocities and accelerations, on which this term does not depend.
    """
    prepare(top, w, t, q)
    constraint_tangents(top.pairs, top.pair_parameters, q, rest, rest, w.cs, w.u, lam, w.stiff, w.gamma_v, w.res_q)
