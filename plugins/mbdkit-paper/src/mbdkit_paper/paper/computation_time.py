"""Computation time by number of bodies (the paper's Fig. 5), and cost of substitution into symbolic matrices."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import theilslopes

from mbdkit_paper.paper.published_results import GILL, METHODS, methods_of
from mbdkit_paper.paper.substitution_timing import measured
from mbdkit_paper.wording import Words, two_digits
from mbdkit_report import Answer, Claim, Column, Figure, Line, Table, exceeds
from mbdkit_studies import METHOD, OPERATIONS, Study, family, value

#: Claimed ratio of the time of an evaluation by substitution to that of a compiled evaluation, for two bodies.
SPEED_UP = 10_000.0
SYMBOLIC_BODIES = (1, 2, 3)
SECONDS, SLOW_SECONDS = "wall_min_s", "wall_q3_s"
#: Growth of time with the number of bodies counts as steep if its exponent is larger than this.
#:
#: The exponent is 3 if dense matrices are solved, and 1 if the work for a chain is proportional to its length.
STEEP = 2.0
WORDS = Words(__file__)


def times(study: Study) -> tuple[Claim, Table, Figure]:
    """Return a claim, a table and a figure: computation time of 1500 steps for each number of bodies and method.

    The claim is open if the spread of the times allows a growth that is steep and one that is not.
    """
    points = {m: family(study, "bodies").at({METHOD: m}) for m in methods_of(family(study, "bodies"))}
    curves = {method: own.along("model.n", SECONDS) for method, own in points.items()}
    counts = {m: np.sum([own.along("model.n", name)[1] for name in OPERATIONS], axis=0) for m, own in points.items()}
    numbers = curves[GILL][0]
    slow = {method: own.along("model.n", SLOW_SECONDS)[1] for method, own in points.items()}
    spans = {m: _exponents(*curves[m], slow[m]) for m in METHODS}
    least, most = np.max(list(spans.values()), axis=0)
    at_least, at_most = exceeds(least, STEEP), exceeds(most, STEEP)
    grown = ", ".join(f"n^{low:.1f} to n^{high:.1f} ({method})" for method, (low, high) in spans.items())
    evaluated = ", ".join(f"n^{_exponents(numbers, counts[m], counts[m])[1]:.1f}" for m in METHODS)
    values = {"growth": grown, "counts": evaluated, "most": most}
    claim = WORDS.claim("time-bodies", at_most if at_most is at_least else Answer.OPEN, **values)
    cells = np.column_stack([cell for method in curves for cell in (1e3 * curves[method][1], counts[method])])
    rows = [(int(number), *row) for number, row in zip(numbers, cells.tolist(), strict=True)]
    columns = (Column("bodies"), *(Column(*label) for m in curves for label in ((m, "ms"), (f"{m}: operations",))))
    lines = []
    for method, (n, fast) in curves.items():
        band = np.vstack([np.c_[n, 1e3 * fast], np.c_[n, 1e3 * slow[method]][::-1]])
        lines.append(Line(method, n, 1e3 * fast, "both", method, band))
    return claim, WORDS.table("time-bodies", rows, columns), WORDS.figure("time-bodies", lines)


def _exponents(numbers: np.ndarray, least: np.ndarray, most: np.ndarray) -> tuple[float, float]:
    """Return the smallest and the largest exponent with which time may grow with the number of bodies.

    Over the upper two thirds of the numbers, the growth is the median of the slopes between all pairs of points
    (Theil-Sen estimator). It lies between the medians of the slopes from the slow time of the one point to the fast
    time of the other, and within the 95 % interval of the fast times, which grows with their scatter about a power law.
    """
    used = (numbers >= np.max(numbers, initial=0.0) / 3) & np.isfinite(least + most)
    if used.sum() < 2:
        return math.nan, math.nan
    n, fast, slow = (np.log(values[used]) for values in (numbers, least, most))
    first, last = np.triu_indices(len(n), 1)
    low, high = (np.median((b[last] - a[first]) / (n[last] - n[first])) for a, b in ((slow, fast), (fast, slow)))
    interval = theilslopes(fast, n)
    return float(min(low, interval.low_slope)), float(max(high, interval.high_slope))


def substitution(study: Study) -> tuple[Claim, Table, Figure]:
    """Compare an evaluation by substitution into SymPy matrices, as in the paper, with a compiled evaluation."""
    points = {int(point.axes["model.n"]): point for point in family(study, "bodies").at({METHOD: GILL})}
    chosen = [number for number in SYMBOLIC_BODIES if number in points]
    symbolic = measured(study.folder, [points[number].spec for number in chosen])
    runs = [points[number] for number in chosen]
    compiled = [value(run, SECONDS) / max(value(run, "rhs_evaluations"), 1.0) for run in runs]
    pairs = list(zip(chosen, symbolic, compiled, strict=True))
    gains = {number: substituted / seconds for number, substituted, seconds in pairs}
    rows = [(n, 1e3 * slow, 1e6 * fast, gains[n], 1500 * 4 * slow) for n, slow, fast in pairs]
    gain = gains.get(2, math.nan)
    factors = ", ".join(f"{one:,.0f} ({n} {'body' if n == 1 else 'bodies'})" for n, one in gains.items())
    values = {"limit": SPEED_UP, "factors": factors, "gain": two_digits(gain)}
    claim = WORDS.claim("substitution", exceeds(gain, SPEED_UP), **values)
    x = np.array(chosen, dtype=float)
    lines = (
        Line("substitution (SymPy)", x, np.array(symbolic), "both", "substitution"),
        Line("compiled (mbdkit)", x, np.array(compiled), "both", GILL),
    )
    return claim, WORDS.table("substitution", rows), WORDS.figure("substitution", lines)
