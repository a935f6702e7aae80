"""The stages of a fully implicit method as vectors: states, predictions, and how large a change of them is."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.jit.decorators import subkernel

EPS = float(np.finfo(float).eps)

FEW_ROUNDINGS = 4.0
"""A change that no longer shrinks is round-off where it moves the state by no more roundings than these."""

STAGNANT = 1e-12
"""A change that no longer shrinks is round-off below this, relative to accelerations or single forces."""


@subkernel
def stage_states(h, a, a2, c, q, v, acc, q_stage, v_stage):
    """Evaluate positions and velocities of every stage."""
    s = len(c)
    for i in range(s):
        qs, vs = q_stage[i], v_stage[i]
        qs[:] = 0.0
        vs[:] = 0.0
        for j in range(s):
            w1, w2 = a[i, j], a2[i, j]
            k = acc[j]
            for d in range(len(q)):
                vs[d] += w1 * k[d]
                qs[d] += w2 * k[d]
        drift = h * c[i]
        for d in range(len(q)):
            qs[d] = q[d] + (drift * v[d] + h * h * qs[d])
            vs[d] = v[d] + h * vs[d]


@subkernel
def extrapolation_weights(offset, ratio, c, out):
    """Write the (s, s) weights that carry stage values of one step to the stages of another.

    Parameters
    ----------
    offset
        Where the other step begins: its time from the beginning of the first, over the first one's size.
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
    """Replace stage values, rows of `x`, by those of the collocation polynomial at the stages of the next step."""
    stages, size = x.shape
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
def stage_mean(x, out):
    """Write the mean over stages into `out`."""
    out[:] = 0.0
    for i in range(len(x)):
        for d in range(len(out)):
            out[d] += x[i, d] / len(x)


@subkernel
def relative_change(acc, change, bodies):
    """Return the largest change of an acceleration relative to the largest one, linear and angular apart.

    It is 1 at most: where forces cancel, a change may well take back all that there was of an acceleration.
    """
    size_t = size_r = change_t = change_r = 0.0
    for i in range(len(acc)):
        for b in range(bodies):
            size_t = max(size_t, abs(acc[i, 3 * b]), abs(acc[i, 3 * b + 1]))
            size_r = max(size_r, abs(acc[i, 3 * b + 2]))
            now_t = abs(change[i, 3 * b]) + abs(change[i, 3 * b + 1])
            now_r = abs(change[i, 3 * b + 2])
            if not now_t + now_r < np.inf:  # a maximum would pass over what is not a number
                return np.inf
            change_t = max(change_t, now_t)
            change_r = max(change_r, now_r)
    relative_t = change_t / max(size_t, change_t) if change_t > 0.0 else 0.0
    relative_r = change_r / max(size_r, change_r) if change_r > 0.0 else 0.0
    return max(relative_t, relative_r)


@subkernel
def is_round_off(top, w, h, q, v, lam, acc, bodies, change, patient):
    """Return whether a change of accelerations that no longer shrinks is round-off, linear and angular ones apart.

    It is where it moves the state of a step by a few roundings only; lengths are compared with the largest coordinate
    (1 m at least), angles with the largest angle (1 rad at least). To the `patient`, who have seen it idle for long, it
    is as well where it is small against what single forces would give: forces that cancel, or point along their arm,
    leave their round-off behind, so that magnitudes are added up.
    """
    change_t = change_r = 0.0
    size_t = size_r = 1.0
    for b in range(bodies):
        size_t = max(size_t, abs(q[3 * b]), abs(q[3 * b + 1]))
        size_r = max(size_r, abs(q[3 * b + 2]))
        for i in range(len(change)):
            change_t = max(change_t, abs(change[i, 3 * b]), abs(change[i, 3 * b + 1]))
            change_r = max(change_r, abs(change[i, 3 * b + 2]))
    small_t = change_t * h * h <= FEW_ROUNDINGS * EPS * size_t
    small_r = change_r * h * h <= FEW_ROUNDINGS * EPS * size_r
    if not patient or (small_t and small_r):
        return small_t and small_r
    level_t = level_r = inverse_arm = 0.0
    for b in range(bodies):
        level_t = max(level_t, abs(top.gravity[0]), abs(top.gravity[1]))
        level_t = max(level_t, abs(acc[3 * b]), abs(acc[3 * b + 1]))
        level_r = max(level_r, abs(acc[3 * b + 2]))
    for k in range(len(top.pairs)):
        force = abs(lam[k, 0]) + abs(lam[k, 1])
        for side in range(2):
            b = top.pairs[k, 1 + side]
            c = 3 * side
            x, y = abs(w.jac[k, c]) + abs(w.jac[k, 6 + c]), abs(w.jac[k, c + 1]) + abs(w.jac[k, 7 + c])
            arm = abs(top.pair_parameters[k, 2 * side]) + abs(top.pair_parameters[k, 2 * side + 1])
            turn = abs(w.jac[k, c + 2]) + abs(w.jac[k, 8 + c]) + arm
            if arm > 0.0:
                inverse_arm = max(inverse_arm, 1.0 / arm)
            level_t = max(level_t, force * max(x, y) * top.weight[b, 0])
            level_r = max(level_r, force * turn * top.weight[b, 2])
    for k in range(len(top.springs)):
        a, b = top.springs[k, 1], top.springs[k, 2]
        speed = 0.0
        for i in range(3):
            speed += abs(w.grad[k, i] * v[3 * a + i]) + abs(w.grad[k, 3 + i] * v[3 * b + i])
        force = abs(w.tension[k, 1]) * (abs(w.s[k, 0]) + abs(top.linear[k, 2])) + abs(w.tension[k, 2]) * speed
        force = max(force, abs(w.tension[k, 0]))
        for side in range(2):
            body = top.springs[k, 1 + side]
            for i in range(3):
                level = force * abs(w.grad[k, 3 * side + i]) * top.weight[body, i]
                if i < 2:
                    level_t = max(level_t, level)
                else:
                    level_r = max(level_r, level)
    level_r = max(level_r, level_t * inverse_arm)  # a point that is held turns its body along
    if not level_t + level_r < np.inf:
        return False
    return (small_t or change_t <= STAGNANT * level_t) and (small_r or change_r <= STAGNANT * level_r)
