"""A drawing of a mechanism with the names of its bodies, joints, force elements and markers, as SVG for a page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from markupsafe import Markup

from mbdkit.mechanism.beams import parts_of
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.motion_corners import jet_of
from mbdkit.mechanism.pathways import JointAngles
from mbdkit.mechanism.state_values import is_of_state
from mbdkit.trust.criteria import ROUND_OFF
from mbdkit_report.figures.beam_curves import bezier_polylines, largest_moment
from mbdkit_report.figures.drawing_geometry import Drawing, draw_centres, draw_mechanism
from mbdkit_report.figures.element_places import cable_places
from mbdkit_report.figures.label_placement import LINE, SWATCH, Name, PlacedName, place_names
from mbdkit_report.figures.page_model import Illustration
from mbdkit_report.figures.palette import body_colors, color_key
from mbdkit_report.figures.plane_geometry import Array, zigzag
from mbdkit_report.figures.svg_canvas import Canvas, shade

NAMES = 60  #: Largest number of names in a drawing; more would overlap.
LONGEST = 28  #: Largest number of characters of a name.
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
        points = drawing.world(pose)
        size = float(np.max(np.ptp(points, axis=0), initial=0.0))
        return cls(drawing, mechanism if known else None, pose, times, ROUND_OFF * size)

    def place(self, body: str, local: tuple[float, float]) -> Array:
        """Return the global coordinates [m] of a point that is given in the frame of a body."""
        if body == GROUND:
            return np.array(local)
        x, y, angle = self.pose[self.drawing.bodies.index(body)]
        c, s = math.cos(angle), math.sin(angle)
        return self.rounded(np.array([x + c * local[0] - s * local[1], y + s * local[0] + c * local[1]]))

    def joint_point(self, joint: Joint) -> Array:
        """Return the global point [m] at which a joint is drawn."""
        held = joint.attachments()
        if not held:
            return self.common_point(joint.bodies)
        if joint.mark == "bar":
            return np.asarray(np.mean([self.place(name, point) for _, name, point in held], axis=0))
        return self.place(*held[-1][1:])

    def common_point(self, bodies: tuple[str, str]) -> Array:
        """Return the global point [m] at which an angle between two bodies is drawn.

        The point is at a joint between the bodies. If there is no such joint, it is between the two closest joints, one
        on each body. If there are no joints at all, it is the centre of mass of the second body.
        """
        joints = () if self.mechanism is None else self.mechanism.joints.values()
        for joint in joints:
            if set(joint.bodies) == set(bodies) and joint.mark in ("pin", "slide", "weld"):
                return self.joint_point(joint)
        ends = [(name, self.place(name, point)) for joint in joints for _, name, point in joint.attachments()]
        of_first, of_second = ([point for name, point in ends if name == body] for body in bodies)
        pairs = [(float(np.hypot(*(a - b))), tuple((a + b) / 2)) for a in of_first for b in of_second]
        if pairs:
            return np.array(min(pairs)[1])
        moving = [name for name in bodies[::-1] if name != GROUND]
        return self.place(moving[0], (0.0, 0.0)) if moving else np.zeros(2)

    def rounded(self, lengths: Sequence[float] | Array) -> Array:
        """Return coordinates or lengths [m], with rounding errors replaced by 0."""
        return np.where(np.abs(lengths) <= self.round_off, 0.0, lengths)


def mechanism_svg(shown: NamedPose, width: float) -> Markup:
    """Return a drawing of a mechanism with names, `width` pixels wide; its colours are those of the page's style."""
    canvas = Canvas.fitted(shown.drawing.world(shown.pose), width)
    _draw(canvas, shown)
    names = [replace(name, text=short_name(name.text)) for name in islice(_names(canvas, shown), NAMES)]
    for placed in place_names(names, canvas.ink, canvas.width, canvas.height):
        _write(canvas, placed)
    return canvas.svg()


def illustration(shown: NamedPose, description: str, caption: str) -> Illustration:
    """Return the drawing of a mechanism with names, for wide and for narrow pages."""
    return Illustration.of(partial(mechanism_svg, shown), description, caption)


def names_shown(shown: NamedPose) -> bool:
    """Return whether a drawing shows names: there are at most `NAMES`, and the drawing is no crowd."""
    elements = shown.mechanism
    count = len(shown.drawing.links)
    if elements is not None:
        count += len(elements.joints) + len(own_forces(elements)) + len(elements.markers)
    return count <= NAMES and not shown.drawing.is_crowd


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
            _ground(canvas, at[index])
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


def _ground(canvas: Canvas, point: Array) -> None:
    canvas.line(point + np.array([[0, 0], [-7, 11], [7, 11]]), "ground", closed=True)
    canvas.line(point + np.array([[-12, 11], [12, 11]]), "ground")


def _draw_loads(canvas: Canvas, shown: NamedPose, mechanism: Mechanism) -> None:
    for joint in mechanism.joints.values():
        if joint.is_driver:
            centre = canvas.px(shown.joint_point(joint))
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
        elif force.pathway.length_unit == "rad":
            canvas.line(_spiral(canvas.px(shown.common_point(force.pathway.bodies))), "spring")
    for marker in mechanism.markers.values():
        point = canvas.px(shown.place(marker.body, marker.held))
        canvas.line(point + np.array([[0, -6], [6, 0], [0, 6], [-6, 0]]), "marker", closed=True)
    gravity = np.asarray(mechanism.gravity, dtype=float) * (1.0, -1.0)
    if np.any(gravity):
        start = np.array([canvas.width - 26.0, 24.0])
        canvas.arrow(start + 17.0 * gravity / np.hypot(*gravity), gravity, 34.0, "faint")
        canvas.parts.append(Markup('<text class="faint" x="{:.0f}" y="28">g</text>').format(canvas.width - 44.0))
        canvas.drawn.append(start + np.array([[-18.0, 0.0], [-14.0, 4.0], [-18.0, 4.0]]))


def _spiral(centre: Array) -> Array:
    angle = np.linspace(0.0, 4.5 * np.pi, 40)
    radius = 2.0 + 0.75 * angle
    return np.asarray(centre + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


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


def _names(canvas: Canvas, shown: NamedPose) -> Iterator[Name]:
    """Yield the names; those with the fewest candidates for their place come first."""
    mechanism, drawing = shown.mechanism, shown.drawing
    if drawing.is_crowd:
        return
    if mechanism is not None:
        for name, joint in mechanism.joints.items():
            kind = "load" if joint.is_driver else "joint"
            yield Name(name, kind, canvas.px(shown.joint_point(joint))[None])
        for name, marker in mechanism.markers.items():
            yield Name(name, "marker", canvas.px(shown.place(marker.body, marker.held))[None])
        for name, force in own_forces(mechanism).items():
            kind = "force" if getattr(force, "load", None) is None else "load"
            yield Name(name, kind, _force_points(canvas, shown, mechanism, force))
    at = canvas.px(drawing.world(shown.pose))
    colors = body_colors(drawing)
    nodes = {node for beam in drawing.beams for node in beam.nodes}
    for body, name in enumerate(drawing.bodies):
        if body not in nodes:
            yield Name(name, "body", _along(at[list(drawing.outlines[body])]), color_key(colors[body]))
    for beam in drawing.beams:
        text = "" if shown.moments is not None else color_key(colors[beam.nodes[0]])
        yield Name(beam.name, "body", at[list(beam.points)], text)


def short_name(name: str, longest: int = LONGEST) -> str:
    """Return a name, shortened with an ellipsis to `longest` characters if it is longer."""
    return name if len(name) <= longest else f"{name[: longest - 1]}\u2026"


def _force_points(canvas: Canvas, shown: NamedPose, mechanism: Mechanism, force: Any) -> Array:
    load = getattr(force, "load", None)
    if load is not None:
        point = canvas.px(shown.place(load.body, load.point))
        away = _load_direction(shown, load) if load.kind != "torque" else np.zeros(2)
        return np.asarray(point - 44.0 * away / float(np.hypot(*away) or 1.0))[None]
    if isinstance(force.pathway, JointAngles):
        places = cable_places(mechanism.joints, force.pathway)
        passed = canvas.px([shown.place(name, point) for name, point in places])
        return np.asarray((passed[1:] + passed[:-1]) / 2)
    ends = [shown.place(name, point) for _, name, point in force.attachments()]
    if len(ends) < 2:
        return canvas.px(ends or [shown.common_point(force.pathway.bodies)])
    return _along(canvas.px(ends))[1:-1]


def _along(corners: Array) -> Array:
    """Return points on the sides of an outline (K, 2), where a name may stand."""
    if len(corners) == 1:
        return corners
    sides = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))[: None if len(corners) > 2 else 1]
    shares = (0.1, 0.3, 0.5, 0.7, 0.9)
    return np.array([start + share * (end - start) for start, end in sides for share in shares])


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
    canvas.parts.append(Markup(text).format(name.kind, x, placed.top + LINE - 4.0, name.text))
