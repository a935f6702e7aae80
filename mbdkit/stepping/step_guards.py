"""Guards of the step loop: the energy balance of every step, misalignment, and branches at singular positions.

**Energy.** The sum of kinetic and potential energy changes in a step by the work done on the mechanism minus the energy
dissipated. What remains is the *jump* of the balance. Integration error makes jumps that are small compared with the
kinetic energy; a step that leads to another solution of the equations makes large ones. Projections are exempt: the
energy of a projected state is that after the projection.

**Branches.** In a singular position the paths of a mechanism cross, and a run may leave the crossing on another branch.
The velocity then turns within a short part of the path. A *dip* is a minimum of the distance to singularity below `DIP`
times its maximum. Around each dip, the directions of the velocities before and after are compared in the mass metric,
as lines. The distance is estimated from the pivots of the last solution for the accelerations, which costs next to
nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.engine.jit.decorators import subkernel
from mbdkit.engine.kernels.applied_forces import evaluate_tension, path_rate, pathway_lengths, potential_energy
from mbdkit.engine.kernels.singularity_kernels import singularity_distance
from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.singularity import new_vectors
from mbdkit.trust.criteria import BRANCH_ANGLE, BRANCH_RATIO

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.engine.workspace import Workspace

ROUNDING = 1e-11
"""Share of the sum of all energies, taken as positive, that round-off may add to a jump.

A mechanism that starts at rest has no kinetic energy to compare with.
"""

DIP = 0.05
"""Share of the largest distance to singularity so far below which a minimum counts as a dip."""

WINDOW = 0.01
"""Path before and after a dip over which the velocity is compared, as a share of the size of the mechanism."""

SPACING = 0.002
"""Path between two samples of the velocity, as a share of the size."""

SAMPLES = 16
"""Number of samples kept; more than ``WINDOW / SPACING``."""

AT_REST = 1e-6
"""Share of the largest speed so far below which a velocity has no direction to compare."""

MOST_TURNS = 16
"""Number of turns that are reported."""


class GuardState(NamedTuple):
    """What the guards know of a run. Arrays have one element unless a shape is given."""

    energy: np.ndarray
    """Kinetic and potential energy of the state [J]; NaN before it is known."""
    kinetic: np.ndarray
    """Largest kinetic energy so far [J]."""
    jump: np.ndarray
    """Largest absolute jump of the energy balance in a step so far [J], and the time at the end of that step [s]."""
    jump_time: np.ndarray
    jumped: np.ndarray
    """Whether the last rejection was because of the energy."""
    size: np.ndarray
    """Size of the mechanism [m]."""
    total_mass: np.ndarray
    """Sum of the masses [kg]."""
    has_loops: np.ndarray
    """Whether joints close a loop. Otherwise no position is singular, and branches are not watched."""
    path: np.ndarray
    """Length of the path so far in the mass metric, as a share of the size."""
    speed: np.ndarray
    """Largest speed so far in the mass metric [m/s]."""
    distance: np.ndarray
    """Distance to singularity in the last attempt."""
    vectors: np.ndarray
    """(P, 11) vectors of its inverse iteration, see `mbdkit.engine.kernels.singularity_kernels`."""
    farthest: np.ndarray
    """Largest distance to singularity so far."""
    nearest: np.ndarray
    """Smallest distance since the last sample."""
    samples: np.ndarray
    """Number of samples so far."""
    sample_path: np.ndarray
    """(SAMPLES,) the path at each of the last samples."""
    sample_direction: np.ndarray
    """(SAMPLES, 3 (B + 1)) the velocity in the mass metric, of unit length; zeros at rest."""
    armed: np.ndarray
    """Whether the distance has been above the limit of a dip since the last dip."""
    dip_path: np.ndarray
    """Path at the lowest point of the current dip; NaN outside of dips."""
    dip_distance: np.ndarray
    """Distance to singularity there, and the time [s]."""
    dip_time: np.ndarray
    dip_direction: np.ndarray
    """(3 (B + 1),) direction of the velocity before the dip, and the path there."""
    dip_begin: np.ndarray
    sharp: np.ndarray
    """(2,) smallest turn that is reported [rad], and the same per path."""
    turns: np.ndarray
    """(MOST_TURNS, 3) time of the dip [s], turn of the velocity [rad], and the path it took, as a share of the size."""
    turn_count: np.ndarray


def _has_loops(mechanism: CompiledMechanism) -> bool:
    """Return whether the joints close a loop: more joints than bodies that they connect one after another."""
    tree = list(range(mechanism.topology.mass.shape[0]))

    def root(body: int) -> int:
        while tree[body] != body:
            body = tree[body]
        return body

    for pairs in mechanism.joint_pairs:
        if len(pairs) == 0:
            continue
        a, b = (root(int(x)) for x in mechanism.topology.pairs[pairs[0], 1:3])
        if a == b:
            return True
        tree[max(a, b)] = min(a, b)
    return False


def new_guard_state(workspace: Workspace) -> GuardState:
    """Return what the guards know at the start of a run."""
    size = workspace.mechanism.length
    entries = workspace.mechanism.size

    def one(x: float = 0.0) -> np.ndarray:
        return np.array([x])

    counts = (np.zeros(1, dtype=np.int64) for _ in range(2))
    return GuardState(
        energy=one(np.nan), kinetic=one(), jump=one(), jump_time=one(), jumped=one(),
        size=one(size),
        total_mass=one(float(np.sum(workspace.mechanism.topology.mass[:-1, 0]))),
        has_loops=one(float(_has_loops(workspace.mechanism))),
        path=one(), speed=one(), distance=one(1.0), vectors=new_vectors(workspace), farthest=one(), nearest=one(np.inf),
        samples=next(counts), sample_path=np.zeros(SAMPLES), sample_direction=np.zeros((SAMPLES, entries)),
        armed=one(1.0), dip_path=one(np.nan), dip_distance=one(), dip_time=one(), dip_direction=np.zeros(entries),
        dip_begin=one(),
        sharp=np.array([BRANCH_ANGLE, BRANCH_RATIO]), turns=np.zeros((MOST_TURNS, 3)), turn_count=next(counts),
    )  # fmt: skip


@subkernel
def energies(top, w, q, v):
    """Return kinetic and potential energy of a state [J]. Requires `prepare` at the state."""
    kinetic = 0.0
    for b in range(len(top.mass) - 1):
        for i in range(3):
            kinetic += 0.5 * top.mass[b, i] * v[3 * b + i] * v[3 * b + i]
    if len(top.springs) > 0:
        pathway_lengths(top, w, q)
        for k in range(len(top.springs)):
            evaluate_tension(top, w, k, path_rate(k, top.springs[k, 1], top.springs[k, 2], v, w.grad))
    return kinetic, potential_energy(top.springs, top.laws, top.mass, top.gravity, q, w.tension)


@subkernel
def _energy_level(top, w, q, kinetic):
    """Return the sum of all parts of the energies, taken as positive [J]. Requires `energies` at the state."""
    level = kinetic
    for b in range(len(top.mass) - 1):
        level += top.mass[b, 0] * (abs(top.gravity[0] * q[3 * b]) + abs(top.gravity[1] * q[3 * b + 1]))
    for k in range(len(top.springs)):
        level += abs(w.tension[k, 3]) + abs(w.tension[k, 0]) * abs(w.s[k, 0])
    return level


@subkernel
def energy_jump(c, q, v, share):
    """Return the jump of the balance by an attempt that led to `q, v`; total and kinetic energy there; and a limit [J].

    The limit is `share` of the largest kinetic energy so far, or rounding; 0 for a share of 0. Requires `prepare` at
    `q`.
    """
    kinetic, potential = energies(c.top, c.w, q, v)
    total = kinetic + potential
    most = 0.0
    if share > 0.0:
        most = share * max(kinetic, c.guards.kinetic[0]) + ROUNDING * _energy_level(c.top, c.w, q, kinetic)
    jump = total - c.guards.energy[0] - (c.gain[0] - c.gain[1])
    return jump, total, kinetic, most


@subkernel
def note_jump(c, t, jump, total, kinetic):
    """Record the jump of a step that ends at `t`, and the energy there."""
    guards = c.guards
    if not abs(jump) <= guards.jump[0] and not np.isnan(guards.energy[0]):
        guards.jump[0], guards.jump_time[0] = abs(jump), t
    guards.energy[0] = total
    guards.kinetic[0] = max(guards.kinetic[0], kinetic)


@subkernel
def distance_to_singularity(c):
    """Return an estimate of the distance to singularity at the last solution for the accelerations.

    It is the square root of the largest reduction of a pivot block by elimination. Where pivots are chosen instead,
    inverse iteration gives the distance itself.
    """
    if c.solver.pivoted[0] != 0:
        return singularity_distance(c.top, c.w, c.solver, c.guards.vectors)
    diagonal, whole = c.solver.schur.diagonal, c.solver.schur.whole
    largest = 1.0
    for k in range(len(diagonal)):
        inverse = diagonal[k, 0] * diagonal[k, 2] - diagonal[k, 1] * diagonal[k, 1]
        largest = max(largest, inverse * whole[k, 0] * whole[k, 1])
    return 1.0 / np.sqrt(largest)


@subkernel
def _write_direction(c, v, out):
    """Write `v` in the mass metric, of unit length, into `out`; zeros at rest."""
    guards, mass = c.guards, c.top.mass
    square = 0.0
    for b in range(len(mass) - 1):
        for i in range(3):
            square += mass[b, i] * v[3 * b + i] * v[3 * b + i]
    speed = np.sqrt(square / guards.total_mass[0])
    guards.speed[0] = max(guards.speed[0], speed)
    scale = 1.0 / np.sqrt(square) if speed > AT_REST * guards.speed[0] else 0.0
    for b in range(len(mass) - 1):
        for i in range(3):
            out[3 * b + i] = np.sqrt(mass[b, i]) * v[3 * b + i] * scale


@subkernel
def _close_dip(guards, path, direction):
    """Compare the directions before and after the dip, and record a turn that is too sharp."""
    cosine = before = after = 0.0
    for d in range(len(direction)):
        cosine += guards.dip_direction[d] * direction[d]
        before += guards.dip_direction[d] * guards.dip_direction[d]
        after += direction[d] * direction[d]
    way = path - guards.dip_begin[0]
    guards.dip_path[0] = np.nan
    if before == 0.0 or after == 0.0:
        return
    turn = np.arccos(min(1.0, abs(cosine)))
    if turn >= guards.sharp[0] and turn >= guards.sharp[1] * way:
        n = guards.turn_count[0]
        if n < MOST_TURNS:
            guards.turns[n, 0], guards.turns[n, 1], guards.turns[n, 2] = guards.dip_time[0], turn, way
        guards.turn_count[0] = n + 1


@subkernel
def _open_dip(guards, n, path, distance, t):
    """Take the last sample, number `n`, as the lowest point of a dip; the window begins `WINDOW` before it."""
    guards.dip_path[0], guards.dip_distance[0], guards.dip_time[0] = path, distance, t
    first = max(0, n - SAMPLES + 1)
    k = n
    while k > first and guards.sample_path[k % SAMPLES] > path - WINDOW:
        k -= 1
    copy(guards.sample_direction[k % SAMPLES], guards.dip_direction)
    guards.dip_begin[0] = guards.sample_path[k % SAMPLES]


@subkernel
def watch_branch(c, t, dq, v, distance):
    """Follow the path by a step `dq` that ends at `t` with the velocity `v`, at a `distance` to singularity."""
    guards, mass = c.guards, c.top.mass
    square = 0.0
    for b in range(len(mass) - 1):
        for i in range(3):
            square += mass[b, i] * dq[3 * b + i] * dq[3 * b + i]
    guards.path[0] += np.sqrt(square / guards.total_mass[0]) / guards.size[0]
    guards.farthest[0] = max(guards.farthest[0], distance)
    guards.nearest[0] = min(guards.nearest[0], distance)
    n, path = guards.samples[0], guards.path[0]
    if n > 0 and path - guards.sample_path[(n - 1) % SAMPLES] < SPACING:
        return
    here = guards.sample_direction[n % SAMPLES]
    _write_direction(c, v, here)
    guards.sample_path[n % SAMPLES] = path
    lowest = guards.nearest[0]
    guards.samples[0], guards.nearest[0] = n + 1, np.inf
    low = lowest < DIP * guards.farthest[0]
    if low and (guards.armed[0] != 0.0 or lowest < guards.dip_distance[0]):
        _open_dip(guards, n, path, lowest, t)
    elif guards.dip_path[0] + WINDOW <= path:  # not if there is no dip
        _close_dip(guards, path, here)
    guards.armed[0] = 0.0 if low else 1.0
