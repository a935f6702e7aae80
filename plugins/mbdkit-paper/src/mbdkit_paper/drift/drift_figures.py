"""Figures of the verdict on drift: errors against the step, and energy with and without projection."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from mbdkit_paper.drift.combination import COMBINATION, LONG, Combination
from mbdkit_paper.wording import Words
from mbdkit_report import Figure, Line
from mbdkit_studies import Study

DRAWN = ("RK4", "Gauss 2", "Radau IIA 3", "Generalized-alpha", "RATTLE")
#: Methods whose errors are drawn, with all formulations and stabilizations; more lines would not be legible.
WORDS = Words(__file__)


def errors(results: Sequence[Combination], added: Collection[str] = ()) -> tuple[Figure, ...]:
    """Return one figure per mechanism of the errors of positions against the step, also of added methods."""
    figures = []
    for mechanism in dict.fromkeys(result.mechanism for result in results):
        lines = []
        for result in results:
            group = result.method.partition(",")[0]
            if result.mechanism == mechanism and result.errors and (group in DRAWN or result.method in added):
                steps, seen = np.array(sorted(result.errors.items())).T
                lines.append(Line(result.method, steps, np.where(seen > 0, seen, np.nan), "both", result.method))
        figures.append(WORDS.figure("error", lines, f"error-{mechanism}", mechanism=mechanism))
    return tuple(figures)


def energies(study: Study, methods: Collection[str], name: str, title: str) -> tuple[Figure, ...]:
    """Return one figure per mechanism of the energy balance of the long runs of some methods.

    Parameters
    ----------
    name, title
        First part of the names and the titles of the figures.
    """
    figures = []
    for family in study.families:
        lines = []
        for point in study.family(family) if family.endswith(LONG) else ():
            label = str(point.axes.get(COMBINATION))
            run = study.run(point) if label in methods and point.status == "complete" else None
            if run is not None:
                with run:
                    lines.append(Line(label, run.time, run.energy.balance, "line", label))
        if lines:
            mechanism = family.removesuffix(LONG)
            figures.append(WORDS.figure("energy", lines, f"{name}-{mechanism}", title=title, mechanism=mechanism))
    return tuple(figures)
