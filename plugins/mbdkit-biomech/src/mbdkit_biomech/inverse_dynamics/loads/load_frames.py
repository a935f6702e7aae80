"""Forces of joints, loads and springs as arrows to scale, in drawings at several times and in the player."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from markupsafe import Markup

from mbdkit.archive.run import Run
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_biomech.inverse_dynamics.signals.cycles import crossings
from mbdkit_report import Canvas, Drawing, Illustration, NamedPose, draw_sketch, mechanism_of
from mbdkit_report.figures.scene import nearest_rows
from mbdkit_report.seams import film_data

FRAMES, FRAMES_NARROW = 6, 3  #: Number of frames side by side on a wide page and on a narrow one.
#: Length of the longest arrow, as a share of the height or width of the mechanism, whichever is larger.
ARROW = 0.45
CONTACT = 0.05  #: A contact begins where a load exceeds this share of its largest value.
KEY = 0.15  #: Height of the space for the legend above the frames, as a share of the height of the frames.
#: Kinds of arrows, which are classes in `templates/drawing.css`, and the texts that explain them.
KINDS = (("joint", "force in a joint"), ("load", "measured load"), ("spring", "force element"))

#: Phrases for the caption: what the arrows of each kind show, and where they are drawn.
_PLACES = {
    "joint": "in joints, on the second body",
    "load": "measured loads, from their point of application",
    "spring": "force elements, at both ends",
}

Arrow = tuple[str, np.ndarray, np.ndarray]


def load_drawing(run: Run, mechanism: Mechanism | None) -> Illustration | None:
    """Return the drawing of a run at several times; None if its mechanism is not known, or has too many bodies."""
    if not _has_arrows(run, mechanism):
        return None
    assert mechanism is not None
    when = "of time" if _cycle(run) is None else "of a cycle, which begins with the contact"
    kinds = {kind for kind, *_ in _frames(run, mechanism, [0])[1][0]}
    described = "; ".join(words for kind, words in _PLACES.items() if kind in kinds)
    text = (
        f"Forces to one scale, at equal intervals {when}: {described}." if described else f"At equal intervals {when}."
    )
    wide = _svg(run, mechanism, FRAMES, Illustration.WIDE)
    narrow = _svg(run, mechanism, FRAMES_NARROW, Illustration.NARROW)
    return Illustration(wide, narrow, "The mechanism at several times with arrows of its forces", text)


@film_data
def film_with_arrows(run: Run, film: dict[str, Any]) -> dict[str, object]:
    """Return the data of the player of a run, with the arrows of forces in each frame if it is one of inverse dynamics.

    Returns
    -------
    dict
        The data `film`. If arrows can be drawn and not all forces are zero, the key ``arrows`` is added: ``kinds`` (A,)
        of the A arrows, the ``texts`` of the kinds, the ``scale`` [m/N], the ``longest`` force [N], and ``values``, the
        position x, y [m] and the force x, y [N] of each arrow, frame by frame. The ``view`` is enlarged about its
        centre so that it contains the arrows.
    """
    if run.kind != "inverse" or not _has_arrows(run, mechanism := mechanism_of(run)):
        return film
    frames, found = _frames(run, mechanism, nearest_rows(np.asarray(run.time), np.asarray(film["time"])).tolist())
    values = np.array([[(*point, *force) for _, point, force in arrows] for arrows in found])
    longest = float(np.max(np.hypot(values[..., 2], values[..., 3]), initial=0.0))
    if longest == 0.0:
        return film
    size = max(float(np.max(np.ptp(box, axis=0))) for box in (_box(frame) for frame in frames))
    scale = ARROW * size / longest
    ends = (values[..., :2] + scale * values[..., 2:]).reshape(-1, 2)
    kinds = [kind for kind, *_ in found[0]]
    data = {
        "kinds": kinds,
        "texts": {kind: text for kind, text in KINDS if kind in kinds},
        "scale": scale,
        "longest": longest,
        "values": [float(f"{value:.5g}") for value in values.reshape(-1).tolist()],
    }
    return film | {"arrows": data, "view": _widened(film["view"], ends)}


def _widened(view: list[float], points: np.ndarray) -> list[float]:
    """Return a view [m] enlarged about its centre so that it contains the points (P, 2)."""
    found = []
    for axis, (low, high) in enumerate((view[:2], view[2:])):
        middle = (low + high) / 2
        half = max((high - low) / 2, 1.05 * float(np.max(np.abs(points[:, axis] - middle))))
        found += [middle - half, middle + half]
    return found


def _has_arrows(run: Run, mechanism: Mechanism | None) -> bool:
    """Return whether arrows can be drawn: the model is available, and its bodies are so few (at most `Drawing.CROWD`)
    that arrows do not hide them.
    """
    return mechanism is not None and list(mechanism.bodies) == list(run.bodies) and len(run.bodies) <= Drawing.CROWD


def _frames(run: Run, mechanism: Mechanism | None, rows: Sequence[int]) -> tuple[list[NamedPose], list[list[Arrow]]]:
    """Return the poses in some rows, and the arrows in each."""
    poses = run.array("trajectory/position")
    first = NamedPose.of(mechanism, list(run.bodies), poses[0], np.asarray(run.time))
    frames = [replace(first, pose=poses[row]) for row in rows]
    return frames, [list(_arrows(run, frame, row)) for frame, row in zip(frames, rows, strict=True)]


def _box(frame: NamedPose) -> np.ndarray:
    """Return the drawn points (P, 2) [m] of the moving bodies in a frame."""
    return np.asarray(frame.drawing.world(frame.pose)[frame.drawing.owner >= 0])


def _svg(run: Run, mechanism: Mechanism, count: int, width: float) -> Markup:
    rows = np.unique(nearest_rows(np.asarray(run.time), _moments(run, count))).tolist()
    frames, arrows = _frames(run, mechanism, rows)
    longest = max((float(np.hypot(*force)) for arrow in arrows for *_, force in arrow), default=0.0)
    boxes = [_box(frame) for frame in frames]
    low, high = min(float(box[:, 1].min()) for box in boxes), max(float(box[:, 1].max()) for box in boxes)
    broadest = max(float(np.ptp(box[:, 0])) for box in boxes)
    size = max(high - low, broadest)
    scale = ARROW * size / longest if longest > 0 else 0.0
    pitch = broadest + 0.25 * size
    shifts = [np.array([pitch * k - (box[:, 0].min() + box[:, 0].max()) / 2, 0.0]) for k, box in enumerate(boxes)]
    canvas = Canvas.fitted(_covered(boxes, arrows, shifts, scale), width)
    for index, (frame, shift, found) in enumerate(zip(frames, shifts, arrows, strict=True)):
        draw_sketch(canvas, frame.drawing, canvas.px(frame.drawing.world(frame.pose) + shift), moving_only=True)
        for kind, point, force in found:
            _arrow(canvas, kind, canvas.px(point + shift), force * scale * canvas.scale)
        centre = float(canvas.px(np.array([pitch * index, low]))[0])
        _text(canvas, centre, canvas.height - 26.0, f"{float(run.time[rows[index]]):.4g} s", "middle")
    canvas.scale_bar()
    _key(canvas, longest, scale, {kind for arrow in arrows for kind, *_ in arrow})
    return canvas.svg()


def _moments(run: Run, count: int) -> np.ndarray:
    """Return the times [s] of the frames: the middles of equal parts of the first cycle or, without a cycle, equally
    spaced times from the first to the last row.
    """
    if (cycle := _cycle(run)) is None:
        return np.linspace(run.time[0], run.time[-1], count)
    begin, end = cycle
    return begin + (end - begin) * (np.arange(count) + 0.5) / count


def _cycle(run: Run) -> tuple[float, float] | None:
    """Return begin and end [s] of the first cycle: the first two times at which the contact of a load begins. The first
    load with two such times is used; None if there is no such load.
    """
    for load in run.loads.values():
        size = np.linalg.norm(load.force, axis=1)
        starts = crossings(np.asarray(run.time), size, CONTACT * float(np.max(size))).tolist()
        if len(starts) > 1:
            return starts[0], starts[1]
    return None


def _covered(boxes: list[np.ndarray], arrows: list[list[Arrow]], shifts: list[np.ndarray], scale: float) -> np.ndarray:
    """Return the points (P, 2) [m] that the drawing must contain: the bodies and the tips of the arrows in all frames,
    which are side by side, and a point above all of these, so that there is space for the legend.
    """
    points = [box + shift for box, shift in zip(boxes, shifts, strict=True)]
    for arrow, shift in zip(arrows, shifts, strict=True):
        points += [(point + scale * force + shift)[None] for _, point, force in arrow]
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
            yield "joint", frame.named("joint", name), np.nan_to_num(force)
    yield from (("load", load.point[row], load.force[row]) for load in run.loads.values())
    for name, element in mechanism.forces.items():
        ends = [frame.place(body, point) for _, body, point in element.attachments()]
        if len(ends) == 2 and name in run.forces and run.forces[name].units == "N":
            between = ends[1] - ends[0]
            pull = float(np.nan_to_num(run.forces[name].value[row])) * between / (float(np.hypot(*between)) or 1.0)
            yield "spring", ends[0], pull
            yield "spring", ends[1], -pull


def _arrow(canvas: Canvas, kind: str, start: np.ndarray, along: np.ndarray) -> None:
    """Draw a force at `start` [px]; arrows too short for a head are not drawn."""
    vector = along * (1.0, -1.0)
    if (length := float(np.hypot(*vector))) > 4.0:
        canvas.arrow(start + vector, vector, length, f"arrow of-{kind}")


def _key(canvas: Canvas, longest: float, scale: float, kinds: set[str]) -> None:
    """Draw the legend: the colours of the arrows, and an arrow whose length stands for a round force."""
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
