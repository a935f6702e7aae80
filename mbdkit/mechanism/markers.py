"""Markers: points of bodies whose motion is recorded."""

from __future__ import annotations

from mbdkit.mechanism.bodies import AtPoint


class Marker(AtPoint):
    """A point of a body whose position and velocity are recorded; it does not affect the motion."""
