"""A drawing of a mechanism with the names of its bodies, joints, force elements and markers, as SVG for a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from mbdkit.mechanism.beams import parts_of
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.motion_corners import jet_of
from mbdkit.mechanism.state_values import is_of_state
from mbdkit.trust.criteria import ROUND_OFF
from mbdkit_report.figures.beam_curves import bezier_polylines, largest_moment
from mbdkit_report.figures.drawing_geometry import Anchor, Drawing, ElementName, draw_centres, draw_mechanism
from mbdkit_report.figures.label_placement import LINE, SWATCH, Name, PlacedName, place_names
from mbdkit_report.figures.page_model import Illustration
from mbdkit_report.figures.palette import KIND_COLORS, MUSCLE, body_colors, color_key
from mbdkit_report.figures.plane_geometry import Array, spiral, zigzag
from mbdkit_report.figures.svg_canvas import Canvas, shade

TAGS = {"joint": 16, "body": 16}  #: Largest number of names of a kind in a moving picture.
_FEW = 6  # this number for other kinds
_SMALL = 500.0  # width for which names of moving pictures are placed [px]
_NOT_DRAWN = ("driver", "load")
Limits = tuple[float, float]
NAMES = 60  #: Largest number of names in a drawing; more would overlap.
LONGEST = 28  #: Largest number of characters of a name.
#: Classes of `templates/drawing.css` by kind of element; that of others is ``muscle``.
_LOOKS = {"driver": "load"} | {kind: kind for kind in ("body", "joint", "force", "load", "marker")}
_SHORT_ARROW = 20.0  # length of the arrows of the distributed load of a beam [px]


@dataclass(frozen=True)
class NamedPose:
    """A mechanism in a pose at a given time, to be drawn with names.

    Parameters
    ----------
    drawing
        Drawing of the mechanism.
    mechanism
        The mechanism; None if its model is not installed, so that only centres of mass are drawn.
    pose
        (B, 3) x [m], y [m] and angle [rad] of the bodies.
    times
        Recorded times [s]; each load is drawn at the time of its largest value.
    round_off
        Coordinates below this value are rounding errors [m].
    moments
        (E,) bending moments of the elements of all beams [N m], by which beams are coloured. If None, each beam has a
        single colour.
    """

    drawing: Drawing
    mechanism: Mechanism | None
    pose: Array
    times: Array
    round_off: float
    moments: Array | None = None

    @classmethod
    def of(cls, mechanism: Mechanism | None, bodies: Sequence[str], pose: Array, times: Array) -> NamedPose:
        """Return a mechanism with bodies in a pose."""
        known = mechanism is not None and list(mechanism.bodies) == list(bodies)
        drawing = draw_mechanism(mechanism) if mechanism is not None and known else draw_centres(bodies)
        pose = np.nan_to_num(pose, posinf=0.0, neginf=0.0)
        size = float(np.max(np.ptp(drawing.world(pose), axis=0), initial=0.0))
        return cls(drawing, mechanism if known else None, pose, times, ROUND_OFF * size)

    def place(self, body: str, local: tuple[float, float]) -> Array:
        """Return the global coordinates [m] of a point that is given in the frame of a body."""
        if body == GROUND:
            return np.array(local)
        x, y, angle = self.pose[self.drawing.bodies.index(body)]
        c, s = math.cos(angle), math.sin(angle)
        return self.rounded(np.array([x + c * local[0] - s * local[1], y + s * local[0] + c * local[1]]))

    def named(self, kind: str, name: str) -> Array:
        """Return the global point [m] at which the element of a kind with this name is drawn."""
        element = next(one for one in self.drawing.names if (one.kind, one.text) == (kind, name))
        return self.rounded(self.drawing.places(element, self.drawing.world(self.pose))[0])

    def rounded(self, lengths: Sequence[float] | Array) -> Array:
        """Return coordinates or lengths [m], with rounding errors replaced by 0."""
        return np.where(np.abs(lengths) <= self.round_off, 0.0, lengths)


def mechanism_svg(shown: NamedPose, width: float) -> Markup:
    """Return a drawing of a mechanism with names, `width` pixels wide; its colours are those of the page's style."""
    canvas = Canvas.fitted(shown.drawing.world(shown.pose), width)
    _draw(canvas, shown)
    names = [replace(name, text=short_name(name.text)) for name in _names(canvas, shown)[:NAMES]]
    for placed in place_names(names, canvas.ink, canvas.width, canvas.height):
        _write(canvas, placed)
    return canvas.svg()


def illustration(shown: NamedPose, description: str, caption: str) -> Illustration:
    """Return the drawing of a mechanism with names, for wide and for narrow pages."""
    return Illustration.of(partial(mechanism_svg, shown), description, caption)


def names_shown(shown: NamedPose) -> bool:
    """Return whether a drawing shows names: there are at most `NAMES`, and the drawing is no crowd."""
    return len(shown.drawing.names) <= NAMES and not shown.drawing.is_crowd


def own_forces(mechanism: Mechanism) -> dict[str, object]:
    """Return the force elements of a mechanism except those that represent the distributed loads of beams."""
    parts = parts_of(mechanism.beams)
    return {name: force for name, force in mechanism.forces.items() if name not in parts}


def _draw(canvas: Canvas, shown: NamedPose) -> None:
    """Draw everything except the names, from the back to the front."""
    drawing = shown.drawing
    draw_sketch(canvas, drawing, canvas.px(drawing.world(shown.pose)), moments=shown.moments)
    if drawing.is_crowd:
        return
    if shown.mechanism is not None:
        _draw_loads(canvas, shown, shown.mechanism)
    canvas.scale_bar()
    if most := largest_moment(shown.moments):
        _draw_moment_scale(canvas, most)


def draw_sketch(
    canvas: Canvas, drawing: Drawing, at: Array, *, moving_only: bool = False, moments: Array | None = None
) -> None:
    """Draw bodies, beams, joints and springs at the points `at` (P, 2) [px].

    With `moving_only`, ground and guides are left out. `moments` (E,) are the bending moments by which beams are
    coloured.
    """
    crowd = drawing.is_crowd
    if not moving_only:
        for index in drawing.grounds if not crowd else drawing.grounds[:1]:
            canvas.line(at[index] + np.array([[0, 0], [-7, 11], [7, 11]]), "ground", closed=True)
            canvas.line(at[index] + np.array([[-12, 11], [12, 11]]), "ground")
        for ends in drawing.guides:
            canvas.line(at[list(ends)], "guide")
    for outline, color in zip(drawing.outlines, body_colors(drawing), strict=True):
        if not outline:
            continue
        if len(outline) == 1:
            canvas.dot(at[outline[0]], "disc", 3.0 if crowd else 7.0, color_key(color))
        else:
            canvas.line(at[list(outline)], "thin body" if crowd else "body", closed=len(outline) > 2,
                        color=color_key(color))  # fmt: skip
    _draw_beams(canvas, drawing, at, moments)
    for paths, look in ((drawing.bars, "bar"), (drawing.shapes, "bar"), (drawing.muscles, "muscle")):
        for points in paths:
            canvas.line(at[list(points)], look)
    for start, end in drawing.springs:
        canvas.line(zigzag(at[start], at[end], 6.0), "spring")
    if crowd:
        return
    for index in drawing.coils:
        canvas.line(spiral(at[index], 12.0), "spring")
    for index, outline in zip(drawing.centres, drawing.outlines, strict=True):
        if len(outline) > 1:
            canvas.dot(at[index], "centre", 3.0)
    for index in drawing.sliders:
        canvas.box(at[index], "joint", 6.0)
    for index in drawing.pins:
        canvas.dot(at[index], "joint", 4.5)
    for index in drawing.welds:
        canvas.box(at[index], "weld", 4.0)


def _draw_beams(canvas: Canvas, drawing: Drawing, at: Array, moments: Array | None) -> None:
    colors, most, first = body_colors(drawing), largest_moment(moments), 0
    for beam in drawing.beams:
        own = color_key(colors[beam.nodes[0]])
        for element, line in zip(beam.elements_of_intervals, bezier_polylines(at[list(beam.corners)]), strict=True):
            color = own if moments is None or not most else shade(float(moments[first + element]) / most)
            canvas.line(line, "thin beam" if drawing.is_crowd else "beam", color=color)
        first += beam.elements


def _draw_moment_scale(canvas: Canvas, largest: float) -> None:
    y, end = canvas.height - 10.0, canvas.width - 66.0
    for share in np.linspace(-1.0, 1.0, 13):
        x = end - 39.0 + 33.0 * share
        canvas.line(np.array([[x - 2.75, y - 3.0], [x + 2.75, y - 3.0]]), "beam", color=shade(float(share)))
    text = Markup('<text class="faint" x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>')
    canvas.parts.append(text.format(end, y + 1.0, "start", f"{largest:.3g} N m"))
    canvas.parts.append(text.format(end - 78.0, y + 1.0, "end", f"\u2212{largest:.3g}"))
    canvas.drawn.append(np.array([[x, y - 4.0] for x in np.arange(end - 120.0, canvas.width, 6.0)]))


def _draw_loads(canvas: Canvas, shown: NamedPose, mechanism: Mechanism) -> None:
    for name, joint in mechanism.joints.items():
        if joint.is_driver:
            centre = canvas.px(shown.named("driver", name))
            if getattr(joint, "coordinate", "angle") == "angle":
                canvas.turn(centre, 15.0, "load")
            else:
                canvas.arrow(centre, _axis(shown, joint), 34.0, "load")
    force: Any
    distributed = parts_of(mechanism.beams)
    for name, force in mechanism.forces.items():
        load = getattr(force, "load", None)
        if load is not None and load.kind == "torque":
            canvas.turn(canvas.px(shown.place(load.body, (0.0, 0.0))), 17.0, "load")
        elif load is not None:
            size = _SHORT_ARROW if name in distributed else 44.0
            canvas.arrow(canvas.px(shown.place(load.body, load.point)), _load_direction(shown, load), size, "load")
    for marker in mechanism.markers.values():
        point = canvas.px(shown.place(marker.body, marker.held))
        canvas.line(point + np.array([[0, -6], [6, 0], [0, 6], [-6, 0]]), "marker", closed=True)
    gravity = np.asarray(mechanism.gravity, dtype=float) * (1.0, -1.0)
    if np.any(gravity):
        start = np.array([canvas.width - 26.0, 24.0])
        canvas.arrow(start + 17.0 * gravity / np.hypot(*gravity), gravity, 34.0, "faint")
        canvas.parts.append(Markup('<text class="faint" x="{:.0f}" y="28">g</text>').format(canvas.width - 44.0))
        canvas.drawn.append(start + np.array([[-18.0, 0.0], [-14.0, 4.0], [-18.0, 4.0]]))


def _axis(shown: NamedPose, driver: Any) -> Array:
    unit = (1.0, 0.0) if driver.coordinate == "x" else (0.0, 1.0)
    first = driver.bodies[0]
    return np.asarray((shown.place(first, unit) - shown.place(first, (0.0, 0.0))) * (1.0, -1.0))


def _load_direction(shown: NamedPose, load: Any) -> Array:
    """Return the direction of a load on the canvas, at the recorded time at which the load is largest.

    A component that is an expression of the state counts as positive and constant.
    """
    values = [1.0 if is_of_state(value) else value for value in load.values]
    force = np.stack([jet_of(value, shown.times).value for value in values], axis=-1)
    x, y = force[int(np.argmax(np.nan_to_num(np.hypot(*force.T))))]
    if load.kind == "body_force":
        x, y = shown.place(load.body, (x, y)) - shown.place(load.body, (0.0, 0.0))
    return np.array([x, -y]) if np.hypot(x, y) > 0 else np.array([0.0, 1.0])


def _names(canvas: Canvas, shown: NamedPose) -> list[Name]:
    """Return the names; those with the fewest candidates for their place come first."""
    drawing, colors = shown.drawing, _name_colors(shown.drawing)
    if drawing.is_crowd:
        return []
    at, names = canvas.px(drawing.world(shown.pose)), []
    for name in drawing.names:
        points = drawing.places(name, at)
        if name.kind == "load" and shown.mechanism is not None:
            load: Any = shown.mechanism.forces[name.text]
            along = np.zeros(2) if load.load.kind == "torque" else _load_direction(shown, load.load)
            points = points - 44.0 * along / float(np.hypot(*along) or 1.0)
        is_bent = shown.moments is not None and any(beam.name == name.text for beam in drawing.beams)
        color = color_key(colors[name.text]) if name.kind == "body" and not is_bent else ""
        names.append(Name(name.text, name.kind, points, color))
    return names


def _name_colors(drawing: Drawing) -> dict[str, str]:
    """Return the colour of each link."""
    colors = body_colors(drawing)
    return {name: colors[drawing.link_numbers.index(number)] for number, name in enumerate(drawing.links)}


@dataclass(frozen=True)
class Tag:
    """A name in a moving picture: its `anchor`, where its left edge and middle stand relative to it, to the right and
    downwards [px], and its colour, ``#rrggbb``.
    """

    text: str
    anchor: Anchor
    beside: tuple[float, float]
    color: str


def name_tags(drawing: Drawing, world: Array, paths: Array, xlim: Limits, ylim: Limits) -> list[Tag]:
    """Return the names of the joints and bodies of a moving picture, and of other elements if they are few, placed for
    one pose.

    Parameters
    ----------
    world
        The points of the drawing in this pose [m], shape (P, 2).
    paths
        Points of paths [m], shape (..., 2), which names avoid.
    xlim, ylim
        Limits of the picture [m].
    """
    kinds: dict[str, list[ElementName]] = {"joint": [], "body": []}
    for name in drawing.names:
        kinds.setdefault(name.kind, []).append(name)
    shown = [names for kind, names in kinds.items() if len(names) <= TAGS.get(kind, _FEW) and kind not in _NOT_DRAWN]
    chosen = [name for names in shown for name in names]
    if drawing.is_crowd or not np.all(np.isfinite(world)):
        return []
    scale = _SMALL / (xlim[1] - xlim[0])
    canvas = Canvas(_SMALL, scale * (ylim[1] - ylim[0]), scale, np.array([sum(xlim) / 2, sum(ylim) / 2]))
    at = canvas.px(world)
    draw_sketch(canvas, drawing, at)
    trail = canvas.px(paths.reshape(-1, 2))
    names = [Name(short_name(name.text), name.kind, drawing.places(name, at)) for name in chosen]
    ink = np.concatenate([canvas.ink, trail[np.all(np.isfinite(trail), axis=1)]])
    tags, colors = [], _name_colors(drawing)
    for name, placed in zip(chosen, place_names(names, ink, canvas.width, canvas.height), strict=True):
        nearest = int(np.argmin(np.hypot(*(placed.name.points - placed.point).T)))
        beside = (placed.left + 2.0 - placed.point[0], placed.top + LINE / 2 - placed.point[1])
        color = colors[name.text] if name.kind == "body" else KIND_COLORS.get(name.kind, MUSCLE)
        tags.append(Tag(placed.name.text, name.anchors[nearest], beside, color))
    return tags


def short_name(name: str, longest: int = LONGEST) -> str:
    """Return a name, shortened with an ellipsis to `longest` characters if it is longer."""
    return name if len(name) <= longest else f"{name[: longest - 1]}\u2026"


def _write(canvas: Canvas, placed: PlacedName) -> None:
    """Write a name, with a patch in the colour of its body, and a line to its point if the point is far away."""
    name, x = placed.name, placed.left + 2.0
    if placed.leader is not None:
        (x0, y0), (x1, y1) = placed.point, placed.leader
        canvas.parts.append(Markup('<path class="leader" d="M{:.1f} {:.1f}L{:.1f} {:.1f}"/>').format(x0, y0, x1, y1))
    if name.color:
        patch = '<rect class="patch" style="--own:var(--{})" x="{:.1f}" y="{:.1f}" width="10" height="5"/>'
        canvas.parts.append(Markup(patch).format(name.color, x, placed.top + LINE / 2 - 2.0))
        x += SWATCH
    text = '<text class="{}" x="{:.1f}" y="{:.1f}">{}</text>'
    canvas.parts.append(Markup(text).format(_LOOKS.get(name.kind, "muscle"), x, placed.top + LINE - 4.0, name.text))
