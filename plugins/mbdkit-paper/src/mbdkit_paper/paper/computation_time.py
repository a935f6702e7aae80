"""Computation time by number of bodies (the paper's Fig. 5), and cost of substitution into symbolic matrices."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import theilslopes

from mbdkit_paper.paper.published_results import GILL, METHODS, methods_of
from mbdkit_paper.paper.substitution_timing import measured
from mbdkit_paper.wording import Words, two_digits
from mbdkit_report import Cell, Claim, Column, Figure, Line, Table, exceeds
from mbdkit_studies import METHOD, family, value

if TYPE_CHECKING:
    from mbdkit_studies import Study

SPEED_UP = 10_000.0
"""Claimed ratio of the time of an evaluation by substitution to that of a compiled evaluation, for two bodies."""
SYMBOLIC_BODIES = (1, 2, 3)
SECONDS = "wall_min_s"
STEEP = 2.0
WORDS = Words(__file__)
"""Growth of time with the number of bodies counts as steep if its exponent is larger than this.

The exponent is 3 if dense matrices are solved, and 1 if the work for a chain is proportional to its length.
"""


def times(study: Study) -> tuple[Claim, Table, Figure]:
    """Return a claim, a table and a figure: computation time of 1500 steps for each number of bodies and method."""
    points = family(study, "bodies")
    methods = methods_of(points)
    curves = {method: points.at({METHOD: method}).along("model.n", SECONDS) for method in methods}
    numbers = curves[GILL][0]
    growth = {method: _exponent(*curves[method]) for method in METHODS}
    most = max(growth.values())
    grown = ", ".join(f"n^{exponent:.1f} ({method})" for method, exponent in growth.items())
    claim = WORDS.claim("time-bodies", exceeds(most, STEEP), growth=grown, most=most)
    rows: list[tuple[Cell, ...]] = [
        (int(number), *(1e3 * float(curves[method][1][k]) for method in methods)) for k, number in enumerate(numbers)
    ]
    columns = (Column("bodies"), *(Column(method, "ms") for method in methods))
    lines = [Line(method, number, 1e3 * seconds, "both", method) for method, (number, seconds) in curves.items()]
    return claim, WORDS.table("time-bodies", rows, columns), WORDS.figure("time-bodies", lines)


def _exponent(numbers: np.ndarray, seconds: np.ndarray) -> float:
    """Return the exponent with which time grows with the number of bodies, over the upper two thirds of the numbers.

    It is the median of the slopes between all pairs (Theil-Sen estimator), which is robust against single runs that
    were slow because the machine was busy.
    """
    upper = (numbers >= np.max(numbers, initial=0.0) / 3) & np.isfinite(seconds)
    if upper.sum() < 2:
        return math.nan
    return float(theilslopes(np.log(seconds[upper]), np.log(numbers[upper])).slope)


def substitution(study: Study) -> tuple[Claim, Table, Figure]:
    """Compare an evaluation by substitution into SymPy matrices, as in the paper, with a compiled evaluation."""
    points = {int(point.axes["model.n"]): point for point in family(study, "bodies").at({METHOD: GILL})}
    chosen = [number for number in SYMBOLIC_BODIES if number in points]
    symbolic = measured(study.folder, [points[number].spec for number in chosen])
    compiled = [
        value(points[number], SECONDS) / max(value(points[number], "rhs_evaluations"), 1.0) for number in chosen
    ]
    rows: list[tuple[Cell, ...]] = []
    gains: dict[int, float] = {}
    for number, substituted, seconds in zip(chosen, symbolic, compiled, strict=True):
        gains[number] = substituted / seconds
        rows.append((number, 1e3 * substituted, 1e6 * seconds, gains[number], 1500 * 4 * substituted))
    gain = gains.get(2, math.nan)
    factors = ", ".join(f"{factor:,.0f} ({number} bodies)" for number, factor in gains.items())
    factors = factors.replace("(1 bodies", "(1 body")
    values = {"limit": SPEED_UP, "factors": factors, "gain": two_digits(gain)}
    claim = WORDS.claim("substitution", exceeds(gain, SPEED_UP), **values)
    x = np.array(chosen, dtype=float)
    lines = (
        Line("substitution (SymPy)", x, np.array(symbolic), "both", "substitution"),
        Line("compiled (mbdkit)", x, np.array(compiled), "both", GILL),
    )
    return claim, WORDS.table("substitution", rows), WORDS.figure("substitution", lines)
