"""Data of the free-form model ``mechanism`` in a spec: gravity, named elements and coordinates, and assembly."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar

from pydantic import BeforeValidator, Field, GetJsonSchemaHandler, ValidationInfo, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.strict_model import StrictModel
from mbdkit.base.text import did_you_mean, listed
from mbdkit.mechanism.beams import Beam
from mbdkit.mechanism.bodies import GROUND, Body, Marker
from mbdkit.mechanism.element_kinds import (
    check_elements,
    element_kinds,
    elements_type,
    field_of,
    kinds_in,
    validated,
    with_kinds,
)
from mbdkit.mechanism.forces import Force
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.state_values import Controller, FirstOrderState, Input
from mbdkit.mechanism.values import Number, Point, Positive, sequence

if TYPE_CHECKING:
    from pydantic.json_schema import JsonSchemaValue

OF_JOINT, OF_BODY, OF_MARKER = ("angle",), ("x", "y", "angle"), ("x", "y")


class NamedCoordinate(StrictModel):
    """A quantity with a name of its own: ``scale * of + offset``, or ``scale * (of - angle of a body) + offset``.

    The generalized force of the coordinate is the force or torque along the quantity, divided by `scale`.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("relative_to", "scale", "offset")

    of: str
    """The quantity: `JOINT.angle` (the relative angle [rad], or the travel of a slide [m]), `BODY.x`, `BODY.y` [m] of
    the centre of mass, `BODY.angle` [rad], `MARKER.x` or `MARKER.y` [m]."""
    relative_to: str | None = None
    """Body whose angle is subtracted from `of`, which is then the angle of another body. The two bodies need not share
    a joint."""
    scale: Number = 1.0
    """Ratio of the change of the coordinate to the change of the quantity; must not be zero."""
    offset: Number = 0.0
    """Value of the coordinate when the quantity is zero [m or rad]."""


def _named(value: object) -> object:
    """Convert a coordinate that is given only by the name of its quantity to a mapping."""
    return {"of": value} if isinstance(value, str) else value


AnyNamedCoordinate = Annotated[NamedCoordinate, BeforeValidator(_named)]


def check_coordinates(
    coordinates: Mapping[str, NamedCoordinate], joints: Container[str], bodies: Container[str], markers: Container[str]
) -> None:
    """Raise a SpecError for the first coordinate with a wrong name, scale, quantity or `relative_to`."""

    def offered_by(owner: str) -> list[str]:
        return [
            *(OF_JOINT if owner in joints else ()),
            *(OF_BODY if owner in bodies and owner != GROUND else ()),
            *(OF_MARKER if owner in markers else ()),
        ]

    for name, coordinate in coordinates.items():
        key = f"model.coordinates.{quoted(name)}"
        owner, _, quantity = name.rpartition(".")
        if quantity in offered_by(owner):
            raise SpecError(f"is the name of a quantity of '{owner}'; choose another name", key=key)
        if coordinate.scale == 0:
            raise SpecError("should not be zero", key=f"{key}.scale")
        owner, _, quantity = coordinate.of.rpartition(".")
        offered = offered_by(owner)
        if quantity in offered:
            _check_relative(coordinate, bodies, f"{key}.relative_to")
            continue
        if offered:
            hint = did_you_mean(quantity, offered) or f"; there are {listed(dict.fromkeys(offered))}"
            raise SpecError(f"'{owner}' has no '{quantity}'{hint}", key=f"{key}.of")
        raise SpecError(
            f"'{coordinate.of}' is not a quantity of a joint, body or marker; write JOINT.angle, BODY.x, BODY.y, "
            "BODY.angle, MARKER.x or MARKER.y",
            key=f"{key}.of",
        )


def _check_relative(coordinate: NamedCoordinate, bodies: Container[str], key: str) -> None:
    owner, _, quantity = coordinate.of.rpartition(".")
    if coordinate.relative_to is None:
        return
    if quantity != "angle" or owner not in bodies or owner == GROUND:
        raise SpecError(f"'{coordinate.of}' is not the angle of a body; `relative_to` needs BODY.angle", key=key)
    if coordinate.relative_to not in bodies or coordinate.relative_to == owner:
        raise SpecError(f"'{coordinate.relative_to}' is not another body", key=key)


#: Kinds of elements of the core: keys of the model, and attributes of `Mechanism`. A canonical spec always has the
#: first two keys; it has the last one, and those of further kinds, only if they have elements.
ELEMENTS = ("joints", "forces", "markers")

NO_BODY = "a mechanism needs at least one body or beam"


class Assembly(StrictModel):
    """Settings for making the initial state consistent with the joints."""

    fix: Annotated[tuple[str, ...], BeforeValidator(sequence)] = ()
    """Names of the bodies that assembly does not move."""
    tolerance: Positive = 1.0e-12
    """Largest constraint residual of a consistent initial state [m, rad, m/s, rad/s]; assembly does not change such a
    state."""


class MechanismData(StrictModel):
    """Data of the model `mechanism`: gravity, bodies, beams, elements, coordinates, states, inputs, controllers,
    assembly.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (
        "beams", "markers", "coordinates", "states", "inputs", "controllers",
    )  # fmt: skip

    gravity: Point = (0.0, -9.81)
    """Gravitational acceleration (x, y) [m/s^2]."""
    bodies: dict[str, Body] = Field(default_factory=dict)
    """Bodies by name; `ground` is predefined."""
    beams: dict[str, Beam] = Field(default_factory=dict)
    """Flexible beams by name; the nodes of a beam `link` are the bodies `link.0`, `link.1`, ..., `link.last`."""
    joints: dict[str, Joint] = Field(default_factory=dict)
    """Joints and drivers by name."""
    forces: dict[str, Force] = Field(default_factory=dict)
    """Force elements by name."""
    markers: dict[str, Marker] = Field(default_factory=dict)
    """Points of bodies whose positions and velocities are recorded, by name."""
    coordinates: dict[str, AnyNamedCoordinate] = Field(default_factory=dict)
    """Named coordinates: quantities, scaled and shifted, such as ``knee_angle: knee.angle`` or
    ``knee_angle: {of: knee.angle, scale: -1}``."""
    states: dict[str, FirstOrderState] = Field(default_factory=dict)
    """First-order states by name, such as ``i: {rate: "(u - R*states.i)/L", unit: A}``."""
    inputs: dict[str, Input] = Field(default_factory=dict)
    """Inputs by name: numbers that a run receives from outside, such as ``torque: {unit: N m, bounds: [-5, 5]}``."""
    controllers: dict[str, Controller] = Field(default_factory=dict)
    """Sampled controllers by name."""
    assembly: Assembly = Assembly()
    """Settings for making the initial state consistent."""

    @model_validator(mode="after")
    def _has_bodies(self) -> MechanismData:
        if not self.bodies and not self.beams:
            raise SpecError(NO_BODY, key="bodies")
        return self

    @model_validator(mode="wrap")
    @classmethod
    def _with_kinds(
        cls, data: object, handler: Callable[[object], MechanismData], info: ValidationInfo
    ) -> MechanismData:
        """Validate as a derived class if there are elements of further kinds, so that only their code is imported."""
        kinds = kinds_in(data) if isinstance(data, Mapping) and data.keys() - cls.model_fields.keys() else []
        if further := tuple(kind for kind in kinds if kind.key_in_model not in cls.model_fields):
            derived: type[MechanismData] = with_kinds(cls, further)
            return validated(derived, data, info.mode, info.context)
        return handler(data)

    @model_validator(mode="after")
    def _elements_fit(self) -> MechanismData:
        check_elements({key: getattr(self, key) for key in element_kinds() if key in type(self).model_fields}, self)
        return self

    @classmethod
    def further_keys(cls) -> list[str]:
        """Return the keys of the kinds of elements that plugins add."""
        return list(element_kinds())

    @classmethod
    def further_field(cls, key: str | int) -> FieldInfo | None:
        """Return the field for the elements of a kind; None if there is no such kind."""
        return field_of(kinds[key]) if isinstance(key, str) and key in (kinds := element_kinds()) else None

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the schema with the elements of all installed kinds, after the markers."""
        schema = super().__get_pydantic_json_schema__(core_schema, handler)
        resolved = handler.resolve_ref_schema(schema)
        further = {
            key: {
                **handler(elements_type(kind).core_schema),
                "description": kind.summary,
                "title": key.replace("_", " ").title(),
            }
            for key, kind in element_kinds().items()
            if key not in cls.model_fields
        }
        properties = resolved["properties"]
        first = list(properties)[: list(properties).index("markers") + 1]
        resolved["properties"] = {key: properties[key] for key in first} | further | properties
        return schema
