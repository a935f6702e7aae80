"""The charts of a run's report: forces first, drift last, with marks at events and one colour for each thing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from mbdkit.figures.drawing_geometry import choose_traces, draw_spec
from mbdkit.figures.page_model import Axis, Figure, Mark
from mbdkit.figures.palette import PALETTE, trace_colors
from mbdkit.plot.plot_kinds import PLOT_KINDS, plot_module
from mbdkit.quantities.array import Recorded
from mbdkit.quantities.table import BY_GROUP, RECORDED
from mbdkit.report.element_charts import component_charts, recorded_charts
from mbdkit.report.load_sections import inverse_charts

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

MARKS = 60
"""Largest number of event crossings that are marked."""
DRIFT = ("misalignment", "velocity-misalignment", "angle-misalignment", "balance")
"""Charts that show how well the constraints and the energy hold."""
_TIME = Axis("time", "s")
_FIRST = ("reactions", "torques", "forces", "beams")
_OF_MOTION = ("m", "rad", "m/s", "rad/s")
"""Units of quantities whose charts follow the trajectory."""
_OF_JOINTS = (
    "reactions",
    "torques",
    *(chart.name for array in BY_GROUP["joints"].columns if isinstance(array, Recorded) for chart in array.charts),
    *DRIFT[:3],
)


def run_charts(run: Run) -> tuple[Figure, ...]:
    """Return the charts of a run that has rows, except those of quantities that it did not record."""
    of_kinds = {kind: list(plot_module(kind).charts(run)) for kind in PLOT_KINDS}
    charts = [chart for kind in _FIRST for chart in of_kinds.pop(kind, [])]
    recorded = [chart for path in RECORDED for chart in recorded_charts(run, path)]
    moving = [chart for chart in recorded if chart.y.unit in _OF_MOTION]
    charts += [
        *inverse_charts(run),
        *component_charts(run),
        *(chart for chart in recorded if chart.y.unit not in _OF_MOTION),
    ]
    charts += [*of_kinds.pop("trajectory"), *moving, *(chart for found in of_kinds.values() for chart in found)]
    charts.sort(key=lambda chart: chart.name in DRIFT)
    marks = _marks(run)
    colors = _colors(run)
    return tuple(
        replace(
            _colored(chart, colors.get(chart.name, {})),
            marks=(*chart.marks, *marks) if chart.x == _TIME else chart.marks,
        )
        for chart in charts
    )


def _colors(run: Run) -> Mapping[str, Mapping[str, str]]:
    """Return the colours of curves, by name of the chart and of the curve; others take them in order."""
    drawing = draw_spec(run.spec, tuple(run.bodies))
    traces = choose_traces(drawing)
    paths = {trace.label: color for trace, color in zip(traces, trace_colors(drawing, traces), strict=True)}
    few = run.joint_names if len(run.joint_names) <= len(PALETTE) else ()
    joints = dict(zip(few, PALETTE, strict=False))
    return {"trajectory": paths} | dict.fromkeys(_OF_JOINTS, joints)


def _colored(chart: Figure, colors: Mapping[str, str]) -> Figure:
    lines = (replace(line, color=line.color or colors.get(line.group or line.label, "")) for line in chart.lines)
    return replace(chart, lines=tuple(lines))


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
