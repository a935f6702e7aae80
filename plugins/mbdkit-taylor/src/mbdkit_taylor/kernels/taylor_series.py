"""Taylor series of joint coordinates: one expansion per step, of any order (`mbdkit_taylor.kernels.tree_series`).

A step of another size from the same state, after a rejection or for dense output, only evaluates the series again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbdkit.base.quadrature import gauss_legendre
from mbdkit.engine.kernels.applied_forces import any_forces, applied_forces
from mbdkit.engine.kernels.bundle_types import State
from mbdkit.engine.kernels.system import NOT_FINITE, OK, evaluate_powers, prepare_angles
from mbdkit.engine.kernels.table_rows import BODIES
from mbdkit.engine.kernels.tree import BODY, PLACE, PLACE_SIDE, coordinates_of, place_bodies
from mbdkit.engine.kernels.vectors import copy, stays_finite
from mbdkit.engine.native.bundle import PinnedBundle, bundle_loader
from mbdkit.engine.native.functions import entry, inlined, subkernel
from mbdkit.engine.spanning_tree import spanning_tree
from mbdkit.expressions.program import MAX_DEPTH
from mbdkit.integrators.run.run_state import AT_START_OF_LAST, FACTORIZATIONS, RHS, keep_node, load_run_state
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit.integrators.stages.relative import BASE, BASE_RATES, V_STAGE, Relative, Y, end_of_step, new_relative
from mbdkit_taylor.kernels.power_series import expand_motions
from mbdkit_taylor.kernels.tree_series import (
    BEFORE,
    BEFORE_X,
    BEFORE_Y,
    OF,
    OF_BODY,
    OF_SPRING,
    OMEGA,
    OWN_X,
    OWN_Y,
    PAIR,
    SERIES,
    VX,
    VY,
    expand_tree,
)

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.integrators.run.step_control import Control
    from mbdkit_taylor.taylor import TaylorSeries

#: Number of the last coefficients from which the error is estimated. Several may vanish by symmetry: for a pendulum
#: released from rest at the horizontal, three of four are zero.
WINDOW = 4


class Taylor(NamedTuple):
    """Coefficients of the series of a step of order p."""

    #: (B + 1, SERIES, p + 2) of angles, rates, joint forces and positions, bodies in the order of the tree.
    series: State
    is_expanded: State  #: (1,) whether the series are those of the last base state.
    links: np.ndarray  #: (B, LINK) the tree; see `mbdkit_taylor.kernels.tree_series`.
    places: np.ndarray  #: (B + 1,) place of every body in this order.
    inverses: np.ndarray  #: (p + 3,) inverses of 1, 2, ...
    springs: np.ndarray  #: (S, OF_SPRING, p + 2) of springs between two points.
    #: (B + 1, OF_BODY) articulated bodies, and lengths between pins, which the estimate of a repeated step reads.
    bodies: State
    motions: np.ndarray  #: (motions, p + 2) of the values of loads.
    stack: np.ndarray  #: (MAX_DEPTH + 2, p + 2) work array of their programs.
    nodes: np.ndarray  #: (n,) Gauss nodes and weights of a step, by which powers are integrated.
    weights: np.ndarray
    power: np.ndarray  #: (2,) work array.
    lam: np.ndarray  #: (P, 2) zeros: no joint does work.
    q_stage: np.ndarray
    relative: Relative


def new_taylor(order: int, size: int, pairs: np.ndarray, springs: int, motions: int, tree: np.ndarray) -> Taylor:
    """Return the bundle of a method of an order.

    The other arguments are numbers of a mechanism, its ``Topology.pairs``, and its tree.
    """
    terms, ground = order + 2, size // 3 - 1
    places = np.full(ground + 1, ground, dtype=np.int64)
    places[tree[:, BODY]] = np.arange(len(tree))
    pins, sides = tree[:, PLACE], tree[:, PLACE_SIDE]
    others = [pairs[k, BODIES][1 - side] if k >= 0 else ground for k, side in zip(pins, sides, strict=True)]
    before = places[np.array(others, dtype=np.int64)]
    links = np.column_stack([tree[:, BODY], pins, sides, np.where(before == ground, -1, before)]).astype(np.int64)
    nodes, weights = gauss_legendre(order // 2 + 1)
    return Taylor(
        series=np.zeros((size // 3, SERIES, terms)),
        is_expanded=np.zeros(1, dtype=np.int64),
        links=np.ascontiguousarray(links),
        places=places,
        inverses=1.0 / np.maximum(np.arange(terms + 1.0), 1.0),
        springs=np.zeros((springs, OF_SPRING, terms)),
        bodies=np.zeros((size // 3, OF_BODY)),
        motions=np.zeros((motions, terms)),
        stack=np.zeros((MAX_DEPTH + 2, terms)),
        nodes=0.5 + 0.5 * nodes,
        weights=0.5 * weights,
        power=np.zeros(2),
        lam=np.zeros((len(pairs), 2)),
        q_stage=np.zeros(size),
        relative=new_relative(size, tree),
    )


_EXAMPLE = np.array([[0, -1, 0, -1, 0]])
load_taylor = bundle_loader(lambda: new_taylor(4, 6, np.zeros((0, 4), dtype=np.int64), 0, 0, _EXAMPLE))


@subkernel
def _expand(c, m, t):
    r = m.relative
    coordinates_of(c.top, r.tree, c.from_q, c.from_v, r.vectors[BASE], r.vectors[BASE_RATES])
    prepare_angles(c.top, c.w, c.from_q)
    if len(m.motions) > 0:
        expand_motions(t, c.top.motion_start, c.top.motion_ops, c.top.motion_values, m.stack, m.motions)
    expand_tree(c.top, c.w.cs, m, c.from_q, c.from_v)
    c.counts[RHS] += 1
    c.counts[FACTORIZATIONS] += 1


@inlined
def _increment(x, inverses, s, d, dq, dv):
    """Write the changes of a coordinate and of its rate, which has the series `x`, in the time `s` [s]."""
    place, rate = 0.0, 0.0
    for k in range(len(x) - 2, 0, -1):
        place = place * s + inverses[k + 1] * x[k]
        rate = rate * s + x[k]
    dv[d] = rate * s
    dq[d] = (place * s + x[0]) * s


@subkernel
def _increments(m, s, dq, dv):
    """Write the changes of the coordinates and of their rates in the time `s` [s]."""
    for n in range(len(m.links)):
        d = 3 * m.links[n, OF]
        _increment(m.series[n, OMEGA], m.inverses, s, d + 2, dq, dv)
        if m.links[n, PAIR] < 0:
            _increment(m.series[n, VX], m.inverses, s, d, dq, dv)
            _increment(m.series[n, VY], m.inverses, s, d + 1, dq, dv)
        else:
            dq[d] = dq[d + 1] = dv[d] = dv[d + 1] = 0.0


@subkernel
def _state_inside(c, m, t, s):
    """Place the bodies at the time `s` after the beginning `t` of the step, in ``m.q_stage`` and row `V_STAGE`."""
    r = m.relative
    _increments(m, s, m.q_stage, r.vectors[Y])
    # both are inputs below: coordinates in row Y, their rates in row V_STAGE
    for d in range(len(m.q_stage)):
        r.vectors[V_STAGE, d] = r.vectors[BASE_RATES, d] + r.vectors[Y, d]
        r.vectors[Y, d] = r.vectors[BASE, d] + m.q_stage[d]
    place_bodies(c.top, c.w, r.tree, t + s, r.vectors[Y], r.vectors[V_STAGE], m.q_stage, r.vectors[V_STAGE])


@subkernel
def _integrate_power(c, m, t, s, out):
    """Write the work of loads and the dissipated energy in the time `s` from `t` by Gauss quadrature."""
    out[0] = out[1] = 0.0
    if c.has_power[0] == 0:
        return
    v = m.relative.vectors[V_STAGE]
    for i in range(len(m.nodes)):
        _state_inside(c, m, t, s * m.nodes[i])
        if any_forces(c.top):
            applied_forces(c.top, c.w, m.q_stage, v)
        m.power[0], m.power[1] = evaluate_powers(c.top, c.w, m.q_stage, v, m.lam)
        for k in range(2):
            out[k] += s * m.weights[i] * m.power[k]


@subkernel
def _truncation(x, h):
    """Return a bound of the truncation error of a series at `h`: the last terms, each times the growth of later ones.

    With the ratio r of a term to the one before, as it follows from the largest terms of the last two windows, each
    term of the last window predicts ``r^j`` of itself j orders later. The sum of these predictions is proportional to
    the power p of the step, whichever of the terms vanish.
    """
    order = len(x) - 2
    high, low, scale, power = 0.0, 0.0, 1.0, h ** (order - WINDOW + 1)
    for j in range(WINDOW):
        high = max(high, abs(x[order - WINDOW + 1 + j]) * scale)
        if order - 2 * WINDOW + 1 + j > 0:
            low = max(low, abs(x[order - 2 * WINDOW + 1 + j]) * scale)
        scale *= h
    ratio = 1.0
    if high * scale < low:
        ratio = np.sqrt(np.sqrt(high * scale / low))
    total = 0.0
    for k in range(order - WINDOW + 1, order + 1):
        total = total * ratio + abs(x[k]) * power
        power *= h
    return total * ratio / (1.0 - ratio) if ratio < 0.5 else total


@subkernel
def _estimate(m, v, h, error_q, error_v):
    """Write bounds of the errors of a step: those of the coordinates and, by the lengths between pins, those of the
    positions of bodies.
    """
    share = h * m.inverses[len(m.inverses) - 1]
    for n in range(len(m.links)):
        i, x, before = m.links[n, OF], m.bodies[n], m.links[n, BEFORE]
        d = 3 * i
        error = _truncation(m.series[n, OMEGA], h)
        error_q[d + 2], error_v[d + 2] = share * error, error
        if m.links[n, PAIR] < 0:
            for j in range(2):
                error = _truncation(m.series[n, VX + j], h)
                error_q[d + j], error_v[d + j] = share * error, error
            continue
        own = abs(x[OWN_X]) + abs(x[OWN_Y])
        moved = own * error_q[d + 2]
        shifted = own * (error_v[d + 2] + abs(v[d + 2]) * error_q[d + 2])
        if before >= 0:
            b, arm = 3 * m.links[before, OF], abs(x[BEFORE_X]) + abs(x[BEFORE_Y])
            moved += error_q[b] + arm * error_q[b + 2]
            shifted += error_v[b] + arm * (error_v[b + 2] + abs(v[b + 2]) * error_q[b + 2])
        error_q[d] = error_q[d + 1] = moved
        error_v[d] = error_v[d + 1] = shifted


@entry
def attempt(run, method, t, h, want_error):
    """Compute a step from the base state; see `mbdkit.integrators.loop.step_loop`."""
    c, m = load_run_state(run), load_taylor(method)
    if m.is_expanded[0] == 0 or c.base_state[0] != AT_START_OF_LAST:
        _expand(c, m, t)
        m.is_expanded[0] = 1
    _increments(m, h, c.dq, c.dv)
    _integrate_power(c, m, t, h, c.gain)
    end_of_step(c, m.relative, t + h)
    if not (stays_finite(c.from_q, c.dq) and stays_finite(c.from_v, c.dv)):
        return NOT_FINITE
    if want_error != 0.0:
        _estimate(m, c.from_v, h, c.est_q, c.est_v)
    return OK


@entry
def dense(run, method, t, h, theta):
    """Write the state at ``t + theta h`` within the last attempt; see `mbdkit.integrators.loop.step_loop`."""
    c, m = load_run_state(run), load_taylor(method)
    _integrate_power(c, m, t, theta * h, c.point_gain)
    _state_inside(c, m, t, theta * h)
    copy(m.q_stage, c.point_q)
    copy(m.relative.vectors[V_STAGE], c.point_v)
    return OK


@entry
def keep(run, method, t, h, unused):
    """Store Gauss nodes of the last attempt as quadrature nodes; see `mbdkit.integrators.loop.step_loop`."""
    c, m = load_run_state(run), load_taylor(method)
    for i in range(len(m.nodes)):
        _state_inside(c, m, t, h * m.nodes[i])
        keep_node(c, t + h * m.nodes[i], h * m.weights[i], m.q_stage, m.relative.vectors[V_STAGE])
    return OK


class CompiledTaylor(CompiledMethod):
    """Taylor series of the joint coordinates of trees of pins."""

    attempt, dense, keep = attempt, dense, keep
    has_dense_output = True

    def __init__(self, method: TaylorSeries, workspace: Workspace, control: Control | None = None):
        super().__init__(workspace)
        top = workspace.mechanism.topology
        motions = len(top.motion_start) - 1
        size, tree = workspace.mechanism.size, spanning_tree(top)
        self.bundle = new_taylor(method.order, size, top.pairs, len(top.springs), motions, tree)
        self.pinned = PinnedBundle(self.bundle)
        self.stages = len(self.bundle.nodes)

    def forget(self) -> None:
        """See `CompiledMethod.forget`."""
        self.bundle.is_expanded[0] = 0
