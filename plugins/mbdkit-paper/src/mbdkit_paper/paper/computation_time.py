"""Computation time by number of bodies (the paper's Fig. 5), and cost of substitution into symbolic matrices."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import theilslopes

from mbdkit_paper.paper.published_results import GILL, METHODS, methods_of
from mbdkit_paper.paper.substitution_timing import measured
from mbdkit_paper.wording import two_digits
from mbdkit_report import Answer, Axis, Cell, Claim, Column, Figure, Line, Table, columns_of, exceeds
from mbdkit_studies import METHOD, family, value

if TYPE_CHECKING:
    from mbdkit_studies import Study

SPEED_UP = 10_000.0
"""Claimed ratio of the time of an evaluation by substitution to that of a compiled evaluation, for two bodies."""
SYMBOLIC_BODIES = (1, 2, 3)
SECONDS = "wall_min_s"
STEEP = 2.0
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
    steep = exceeds(most, STEEP)
    claim = Claim(
        "time-bodies",
        "Computation time grows steeply with the number of bodies.",
        "steep growth with the number of bodies and of stages, for 1500 steps",
        "the time for n bodies grows like "
        + ", ".join(f"n^{exponent:.1f} ({method})" for method, exponent in growth.items()),
        steep,
        f"With compiled elements, the time for 1500 steps grows at most like n^{most:.1f} with the number n of bodies"
        + (
            ", little more than linearly: the steep growth in the paper is due to symbolic whole-system matrices."
            if steep is Answer.NO
            else "."
        ),
    )
    rows: list[tuple[Cell, ...]] = [
        (int(number), *(1e3 * float(curves[method][1][k]) for method in methods)) for k, number in enumerate(numbers)
    ]
    table = Table(
        "time-bodies",
        "Time for 1500 steps",
        (Column("bodies"), *(Column(method, "ms") for method in methods)),
        tuple(rows),
        "The shortest of five runs on this machine, from the first step to the last.",
    )
    figure = Figure(
        "time-bodies",
        "Time for 1500 steps by number of bodies",
        "The paper's Fig. 5 with compiled elements.",
        Axis("bodies"),
        Axis("time", "ms"),
        tuple(Line(method, number, 1e3 * seconds, "both", method) for method, (number, seconds) in curves.items()),
    )
    return claim, table, figure


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
    enough = exceeds(gain, SPEED_UP)
    claim = Claim(
        "substitution",
        f"Compiled elements evaluate two bodies at least {SPEED_UP:,.0f} times faster than symbolic substitution.",
        "the paper names substitution as the bottleneck, and faster substitution as future work",
        "compiled elements are faster by factors of "
        + ", ".join(f"{factor:,.0f} ({number} bodies)" for number, factor in gains.items()).replace(
            "(1 bodies", "(1 body"
        ),
        enough,
        f"For two bodies, one compiled evaluation is {two_digits(gain)} times faster than one by substitution into "
        "SymPy matrices, measured on this machine.",
    )
    columns = columns_of("bodies; substitution [ms]; compiled [us]; ratio; 1500 steps of RK-Gill by substitution [s]")
    table = Table(
        "substitution",
        "One evaluation of the equations of motion",
        columns,
        tuple(rows),
        "Substitution: matrices with numeric masses and lengths, into which SymPy's subs inserts time, positions and "
        "velocities; the system is solved by LAPACK; shortest processor time of several evaluations. Compiled: total "
        "time of RK-Gill from the first to the last step, divided by its evaluations. The last column is calculated "
        "from the column on substitution.",
    )
    return claim, table, _figure(symbolic, chosen, compiled)


def _figure(symbolic: list[float], bodies: list[int], compiled: list[float]) -> Figure:
    x = np.array(bodies, dtype=float)
    return Figure(
        "substitution",
        "Time of one evaluation",
        "Symbolic substitution, the bottleneck of the paper, and the same equations compiled element by element.",
        Axis("bodies"),
        Axis("time", "s", log=True),
        (
            Line("substitution (SymPy)", x, np.array(symbolic), "both", "substitution"),
            Line("compiled (mbdkit)", x, np.array(compiled), "both", GILL),
        ),
    )
