"""Muscles in `.osim` files: their paths in the plane, with offsets along z, and the parameters of Hill-type muscles."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from mbdkit_opensim.frames import OsimFrames, turn
from mbdkit_opensim.functions import Function, function_named
from mbdkit_opensim.osim_document import (
    flag_of,
    label_of,
    last_part,
    name_of,
    number_of,
    numbers_of,
    objects_of,
    refused,
    text_of,
)
from mbdkit_opensim.understood import defaults_of

#: Classes of muscles that can be read, and the curves used for them. The curves of Thelen's muscles are replaced by
#: others.
CURVES = {
    "Millard2012EquilibriumMuscle": "millard",
    "DeGrooteFregly2016Muscle": "de-groote-fregly",
    "Thelen2003Muscle": "millard",
}

FLAT = 1e-6  #: Largest sine of the angle between the axis of a cylinder and the z axis.

QUADRANTS = {"x": (1.0, 0.0), "+x": (1.0, 0.0), "-x": (-1.0, 0.0), "y": (0.0, 1.0), "+y": (0.0, 1.0), "-y": (0.0, -1.0)}


@dataclass(frozen=True)
class MuscleReader:
    """Reads the muscles of a model whose bodies and joints have been read.

    Parameters
    ----------
    model, frames
        The model and its frames.
    centres
        Centre of mass (2,) of each body in the frame of the body [m].
    heights
        Offset of each body from the ground along z [m].
    coordinates
        Names of the coordinates of the mechanism.
    values
        Initial values of all coordinates of the file, by name.
    place
        Function that returns the initial position (2,) of a point of a body [m].
    """

    model: Element
    frames: OsimFrames
    centres: Mapping[str, np.ndarray]
    heights: Mapping[str, float]
    coordinates: Collection[str]
    values: Mapping[str, float]
    place: Callable[[str, np.ndarray], np.ndarray]

    def muscle(self, element: Element) -> dict[str, Any]:
        """Return the arguments of `Mechanism.muscle`; raises SpecError with the reason if it cannot be read."""
        path = element.find("GeometryPath")
        path = element.find("path/*") if path is None else path
        if path is None or path.find("PathPointSet") is None:
            raise refused("its path is not a GeometryPath")
        items = [item for point in objects_of(path, "PathPointSet") for item in self._point(point)]
        for wrap in objects_of(path, "PathWrapSet"):
            self._add_circle(items, wrap)

        def number(tag: str) -> float:
            return number_of(element, tag, defaults_of(element.tag).get(tag, "0"))

        return {
            "path": items,
            "max_force": number("max_isometric_force"),
            "optimal_length": number("optimal_fiber_length"),
            "tendon_length": number("tendon_slack_length"),
            "pennation": number("pennation_angle_at_optimal"),
            "max_velocity": number("max_contraction_velocity"),
            "damping": number("fiber_damping"),
            "curves": CURVES[element.tag],
            "activation": {
                "rise": number("activation_time_constant"),
                "fall": number("deactivation_time_constant"),
                "initial": min(1.0, max(0.0, number("default_activation"))),
            },
        }

    def _point(self, element: Element) -> list[dict[str, object]]:
        """Return a point of a path, in a list; an empty list if the point is active only in a range that its coordinate
        never reaches.
        """
        if element.tag == "MovingPathPoint":
            return [self._moving(element)]
        if element.tag not in ("PathPoint", "ConditionalPathPoint"):
            raise refused(f"its path has a {element.tag}")
        body, place, axes = self.frames.of_point(element)
        item = self._item(body, place + axes @ numbers_of(element, "location", 3, "0 0 0"))
        if element.tag == "ConditionalPathPoint":
            coordinate = last_part(text_of(element, "socket_coordinate"))
            low, high = numbers_of(element, "range", 2, "0 0").tolist()
            if coordinate in self.coordinates:
                item["when"] = {coordinate: [low, high]}
            elif not low <= self.values.get(coordinate, math.nan) <= high:
                return []
        return [item]

    def _item(self, body: str, place: np.ndarray) -> dict[str, object]:
        x, y = (place[:2] - self.centres[body]).tolist()
        return {"body": body, "point": [x, y, float(place[2] + self.heights[body])]}

    def _moving(self, element: Element) -> dict[str, object]:
        body, place, axes = self.frames.of_point(element)
        if np.any(place != 0) or not np.allclose(axes, np.eye(3), rtol=0, atol=1e-12):
            raise refused("it has a moving point in a frame that is offset from its body")
        parts: list[Any] = []
        for axis, centre in zip("xyz", (*self.centres[body], -self.heights[body]), strict=True):
            coordinate = last_part(text_of(element, f"socket_{axis}_coordinate"))
            function = function_named(element, f"{axis}_location", f"{axis} of {label_of(element)}")
            if coordinate not in self.coordinates or function.degree == 0:
                parts.append(function(self.values.get(coordinate, 0.0)) - float(centre))
            elif axis == "z":
                raise refused("it has a point that moves perpendicular to the plane")
            else:
                parts.append(_of_coordinate(function, coordinate, float(centre)))
        return {"body": body, "point": parts}

    def _add_circle(self, items: list[dict[str, Any]], wrap: Element) -> None:
        """Add to `items` a circle between two points of a path."""
        name = last_part(text_of(wrap, "wrap_object"))
        results = [
            (body, one)
            for body in (*self.model.iterfind("BodySet/objects/Body"), *self.model.iterfind("Ground"))
            for one in body.iterfind("WrapObjectSet/objects/*")
            if name_of(one) == name
        ]
        if not results:
            raise refused(f"it wraps around '{name}', which does not exist")
        owner, surface = results[0]
        body = "ground" if owner.tag == "Ground" else name_of(owner)
        if surface.tag != "WrapCylinder":
            raise refused(f"it wraps around a {surface.tag}")
        if not flag_of(surface, "active", default=True):
            return
        axes = turn(numbers_of(surface, "xyz_body_rotation", 3, "0 0 0"))
        if math.hypot(axes[0, 2], axes[1, 2]) > FLAT:
            raise refused(f"it wraps around '{name}', whose axis is not along z")
        if len(items) != 2:
            raise refused(f"it wraps around '{name}' between one pair of several points")
        center = numbers_of(surface, "translation", 3, "0 0 0")[:2]
        quadrant = text_of(surface, "quadrant", "all")
        start, end = (self._start(item) for item in items)
        middle = self.place(body, center)
        left = np.array([start[1] - end[1], end[0] - start[0]])
        if quadrant in QUADRANTS:
            toward = self.place(body, center + axes[:2, :2] @ np.array(QUADRANTS[quadrant])) - middle
        else:  # the path passes the circle on the side that makes it shorter at the start
            toward = 0.5 * (start + end) - middle
        side = "left" if float(toward @ left) > 0 else "right"
        radius = number_of(surface, "radius", "1")
        circle = {"body": body, "center": (center - self.centres[body]).tolist(), "radius": radius, "side": side}
        items.insert(1, {"wrap": circle})

    def _start(self, item: Mapping[str, Any]) -> np.ndarray:
        """Return the initial position (2,) of a fixed point [m]."""
        x, y, _ = item["point"]
        if not isinstance(x, float) or not isinstance(y, float):
            raise refused("it wraps around a cylinder beside a moving point")
        return self.place(item["body"], np.array([x, y]) + self.centres[item["body"]])


def _of_coordinate(function: Function, coordinate: str, centre: float) -> object:
    """Return a function of a coordinate minus the number `centre`, as a table or an expression."""
    if function.spline is None:
        if not coordinate.isidentifier():
            raise refused(f"the name of coordinate '{coordinate}' is no word, as an expression needs it")
        first, *others = function.polynomial
        terms = [f"({c!r})*{coordinate}**{power}" for power, c in enumerate(others, start=1)]
        return " + ".join([repr(first - centre), *terms])
    knots = function.spline.x
    # with a point inside each outer interval, the spline through the table satisfies the condition `not-a-knot`
    inner = [(2 * knots[0] + knots[1]) / 3, (knots[-2] + 2 * knots[-1]) / 3]
    at = np.unique(np.concatenate([knots, inner]))
    return {"table": [at.tolist(), [function(x) - centre for x in at.tolist()]], "of": coordinate}
