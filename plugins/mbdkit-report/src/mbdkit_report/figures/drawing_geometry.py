"""Drawing of a mechanism: each body is drawn through the attachment points of joints and force elements.

A drawing is a table of points, each fixed on a body or on the ground, and lists of indices into it: outlines, pins,
springs. The poses of the bodies give the global coordinates of all points at all times.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mbdkit.base.errors import MbdkitError
from mbdkit.mechanism.beams import Beam, parts_of
from mbdkit.mechanism.element_kinds import element_kinds
from mbdkit.mechanism.joint_base import FunctionJoint
from mbdkit.mechanism.joints import SlidingJoint
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import lines_of
from mbdkit.mechanism.pathways import JointAngles
from mbdkit_report.figures.beam_curves import BeamCurve
from mbdkit_report.figures.curves import evenly, take
from mbdkit_report.figures.element_places import Place, cable_places, contact_places
from mbdkit_report.figures.plane_geometry import Array, convex_hull

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit_contact.contact import Shape

GROUND = -1
_SHARES = (0.1, 0.3, 0.5, 0.7, 0.9)  # places of names along lines


@dataclass(frozen=True)
class Trace:
    """A point whose path can be drawn: its label, its index in the table of the drawing, and whether it is a marker."""

    label: str
    point: int
    is_marker: bool = False


#: A point of a picture: two points of a drawing, and the share of the way from the first to the second.
Anchor = tuple[int, int, float]


@dataclass(frozen=True)
class ElementName:
    """The name of an element, which may stand beside any of the `anchors`. `kind` is ``body``, ``joint``, ``driver``,
    ``force``, ``load``, ``marker``, or the name of an `ElementKind`, such as ``muscle``.
    """

    text: str
    kind: str
    anchors: tuple[Anchor, ...]


@dataclass(frozen=True)
class Drawing:
    """Drawing of a mechanism with P points.

    Parameters
    ----------
    bodies
        Names of the B bodies, in the order of the poses.
    owner
        Body index of each point, -1 for the ground, shape (P,).
    local
        Points in their body's frame [m], shape (P, 2).
    outlines
        Points of the outline of each body in order: one (a disc), two (a rod) or more (a closed outline). Most nodes of
        beams have none.
    pins
        Points drawn as pins.
    grounds
        Points drawn as ground symbols.
    centres
        Centre of mass of each body.
    springs
        Pairs of points joined by a spring.
    bars
        Pairs of points joined by a massless bar (a distance joint).
    muscles
        Points along the lines of elements of further kinds, such as muscles.
    shapes
        Points along the outline of each shape of a contact, and along each line of a joint, such as a pitch circle.
    lines
        Pairs of points on lines of unlimited extent, which are the ends of their parts in `shapes`.
    guides
        Pairs of points: the ends of the line along which each sliding joint moves.
    sliders
        Points that slide along guides.
    welds
        Points drawn as rigid connections.
    beams
        Beams, each drawn as one curve instead of its nodes.
    traces
        Points whose paths can be drawn: markers first, then free ends and moving joints.
    coils
        Points at which springs between the angles of two bodies are drawn.
    names
        The names of all elements.
    """

    #: Number of links above which joints, centres of mass, loads and names are not drawn.
    CROWD: ClassVar[int] = 40

    bodies: tuple[str, ...]
    owner: NDArray[np.intp]
    local: Array
    outlines: tuple[tuple[int, ...], ...]
    pins: tuple[int, ...] = ()
    grounds: tuple[int, ...] = ()
    centres: tuple[int, ...] = ()
    springs: tuple[tuple[int, int], ...] = ()
    bars: tuple[tuple[int, int], ...] = ()
    muscles: tuple[tuple[int, ...], ...] = ()
    shapes: tuple[tuple[int, ...], ...] = ()
    lines: tuple[tuple[int, ...], ...] = ()
    guides: tuple[tuple[int, int], ...] = ()
    sliders: tuple[int, ...] = ()
    welds: tuple[int, ...] = ()
    beams: tuple[BeamCurve, ...] = ()
    traces: tuple[Trace, ...] = ()
    coils: tuple[int, ...] = ()
    names: tuple[ElementName, ...] = ()

    @cached_property
    def links(self) -> tuple[str, ...]:
        """Names of the links in the drawing: bodies that are not nodes of beams, followed by beams."""
        nodes = {node for beam in self.beams for node in beam.nodes}
        return (
            *(name for body, name in enumerate(self.bodies) if body not in nodes),
            *(beam.name for beam in self.beams),
        )

    @property
    def is_crowd(self) -> bool:
        """Whether there are so many links that joints, centres of mass, loads and names are not drawn."""
        return len(self.links) > self.CROWD

    @cached_property
    def link_numbers(self) -> tuple[int, ...]:
        """Index in `links` of the link of each body, shape (B,); a node of a beam belongs to the link of the beam."""
        beams = {node: number for number, beam in enumerate(self.beams) for node in beam.nodes}
        rigid = itertools.count()
        first = len(self.links) - len(self.beams)
        return tuple(first + beams[body] if body in beams else next(rigid) for body in range(len(self.bodies)))

    @property
    def key(self) -> list[tuple[str, str]]:
        """What is drawn besides bodies, joints and markers, for legends: kind, and names or, of more than three
        elements, their number.
        """
        found: dict[str, list[str]] = {}
        for name in self.names:
            if name.kind not in ("body", "joint", "driver", "load", "marker"):
                found.setdefault(name.kind, []).append(name.text)
        words = {"force": "force element"}
        return [
            (kind, ", ".join(texts) if len(texts) < 4 else f"{len(texts)} {words.get(kind, kind)}s")
            for kind, texts in found.items()
        ]

    def places(self, name: ElementName, world: Array) -> Array:
        """Return the K points (K, 2) beside which a name may stand, given the points (P, 2) of the drawing."""
        first, second, share = (np.array(column) for column in zip(*name.anchors, strict=True))
        return np.asarray(world[first] + share[:, None] * (world[second] - world[first]))

    @property
    def main_traces(self) -> tuple[Trace, ...]:
        """The traces that are drawn unless points are selected: the markers or, if there are none, all traces."""
        return tuple(trace for trace in self.traces if trace.is_marker) or self.traces

    def spanning(self, xlim: tuple[float, float], ylim: tuple[float, float], poses: Array) -> Drawing:
        """Return the drawing with lines of unlimited extent that cross the whole picture.

        Parameters
        ----------
        xlim, ylim
            Limits of the picture [m].
        poses
            The poses that are shown, shape (..., B, 3); see `world`.
        """
        local, diagonal = self.local.copy(), float(np.hypot(xlim[1] - xlim[0], ylim[1] - ylim[0]))
        for ends in self.lines:
            middle = self.world(poses, ends).mean(axis=-2)
            away = np.hypot(middle[..., 0] - np.mean(xlim), middle[..., 1] - np.mean(ylim))
            reach = diagonal + float(np.max(away, initial=0.0, where=np.isfinite(away)))
            first, last = self.local[list(ends)]
            along = (last - first) / np.hypot(*(last - first))
            local[list(ends)] = 0.5 * (first + last) + reach * np.array([-along, along])
        return replace(self, local=local)

    def world(self, poses: Array, points: Sequence[int] | None = None) -> Array:
        """Return the points of the drawing in the global frame.

        Parameters
        ----------
        poses
            x [m], y [m] and angle [rad] of each body, shape (..., B, 3).
        points
            Indices of K points; by default all P.

        Returns
        -------
        Array
            Global coordinates [m], shape (..., K, 2).
        """
        chosen = slice(None) if points is None else np.asarray(points, dtype=np.intp)
        owner, local = self.owner[chosen], self.local[chosen]
        fixed = owner == GROUND
        pose = poses[..., np.where(fixed, 0, owner), :]
        with np.errstate(invalid="ignore"):  # the states of a failed run may contain infinities
            cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        x = pose[..., 0] + cosine * local[:, 0] - sine * local[:, 1]
        y = pose[..., 1] + sine * local[:, 0] + cosine * local[:, 1]
        return np.stack([np.where(fixed, local[:, 0], x), np.where(fixed, local[:, 1], y)], axis=-1)


def draw_run(run: Run) -> Drawing:
    """Return the drawing of the mechanism of a run, or of the centres of mass if the mechanism is not known."""
    mechanism, bodies = mechanism_of(run), list(run.bodies)
    return draw_mechanism(mechanism) if mechanism and list(mechanism.bodies) == bodies else draw_centres(bodies)


def mechanism_of(run: Run) -> Mechanism | None:
    """Return the mechanism of a run; None if it is not known, and `Run.not_drawn` says why."""
    try:
        return run.mechanism
    except MbdkitError:
        return None


def draw_centres(bodies: Sequence[str]) -> Drawing:
    """Return a drawing of the centres of mass of the `bodies` only."""
    indices = tuple(range(len(bodies)))
    return Drawing(
        bodies=tuple(bodies),
        owner=np.arange(len(bodies), dtype=np.intp),
        local=np.zeros((len(bodies), 2)),
        outlines=tuple((index,) for index in indices),
        centres=indices,
        traces=tuple(Trace(name, index) for index, name in enumerate(bodies)),
        names=tuple(ElementName(name, "body", ((index, index, 0.0),)) for index, name in enumerate(bodies)),
    )


def draw_mechanism(mechanism: Mechanism) -> Drawing:
    """Return the drawing of `mechanism`."""
    sketch = _Sketch(list(mechanism.bodies))
    for name, beam in mechanism.beams.items():
        sketch.beam(name, beam)
    for name, joint in mechanism.joints.items():
        sketch.joint(name, joint)
        if joint.mark == "slide":
            sliding: Any = joint
            sketch.guide(sliding, _travel(mechanism, sliding))
        if isinstance(joint, FunctionJoint):
            for line in joint.lines(mechanism.relative_pose(joint)):
                sketch.parts["shapes"].append(sketch.points([(joint.bodies[side], place) for side, place in line]))
    for name, joint in mechanism.joints.items():
        held = sketch.places(joint)
        first = held[0] if joint.mark == "bar" else held[-1] if held else 0
        anchor = (first, held[-1], 0.5) if held else sketch.between(mechanism, joint.bodies)
        sketch.name(name, "driver" if joint.is_driver else "joint", [anchor])
    for name, marker in mechanism.markers.items():
        place = sketch.marker(name, marker.body, marker.held)
        sketch.name(name, "marker", [(place, place, 0.0)] if name not in mechanism.joints else [])
    loads = parts_of(mechanism.beams)
    for name, force in mechanism.forces.items():
        ends = sketch.attach(force)
        pathway, load = getattr(force, "pathway", None), getattr(force, "load", None)
        points = ends if load is None else sketch.points([(load.body, load.point)])
        anchors: list[Anchor] = [(point, point, 0.0) for point in points[:1]]
        if pathway is not None and pathway.is_line:
            sketch.parts["springs"].append((ends[0], ends[1]))
            anchors = [(ends[0], ends[1], share) for share in _SHARES[1:-1]]
        elif isinstance(pathway, JointAngles):
            cable = sketch.points(cable_places(mechanism.joints, pathway))
            sketch.parts["springs"] += itertools.pairwise(cable)
            anchors = _middles(cable)
        elif pathway is not None and not ends:
            anchors = [sketch.between(mechanism, pathway.bodies)]
            if pathway.length_unit == "rad":
                sketch.parts["coils"].append(anchors[0][0])
        if name not in loads:
            sketch.name(name, "force" if load is None else "load", anchors)
    for key, own in element_kinds().items():
        for name, element in mechanism.elements.get(key, {}).items():
            lines = [sketch.points(line) for line in lines_of(own, mechanism, element)]
            sketch.parts["muscles"] += lines
            sketch.name(name, own.name, [anchor for line in lines for anchor in _middles(line)])
    contacts: Mapping[str, Any] = mechanism.elements.get("contacts", {})
    for contact in contacts.values():
        for _, _, body, shape in contact.by_body:
            sketch.shape(body, shape, contact_places(mechanism, body, shape))
    return sketch.finish()


def _along(corners: Sequence[int]) -> list[Anchor]:
    """Return points on the sides of an outline."""
    if len(corners) == 1:
        return [(corners[0], corners[0], 0.0)]
    sides = list(itertools.pairwise([*corners, corners[0]]))[: None if len(corners) > 2 else 1]
    return [(*ends, share) for ends in sides for share in _SHARES]


def _middles(points: Sequence[int]) -> list[Anchor]:
    return [(*ends, 0.5) for ends in itertools.pairwise(points)]


def _travel(mechanism: Mechanism, joint: SlidingJoint) -> tuple[float, float]:
    """Return the ends of a guide as distances along its axis from the point of the joint on the first body [m].

    The guide extends beyond this point and beyond the slider by a quarter of the mechanism's size.
    """
    elements = [*mechanism.joints.values(), *mechanism.forces.values()]
    places = [mechanism.to_global(name, point) for element in elements for _, name, point in element.attachments()]
    room = 0.25 * float(np.max(np.ptp(np.array(places), axis=0))) or 1.0
    (a, b), (start, slider) = joint.bodies, joint.ends
    x, y = mechanism.to_local(a, mechanism.to_global(b, slider))
    along = (x - start[0]) * joint.direction[0] + (y - start[1]) * joint.direction[1]
    return min(along, 0.0) - room, max(along, 0.0) + room


class _Sketch:
    def __init__(self, bodies: list[str]):
        self.bodies = bodies
        self.index = {"ground": GROUND} | {name: number for number, name in enumerate(bodies)}
        self.owner: list[int] = []
        self.local: list[tuple[float, float]] = []
        self.known: dict[tuple[int, float, float], int] = {}
        self.held: list[list[int]] = [[] for _ in bodies]  # points of joints on each body
        self.touched: list[list[int]] = [[] for _ in bodies]  # points of anything on each body
        self.parts: defaultdict[str, list[Any]] = defaultdict(list)  # fields of the drawing
        self.marked: list[Trace] = []
        self.moving: list[Trace] = []
        # Bodies with the trace of a joint or of a free end. Of other bodies, except nodes, the centre is traced.
        self.traced: set[int] = set()

    def point(self, body: int, local: tuple[float, float]) -> int:
        """Return the index of a point given in the frame of a body. The point is added if it is new."""
        key = (body, round(local[0], 12), round(local[1], 12))
        if key not in self.known:
            self.known[key] = len(self.owner)
            self.owner.append(body)
            self.local.append((float(local[0]), float(local[1])))
        return self.known[key]

    def attach(self, element: Any, *, joint: bool = False) -> list[int]:
        """Add the points of a joint or force element and return their indices."""
        results = []
        for _, name, local in element.attachments():
            body = self.index[name]
            index = self.point(body, local)
            results.append(index)
            if body == GROUND:
                if index not in self.parts["grounds"] and getattr(element, "mark", "") != "none":
                    self.parts["grounds"].append(index)
                continue
            self.touched[body].append(index)
            if joint:
                self.held[body].append(index)
        return results

    def beam(self, name: str, beam: Beam) -> None:
        """Add the curve of a beam."""
        nodes = [self.index[node] for node in beam.node_names(name)]
        third = beam.length / (len(nodes) - 1) / 3.0
        corners = [self.point(node, (place, 0.0)) for node in nodes for place in (-third, 0.0, third)]
        self.parts["beams"].append(BeamCurve(name, tuple(nodes), tuple(corners[1:-1]), beam.elements))

    def points(self, places: Sequence[Place]) -> tuple[int, ...]:
        """Return the indices of several points, given by body and place in its frame."""
        return tuple(self.point(self.index[body], local) for body, local in places)

    def shape(self, body: str, shape: Shape, places: Sequence[Place]) -> None:
        """Add the outline of the shape of a contact, only once if several contacts share it. The outline of the body is
        extended so that it contains the points of the shape, unless the shape is a line.
        """
        owner = self.index[body]
        drawn = self.points(places)
        for name in ("shapes", "lines") if shape.line is not None else ("shapes",):
            if places and drawn not in self.parts[name]:
                self.parts[name].append(drawn)
        if owner != GROUND and shape.line is None:
            self.touched[owner] += [self.point(owner, local) for _, local in shape.points()]

    def joint(self, name: str, joint: Any) -> None:
        """Add a joint. A distance joint is drawn as a bar and a driver is not drawn; others are drawn as a symbol at
        their point.
        """
        ends = self.attach(joint, joint=joint.mark != "none")
        if joint.mark == "bar":
            self.parts["bars"].append((ends[0], ends[1]))
        elif joint.mark != "none" and ends:
            moving = [index for index in ends if self.owner[index] != GROUND]
            place = ends[1] if joint.point_moves_on_first else moving[0] if moving else ends[0]
            self.parts[{"pin": "pins", "slide": "sliders", "weld": "welds"}[joint.mark]].append(place)
            if len(moving) == 2:
                self.moving.append(Trace(name, place))
                self.traced.update(self.owner[index] for index in moving)

    def marker(self, name: str, body: str, local: tuple[float, float]) -> int:
        """Add a marker, a point of a body whose path can be drawn, and return the index of its point. A marker on the
        ground has no path.
        """
        owner = self.index[body]
        index = self.point(owner, local)
        if owner != GROUND:
            self.touched[owner].append(index)
            self.marked.append(Trace(name, index, is_marker=True))
        return index

    def name(self, text: str, kind: str, anchors: Iterable[Anchor]) -> None:
        """Add the name of an element that is drawn."""
        if kept := tuple(anchors):
            self.parts["names"].append(ElementName(text, kind, kept))

    def places(self, element: Any) -> list[int]:
        """Return the indices of the points of an element."""
        return [self.point(self.index[body], local) for _, body, local in element.attachments()]

    def between(self, mechanism: Mechanism, bodies: tuple[str, str]) -> Anchor:
        """Return where an angle between two bodies is drawn: at a joint between them; without one, between the two
        closest joints, one on each body; without joints at all, at the centre of mass of the second body.
        """
        joints = mechanism.joints.values()
        for joint in joints:
            if set(joint.bodies) == set(bodies) and joint.mark in ("pin", "slide", "weld"):
                place = self.places(joint)[-1]
                return (place, place, 0.0)
        ends = [held[1:] for joint in joints for held in joint.attachments()]
        pairs = [
            (math.dist(mechanism.to_global(*a), mechanism.to_global(*b)), a, b)
            for a in ends if a[0] == bodies[0] for b in ends if b[0] == bodies[1]
        ]  # fmt: skip
        moving = next((name for name in bodies[::-1] if name != "ground"), "ground")
        _, a, b = min(pairs, default=(0.0, (moving, (0.0, 0.0)), (moving, (0.0, 0.0))))
        first, second = self.points([a, b])
        return (first, second, 0.5)

    def guide(self, joint: SlidingJoint, travel: tuple[float, float]) -> None:
        """Add the line of a sliding joint between two distances along its axis [m]."""
        (x, y), (dx, dy) = joint.ends[0], joint.direction
        low, high = (self.point(self.index[joint.bodies[0]], (x + s * dx, y + s * dy)) for s in travel)
        self.parts["guides"].append((low, high))

    def finish(self) -> Drawing:
        """Return the drawing with outlines and free ends."""
        free = self._free_nodes()
        nodes = {node for beam in self.parts["beams"] for node in beam.nodes}
        outlines: list[tuple[int, ...]] = []
        centres = []
        for body, name in enumerate(self.bodies):
            centre = self.point(body, (0.0, 0.0))
            centres.append(centre)
            if body in nodes:
                outline = self._outline([*self.touched[body], centre])
                outlines.append(outline if len(outline) > 1 else ())
                continue
            points = list(dict.fromkeys(self.touched[body]))
            if (end := self._free_end(body)) is not None:
                points.append(self.point(body, end))
                free.append(Trace(f"{name} end", points[-1]))
                self.traced.add(body)
            outlines.append(self._outline([*points, centre]))
            self.name(name, "body", _along(outlines[-1]))
            if body not in self.traced:
                free.append(Trace(name, centre))
        for beam in self.parts["beams"]:
            self.name(beam.name, "body", [(point, point, 0.0) for point in beam.points])
        own = ("body", "joint", "driver", "force", "load", "marker")
        self.parts["names"].sort(key=lambda name: name.kind not in own)  # muscles are many
        return Drawing(
            bodies=tuple(self.bodies),
            owner=np.array(self.owner, dtype=np.intp),
            local=np.array(self.local, dtype=np.float64).reshape(-1, 2),
            outlines=tuple(outlines),
            centres=tuple(centres),
            **{name: tuple(part) for name, part in self.parts.items()},
            traces=tuple(self.marked + free + self.moving),
        )

    def _free_nodes(self) -> list[Trace]:
        traces = []
        for beam in self.parts["beams"]:
            ends = [node for node in (beam.nodes[0], beam.nodes[-1]) if not self.held[node]]
            shown = ends or [beam.nodes[len(beam.nodes) // 2]]
            traces += [Trace(self.bodies[node], self.point(node, (0.0, 0.0))) for node in shown]
        return traces

    def _free_end(self, body: int) -> tuple[float, float] | None:
        """Return the free end of a body, in the frame of the body [m]; None if there is none.

        A body whose joints are all on one side of its centre of mass has a free end: the mean of the points of the
        joints, reflected at the centre of mass. A marker beyond half of the distance to this point, such as the head of
        a trunk, replaces the free end.
        """
        held = np.array([self.local[index] for index in dict.fromkeys(self.held[body])]).reshape(-1, 2)
        if not len(held):
            return None
        middle = held.mean(axis=0)
        spread = float(np.max(np.hypot(*(held - middle).T)))
        if float(np.hypot(*middle)) <= spread + 1e-12:
            return None
        own = [self.local[trace.point] for trace in self.marked if self.owner[trace.point] == body]
        if any(-float(np.dot(point, middle)) > 0.5 * float(np.dot(middle, middle)) for point in own):
            return None
        return -float(middle[0]), -float(middle[1])

    def _outline(self, indices: Iterable[int]) -> tuple[int, ...]:
        """Return the corners of the convex hull of points in order; only two if the points are collinear."""
        chosen = list(dict.fromkeys(indices))
        return tuple(chosen[corner] for corner in convex_hull(np.array([self.local[index] for index in chosen])))


def choose_traces(drawing: Drawing) -> tuple[Trace, ...]:
    """Return up to six of the main traces: all of them, or four evenly spread if there are more."""
    traces = drawing.main_traces
    count = len(traces)
    return traces if count <= 6 else tuple(traces[index] for index in (0, count // 4, count // 2, 3 * count // 4))


def trace_points(drawing: Drawing, traces: Sequence[Trace]) -> tuple[Drawing, list[int]]:
    """Return a drawing of the points of `traces` only, and the indices of the bodies whose poses it needs."""
    owners = [int(drawing.owner[trace.point]) for trace in traces]
    few = sorted(set(owners))
    points = Drawing(
        bodies=tuple(drawing.bodies[body] for body in few),
        owner=np.array([few.index(owner) for owner in owners], dtype=np.intp),
        local=drawing.local[[trace.point for trace in traces]].reshape(-1, 2),
        outlines=(),
    )
    return points, few


def traced_paths(run: Run, rows: int) -> tuple[Drawing, tuple[Trace, ...], Array]:
    """Return the drawing of a run, the traced points, and their paths [m], shape (R, K, 2), with at most `rows` rows
    that are evenly spaced.
    """
    drawing = draw_run(run)
    traces = choose_traces(drawing)
    fixed, owners = trace_points(drawing, traces)
    return drawing, traces, fixed.world(take(run.dataset("trajectory/position"), evenly(len(run.time), rows), owners))
