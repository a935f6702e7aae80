"""Lobatto IIIA-IIIB pairs: symplectic, symmetric, order 2 s - 2, both constraints met at the end of every step.

The pair of two stages is RATTLE (Andersen 1983), and velocity Verlet where nothing is constrained; Jay (1996) proved
the order of all of them on constrained Hamiltonian systems.
"""

from __future__ import annotations

from fractions import Fraction

ANDERSEN = """@article{andersen1983,
  author = {Andersen, Hans C.},
  title = {{RATTLE}: a ``velocity'' version of the {SHAKE} algorithm for molecular dynamics calculations},
  journal = {Journal of Computational Physics}, volume = {52}, number = {1}, pages = {24--34}, year = {1983},
  doi = {10.1016/0021-9991(83)90014-1}}"""
JAY = """@article{jay1996,
  author = {Jay, Laurent},
  title = {Symplectic partitioned {R}unge-{K}utta methods for constrained {H}amiltonian systems},
  journal = {SIAM Journal on Numerical Analysis}, volume = {33}, number = {1}, pages = {368--387}, year = {1996},
  doi = {10.1137/0733019}}"""

Row = tuple[Fraction, ...]

_IIIA: dict[int, tuple[tuple[str, ...], ...]] = {
    2: (("0", "0"), ("1/2", "1/2")),
    3: (("0", "0", "0"), ("5/24", "1/3", "-1/24"), ("1/6", "2/3", "1/6")),
}


def coefficients(stages: int) -> tuple[tuple[Row, ...], tuple[Row, ...], Row, Row]:
    """Return a of IIIA, a' of IIIB, b and c of the pair with 2 or 3 `stages`, exact.

    IIIB follows from IIIA by the condition under which a pair is symplectic, ``b_i a'_ij + b_j a_ji = b_i b_j``.
    """
    a = tuple(tuple(Fraction(x) for x in row) for row in _IIIA[stages])
    b = a[-1]
    s = range(stages)
    partner = tuple(tuple(b[j] * (1 - a[j][i] / b[i]) for j in s) for i in s)
    return a, partner, b, tuple(sum(row, Fraction(0)) for row in a)
