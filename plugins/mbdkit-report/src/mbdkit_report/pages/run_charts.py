"""Charts in the report of a run, with marks at events. Charts of forces come first, charts of misalignment and energy
balance last. A joint has the same colour in all charts if there are no more joints than colours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.quantities.array import Recorded
from mbdkit.quantities.registered_kinds import kind_of_group
from mbdkit_report.figures.curves import bands
from mbdkit_report.figures.drawing_geometry import choose_traces, draw_run
from mbdkit_report.figures.page_model import TIME, Axis, Figure, Line, Mark
from mbdkit_report.figures.palette import PALETTE, trace_colors
from mbdkit_report.pages.section_items import added_charts
from mbdkit_report.plot.plot_kinds import plot_kinds, plot_module

MARKS = 60  #: No events are marked if a run has more event crossings than this.
#: Charts that show how well the constraints and the energy hold.
DRIFT = ("misalignment", "velocity-misalignment", "angle-misalignment", "balance")
_FIRST = ("reactions", "torques", "forces", "beams")
#: Units of the recorded arrays whose charts come after the chart of the trajectory.
_OF_MOTION = ("m", "rad", "m/s", "rad/s")
_OF_JOINTS = (
    "reactions",
    "torques",
    *(chart.name for array in kind_of_group("joints").columns if isinstance(array, Recorded) for chart in array.charts),
    *DRIFT[:3],
)


def run_charts(run: Run) -> tuple[Figure, ...]:
    """Return the charts of a run that has rows. Quantities that the run did not record are left out."""
    of_kinds = {kind: list(plot_module(kind).charts(run)) for kind in plot_kinds()}
    charts = [chart for kind in _FIRST for chart in of_kinds.pop(kind, [])]
    every = [array for kind in run.kinds.values() for array in kind.arrays if isinstance(array, Recorded)]
    recorded = [chart for array in every for chart in recorded_charts(run, array)]
    moving = [chart for chart in recorded if chart.y.unit in _OF_MOTION]
    charts += [*added_charts(run), *(chart for chart in recorded if chart.y.unit not in _OF_MOTION)]
    charts += [*of_kinds.pop("trajectory"), *moving, *(chart for of_kind in of_kinds.values() for chart in of_kind)]
    charts.sort(key=lambda chart: chart.name in DRIFT)
    marks = _marks(run)
    colors = _colors(run)
    found = []
    for chart in charts:
        own = colors.get(chart.name, {})
        lines = (replace(line, color=line.color or own.get(line.group or line.label, "")) for line in chart.lines)
        at = (*chart.marks, *marks) if chart.x == TIME else chart.marks
        found.append(replace(chart, lines=tuple(lines), marks=at))
    return tuple(found)


def _colors(run: Run) -> Mapping[str, Mapping[str, str]]:
    """Return the colours of curves by the name of the chart and the label of the curve; curves not listed take colours
    in order.
    """
    drawing = draw_run(run)
    traces = choose_traces(drawing)
    paths = {trace.label: color for trace, color in zip(traces, trace_colors(drawing, traces), strict=True)}
    few = run.joint_names if len(run.joint_names) <= len(PALETTE) else ()
    joints = dict(zip(few, PALETTE, strict=False))
    return {"trajectory": paths} | dict.fromkeys(_OF_JOINTS, joints)


def _marks(run: Run) -> tuple[Mark, ...]:
    """Return marks at the times of events; empty if there are too many. Only the first mark of each event has its
    name.
    """
    if len(run.events) > MARKS:
        return ()
    names = [event.name for event in run.events]
    return tuple(Mark("" if one.name in names[:place] else one.name, one.time) for place, one in enumerate(run.events))


#: Largest number of curves in the chart of a recorded array. Of more curves, those with the largest values are drawn.
LINES = len(PALETTE)
_POINTS = 1_000


def recorded_charts(run: Run, array: Recorded) -> list[Figure]:
    """Return the charts of a recorded array; empty if the run did not record it. Columns with different units have
    different charts. Charts whose values are all zero are left out.
    """
    if not array.charts or not run.records(array.path):
        return []
    names = [str(name) for name in run.array(f"{array.group}/{array.dims[1]}")]
    units = [array.units] * len(names)
    if array.row_units:
        units = [str(unit) for unit in run.array(f"{array.group}/{array.row_units}")]
    found = []
    for chart in array.charts:
        of_units = [chart.unit] if chart.unit else [*dict.fromkeys(units)]
        for number, unit in enumerate(of_units, 1):
            if lines := _lines(run, array.path, names, [column for column, own in enumerate(units) if own == unit]):
                name = chart.name if len(of_units) == 1 else f"{chart.name}-{number}"
                axis = Axis(chart.axis, "" if unit == "1" else unit)
                found.append(Figure(name, chart.title, chart.caption, TIME, axis, lines))
    return found


def _lines(run: Run, path: str, names: Sequence[str], columns: list[int]) -> tuple[Line, ...]:
    """Return lines of some columns of an array, at most `LINES`: those with the largest values. Columns whose
    values are all zero are left out.
    """
    curves = bands(np.asarray(run.time), run.dataset(path), points=_POINTS)
    peaks = np.nan_to_num(curves.peaks[columns])
    order = np.argsort(-peaks, kind="stable")[:LINES]
    shown = sorted(columns[place] for place in order if peaks[place] > 0)
    return tuple(Line(names[column], *curves.curve(column)) for column in shown)
