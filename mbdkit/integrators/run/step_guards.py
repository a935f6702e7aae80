"""Guards of the step loop: the energy balance of every step, misalignment, and branches at singular positions.

**Energy.** The sum of kinetic and potential energy changes in a step by the work done on the mechanism minus the energy
dissipated. The difference is the *jump* of the energy balance in this step. Integration errors cause jumps that are
small compared with the kinetic energy; a step that converges to a spurious solution causes large ones. Projections are
exempt: the energy of a projected state is that after the projection.

**Branches.** In a singular position, several possible motions (branches) of a mechanism intersect, and a run may
continue on another branch. The velocity then changes its direction within a short part of the path. A *dip* is a
minimum of the distance to singularity below `DIP` times its maximum. Around each dip, the directions of the velocities
before and after are compared in the mass metric, as lines. The distance is estimated from the pivots of the last
solution for the accelerations, at negligible cost. Paths are measured in characteristic lengths instead of sizes of the
mechanism, because velocities change direction on the scale of a link, for any number of links.

The compiled step loop calls these functions; `mbdkit.integrators.loop.step_watch` calls them for steps in Python.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.kernels.applied_forces import evaluate_tension, path_rate, pathway_lengths, potential_energy
from mbdkit.engine.kernels.cross_sections import evaluate_sections
from mbdkit.engine.kernels.singularity_kernels import singularity_distance
from mbdkit.engine.kernels.system import OK, prepare
from mbdkit.engine.kernels.table_rows import BODIES
from mbdkit.engine.kernels.vectors import copy
from mbdkit.engine.native.arithmetic import where
from mbdkit.engine.native.functions import subkernel
from mbdkit.engine.singularity import new_vectors
from mbdkit.trust.criteria import BRANCH_ANGLE, BRANCH_RATIO

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism

#: Status of a step: a limit of the guards was exceeded, see `mbdkit.integrators.run.run_plan.GuardLimits`.
FELL_APART, ENERGY_JUMP = 6, 7

#: Share of the sum of the absolute values of all energies that round-off may add to a jump.
#:
#: The kinetic energy is not used for comparison, because it is zero in a mechanism that starts at rest.
ROUNDING = 1e-11

DIP = 0.05  #: Share of the largest distance to singularity so far below which a minimum counts as a dip.

WINDOW = 0.01  #: Path before and after a dip over which the velocity is compared, in characteristic lengths.

SPACING = 0.002  #: Path between two samples of the velocity, in characteristic lengths.

SAMPLES = 16  #: Number of samples that are stored; more than ``WINDOW / SPACING``.

AT_REST = 1e-12  #: Share of the largest kinetic energy so far below which the direction of the velocity is not used.

MOST_TURNS = 16  #: Number of turns that are reported.


class GuardState(NamedTuple):
    """State of the guards of a run. Arrays have one element unless a shape is given."""

    energy: np.ndarray  #: Kinetic and potential energy of the state [J]; NaN before it is known.
    kinetic: np.ndarray  #: Largest kinetic energy so far [J].
    #: Largest absolute jump of the energy balance in a step so far [J], and the time at the end of that step [s].
    #:
    #: Jumps within round-off are ignored.
    jump: np.ndarray
    jump_time: np.ndarray
    exceeded: np.ndarray  #: Whether the jump of the last step exceeded the limit of the run.
    jumped: np.ndarray  #: Whether the jump of the energy balance was the reason for the last rejection of a step.
    #: Factor that converts the square of a displacement in the mass metric to the square of a path in characteristic
    #: lengths [1/(kg m^2)].
    per_square: np.ndarray
    #: Whether joints close a loop. Otherwise no position is singular, and branches are not watched.
    has_loops: np.ndarray
    path: np.ndarray  #: Path so far in the mass metric, in characteristic lengths.
    distance: np.ndarray  #: Distance to singularity in the last attempt.
    #: (P, 11) vectors of the inverse iteration for this distance; see `mbdkit.engine.kernels.singularity_kernels`.
    vectors: np.ndarray
    farthest: np.ndarray  #: Largest distance to singularity so far.
    nearest: np.ndarray  #: Smallest distance since the last sample.
    samples: np.ndarray  #: Number of samples so far.
    sample_path: np.ndarray  #: (SAMPLES,) the path at each of the last samples.
    sample_v: np.ndarray  #: (SAMPLES, 3 (B + 1)) the velocities at the last samples.
    armed: np.ndarray  #: Whether the distance has exceeded the limit of dips since the last dip.
    dip_path: np.ndarray  #: Path at the lowest point of the current dip; NaN outside of dips.
    dip_distance: np.ndarray  #: Distance to singularity at the lowest point of the current dip, and the time [s].
    dip_time: np.ndarray
    dip_v: np.ndarray  #: (3 (B + 1),) velocities before the dip, and the path at which they were sampled.
    dip_begin: np.ndarray
    #: (2,) smallest turn that is reported [rad], and smallest turn per path [rad per characteristic length].
    sharp: np.ndarray
    turns: np.ndarray  #: (MOST_TURNS, 3) time of the dip [s], turn of the velocity [rad], and the path it took.
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
        a, b = (root(int(x)) for x in mechanism.topology.pairs[pairs[0], BODIES])
        if a == b:
            return True
        tree[max(a, b)] = min(a, b)
    return False


def new_guard_state(mechanism: CompiledMechanism) -> GuardState:
    """Return the state of the guards at the start of a run."""
    mass = float(np.sum(mechanism.topology.mass[:-1, 0]))

    def one(x: float = 0.0) -> np.ndarray:
        return np.array([x])

    counts = (np.zeros(1, dtype=np.int64) for _ in range(2))
    return GuardState(
        energy=one(np.nan), kinetic=one(), jump=one(), jump_time=one(), exceeded=one(), jumped=one(),
        per_square=one(1.0 / (mass * mechanism.length**2)), has_loops=one(float(_has_loops(mechanism))),
        path=one(), distance=one(1.0), vectors=new_vectors(mechanism), farthest=one(), nearest=one(np.inf),
        samples=next(counts), sample_path=np.zeros(SAMPLES), sample_v=np.zeros((SAMPLES, mechanism.size)),
        armed=one(1.0), dip_path=one(np.nan), dip_distance=one(), dip_time=one(), dip_v=np.zeros(mechanism.size),
        dip_begin=one(),
        sharp=np.array([BRANCH_ANGLE, BRANCH_RATIO]), turns=np.zeros((MOST_TURNS, 3)), turn_count=next(counts),
    )  # fmt: skip


@subkernel
def _product(mass, v, u):
    """Return the product of two velocities in the mass metric; that of equal ones is twice the kinetic energy [J]."""
    product = 0.0
    for b in range(len(mass) - 1):
        for i in range(3):
            product += mass[b, i] * v[3 * b + i] * u[3 * b + i]
    return product


@subkernel
def energies(top, w, q, v):
    """Return kinetic and potential energy of a state, and the level of their rounding errors [J]; needs `prepare`."""
    kinetic = 0.5 * _product(top.mass, v, v)
    if len(top.springs) > 0:
        pathway_lengths(top, w, q)
        for k in range(len(top.springs)):
            evaluate_tension(top, w, k, path_rate(k, top.springs, v, w.grad))
    if len(top.sections) > 0:
        evaluate_sections(top, w, q, v)
    potential, level = potential_energy(top, w, q)
    return kinetic, potential, kinetic + level


@subkernel
def begin_energy(h, guards, t, q, v):
    """Evaluate the energy of the initial state, or of a state that an impulse or a projection has changed."""
    prepare(h.top, h.w, t, q)
    kinetic, potential, _ = energies(h.top, h.w, q, v)
    guards.energy[0] = kinetic + potential
    guards.kinetic[0] = max(kinetic, guards.kinetic[0])


@subkernel
def energy_jump(h, guards, gain, q, v):
    """Return the jump of the energy balance in a step to `q, v`, total and kinetic energy there, and the round-off of
    the jump.

    `h` has the mechanism and its scratch arrays, `gain` (2,) is the work done on the mechanism and the energy
    dissipated. All are energies [J]. Requires `prepare` at `q`.
    """
    kinetic, potential, level = energies(h.top, h.w, q, v)
    total = kinetic + potential
    return total - guards.energy[0] - (gain[0] - gain[1]), total, kinetic, ROUNDING * level


@subkernel
def note_jump(guards, t, jump, total, kinetic, rounding, share):
    """Record the jump of a step that ends at `t`, the energy there, and whether the jump exceeds a limit.

    The limit is `share` times the largest kinetic energy so far, plus the rounding error of the jump.
    """
    size = abs(jump)
    is_larger = (not size <= max(guards.jump[0], rounding)) & (guards.energy[0] == guards.energy[0])
    guards.jump[0], guards.jump_time[0] = (
        where(is_larger, size, guards.jump[0]),
        where(is_larger, t, guards.jump_time[0]),
    )
    guards.energy[0] = total
    guards.kinetic[0] = max(guards.kinetic[0], kinetic)
    guards.exceeded[0] = where(size > share * guards.kinetic[0] + rounding, 1.0, 0.0)


@subkernel
def limit_status(guards, worst, limits):
    """Return the status for the limit of a run that is exceeded, or OK; `worst` (P,) are squared misalignments."""
    for k in range(len(worst)):
        if worst[k] > limits.squared_misalignment[k]:
            return FELL_APART
    return ENERGY_JUMP if guards.exceeded[0] != 0.0 else OK


@subkernel
def distance_to_singularity(h, vectors):
    """Return an estimate of the distance to singularity at the last solution for the accelerations.

    With the Schur complement, it is computed by `distance_by_pivots`. With the pivoted solver, inverse iteration gives
    the distance itself.
    """
    if h.solver.pivoted[0] != 0:
        return singularity_distance(h.top, h.w, h.solver, vectors)
    return distance_by_pivots(h.solver.schur)


@subkernel
def distance_by_pivots(schur):
    """Return the smallest ``sqrt(det / (xx yy))`` of all pivot blocks of the Schur complement, at most 1.

    Here det is the determinant of a block when it becomes the pivot; xx and yy are its diagonal before elimination.
    """
    diagonal, whole = schur.diagonal, schur.whole
    largest = 1.0
    for k in range(len(diagonal)):
        inverse = diagonal[k, 0] * diagonal[k, 2] - diagonal[k, 1] * diagonal[k, 1]
        largest = max(largest, inverse * whole[k, 0] * whole[k, 1])
    return 1.0 / np.sqrt(largest)


@subkernel
def _close_dip(guards, mass, path, v):
    """Compare the directions before and after the dip, and record a turn that is too sharp."""
    before, after = _product(mass, guards.dip_v, guards.dip_v), _product(mass, v, v)
    way = path - guards.dip_begin[0]
    guards.dip_path[0] = np.nan
    if not min(before, after) > 2.0 * AT_REST * guards.kinetic[0]:
        return
    turn = elementary.acos(min(1.0, abs(_product(mass, guards.dip_v, v)) / np.sqrt(before * after)))
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
    copy(guards.sample_v[k % SAMPLES], guards.dip_v)
    guards.dip_begin[0] = guards.sample_path[k % SAMPLES]


@subkernel
def watch_branch(guards, mass, t, dq, v):
    """Update the path by a step `dq` that ends at `t` with the velocity `v`, at ``guards.distance`` to singularity."""
    distance = guards.distance[0]
    path = guards.path[0] + np.sqrt(_product(mass, dq, dq) * guards.per_square[0])
    guards.path[0] = path
    guards.farthest[0] = max(guards.farthest[0], distance)
    lowest = min(guards.nearest[0], distance)
    n = guards.samples[0]
    if n > 0 and path - guards.sample_path[(n - 1) % SAMPLES] < SPACING:
        guards.nearest[0] = lowest
        return
    copy(v, guards.sample_v[n % SAMPLES])
    guards.sample_path[n % SAMPLES] = path
    guards.samples[0], guards.nearest[0] = n + 1, np.inf
    low = lowest < DIP * guards.farthest[0]
    if low and (guards.armed[0] != 0.0 or lowest < guards.dip_distance[0]):
        _open_dip(guards, n, path, lowest, t)
    elif guards.dip_path[0] + WINDOW <= path:  # false for NaN, that is, outside of dips
        _close_dip(guards, mass, path, v)
    guards.armed[0] = 0.0 if low else 1.0
