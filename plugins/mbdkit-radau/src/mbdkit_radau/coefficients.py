"""Coefficients of Radau IIA with any number of stages: tableau, transformation, extrapolation, dense output."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import mpmath
import numpy as np

import mbdkit
from mbdkit.plugin import collocation
from mbdkit.plugin.methods import collocation_polynomials

REFERENCES = tuple(Path(__file__).with_name("references.bib").read_text(encoding="utf-8").strip().split("\n\n"))
DIGITS = 75


class Coefficients(NamedTuple):
    """Coefficients of s stages.

    Parameters
    ----------
    a, c
        (s, s) matrix, whose last row has the weights, and (s,) nodes.
    squared
        (s, s) ``a @ a``, the weights of accelerations in positions.
    inverse
        (s, s) inverse of `a`.
    real
        The real eigenvalue of `a`.
    values
        ((s + 1) / 2,) the real eigenvalue and those with positive imaginary part.
    vectors, to_vectors
        (s, (s + 1) / 2) their eigenvectors, times 2 for complex ones, and the rows of the inverse of the matrix of all
        eigenvectors: a real vector x of the stages is the real part of ``vectors @ (to_vectors @ x)``.
    first, second
        (s, s) and (s, s + 1) polynomials of dense output; see `mbdkit.plugin.methods.collocation_polynomials`.
    """

    a: np.ndarray
    c: np.ndarray
    squared: np.ndarray
    inverse: np.ndarray
    real: float
    values: np.ndarray
    vectors: np.ndarray
    to_vectors: np.ndarray
    first: np.ndarray
    second: np.ndarray


def tableau(s: int) -> mbdkit.ButcherTableau:
    """Return Radau IIA with `s` stages, whose nodes are the roots of P_s - P_(s-1), and 1."""
    with mpmath.workdps(DIGITS):
        difference = mpmath.taylor(lambda x: mpmath.legendre(s, x) - mpmath.legendre(s - 1, x), 0, s)
        roots = sorted(mpmath.re(x) for x in mpmath.polyroots(difference[::-1], maxsteps=200, extraprec=200))
        nodes = [(1 + x) / 2 for x in roots[:-1]] + [mpmath.mpf(1)]
    return collocation(f"radau-iia-{s}", nodes, order=2 * s - 1, reference=REFERENCES[1])


@cache
def coefficients(s: int) -> Coefficients:
    """Return the coefficients of `s` stages, an odd number, so that `a` has one real eigenvalue."""
    method = tableau(s)
    a, _, c = method.floats()
    values, vectors, inverse = method.eigensystem()
    is_real = np.abs(values.imag) < 1e-12
    kept = np.concatenate([np.flatnonzero(is_real), np.flatnonzero((values.imag > 0) & ~is_real)])
    twice = np.where(is_real, 1.0, 2.0)[kept]
    return Coefficients(
        a, c, method.second_order_floats()[0], np.linalg.inv(a), float(values[kept[0]].real), values[kept],
        twice * vectors[:, kept], inverse[kept], *collocation_polynomials(c),
    )  # fmt: skip
