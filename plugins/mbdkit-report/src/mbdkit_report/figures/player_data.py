"""JSON data of an animation on a page: poses, paths and joint gaps, read by `templates/player.js`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbdkit_report.figures.beam_curves import largest_moment
from mbdkit_report.figures.drawing_geometry import Drawing, mechanism_of
from mbdkit_report.figures.palette import KIND_COLORS, MUSCLE, body_colors, color_key, trace_colors
from mbdkit_report.figures.plane_geometry import Array
from mbdkit_report.figures.scene import Scene, scene

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

RATE = 50  #: Frames per second; fewer if there are many bodies.
_GRAIN = 1.0 / 20_000  # unit of positions, as a share of the view; a fourteenth of a pixel on a wide screen
_ANGLE = 2e-4  # unit of angles [rad]
_JOINTS = 40  # largest number of joints with gaps
_POINTS = ("pins", "grounds", "centres", "springs", "muscles", "shapes", "bars", "guides", "sliders", "welds", "coils")
_SAME = 1e-9  # m; closer points of a body are drawn as one point


def film_data(run: Run, numbers: int, label: str = "") -> dict[str, object]:
    """Return the data of an animation of a run, with about `numbers` pose values of six bytes each; `label` is the name
    of the run on a page with several runs.
    """
    most = int(np.clip(numbers // (3 * max(1, len(run.bodies))), 30, 1_000))
    shown = scene(run, rate=RATE, most=most, shortest=2.0, longest=30.0)
    return {"label": label} | _scene_data(shown) | {"gaps": _gap_data(run, shown)}


def _scene_data(shown: Scene) -> dict[str, object]:
    """Return the drawing, and the poses as integers: positions in units of `_GRAIN` times the size of the view, angles
    in units of `_ANGLE`.
    """
    drawing = shown.drawing
    (x0, x1), (y0, y1) = shown.xlim, shown.ylim
    grain = max(x1 - x0, y1 - y0) * _GRAIN
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    with np.errstate(invalid="ignore", over="ignore"):
        poses = np.clip((shown.poses - centre) / (grain, grain, _ANGLE), -2e9, 2e9).round()
    colors = body_colors(drawing)
    return {
        "time": _short(shown.time, 9),
        "speed": shown.speed,
        "view": [x0, x1, y0, y1],
        "grain": [grain, _ANGLE],
        "bodies": list(drawing.bodies),
        "colors": [color_key(color) for color in colors],
        "links": [[name, color_key(colors[drawing.link_numbers.index(k)])] for k, name in enumerate(drawing.links)],
        "key": [[text, color_key(KIND_COLORS.get(kind, MUSCLE))] for kind, text in drawing.key],
        "names": [
            [tag.text, color_key(tag.color), *tag.anchor, *_short(np.array(tag.beside), 3)] for tag in shown.tags
        ],
        "owner": drawing.owner.tolist(),
        "local": _short(drawing.local, 6),
        "outlines": drawing.outlines,
        **_beam_data(shown),
        **{name: getattr(drawing, name) for name in _POINTS},
        "traces": [
            {"label": trace.label, "point": trace.point, "color": color_key(color)}
            for trace, color in zip(shown.traces, trace_colors(drawing, shown.traces), strict=True)
        ],
        "poses": [None if value != value else int(value) for value in poses.reshape(-1).tolist()],
    }


def _beam_data(shown: Scene) -> dict[str, object]:
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


def _gap_data(run: Run, shown: Scene) -> dict[str, object]:
    """Return the gaps of the joints with the largest gaps [m], and the largest gap in any frame."""
    result: JointGaps = gaps(run, shown.drawing, shown.poses).largest(_JOINTS)
    size = np.hypot(result.vectors[..., 0], result.vectors[..., 1])
    return {
        "joints": list(result.joints),
        "ends": [list(ends) for ends in result.ends],
        "largest": float(np.max(size[np.isfinite(size)], initial=0.0)),
        "vectors": _short(result.vectors, 3),
    }


def _short(values: Array, digits: int) -> list[float | None]:
    return [float(f"{value:.{digits}g}") if abs(value) < np.inf else None for value in values.reshape(-1).tolist()]


@dataclass(frozen=True)
class JointGaps:
    """Gaps of the joints over F frames.

    `ends` has for each joint the indices in the drawing's table of its points on the first and the second body.
    `vectors` (F, J, 2) leads from the required to the actual position of the second body's point [m], in the global
    frame; its length is the misalignment of the joint.
    """

    joints: tuple[str, ...]
    ends: tuple[tuple[int, int], ...]
    vectors: Array

    def largest(self, count: int) -> JointGaps:
        """Return the `count` largest gaps, in the order of the joints."""
        size = np.nan_to_num(np.hypot(self.vectors[..., 0], self.vectors[..., 1]), nan=np.inf).max(axis=0, initial=0.0)
        kept = sorted(np.argsort(-size, kind="stable")[:count].tolist())
        joints, ends = tuple(self.joints[joint] for joint in kept), tuple(self.ends[joint] for joint in kept)
        return JointGaps(joints, ends, self.vectors[:, kept])


def gaps(run: Run, drawing: Drawing, poses: Array) -> JointGaps:
    """Return the gaps of the joints of a run; none if its mechanism is not known. Drivers, and joints that do not
    connect two points, are left out.

    Parameters
    ----------
    poses
        x [m], y [m] and angle [rad] of each body, shape (F, B, 3).
    """
    mechanism = mechanism_of(run)
    if mechanism is None or tuple(mechanism.bodies) != drawing.bodies:
        return JointGaps((), (), np.zeros((len(poses), 0, 2)))
    index = {"ground": -1} | {name: number for number, name in enumerate(mechanism.bodies)}
    joints = {name: joint for name, joint in mechanism.joints.items() if not joint.is_driver and joint.points}
    owner = np.array([index[body] for joint in joints.values() for body in joint.bodies], dtype=np.intp)
    local = np.array([joint.points for joint in joints.values()], dtype=float).reshape(-1, 2)
    exact = Drawing(drawing.bodies, owner, local, ())  # the points of `drawing` are rounded
    world = exact.world(poses).reshape(len(poses), -1, 2, 2)
    angles = np.where(owner < 0, 0.0, poses[..., 2][:, owner]).reshape(len(poses), -1, 2)
    vectors = [joint.gap(world[:, j, 1] - world[:, j, 0], angles[:, j]) for j, joint in enumerate(joints.values())]
    places = [_find(drawing, *point) for point in zip(owner.tolist(), local, strict=True)]
    stacked = np.stack(vectors, axis=1) if vectors else np.zeros((len(poses), 0, 2))
    return JointGaps(tuple(joints), tuple(zip(places[::2], places[1::2], strict=True)), stacked)


def _find(drawing: Drawing, body: int, local: Array) -> int:
    here = np.flatnonzero(drawing.owner == body)
    nearest = here[np.argmin(np.hypot(*(drawing.local[here] - local).T))]
    assert np.hypot(*(drawing.local[nearest] - local)) < _SAME
    return int(nearest)
