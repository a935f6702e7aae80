"""Sections of a spec of inverse dynamics of a person: the person, the plane of motion, and joint centres."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mbdkit.base.errors import SpecError
from mbdkit.spec.sections import Section

Marker = Annotated[str, Field(min_length=1)]


class Subject(Section):
    """The person whose markers were measured. The model, whose own height and mass are those for which its muscles are
    given, is scaled to this person.
    """

    mass: Annotated[float, Field(gt=0, le=500)]
    """Body mass [kg]."""
    height: Annotated[float, Field(gt=0, le=3)]
    """Body height [m]."""
    sex: Literal["female", "male"]
    """Which of de Leva's tables gives masses, centres of mass and radii of gyration of the segments."""


class PlaneAxes(Section):
    """The plane of motion, by axes of the laboratory."""

    forward: Literal["x", "-x", "y", "-y", "z", "-z"]
    """Axis of the laboratory in the direction in which the person faces."""
    up: Literal["z", "y"]
    """Axis of the laboratory that points up."""

    def model_post_init(self, _context: object) -> None:
        """Raise SpecError if both axes are the same."""
        if self.forward[-1] == self.up:
            raise SpecError("is the axis that points up; choose one of the horizontal axes", key="forward")


class Midpoint(Section):
    """A joint centre midway between two landmarks."""

    midpoint: tuple[Marker, Marker]
    """Markers on the medial and the lateral side of the joint, in the static trial if it has them, otherwise in the
    motion."""

    def model_post_init(self, _context: object) -> None:
        """Raise SpecError if both landmarks are the same."""
        if len(set(self.midpoint)) == 1:
            raise SpecError("names one marker twice", key="midpoint")


CenterMethod = Literal["functional", "hip-regression", "static"]
#: Keys of `motion` that only specs with `subject` have.
OF_PERSONS = ("plane", "clusters", "centers", "static")

Center = CenterMethod | Midpoint
