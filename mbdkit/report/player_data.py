"""JSON data of an animation on a page: poses, paths and joint gaps, read by `templates/player.js`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.plot.beam_curves import largest_moment
from mbdkit.plot.joint_gaps import Gaps, gaps
from mbdkit.plot.plane_geometry import Array
from mbdkit.plot.pose import body_colors, trace_colors
from mbdkit.plot.scene import Scene, scene
from mbdkit.report.chart_data import color_key

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

RATE = 50
"""Frames per second, unless there are many bodies."""
_GRAIN = 1.0 / 20_000  # share of the view: a fourteenth of a pixel on a wide screen
_ANGLE = 2e-4  # rad
_JOINTS = 40  # largest number of joints with gaps


def film_data(run: Run, numbers: int, label: str = "") -> dict[str, Any]:
    """Return the data of an animation of a run.

    Parameters
    ----------
    numbers
        Approximate number of pose values, six bytes each.
    label
        Name of the run on a page with several.
    """
    most = int(np.clip(numbers // (3 * max(1, len(run.bodies))), 30, 1_000))
    shown = scene(run, rate=RATE, most=most, shortest=2.0, longest=30.0)
    return {"label": label} | _scene_data(shown) | {"gaps": _gap_data(run.spec, shown)}


def _scene_data(shown: Scene) -> dict[str, Any]:
    """Return the drawing and its poses as integers: positions in units of `grain`, angles in units of `_ANGLE`."""
    drawing = shown.drawing
    (x0, x1), (y0, y1) = shown.xlim, shown.ylim
    size = max(x1 - x0, y1 - y0)
    grain = size * _GRAIN
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    with np.errstate(invalid="ignore", over="ignore"):
        poses = np.clip((shown.poses - centre) / (grain, grain, _ANGLE), -2e9, 2e9).round()
    colors = body_colors(drawing)
    flat = [None if value != value else int(value) for value in poses.reshape(-1).tolist()]
    return {
        "time": _short(shown.time, 9),
        "speed": shown.speed,
        "view": [x0, x1, y0, y1],
        "grain": [grain, _ANGLE],
        "bodies": list(drawing.bodies),
        "colors": [color_key(color) for color in colors],
        "links": [[name, color_key(colors[drawing.link_numbers.index(k)])] for k, name in enumerate(drawing.links)],
        "owner": drawing.owner.tolist(),
        "local": _short(drawing.local, 6),
        "outlines": [list(outline) for outline in drawing.outlines],
        **_beam_data(shown),
        "pins": list(drawing.pins),
        "grounds": list(drawing.grounds),
        "centres": list(drawing.centres),
        "springs": [list(ends) for ends in drawing.springs],
        "bars": [list(ends) for ends in drawing.bars],
        "guides": [list(ends) for ends in drawing.guides],
        "sliders": list(drawing.sliders),
        "welds": list(drawing.welds),
        "traces": [
            {"label": trace.label, "point": trace.point, "color": color_key(color)}
            for trace, color in zip(shown.traces, trace_colors(drawing, shown.traces), strict=True)
        ],
        "poses": flat,
    }


def _beam_data(shown: Scene) -> dict[str, Any]:
    """Return the curves of the beams, and their bending moments in percent of the largest magnitude."""
    beams = [
        {"name": beam.name, "corners": list(beam.corners), "element": beam.elements_of_intervals,
         "elements": beam.elements, "body": beam.nodes[0]}
        for beam in shown.drawing.beams
    ]  # fmt: skip
    most = largest_moment(shown.moments)
    if not most or shown.moments is None:
        return {"beams": beams, "bending": None}
    percent = np.nan_to_num(100.0 * shown.moments / most, posinf=100.0, neginf=-100.0).round().astype(int)
    return {"beams": beams, "bending": {"largest": most, "percent": percent.reshape(-1).tolist()}}


def _gap_data(spec: Mapping[str, Any], shown: Scene) -> dict[str, Any]:
    """Return the gaps of the joints with the largest gaps [m], and the largest of them in a frame."""
    found: Gaps = gaps(spec, shown.drawing, shown.poses).largest(_JOINTS)
    size = np.hypot(found.vectors[..., 0], found.vectors[..., 1])
    return {
        "joints": list(found.joints),
        "ends": [list(ends) for ends in found.ends],
        "largest": float(np.max(size[np.isfinite(size)], initial=0.0)),
        "vectors": _short(found.vectors, 3),
    }


def _short(values: Array, digits: int) -> list[float | None]:
    return [float(f"{value:.{digits}g}") if abs(value) < np.inf else None for value in values.reshape(-1).tolist()]
