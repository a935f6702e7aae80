"""Sparse block LDL^T factorization of the Schur complement ``S = Phi_q M^-1 Phi_q^T``, with blocks of 2 x 2.

The mass matrix is diagonal, so S has a block for every two pairs of rows that share a body, and is positive definite
if the rows are independent. The factorization therefore needs no pivoting; `TOO_SMALL` detects a loss of accuracy. The
pairs of constraint rows are numbered in elimination order, so that the factors need no permutation. The existing blocks
and the target of every update are determined once per mechanism (`mbdkit.engine.elimination_order`); the kernels only
follow this schedule.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from mbdkit.engine.kernels.bundle_types import IntMatrix, IntVector, RealMatrix
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.native.arithmetic import is_refused, usable
from mbdkit.engine.native.functions import inlined, subkernel

#: If elimination shrinks a pivot block to this fraction, ten digits have been lost and the pivoted solver is used.
TOO_SMALL = 1e-10


class Schur(NamedTuple):
    """Schedule and storage of the block factorization; P pairs, E blocks below the diagonal."""

    start: IntVector  #: (P + 1,) first block of each column.
    row: IntVector  #: (E,) block row of each block.
    #: Targets of the updates: for each column and each two of its blocks, in order of use, the block from which their
    #: product is subtracted.
    update: IntVector
    #: (C, 6) contributions to the blocks of S off the diagonal, one for each shared body: the block; the pair of its
    #: row, and the first column of the body in the Jacobian of this pair; the same two numbers for the pair of its
    #: column; the body.
    coupling: Annotated[IntMatrix, 6]
    diagonal: Annotated[RealMatrix, 3]  #: (P, 3) entries (xx, xy, yy) of the inverse pivot blocks.
    whole: Annotated[RealMatrix, 2]  #: (P, 2) entries xx and yy of the diagonal blocks before elimination.
    below: Annotated[RealMatrix, 4]  #: (E, 4) blocks of the unit lower factor, row by row.
    #: (E, 4) scratch array: blocks of S, later of L D, that is, before multiplication by the inverse pivot block.
    scaled: Annotated[RealMatrix, 4]


@inlined
def diagonal_block(top, jac, k):
    """Return the entries (xx, xy, yy) of the diagonal block of ``Phi_q M^-1 Phi_q^T`` that belongs to pair `k`."""
    weight, a, b = top.weight, top.pairs[k, PAIR.first], top.pairs[k, PAIR.second]
    d00 = d01 = d11 = 0.0
    for i in range(3):
        wa, wb = weight[a, i], weight[b, i]
        d00 += wa * jac[k, i] * jac[k, i] + wb * jac[k, 3 + i] * jac[k, 3 + i]
        d01 += wa * jac[k, i] * jac[k, 6 + i] + wb * jac[k, 3 + i] * jac[k, 9 + i]
        d11 += wa * jac[k, 6 + i] * jac[k, 6 + i] + wb * jac[k, 9 + i] * jac[k, 9 + i]
    return d00, d01, d11


@subkernel
def factor(top, jac, schur):
    """Assemble and factorize S; return the pair whose pivot block became too small, or -1.

    Right-looking elimination: each column of blocks is divided by its pivot block and its products are subtracted from
    the later columns at once. Only the lower triangle is stored. The check compares the xx entry and the determinant
    of the pivot block with the diagonal before elimination.
    """
    start, row, update, coupling = schur.start, schur.row, schur.update, schur.coupling
    diagonal, whole, below, scaled = schur.diagonal, schur.whole, schur.below, schur.scaled
    rows, weight, n = top.rows, top.weight, len(top.pairs)
    for k in range(n):
        d00, d01, d11 = diagonal_block(top, jac, k)
        if rows[k] < 2:  # a row that is not solved for is zero; a unit pivot keeps the block regular
            d11 = 1.0
            if rows[k] == 0:
                d00 = 1.0
        diagonal[k, 0], diagonal[k, 1], diagonal[k, 2] = d00, d01, d11
        whole[k, 0], whole[k, 1] = d00, d11
    for e in range(len(row)):
        scaled[e, 0] = scaled[e, 1] = scaled[e, 2] = scaled[e, 3] = 0.0
    for c in range(len(coupling)):  # block J_r M^-1 J_k^T, restricted to the columns of one shared body
        e, r, i0, k, j0, body = coupling[c]
        s00, s01, s10, s11 = scaled[e, 0], scaled[e, 1], scaled[e, 2], scaled[e, 3]
        for i in range(3):
            w = weight[body, i]
            r0, r1 = w * jac[r, i0 + i], w * jac[r, i0 + 6 + i]
            k0, k1 = jac[k, j0 + i], jac[k, j0 + 6 + i]
            s00 += r0 * k0
            s01 += r0 * k1
            s10 += r1 * k0
            s11 += r1 * k1
        scaled[e, 0], scaled[e, 1], scaled[e, 2], scaled[e, 3] = s00, s01, s10, s11
    # elimination; the targets of all updates are listed in the order in which this loop needs them
    u = 0
    for k in range(n):
        d00, d01, d11 = diagonal[k, 0], diagonal[k, 1], diagonal[k, 2]
        det = d00 * d11 - d01 * d01
        sound = (d00 > TOO_SMALL * whole[k, 0]) & (det > TOO_SMALL * whole[k, 0] * whole[k, 1])  # false for NaN
        if is_refused(sound):
            return k
        inverse = 1.0 / usable(det, sound)
        p00, p01, p11 = d11 * inverse, -d01 * inverse, d00 * inverse  # inverse of the symmetric 2 x 2 pivot block
        diagonal[k, 0], diagonal[k, 1], diagonal[k, 2] = p00, p01, p11
        for e in range(start[k], start[k + 1]):
            s00, s01, s10, s11 = scaled[e, 0], scaled[e, 1], scaled[e, 2], scaled[e, 3]
            l00, l01 = s00 * p00 + s01 * p01, s00 * p01 + s01 * p11
            l10, l11 = s10 * p00 + s11 * p01, s10 * p01 + s11 * p11
            below[e, 0], below[e, 1], below[e, 2], below[e, 3] = l00, l01, l10, l11
            for f in range(start[k], e):
                t = update[u]
                u += 1
                f00, f01, f10, f11 = scaled[f, 0], scaled[f, 1], scaled[f, 2], scaled[f, 3]
                scaled[t, 0] -= l00 * f00 + l01 * f01
                scaled[t, 1] -= l00 * f10 + l01 * f11
                scaled[t, 2] -= l10 * f00 + l11 * f01
                scaled[t, 3] -= l10 * f10 + l11 * f11
            # the block on the diagonal is symmetric, three entries suffice
            i = row[e]
            diagonal[i, 0] -= l00 * s00 + l01 * s01
            diagonal[i, 1] -= l00 * s10 + l01 * s11
            diagonal[i, 2] -= l10 * s10 + l11 * s11
    return -1


@subkernel
def solve(schur, x):
    """Solve S x = b in place by forward and backward substitution; `x` (P, 2) holds b on entry."""
    start, row, diagonal, below = schur.start, schur.row, schur.diagonal, schur.below
    n = len(diagonal)
    for k in range(n):
        x0, x1 = x[k, 0], x[k, 1]
        for e in range(start[k], start[k + 1]):
            i = row[e]
            x[i, 0] -= below[e, 0] * x0 + below[e, 1] * x1
            x[i, 1] -= below[e, 2] * x0 + below[e, 3] * x1
    for k in range(n - 1, -1, -1):
        # the inverse pivot block and the transposed factor in one pass, from the last pair to the first
        b0, b1 = x[k, 0], x[k, 1]
        x0 = diagonal[k, 0] * b0 + diagonal[k, 1] * b1
        x1 = diagonal[k, 1] * b0 + diagonal[k, 2] * b1
        for e in range(start[k], start[k + 1]):
            i = row[e]
            x0 -= below[e, 0] * x[i, 0] + below[e, 2] * x[i, 1]
            x1 -= below[e, 1] * x[i, 0] + below[e, 3] * x[i, 1]
        x[k, 0], x[k, 1] = x0, x1
