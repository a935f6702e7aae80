"""What the verdict on drift draws: errors over the step, and the energy of a method that is projected or not."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.analysis.verdict import Axis, Figure, Line
from mbdkit.studies.packaged.drift.combination import COMBINATION, LONG, Combination

if TYPE_CHECKING:
    from mbdkit.studies.study import Study

DRAWN = ("RK4", "Gauss 2", "Radau IIA 3", "Generalized-alpha", "RATTLE")
"""The methods of which errors are drawn, in all their formulations and stabilizations: more cannot be told apart."""


def errors(found: Sequence[Combination]) -> tuple[Figure, ...]:
    """Return a figure a mechanism: errors of positions over the step.

    Parameters
    ----------
    found
        What was measured.
    """
    figures = []
    for mechanism in dict.fromkeys(one.mechanism for one in found):
        lines = []
        for one in found:
            group = one.method.partition(",")[0]
            if one.mechanism == mechanism and one.errors and group in DRAWN:
                steps = sorted(one.errors)
                seen = np.array([one.errors[step] for step in steps])
                lines.append(Line(one.method, np.array(steps), np.where(seen > 0, seen, np.nan), "both", one.method))
        figures.append(
            Figure(
                f"error-{mechanism}",
                f"Error over the step: {mechanism}",
                "Largest distance of a body from the reference, as a share of the mechanism's size.",
                Axis("step", "s", log=True),
                Axis("error of positions", log=True),
                tuple(lines),
            )
        )
    return tuple(figures)


def energies(study: Study, methods: Collection[str]) -> tuple[Figure, ...]:
    """Return a figure a mechanism: the energy balance of the long runs of some methods.

    Parameters
    ----------
    study
        The study.
    methods
        Labels of the methods.
    """
    figures = []
    for name in study.families:
        lines = []
        for point in study.family(name) if name.endswith(LONG) else ():
            label = str(point.axes.get(COMBINATION))
            run = study.run(point) if label in methods and point.status == "complete" else None
            if run is not None:
                with run:
                    lines.append(Line(label, run.time, run.energy.balance, "line", label))
        if lines:
            mechanism = name.removesuffix(LONG)
            figures.append(
                Figure(
                    f"energy-{mechanism}",
                    f"Energy of one method, projected or not: {mechanism}",
                    "Energy balance of the long run; a slope is a trend, the rest oscillation.",
                    Axis("time", "s"),
                    Axis("energy balance", "J"),
                    tuple(lines),
                )
            )
    return tuple(figures)
