"""Charts of a run's report that no kind of plot has: components in the frames of bodies, and those of the table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.archive.run_summary import ROUND_OFF
from mbdkit.figures.curves import bands
from mbdkit.figures.drawing_geometry import draw_spec
from mbdkit.figures.page_model import Axis, Figure, Line
from mbdkit.figures.palette import INK, PALETTE, body_colors
from mbdkit.mechanism.bodies import GROUND
from mbdkit.quantities.table import RECORDED
from mbdkit.report.answer_section import Peaks

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

LINES = len(PALETTE)
"""Largest number of curves in a chart, those with the largest values."""
COMPONENTS = 4
"""Largest number of joints whose components are shown, those with the largest forces."""
_POINTS = 1_000
_TIME = Axis("time", "s")
_SIDES = (("first", "joints/reaction_force_first"), ("second", "joints/reaction_force_second"))


def component_charts(run: Run) -> list[Figure]:
    """Return a chart of the force components in the frames of both bodies for each of the joints with large forces."""
    if not all(run.records(path) for _, path in _SIDES):
        return []
    time, data = np.asarray(run.time), run.dataset("joints/reaction_force")
    peaks = np.nan_to_num(Peaks.of(time, data, lambda f: np.hypot(f[..., 0], f[..., 1])).value)
    most = np.argsort(-peaks, kind="stable")[:COMPONENTS].tolist()
    colors = dict(zip(run.bodies, body_colors(draw_spec(run.spec, tuple(run.bodies))), strict=True)) | {GROUND: INK}
    joints = list(run.joints.values())
    return [_components(run, joints[k], colors) for k in sorted(most) if peaks[k] > ROUND_OFF * peaks[most[0]]]


def _components(run: Run, joint: Any, colors: dict[str, str]) -> Figure:
    lines = []
    for body, (_, path) in zip(joint.bodies, _SIDES, strict=True):
        curves = bands(np.asarray(run.time), run.column(path, joint.index, slice(0, 2)), points=_POINTS)
        frame = "global {}" if body == GROUND else f"{{}} of {body}"
        color = colors.get(body, "")
        lines += [Line(frame.format(axis), *curves.curve(k), color=color, group=body) for k, axis in enumerate("xy")]
    caption = (
        f"Components of the force of {joint.bodies[0]} on {joint.bodies[1]} along the axes that are fixed to each body."
    )
    title = f"Force in {joint.name}, in the frames of its bodies"
    return Figure(f"components-{joint.index + 1}", title, caption, _TIME, Axis("force component", "N"), tuple(lines))


def recorded_charts(run: Run, path: str) -> list[Figure]:
    """Return the charts of an array that the table of quantities describes, without those whose values are all zero."""
    array = RECORDED[path]
    if not array.charts or not run.records(path):
        return []
    names = [str(name) for name in run.array(f"{array.group}/{array.dims[1]}")]
    units = [array.units] * len(names)
    if array.row_units:
        units = [str(unit) for unit in run.array(f"{array.group}/{array.row_units}")]
    found = []
    for chart in array.charts:
        lines = _lines(run, path, names, [column for column, unit in enumerate(units) if unit == chart.unit])
        if lines:
            axis = Axis(chart.axis, chart.unit)
            found.append(Figure(chart.name, chart.title, chart.caption, _TIME, axis, lines))
    return found


def _lines(run: Run, path: str, names: Any, chosen: Any) -> tuple[Line, ...]:
    """Return lines of the chosen columns of an array, limited to those with the largest values; none if all are
    zero.
    """
    columns = list(chosen)
    time, data = np.asarray(run.time), run.dataset(path)
    peaks = np.nan_to_num(Peaks.of(time, data).value[columns]) if columns else np.zeros(0)
    order = np.argsort(-peaks, kind="stable")[:LINES]
    shown = sorted(columns[place] for place in order if peaks[place] > 0)
    if not shown:
        return ()
    curves = bands(time, data, points=_POINTS)
    return tuple(Line(names[column], *curves.curve(column)) for column in shown)
