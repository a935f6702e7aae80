"""Stages of an implicit step as vectors: their states, and polynomials through them (extrapolation, dense output)."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.vectors import fill
from mbdkit.engine.native.arithmetic import renewed
from mbdkit.engine.native.functions import subkernel


@subkernel
def stage_states(c, m, h):
    """Evaluate ``q_i = q + h c_i v + h^2 sum_j a2_ij a_j`` and ``v_i = v + h sum_j a_ij a_j`` from ``m.acc``.

    Small terms are added up before they are added to the state, so that each coordinate is rounded once at its size.
    """
    a, a2, nodes = m.rk.a, m.rk.a2, m.rk.c
    q, v = c.from_q, c.from_v
    s = len(nodes)
    for i in range(s):
        qs, vs = m.q_stage[i], m.v_stage[i]
        fill(qs, 0.0)
        fill(vs, 0.0)
        for j in range(s):
            w1, w2 = a[i, j], a2[i, j]
            k = m.acc[j]
            for d in range(len(q)):
                vs[d] += w1 * k[d]
                qs[d] += w2 * k[d]
        drift = h * nodes[i]
        for d in range(len(q)):
            qs[d] = q[d] + (drift * v[d] + h * h * qs[d])
            vs[d] = v[d] + h * vs[d]


@subkernel
def stage_mean(x, out, wanted):
    """Write the mean over stages into `out`, in lanes only where `wanted`."""
    for i in range(len(x)):
        for d in range(len(out)):
            before = 0.0 if i == 0 else out[d]
            out[d] = renewed(before + x[i, d] / len(x), out[d], wanted)


@subkernel
def stage_mean_of_pairs(x, out, wanted):
    """Write the mean over stages of `x` (s, P, 2) into `out` (P, 2), in lanes only where `wanted`."""
    for k in range(len(out)):
        for r in range(2):
            mean = 0.0
            for i in range(len(x)):
                mean += x[i, k, r] / len(x)
            out[k, r] = renewed(mean, out[k, r], wanted)


@subkernel
def extrapolation_weights(offset, ratio, c, out):
    """Write the weights that carry stage values of one step to the stages of another (Lagrange polynomials).

    Parameters
    ----------
    offset
        Time from the beginning of the first step to the beginning of the other, over the size of the first.
    ratio
        Size of the other step over that of the first.
    c : (s,) array
        Nodes.
    out : (s, s) array
        Receives the weights.
    """
    for i in range(len(c)):
        at = offset + ratio * c[i]
        for j in range(len(c)):
            w = 1.0
            for m in range(len(c)):
                if m != j:
                    w *= (at - c[m]) / (c[j] - c[m])
            out[i, j] = w


@subkernel
def extrapolate(weights, x, scratch):
    """Replace stage values, the rows of `x`, by ``weights @ x``; `scratch` has the shape of `x`."""
    stages, size = len(x), len(x[0])
    for i in range(stages):
        for d in range(size):
            scratch[i, d] = x[i, d]
            x[i, d] = 0.0
    for i in range(stages):
        for j in range(stages):
            w = weights[i, j]
            for d in range(size):
                x[i, d] += w * scratch[j, d]


@subkernel
def extrapolate_pairs(weights, x, scratch):
    """Replace stage values by pairs, `x` (s, P, 2), by those of another step; `scratch` has the shape of `x`."""
    for i in range(len(x)):
        for k in range(len(x[0])):
            for r in range(2):
                scratch[i, k, r] = x[i, k, r]
                x[i, k, r] = 0.0
    for i in range(len(x)):
        for j in range(len(x)):
            for k in range(len(x[0])):
                for r in range(2):
                    x[i, k, r] += weights[i, j] * scratch[j, k, r]


@subkernel
def weights_at(polynomials, theta, out):
    """Evaluate ``sum_k polynomials[i, k] theta^(k + 1)`` into `out` (s,)."""
    degree = polynomials.shape[1]
    for i in range(len(out)):
        value = 0.0
        for k in range(degree - 1, -1, -1):
            value = (value + polynomials[i, k]) * theta
        out[i] = value


@subkernel
def dense_gains(h, weights, power, out):
    """Write the energies gained up to a point of the step into `out` (2,), given the powers (s, 2) of the stages."""
    out[0] = out[1] = 0.0
    for i in range(len(weights)):
        out[0] += h * weights[i] * power[i, 0]
        out[1] += h * weights[i] * power[i, 1]


def collocation_polynomials(c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the polynomials that integrate stage accelerations of a collocation method to velocities and positions.

    Parameters
    ----------
    c
        (s,) distinct nodes.

    Returns
    -------
    first : (s, s) array
        Weight of acceleration i in the velocity gained up to theta, over h: ``sum_k first[i, k] theta^(k + 1)``.
    second : (s, s + 1) array
        Weight of acceleration i in the position gained beyond free flight, over h^2.
    """
    s = len(c)
    first, second = np.zeros((s, s)), np.zeros((s, s + 1))
    for i in range(s):
        lagrange = np.array([1.0])  # coefficients in ascending order
        for j in range(s):
            if j != i:
                shifted = np.append(0.0, lagrange)
                lagrange = (shifted - c[j] * np.append(lagrange, 0.0)) / (c[i] - c[j])
        first[i] = lagrange / np.arange(1, s + 1)
        second[i, 1:] = first[i] / np.arange(2, s + 2)
    return first, second
