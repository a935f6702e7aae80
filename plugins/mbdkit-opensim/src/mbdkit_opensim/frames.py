"""Frames of an `.osim` file in the sagittal plane: x forward, y up, z to the right, as OpenSim orients its models.

A frame lies in the plane if its z axis has the direction of the z axis of its body, or the opposite direction. Offsets
along z are ignored, because they do not influence motions in the plane.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from posixpath import join, normpath
from xml.etree.ElementTree import Element

import numpy as np

from mbdkit.plugin import listed
from mbdkit_opensim.osim_document import label_of, last_part, name_of, numbers_of, objects_of, refused, text_of

FLAT = 1e-9  #: Axes count as parallel if the sine of the angle between them is below this.

GROUND = "/ground"

DEEPEST = 50  #: Largest length of a chain of frames, each of which is an offset of the next.


def turn(angles: np.ndarray) -> np.ndarray:
    """Return the rotation of body-fixed angles about x, y and z [rad], (3, 3)."""
    result = np.eye(3)
    for axis, angle in enumerate(angles.tolist()):
        result = result @ about(np.eye(3)[axis], angle)
    return result


def about(axis: np.ndarray, angle: float) -> np.ndarray:
    """Return the rotation about a unit vector by an angle [rad], (3, 3)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross))


@dataclass(frozen=True)
class OffsetFrame:
    """A frame in the plane of a body: its position in the frame of the body, (2,) [m], and its axes as columns, (2, 2).

    `height` is the offset of the frame along the z axis of the body [m]. The determinant of `axes` is -1 if the two z
    axes are opposite.
    """

    body: str
    place: np.ndarray
    axes: np.ndarray
    height: float = 0.0

    @property
    def side(self) -> float:
        """1, or -1 if the z axes of frame and body are opposite."""
        return 1.0 if np.linalg.det(self.axes) > 0 else -1.0


class OsimFrames:
    """The bodies and frames of a model by path, such as ``/bodyset/thigh`` and ``/jointset/hip/thigh_offset``."""

    def __init__(self, bodies: Mapping[str, Element], model: Element):
        self.bodies = {GROUND: "ground", **{f"/bodyset/{name}": name for name in bodies}}
        self.offsets: dict[str, Element] = {}
        self._add(model.iterfind("components/*"), "")
        self._add(model.iterfind("ComponentSet/objects/*"), "/componentset")
        self._add((part for ground in model.iter("Ground") for part in ground.iterfind("components/*")), GROUND)
        for name, body in bodies.items():
            self._add(body.iterfind("components/*"), f"/bodyset/{name}")
        for joint in objects_of(model, "JointSet"):
            self._add(joint.iterfind("frames/*"), _path_of_joint(joint))

    def _add(self, elements: Iterable[Element], owner: str) -> None:
        for element in elements:
            path = f"{owner}/{name_of(element)}"
            if element.tag == "PhysicalOffsetFrame":
                self.offsets[path] = element
                self._add(element.iterfind("components/*"), path)

    def of_joint(self, joint: Element, socket: str) -> OffsetFrame:
        """Return the parent or child frame of a joint; raises SpecError if it does not lie in the plane."""
        body, place, axes = self._resolved(text_of(joint, socket), _path_of_joint(joint), joint)
        if math.hypot(axes[0, 2], axes[1, 2]) > FLAT:
            raise refused(
                f"{label_of(joint)} is not planar: the z axis of its {socket.split('_')[1]} frame does not point along "
                f"the z axis of {body}"
            )
        return OffsetFrame(body, place[:2], axes[:2, :2], float(place[2]))

    def of_marker(self, marker: Element) -> tuple[str, np.ndarray]:
        """Return the body to which a marker is fixed, and its position in the frame of that body, (2,) [m]."""
        body, place, axes = self.of_point(marker)
        return body, (place + axes @ numbers_of(marker, "location", 3, "0 0 0"))[:2]

    def of_point(self, point: Element) -> tuple[str, np.ndarray, np.ndarray]:
        """Return the body to which a point of a path is fixed, and position (3,) and axes (3, 3) of the point's frame
        in the frame of the body.
        """
        return self._resolved(text_of(point, "socket_parent_frame"), "", point)

    def of_socket(self, constraint: Element, socket: str) -> tuple[str, np.ndarray, np.ndarray]:
        """Return the body to which a frame of a constraint is fixed, and position (3,) and axes (3, 3) of the frame in
        that of the body.
        """
        path = text_of(constraint, socket) or text_of(constraint, socket.removeprefix("socket_"))  # of OpenSim 4, or 3
        return self._resolved(path, f"/constraintset/{name_of(constraint)}", constraint)

    def _resolved(self, path: str, owner: str, element: Element) -> tuple[str, np.ndarray, np.ndarray]:
        """Return the body to which a frame is fixed, and position (3,) and axes (3, 3) of the frame in that of the
        body.

        Parameters
        ----------
        path
            Path of the frame, absolute or relative to the component `owner`.
        element
            The component that refers to the frame, for messages.
        """
        place, axes = np.zeros(3), np.eye(3)
        for _ in range(DEEPEST):
            path = self._absolute(path, owner, element)
            if path in self.bodies:
                return self.bodies[path], place, axes
            offset = self.offsets[path]
            own = turn(numbers_of(offset, "orientation", 3, "0 0 0"))
            place = numbers_of(offset, "translation", 3, "0 0 0") + own @ place
            axes = own @ axes
            path, owner = text_of(offset, "socket_parent"), path
        raise refused(f"{label_of(element)}: more than {DEEPEST} frames are offset from each other")

    def _absolute(self, path: str, owner: str, element: Element) -> str:
        """Return the absolute path of a frame; without a component at this path, that of the only frame of its name."""
        known = (*self.bodies, *self.offsets)
        absolute = normpath(join(owner, path))
        if absolute in known:
            return absolute
        matching = [candidate for candidate in known if last_part(candidate) == last_part(path)]
        if len(matching) != 1:
            state = "does not exist" if not matching else f"may be {listed(matching, 'or')}"
            raise refused(f"{label_of(element)} refers to the frame '{path}', which {state}")
        return matching[0]


def _path_of_joint(joint: Element) -> str:
    return f"/jointset/{name_of(joint)}"
