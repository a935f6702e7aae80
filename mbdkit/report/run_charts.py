"""The charts of a run's report: those of every kind of plot, with marks at the times of events."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mbdkit.analysis.verdict import Axis, Figure, Mark
from mbdkit.plot.plot_kinds import PLOT_KINDS, plot_module

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

MARKS = 60
"""Largest number of event crossings that are marked."""
_TIME = Axis("time", "s")


def run_charts(run: Run) -> tuple[Figure, ...]:
    """Return the charts of a run that has rows, except those of quantities that it did not record."""
    charts = [chart for kind in PLOT_KINDS for chart in plot_module(kind).charts(run)]
    marks = _marks(run)
    return tuple(replace(chart, marks=(*chart.marks, *marks)) if chart.x == _TIME else chart for chart in charts)


def _marks(run: Run) -> tuple[Mark, ...]:
    """Return marks at the times of events, only the first of each event with its name; none if there are too many."""
    if len(run.events) > MARKS:
        return ()
    named: set[str] = set()
    marks = []
    for event in run.events:
        marks.append(Mark("" if event.name in named else event.name, event.time))
        named.add(event.name)
    return tuple(marks)
