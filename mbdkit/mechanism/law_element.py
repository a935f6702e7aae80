"""Force elements by law: a pathway, which has a length, and a force law by name, which pulls along it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import InitErrorDetails, to_json

from mbdkit.errors import SpecError
from mbdkit.mechanism.elements import Attachment, Between, BetweenPoints, Element, Points
from mbdkit.mechanism.force_law import ForceLaw

OptionsClass = type[BaseModel]


class TwoPoints(BetweenPoints):
    """The distance of two points [m]; a positive force pulls them together."""

    type: Literal["two-points"]


class RelativeAngle(Between):
    """``angle_b - angle_a`` [rad]; a positive torque turns b back towards a."""

    type: Literal["relative-angle"]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in its frame) of each point that is held."""
        return []

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose own angle takes part, so that it cannot be a point mass."""
        return self.places()


class Coordinate(Between):
    """``x`` or ``y`` of b's point in a's frame, from a's origin [m]; a positive force makes it smaller."""

    type: Literal["coordinate"]
    coordinate: Literal["x", "y"]
    """Which coordinate is the length."""
    points: Points | None = None
    """``[[0, 0], b's point]``; left out, b's origin."""

    @model_validator(mode="before")
    @classmethod
    def _no_angle(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and data.get("coordinate") == "angle":
            raise SpecError("the pathway along an angle is written {type: relative-angle, ...}", key="coordinate")
        return data

    @model_validator(mode="after")
    def _points_fit(self) -> Coordinate:
        if self.points is not None and self.points[0] != (0.0, 0.0):
            raise SpecError(
                "should be [0, 0]: a coordinate is measured from the origin of the first body", key="points[0]"
            )
        return self

    @property
    def point(self) -> tuple[float, float]:
        """B's point in b's frame [m]."""
        return (0.0, 0.0) if self.points is None else self.points[1]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in its frame) of each point that is held."""
        return [("points[1]", self.bodies[1], self.point)]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose own angle takes part, so that it cannot be a point mass."""
        return self.places()[:1]


Pathway = Annotated[TwoPoints | RelativeAngle | Coordinate, Field(discriminator="type")]


class Law(Element):
    """A force along a pathway by a force law, whose own options stand beside its name.

    The law gives the tension, from the pathway's length, its rate and the time. ``mbdkit plugins list`` names the laws
    that are installed.
    """

    # The options of a law are fields of a class of its own, which `law_element` makes; that class is strict.
    model_config = ConfigDict(extra="ignore")

    type: Literal["law"] = "law"
    law: str
    """Name of the force law, such as one-sided or table."""
    pathway: Pathway
    """What the length is, and between which bodies."""

    force_law: ClassVar[ForceLaw]
    """The law itself."""
    law_id: ClassVar[str]
    """Its long name."""
    law_options: ClassVar[OptionsClass]
    """Its options."""

    @model_validator(mode="wrap")
    @classmethod
    def _by_its_law(cls, data: Any, handler: ModelWrapValidatorHandler[Law], info: ValidationInfo) -> Law:
        if cls is not Law or not isinstance(data, Mapping) or not isinstance(data.get("law"), str):
            return handler(data)
        element = find_law(data["law"], info.context)
        try:
            return element.model_validate_json(to_json(data, fallback=lambda x: x.tolist()))
        except ValidationError as error:
            raise _below(error, element.law_id) from None

    @property
    def bodies(self) -> tuple[str, str]:
        """Names of the two bodies."""
        return self.pathway.bodies

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element names."""
        return [(f"pathway.{key}", name) for key, name in self.pathway.places()]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in its frame) of each point that is held."""
        return [(f"pathway.{key}", name, point) for key, name, point in self.pathway.attachments()]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose own angle takes part, so that it cannot be a point mass."""
        return [(f"pathway.{key}", name) for key, name in self.pathway.angles()]


FindLaw = Callable[[str], type[Law]]
"""Returns the element of a law by its name, or raises SpecError with the key ``law``."""


def find_law(name: str, context: Any = None) -> type[Law]:
    """Return the element class of the law of this name.

    Parameters
    ----------
    name
        Short or long name.
    context
        Context of a validation, whose ``find_law`` is a `FindLaw`; without it, all that is installed is searched.

    Raises
    ------
    SpecError
        If there is none, with the key ``law``.
    """
    given: FindLaw | None = context.get("find_law") if isinstance(context, Mapping) else None
    if given is None:
        from mbdkit.spec.law_options import find_installed_law

        given = find_installed_law
    return given(name)


def _below(error: ValidationError, law_id: str) -> ValidationError:
    """Return the same complaints with the law's name before their locations, as a tag in a union would be."""
    lines: list[InitErrorDetails] = []
    for details in error.errors(include_url=False):
        context = details.get("ctx", {})
        kind: Any = details["type"]
        line = InitErrorDetails(type=kind, loc=(law_id, *details["loc"]), input=details["input"], ctx=context)
        lines.append(line)
    return ValidationError.from_exception_data(error.title, lines)
