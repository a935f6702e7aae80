"""Markers: points of bodies whose motion is recorded."""

from __future__ import annotations

from mbdkit.mechanism.bodies import Attachment, Element
from mbdkit.mechanism.values import Point


class Marker(Element):
    """A point of a body whose position and velocity are recorded; it does not affect the motion."""

    body: str
    """Name of the body."""
    point: Point = (0.0, 0.0)
    """The point in the body's frame [m]; by default, the centre of mass."""

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element refers to."""
        return [("body", self.body)]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        return [("point", self.body, self.point)]
