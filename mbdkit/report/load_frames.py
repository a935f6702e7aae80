"""A mechanism at several times with arrows of the forces of its joints, loads and springs to scale, as SVG."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.plot.plane_geometry import Array
from mbdkit.report.mechanism_drawing import CROWD, NARROW, WIDE, NamedPose, draw_scale_bar, draw_sketch, joint_point
from mbdkit.report.section import Drawing
from mbdkit.report.svg_canvas import Canvas

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

FRAMES, FRAMES_NARROW = 6, 3
"""Number of frames in a row on a wide page and on a narrow one."""
ARROW = 0.45
"""Length of the longest arrow, as a share of the height of the mechanism."""
KEY = 0.15
"""Room for the key above the frames, as a share of their height."""
KINDS = (("joint", "force in a joint"), ("load", "measured load"), ("spring", "force element"))
"""Class of the arrows in `templates/drawing.css`, and what they show."""

Arrow = tuple[str, Array, Array]


def load_drawing(run: Run, mechanism: Mechanism | None) -> Drawing | None:
    """Return the drawing of a run in several frames; None if its model is not available, or has very many bodies."""
    if mechanism is None or list(mechanism.bodies) != list(run.bodies) or len(run.bodies) > CROWD:
        return None
    text = (
        "Forces to one scale, at equal intervals of time: in joints, on the second body; measured loads, from their "
        "point of application; force elements, at both ends."
    )
    wide, narrow = (_svg(run, mechanism, *size) for size in ((FRAMES, WIDE), (FRAMES_NARROW, NARROW)))
    return Drawing(wide, narrow, "The mechanism at several times with arrows of its forces", text)


def _svg(run: Run, mechanism: Mechanism, count: int, width: float) -> Markup:
    rows = np.unique(np.linspace(0, len(run.time) - 1, count).round().astype(int)).tolist()
    poses = run.array("trajectory/position")
    frames = [NamedPose.of(mechanism, list(run.bodies), poses[row], np.asarray(run.time)) for row in rows]
    arrows = [list(_arrows(run, frame, row)) for frame, row in zip(frames, rows, strict=True)]
    longest = max((float(np.hypot(*force)) for found in arrows for *_, force in found), default=0.0)
    boxes = [frame.drawing.world(frame.pose)[frame.drawing.owner >= 0] for frame in frames]
    low, high = min(float(box[:, 1].min()) for box in boxes), max(float(box[:, 1].max()) for box in boxes)
    broadest = max(float(np.ptp(box[:, 0])) for box in boxes)
    size = max(high - low, broadest)
    scale = ARROW * size / longest if longest > 0 else 0.0
    pitch = broadest + 0.25 * size
    shifts = [np.array([pitch * k - (box[:, 0].min() + box[:, 0].max()) / 2, 0.0]) for k, box in enumerate(boxes)]
    canvas = Canvas.fitted(_covered(boxes, arrows, shifts, scale), width)
    for place, (frame, shift, found) in enumerate(zip(frames, shifts, arrows, strict=True)):
        draw_sketch(canvas, frame.drawing, canvas.px(frame.drawing.world(frame.pose) + shift), moving_only=True)
        for kind, point, force in found:
            _arrow(canvas, kind, canvas.px(point + shift), force * scale * canvas.scale)
        centre = float(canvas.px(np.array([pitch * place, low]))[0])
        _text(canvas, centre, canvas.height - 26.0, f"{float(run.time[rows[place]]):.4g} s", "middle")
    draw_scale_bar(canvas)
    _key(canvas, longest, scale, {kind for found in arrows for kind, *_ in found})
    box_ = f"0 0 {canvas.width:.0f} {canvas.height:.0f}"
    return Markup('<svg viewBox="{}" aria-hidden="true">{}</svg>').format(box_, Markup("").join(canvas.parts))


def _covered(boxes: list[Array], arrows: list[list[Arrow]], shifts: list[Array], scale: float) -> Array:
    """Return the points (P, 2) [m] of all frames and the ends of their arrows, side by side, and room for the key."""
    points = [box + shift for box, shift in zip(boxes, shifts, strict=True)]
    for found, shift in zip(arrows, shifts, strict=True):
        points += [(point + scale * force + shift)[None] for _, point, force in found]
    found_points = np.concatenate(points)
    low, high = found_points.min(axis=0), found_points.max(axis=0)
    return np.vstack([found_points, [low[0], high[1] + KEY * (high[1] - low[1])]])


def _arrows(run: Run, frame: NamedPose, row: int) -> Iterator[Arrow]:
    """Yield kind, point [m] and force [N] of each arrow of a frame."""
    mechanism = frame.mechanism
    assert mechanism is not None
    forces = run.array("joints/reaction_force")[row] if run.joint_names else np.zeros((0, 2))
    for name, force in zip(run.joint_names, forces, strict=True):
        if name in mechanism.joints and not mechanism.joints[name].is_driver:
            yield "joint", joint_point(frame, mechanism, mechanism.joints[name]), np.nan_to_num(force)
    for load in run.loads.values():
        yield "load", load.point[row], load.force[row]
    for name, element in mechanism.forces.items():
        ends = [frame.place(body, point) for _, body, point in element.attachments()]
        if len(ends) == 2 and name in run.forces and run.forces[name].units == "N":
            between = ends[1] - ends[0]
            pull = float(np.nan_to_num(run.forces[name].value[row])) * between / (float(np.hypot(*between)) or 1.0)
            yield "spring", ends[0], pull
            yield "spring", ends[1], -pull


def _arrow(canvas: Canvas, kind: str, start: Array, along: Array) -> None:
    """Draw a force from `start` [px]; forces too short for a head are left out."""
    vector = along * (1.0, -1.0)
    length = float(np.hypot(*vector))
    if length > 4.0:
        canvas.arrow(start + vector, vector, length, f"arrow of-{kind}")


def _key(canvas: Canvas, longest: float, scale: float, kinds: set[str]) -> None:
    """Draw what the colours of the arrows mean, and an arrow of a round force."""
    y = 14.0
    for kind, text in KINDS:
        if kind in kinds:
            canvas.line(np.array([[10.0, y], [30.0, y]]), f"arrow of-{kind}")
            _text(canvas, 36.0, y + 4.0, text)
            y += 17.0
    if longest > 0:
        power = 10.0 ** math.floor(math.log10(longest))
        force = next(digit * power for digit in (5.0, 2.0, 1.0) if digit * power <= longest)
        end = canvas.width - 12.0
        canvas.line(np.array([[end - force * scale * canvas.scale, 14.0], [end, 14.0]]), "arrow")
        _text(canvas, end, 30.0, f"{force:g} N", "end")


def _text(canvas: Canvas, x: float, y: float, text: str, anchor: str = "start") -> None:
    shown = Markup('<text class="faint" text-anchor="{}" x="{:.1f}" y="{:.1f}">{}</text>')
    canvas.parts.append(shown.format(anchor, x, y, text))
