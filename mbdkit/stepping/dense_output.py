"""Dense output: the weights of the stages at any point of a step, as polynomials."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.jit.decorators import subkernel


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
    """Write the energies gained up to a point of the step into `out` (2,), from the powers of the stages (s, 2)."""
    out[0] = out[1] = 0.0
    for i in range(len(weights)):
        out[0] += h * weights[i] * power[i, 0]
        out[1] += h * weights[i] * power[i, 1]


def collocation_polynomials(c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the polynomials that carry stage accelerations of a collocation method into velocities and positions.

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
        lagrange = np.polynomial.Polynomial([1.0])
        for j in range(s):
            if j != i:
                lagrange *= np.polynomial.Polynomial([-c[j], 1.0]) / (c[i] - c[j])
        once = lagrange.integ()
        first[i] = once.coef[1:]
        second[i] = once.integ().coef[1:]
    return first, second
