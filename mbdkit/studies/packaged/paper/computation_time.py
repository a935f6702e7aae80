"""What the equations cost: time by number of bodies (the paper's Fig. 5), and numbers put into symbols."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import theilslopes

from mbdkit.analysis.number_text import two_digits
from mbdkit.analysis.verdict import Answer, Axis, Cell, Claim, Column, Figure, Line, Table, exceeds
from mbdkit.studies.packaged.paper.published_results import GILL, METHODS
from mbdkit.studies.packaged.paper.substitution_timing import Substitution, measured
from mbdkit.studies.point_selection import METHOD, family, value

if TYPE_CHECKING:
    from mbdkit.studies.study import Study

SPEED_UP = 10_000.0
"""What compiled elements are to gain over substitution, per evaluation at two bodies."""
SYMBOLIC_BODIES = (1, 2, 3)
SECONDS = "wall_min_s"
STEEP = 2.0
"""Power of the number of bodies from which growth is called steep: dense matrices take the third, chains the first."""


def times(study: Study) -> tuple[Claim, Table, Figure]:
    """Draw time for 1500 steps by number of bodies and method."""
    points = family(study, "bodies")
    curves = {method: points.at({METHOD: method}).along("model.n", SECONDS) for method in METHODS}
    numbers = curves[GILL][0]
    growth = {method: _exponent(*curve) for method, curve in curves.items()}
    most = max(growth.values())
    steep = exceeds(most, STEEP)
    claim = Claim(
        "time-bodies",
        "Computation time grows steeply with the number of bodies.",
        "steep growth with bodies and with the method's stages, 1500 steps",
        ", ".join(f"like n^{exponent:.1f} ({method})" for method, exponent in growth.items()),
        steep,
        f"Compiled, the time for 1500 steps grows at most like n^{most:.1f} with the number n of bodies"
        + (
            ", hardly more than in proportion: the steep growth was that of whole-system symbolic matrices."
            if steep is Answer.NO
            else "."
        ),
    )
    rows: list[tuple[Cell, ...]] = [
        (int(number), *(1e3 * float(curves[method][1][k]) for method in METHODS)) for k, number in enumerate(numbers)
    ]
    table = Table(
        "time-bodies",
        "Time for 1500 steps",
        (Column("bodies"), *(Column(method, "ms") for method in METHODS)),
        tuple(rows),
        "The least of five runs on this machine, from the first step to the last.",
    )
    figure = Figure(
        "time-bodies",
        "Time for 1500 steps by number of bodies",
        "The paper's Fig. 5, compiled.",
        Axis("bodies"),
        Axis("time", "ms"),
        tuple(Line(method, number, 1e3 * seconds, "both", method) for method, (number, seconds) in curves.items()),
    )
    return claim, table, figure


def _exponent(numbers: np.ndarray, seconds: np.ndarray) -> float:
    """Return the power of the number of bodies that time grows with, over the upper two thirds of the numbers.

    The median of the slopes between any two of them (Theil and Sen): a run that a busy machine held up does not count.
    """
    upper = (numbers >= np.max(numbers, initial=0.0) / 3) & np.isfinite(seconds)
    if upper.sum() < 2:
        return math.nan
    return float(theilslopes(np.log(seconds[upper]), np.log(numbers[upper])).slope)


def substitution(study: Study) -> tuple[Claim, Table, Figure]:
    """Compare one evaluation by substitution into SymPy's matrices, as in the paper, with a compiled one."""
    points = {int(point.axes["model.n"]): point for point in family(study, "bodies").at({METHOD: GILL})}
    chosen = [number for number in SYMBOLIC_BODIES if number in points]
    symbolic = measured(study.folder, [points[number].spec for number in chosen])
    compiled = [
        value(points[number], SECONDS) / max(value(points[number], "rhs_evaluations"), 1.0) for number in chosen
    ]
    rows: list[tuple[Cell, ...]] = []
    gains: dict[int, float] = {}
    for entry, seconds in zip(symbolic, compiled, strict=True):
        gains[entry.bodies] = entry.least_s / seconds
        steps = 1500 * 4 * entry.least_s
        rows.append((entry.bodies, 1e3 * entry.least_s, 1e6 * seconds, gains[entry.bodies], steps))
    gain = gains.get(2, math.nan)
    enough = exceeds(gain, SPEED_UP)
    claim = Claim(
        "substitution",
        f"Compiled elements evaluate two bodies at least {SPEED_UP:,.0f} times faster than substitution into symbols.",
        "substitution named as the bottleneck, and a better one as the mission ahead",
        ", ".join(f"{factor:,.0f} times ({number} bodies)" for number, factor in gains.items()).replace(
            "(1 bodies", "(1 body"
        ),
        enough,
        f"One evaluation of two bodies is {two_digits(gain)} times faster compiled than by substitution into SymPy's "
        "matrices, measured on this machine.",
    )
    columns = (
        Column("bodies"),
        Column("substitution", "ms"),
        Column("compiled", "us"),
        Column("ratio"),
        Column("1500 steps of RK-Gill by substitution", "s"),
    )
    table = Table(
        "substitution",
        "One evaluation of the equations of motion",
        columns,
        tuple(rows),
        "Substitution: masses and lengths as numbers already, time, positions and velocities put in by SymPy's subs, "
        "the system solved by LAPACK; the least processor time of several. Compiled: RK-Gill's time from first to last "
        "step, all included, by its evaluations. The last column is reckoned from the first.",
    )
    return claim, table, _figure(symbolic, chosen, compiled)


def _figure(symbolic: tuple[Substitution, ...], bodies: list[int], compiled: list[float]) -> Figure:
    x = np.array(bodies, dtype=float)
    return Figure(
        "substitution",
        "Time of one evaluation",
        "What the paper calls its bottleneck, beside the same equations compiled element by element.",
        Axis("bodies"),
        Axis("time", "s", log=True),
        (
            Line("substitution (SymPy)", x, np.array([entry.least_s for entry in symbolic]), "both", "substitution"),
            Line("compiled (mbdkit)", x, np.array(compiled), "both", GILL),
        ),
    )
