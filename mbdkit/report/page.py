"""A run as one HTML page that plays it on a canvas: no library, no network, all data inside."""

from __future__ import annotations

import html
import json
import re
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.report.caption import caption
from mbdkit.report.pose import body_colors
from mbdkit.report.scene import Scene, scene
from mbdkit.report.style import PALETTE
from mbdkit.report.trajectory import trace_colors

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

RATE = 50
"""Frames a second, where there are not too many bodies."""
_NUMBERS = 450_000  # of poses in a page, about three megabytes
_GRAIN = 1.0 / 20_000  # of the view: a fourteenth of a pixel on a wide screen
_ANGLE = 2e-4  # rad


def write_html(run: Run, target: Path) -> None:
    """Write a run as a page with controls."""
    target.write_text(page(run), encoding="utf-8")


def page(run: Run) -> str:
    """Return the page of a run."""
    most = int(np.clip(_NUMBERS // (3 * max(1, len(run.bodies))), 30, 1_000))
    shown = scene(run, rate=RATE, most=most, shortest=2.0, longest=30.0)
    head = caption(run)
    parts = {
        "TITLE": html.escape(head.title),
        "SETTINGS": html.escape(head.settings),
        "ALARM": f'<p class="alarm" role="status">{html.escape(head.alarm)}</p>' if head.alarm else "",
        "DATA": script_json(_data(shown)),
    }
    template = files("mbdkit.report").joinpath("animation.html").read_text(encoding="utf-8")
    return re.sub("@@([A-Z]+)@@", lambda found: parts[found[1]], template)


def script_json(value: Any) -> str:
    """Return compact JSON that may stand inside a script element: nothing in it can end the element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _data(shown: Scene) -> dict[str, Any]:
    """Return what the page draws; poses are integers in grains of the view, angles in units of `_ANGLE`."""
    drawing = shown.drawing
    (x0, x1), (y0, y1) = shown.xlim, shown.ylim
    size = max(x1 - x0, y1 - y0)
    grain = size * _GRAIN
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    with np.errstate(invalid="ignore", over="ignore"):
        poses = np.clip((shown.poses - centre) / (grain, grain, _ANGLE), -2e9, 2e9).round()
    flat = [None if value != value else int(value) for value in poses.reshape(-1).tolist()]
    return {
        "time": [float(f"{value:.9g}") for value in shown.time.tolist()],
        "speed": shown.speed,
        "view": [x0, x1, y0, y1],
        "grain": [grain, _ANGLE],
        "bodies": list(drawing.bodies),
        "colors": [_color_key(color) for color in body_colors(drawing)],
        "owner": drawing.owner.tolist(),
        "local": [float(f"{value:.6g}") for value in drawing.local.reshape(-1).tolist()],
        "outlines": [list(outline) for outline in drawing.outlines],
        "pins": list(drawing.pins),
        "grounds": list(drawing.grounds),
        "centres": list(drawing.centres),
        "springs": [list(ends) for ends in drawing.springs],
        "bars": [list(ends) for ends in drawing.bars],
        "guides": [list(ends) for ends in drawing.guides],
        "sliders": list(drawing.sliders),
        "welds": list(drawing.welds),
        "traces": [
            {"label": trace.label, "point": trace.point, "color": _color_key(color)}
            for trace, color in zip(shown.traces, trace_colors(drawing, shown.traces), strict=True)
        ],
        "poses": flat,
    }


def _color_key(color: str) -> int | str:
    """Return the page's name of a colour: its place in the palette, or the ink."""
    return PALETTE.index(color) if color in PALETTE else "ink"
