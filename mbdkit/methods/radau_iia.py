"""Radau IIA collocation in fixed steps, order 2 s - 1: stiffly accurate and L-stable, for stiff springs and dampers.

Not to be confused with SciPy's adaptive `Radau`: forced to a fixed step, that one stops its Newton iteration early and
its constraints drift hundreds of times faster.
"""

from __future__ import annotations

from functools import cache

import mpmath

from mbdkit.methods.tableau import ButcherTableau, collocation

REFERENCE = """@book{hairer1996,
  author = {Hairer, Ernst and Wanner, Gerhard},
  title = {Solving Ordinary Differential Equations {II}: Stiff and Differential-Algebraic Problems},
  edition = {2}, publisher = {Springer}, year = {1996}, doi = {10.1007/978-3-642-05221-7}}"""

_CLOSED_FORMS: dict[int, tuple[list[list[str]], list[str], list[str]]] = {
    2: ([["5/12", "-1/12"], ["3/4", "1/4"]], ["3/4", "1/4"], ["1/3", "1"]),
    3: (
        [
            ["(88 - 7*sqrt(6))/360", "(296 - 169*sqrt(6))/1800", "(-2 + 3*sqrt(6))/225"],
            ["(296 + 169*sqrt(6))/1800", "(88 + 7*sqrt(6))/360", "(-2 - 3*sqrt(6))/225"],
            ["(16 - sqrt(6))/36", "(16 + sqrt(6))/36", "1/9"],
        ],
        ["(16 - sqrt(6))/36", "(16 + sqrt(6))/36", "1/9"],
        ["(4 - sqrt(6))/10", "(4 + sqrt(6))/10", "1"],
    ),
}


@cache
def tableau(stages: int) -> ButcherTableau:
    """Return the tableau with 2, 3 (closed forms) or 5 `stages` (nodes to 75 digits)."""
    name = f"radau-iia-{stages}"
    if stages in _CLOSED_FORMS:
        a, b, c = _CLOSED_FORMS[stages]
        return ButcherTableau(name, a, b, c, order=2 * stages - 1, reference=REFERENCE)
    with mpmath.workdps(75):
        difference = mpmath.taylor(lambda x: mpmath.legendre(stages, x) - mpmath.legendre(stages - 1, x), 0, stages)
        roots = sorted(mpmath.re(x) for x in mpmath.polyroots(difference[::-1], maxsteps=200, extraprec=200))
        nodes = [(1 + x) / 2 for x in roots[:-1]] + [mpmath.mpf(1)]
    return collocation(name, nodes, order=2 * stages - 1, reference=REFERENCE)
