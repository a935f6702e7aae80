"""A mechanism as something to draw: every body through the points that joints and force elements have on it.

A drawing is a flat table of points, each fixed on one body (or on the ground), and lists of indices into it: outlines,
pins, springs. Turning it with the bodies' poses gives the world coordinates of all points at all times in one go.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbdkit.plot.shapes import Array, convex_hull

if TYPE_CHECKING:
    from mbdkit.mechanism.joints import SlidingJoint
    from mbdkit.mechanism.mechanism import Mechanism

GROUND = -1


@dataclass(frozen=True)
class Trace:
    """A point whose path is worth drawing: `label` and the `point`'s index in the drawing's table."""

    label: str
    point: int


@dataclass(frozen=True)
class Drawing:
    """What to draw of a mechanism with P points.

    Parameters
    ----------
    bodies
        Names of the B bodies, in the order in which poses are given.
    owner
        Body index of each point, -1 for the ground, shape (P,).
    local
        Points in their body's frame [m], shape (P, 2).
    outlines
        For each body the points it is drawn through, in order: one (a disc), two (a rod) or more (a closed outline).
    pins, grounds, centres
        Points drawn as joints, as ground symbols and as centres of mass.
    springs, bars
        Pairs of points joined by a spring, or by a massless bar (a distance joint).
    guides, sliders
        Pairs of points between which a prismatic joint's line is drawn, and the points that slide on them.
    welds
        Points drawn as rigid connections.
    traces
        Points whose paths are drawn: free ends first, then moving joints.
    """

    bodies: tuple[str, ...]
    owner: NDArray[np.intp]
    local: Array
    outlines: tuple[tuple[int, ...], ...]
    pins: tuple[int, ...] = ()
    grounds: tuple[int, ...] = ()
    centres: tuple[int, ...] = ()
    springs: tuple[tuple[int, int], ...] = ()
    bars: tuple[tuple[int, int], ...] = ()
    guides: tuple[tuple[int, int], ...] = ()
    sliders: tuple[int, ...] = ()
    welds: tuple[int, ...] = ()
    traces: tuple[Trace, ...] = ()

    def world(self, poses: Array, points: Sequence[int] | None = None) -> Array:
        """Return the points of the drawing in the global frame.

        Parameters
        ----------
        poses
            x [m], y [m] and angle [rad] of each body, shape (..., B, 3).
        points
            Indices of the K points wanted; all P if left out.

        Returns
        -------
        Array
            Global coordinates [m], shape (..., K, 2).
        """
        chosen = slice(None) if points is None else np.asarray(points, dtype=np.intp)
        owner, local = self.owner[chosen], self.local[chosen]
        fixed = owner == GROUND
        pose = poses[..., np.where(fixed, 0, owner), :]
        with np.errstate(invalid="ignore"):  # of a run that failed
            cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        x = pose[..., 0] + cosine * local[:, 0] - sine * local[:, 1]
        y = pose[..., 1] + sine * local[:, 0] + cosine * local[:, 1]
        return np.stack([np.where(fixed, local[:, 0], x), np.where(fixed, local[:, 1], y)], axis=-1)


def draw_spec(spec: Mapping[str, Any], bodies: Sequence[str]) -> Drawing:
    """Return the drawing of the model of a run spec, or of its bodies' centres where that model is missing.

    Parameters
    ----------
    spec
        The run spec as a plain mapping.
    bodies
        Names of the recorded bodies.
    """
    try:
        mechanism = build_mechanism(spec)
    except Exception:  # a plugin that is missing, older or broken is no reason to show nothing
        return draw_centres(bodies)
    return draw_mechanism(mechanism) if list(mechanism.bodies) == list(bodies) else draw_centres(bodies)


def build_mechanism(spec: Mapping[str, Any]) -> Mechanism:
    """Return the mechanism of a plain run spec, as its model builds it (before assembly).

    Raises
    ------
    SpecError
        The model is not installed.
    pydantic.ValidationError
        The installed model does not know the spec's parameters.
    """
    from mbdkit.registry.items import ModelPlugin
    from mbdkit.registry.manager import registry

    parameters = dict(spec["model"])
    plugin = registry().get("model", parameters.pop("name")).plugin
    assert isinstance(plugin, ModelPlugin)
    return plugin.build(plugin.options.model_validate_json(json.dumps(parameters)))


def draw_centres(bodies: Sequence[str]) -> Drawing:
    """Return a drawing that has the centre of mass of each of the `bodies` and nothing else."""
    indices = tuple(range(len(bodies)))
    return Drawing(
        bodies=tuple(bodies),
        owner=np.arange(len(bodies), dtype=np.intp),
        local=np.zeros((len(bodies), 2)),
        outlines=tuple((index,) for index in indices),
        centres=indices,
        traces=tuple(Trace(name, index) for index, name in enumerate(bodies)),
    )


def draw_mechanism(mechanism: Mechanism) -> Drawing:
    """Return the drawing of `mechanism`."""
    sketch = _Sketch(list(mechanism.bodies))
    for name, joint in mechanism.joints.items():
        sketch.joint(name, joint)
        if joint.mark == "slide":
            sliding: Any = joint
            sketch.guide(sliding, _travel(mechanism, sliding))
    for force in mechanism.forces.values():
        ends = sketch.attach(force)
        pathway = getattr(force, "pathway", None)
        if pathway is not None and pathway.is_line:
            sketch.springs.append((ends[0], ends[1]))
    return sketch.finish()


def _travel(mechanism: Mechanism, joint: SlidingJoint) -> tuple[float, float]:
    """Return the ends of a guide, measured along its axis from its point [m]: past the slider, with room to move."""
    elements = [*mechanism.joints.values(), *mechanism.forces.values()]
    places = [mechanism.to_global(name, point) for one in elements for _, name, point in one.attachments()]
    room = 0.25 * float(np.max(np.ptp(np.array(places), axis=0))) or 1.0
    (a, b), (start, slider) = joint.bodies, joint.points
    x, y = mechanism.to_local(a, mechanism.to_global(b, slider))
    along = (x - start[0]) * joint.direction[0] + (y - start[1]) * joint.direction[1]
    return min(along, 0.0) - room, max(along, 0.0) + room


class _Sketch:
    """A drawing in the making: the table of points grows as elements are attached."""

    def __init__(self, bodies: list[str]):
        self.bodies = bodies
        self.index = {"ground": GROUND} | {name: number for number, name in enumerate(bodies)}
        self.owner: list[int] = []
        self.local: list[tuple[float, float]] = []
        self.known: dict[tuple[int, float, float], int] = {}
        self.held: list[list[int]] = [[] for _ in bodies]  # points of joints on each body
        self.touched: list[list[int]] = [[] for _ in bodies]  # points of anything on each body
        self.pins: list[int] = []
        self.bars: list[tuple[int, int]] = []
        self.springs: list[tuple[int, int]] = []
        self.guides: list[tuple[int, int]] = []
        self.sliders: list[int] = []
        self.welds: list[int] = []
        self.grounds: list[int] = []
        self.moving: list[Trace] = []
        self.traced: set[int] = set()  # bodies that have a traced point

    def point(self, body: int, local: tuple[float, float]) -> int:
        """Return the index of a point of a body, the same one for the same place."""
        key = (body, round(local[0], 12), round(local[1], 12))
        if key not in self.known:
            self.known[key] = len(self.owner)
            self.owner.append(body)
            self.local.append((float(local[0]), float(local[1])))
        return self.known[key]

    def attach(self, element: Any, *, joint: bool = False) -> list[int]:
        """Enter the points of a joint or force element and return their indices."""
        found = []
        for _, name, local in element.attachments():
            body = self.index[name]
            index = self.point(body, local)
            found.append(index)
            if body == GROUND:
                if index not in self.grounds and getattr(element, "mark", "") != "none":
                    self.grounds.append(index)
                continue
            self.touched[body].append(index)
            if joint:
                self.held[body].append(index)
        return found

    def joint(self, name: str, joint: Any) -> None:
        """Enter a joint: a bar for a distance, nothing for a driver, a mark at its point for all others."""
        ends = self.attach(joint, joint=joint.mark != "none")
        if joint.mark == "bar":
            self.bars.append((ends[0], ends[1]))
        elif joint.mark != "none" and ends:
            moving = [index for index in ends if self.owner[index] != GROUND]
            marks = {"pin": self.pins, "slide": self.sliders, "weld": self.welds}[joint.mark]
            place = ends[1] if joint.mark == "slide" else moving[0] if moving else ends[0]
            marks.append(place)
            if len(moving) == 2:
                self.moving.append(Trace(name, place))
                self.traced.update(self.owner[index] for index in moving)

    def guide(self, joint: SlidingJoint, travel: tuple[float, float]) -> None:
        """Enter the line of a prismatic joint, from one end of its travel to the other."""
        (x, y), (dx, dy) = joint.points[0], joint.direction
        low, high = (self.point(self.index[joint.bodies[0]], (x + s * dx, y + s * dy)) for s in travel)
        self.guides.append((low, high))

    def finish(self) -> Drawing:
        """Return the drawing, with the outlines and free ends worked out."""
        free: list[Trace] = []
        outlines, centres = [], []
        for body, name in enumerate(self.bodies):
            centre = self.point(body, (0.0, 0.0))
            centres.append(centre)
            points = list(dict.fromkeys(self.touched[body]))
            end = self._free_end(body)
            if end is not None:
                points.append(self.point(body, end))
                free.append(Trace(f"{name} end", points[-1]))
                self.traced.add(body)
            outlines.append(self._outline([*points, centre]))
            if body not in self.traced:
                free.append(Trace(name, centre))
        return Drawing(
            bodies=tuple(self.bodies),
            owner=np.array(self.owner, dtype=np.intp),
            local=np.array(self.local, dtype=np.float64).reshape(-1, 2),
            outlines=tuple(outlines),
            pins=tuple(self.pins),
            grounds=tuple(self.grounds),
            centres=tuple(centres),
            springs=tuple(self.springs),
            bars=tuple(self.bars),
            guides=tuple(self.guides),
            sliders=tuple(self.sliders),
            welds=tuple(self.welds),
            traces=tuple(free + self.moving),
        )

    def _free_end(self, body: int) -> tuple[float, float] | None:
        """Mirror of a body's joints about its centre of mass, where they all lie to one side of it."""
        held = np.array([self.local[index] for index in dict.fromkeys(self.held[body])]).reshape(-1, 2)
        if not len(held):
            return None
        middle = held.mean(axis=0)
        spread = float(np.max(np.hypot(*(held - middle).T)))
        if float(np.hypot(*middle)) <= spread + 1e-12:
            return None
        return -float(middle[0]), -float(middle[1])

    def _outline(self, indices: Iterable[int]) -> tuple[int, ...]:
        """Return the points of the convex hull of a body's points, in order; its two ends if they are in one line."""
        chosen = list(dict.fromkeys(indices))
        return tuple(chosen[corner] for corner in convex_hull(np.array([self.local[index] for index in chosen])))


def choose_traces(drawing: Drawing) -> tuple[Trace, ...]:
    """Return all traces of a drawing that has few, else four of them, evenly spread."""
    count = len(drawing.traces)
    if count <= 6:
        return drawing.traces
    return tuple(drawing.traces[index] for index in (0, count // 4, count // 2, 3 * count // 4))


def trace_points(drawing: Drawing, traces: Sequence[Trace]) -> tuple[Drawing, list[int]]:
    """Return a drawing of the `traces`' points alone, and the bodies whose poses it needs."""
    owners = [int(drawing.owner[trace.point]) for trace in traces]
    few = sorted(set(owners))
    points = Drawing(
        bodies=tuple(drawing.bodies[body] for body in few),
        owner=np.array([few.index(owner) for owner in owners], dtype=np.intp),
        local=drawing.local[[trace.point for trace in traces]].reshape(-1, 2),
        outlines=(),
    )
    return points, few
