"""The element of type ``law``: a pathway and the name of the force law that acts along it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import InitErrorDetails, to_json

from mbdkit.mechanism import higher_layers
from mbdkit.mechanism.bodies import Attachment, Element
from mbdkit.mechanism.force_law import ForceLaw
from mbdkit.mechanism.pathways import Pathway

OptionsClass = type[BaseModel]


class Law(Element):
    """A force along a pathway by a force law, whose own options stand beside its name.

    The law gives the tension, from the pathway's length, its rate and the time. ``mbdkit plugins list`` names the laws
    that are installed.
    """

    # The options of a law are fields of a subclass made by `mbdkit.registry.item_options.law_element`, which is strict.
    model_config = ConfigDict(extra="ignore")

    type: Literal["law"] = "law"
    law: str
    """Name of the force law, such as one-sided or table."""
    pathway: Pathway
    """What the length is, and between which bodies."""
    pathway_key: ClassVar[str] = "pathway."
    """Prefix of the keys of the pathway."""

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
        """Return (key, body name, point in its frame) of each body-fixed point of the element."""
        return [(f"pathway.{key}", name, point) for key, name, point in self.pathway.attachments()]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses, and which is therefore no point mass."""
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
        Context of a validation, whose ``find_law`` is a `FindLaw`; without it, the installed laws are searched.

    Raises
    ------
    SpecError
        If there is none, with the key ``law``.
    """
    given: FindLaw | None = context.get("find_law") if isinstance(context, Mapping) else None
    element: type[Law] = (given or higher_layers.find_installed_law)(name)
    return element


def _below(error: ValidationError, law_id: str) -> ValidationError:
    """Return the same errors with the law's name before their locations, as pydantic puts the tag of a union."""
    lines: list[InitErrorDetails] = []
    for details in error.errors(include_url=False):
        context = details.get("ctx", {})
        kind: Any = details["type"]
        line = InitErrorDetails(type=kind, loc=(law_id, *details["loc"]), input=details["input"], ctx=context)
        lines.append(line)
    return ValidationError.from_exception_data(error.title, lines)
