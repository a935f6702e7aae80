"""Steps in the coordinates of a spanning tree: their arrays, and the state and the errors of the bodies at the end.

The state of a run is that of the bodies. Methods take the coordinates from it at the beginning of each step, and place
the bodies by them at the end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit.engine.kernels.articulated import ARTICULATED
from mbdkit.engine.kernels.bundle_types import State
from mbdkit.engine.kernels.tree import BODY, COLUMNS, PLACE, TURN, place_bodies
from mbdkit.engine.kernels.tree_displacements import ARMS
from mbdkit.engine.native.functions import subkernel

#: Rows of `Relative.vectors`: coordinates at the base state, and their rates; coordinates of a stage, or at the end of
#: the step, and the rates of the latter; velocities of the bodies in a stage; state of the bodies at the end.
BASE, BASE_RATES, Y, Y_RATES, V_STAGE, END_Q, END_V, VECTORS = range(8)


class Relative(NamedTuple):
    """Arrays of the formulation ``joint-coordinates``; empty in other formulations.

    The rates and accelerations of stages are then those of the coordinates of a spanning tree
    (`mbdkit.engine.kernels.tree`), and the state of the bodies follows from them. The state of the run remains that of
    the bodies: coordinates are taken from it at the beginning of each step.
    """

    tree: np.ndarray  #: (B, 5) the spanning tree; no rows in other formulations.
    vectors: State  #: (7, 3 (B + 1)) one array of all vectors, because each array makes the calls of kernels slower.
    #: (B + 1, 13) work array of `mbdkit.engine.kernels.articulated`; no rows if the accelerations follow from the
    #: equations with multipliers.
    bodies: np.ndarray


def new_relative(size: int, tree: np.ndarray | None = None, *, of_pins: bool = False) -> Relative:
    """Return the arrays for a spanning tree, or empty ones without a tree; `of_pins`: all its joints are fixed pins."""
    rows, size = (np.zeros((0, COLUMNS), dtype=np.int64), 0) if tree is None else (tree, size)
    return Relative(rows, np.zeros((VECTORS, size)), np.zeros((size // 3 if of_pins else 0, ARTICULATED)))


class OnTree(NamedTuple):
    """What the stages of a collocation method need in addition in the coordinates of a tree; empty without one."""

    relative: Relative
    from_q: np.ndarray  #: (3 (B + 1),) base state of the bodies during an attempt.
    from_v: np.ndarray
    y: np.ndarray  #: (s, 3 (B + 1)) coordinates of the stages, and their rates.
    rates: np.ndarray
    acc: State  #: (s, 3 (B + 1)) accelerations of the bodies in the stages.
    first_acc: State  #: (3 (B + 1),) accelerations of the bodies at the beginning of the step.
    arms: np.ndarray  #: (B, 6) arms of the joints of the tree at the tangent state.


def new_on_tree(stages: int, size: int, tree: np.ndarray | None = None) -> OnTree:
    """Return the arrays for a spanning tree, or empty ones without a tree."""
    relative = new_relative(size, tree)
    y, rates, acc = np.zeros((3, stages, relative.vectors.shape[1]))
    from_q, from_v, first_acc = np.zeros((3, relative.vectors.shape[1]))
    return OnTree(relative, from_q, from_v, y, rates, acc, first_acc, np.zeros((len(relative.tree), ARMS)))


@subkernel
def end_of_step(c, r, t):
    """Place the bodies at the end `t` of the step; replace the increments of coordinates by those of the bodies.

    The step loop adds the increments by compensated sums. Coordinates that are part of the state are therefore added up
    in the same way, so that the bodies are placed by the angles of the new state, to the last bit; and the low parts of
    the sums of the other components are subtracted from their increments, because these components do not accumulate.
    """
    vectors, tree = r.vectors, r.tree
    for d in range(len(c.dq)):
        vectors[Y, d] = vectors[BASE, d] + c.dq[d]
        vectors[Y_RATES, d] = vectors[BASE_RATES, d] + c.dv[d]
    for n in range(len(tree)):
        for i in range(3):
            if tree[n, PLACE if i < 2 else TURN] < 0:
                d = 3 * tree[n, BODY] + i
                vectors[Y, d] = c.from_q[d] + (c.dq[d] + c.q_low[d])
                vectors[Y_RATES, d] = c.from_v[d] + (c.dv[d] + c.v_low[d])
    place_bodies(c.top, c.w, tree, t, vectors[Y], vectors[Y_RATES], vectors[END_Q], vectors[END_V])
    for n in range(len(tree)):
        for i in range(3):
            if tree[n, PLACE if i < 2 else TURN] >= 0:
                d = 3 * tree[n, BODY] + i
                c.dq[d] = (vectors[END_Q, d] - c.from_q[d]) - c.q_low[d]
                c.dv[d] = (vectors[END_V, d] - c.from_v[d]) - c.v_low[d]


@subkernel
def errors_of_bodies(c, r, t, error_q, error_v, q, v):
    """Replace the errors of the coordinates at the end `t` of the step by those of the state of the bodies.

    Requires `end_of_step`; `q` and `v` are work arrays.
    """
    vectors = r.vectors
    for d in range(len(error_q)):
        error_q[d] += vectors[Y, d]
        error_v[d] += vectors[Y_RATES, d]
    place_bodies(c.top, c.w, r.tree, t, error_q, error_v, q, v)
    for d in range(len(error_q)):
        error_q[d] = q[d] - vectors[END_Q, d]
        error_v[d] = v[d] - vectors[END_V, d]
