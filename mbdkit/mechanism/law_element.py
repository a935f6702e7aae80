"""The element of type ``law``: a pathway and the name of the force law that acts along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal, Protocol, Self, get_args

from pydantic import BaseModel, ConfigDict, ModelWrapValidatorHandler, ValidationError, ValidationInfo, model_validator
from pydantic_core import to_json

from mbdkit.base import higher_layers
from mbdkit.base.errors import blaming
from mbdkit.base.plain_data import plain
from mbdkit.base.strict_model import located_below
from mbdkit.mechanism.bodies import Attachment, Body, Element
from mbdkit.mechanism.force_law import ForceLaw
from mbdkit.mechanism.pathways import Pathway

OptionsClass = type[BaseModel]


class Law(Element):
    """A force along a pathway, computed by a force law; the law's options are further keys of the element.

    The law computes the tension from the length of the pathway, its rate and the time. ``mbdkit plugins list`` shows
    the installed laws.
    """

    # The options of a law are fields of a strict subclass, created by `mbdkit.spec.choices.law_element`.
    model_config = ConfigDict(extra="ignore")

    type: Literal["law"] = "law"
    law: str
    """Name of the force law, such as one-sided or table."""
    pathway: Pathway
    """The pathway: which length, angle or coordinate the law acts along, and between which bodies."""
    pathway_key: ClassVar[str] = "pathway."
    """Prefix of the keys of the pathway in key paths."""

    force_law: ClassVar[ForceLaw]
    """The force law."""
    law_id: ClassVar[str]
    """Full name of the law."""
    law_options: ClassVar[OptionsClass]
    """Model of the law's options."""

    @model_validator(mode="wrap")
    @classmethod
    def _by_its_law(cls, data: object, handler: ModelWrapValidatorHandler[Law], info: ValidationInfo) -> Law:
        if cls is not Law or not isinstance(data, Mapping) or not isinstance(data.get("law"), str):
            return handler(data)
        element = _plugin_lookup(info.context).law_element(data["law"])
        text = to_json(plain(data))
        try:
            with blaming(f"force law {element.law_id} failed to check its options", ValidationError):
                return element.model_validate_json(text)
        except ValidationError as error:
            raise located_below(error, element.law_id) from None

    def places(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body that the element refers to."""
        return [(f"pathway.{key}", name) for key, name in self.pathway.places()]

    def attachments(self) -> list[Attachment]:
        """Return (key, body name, point in the body's frame [m]) of each body-fixed point of the element."""
        return [(f"pathway.{key}", name, point) for key, name, point in self.pathway.attachments()]

    def angles(self) -> list[tuple[str, str]]:
        """Return (key, body name) of each body whose angle the element uses; these bodies cannot be point masses."""
        return [(f"pathway.{key}", name) for key, name in self.pathway.angles()]

    @classmethod
    def unit_along(cls, data: Mapping[str, object]) -> str:
        """Return the unit of the length of the pathway; see `Element.unit_along`."""
        pathway = data.get("pathway")
        kind = pathway.get("type") if isinstance(pathway, Mapping) else getattr(pathway, "type", None)
        classes = get_args(get_args(Pathway)[0])
        return next((law.length_unit for law in classes if kind in get_args(law.model_fields["type"].annotation)), "")

    def placed(self, bodies: Mapping[str, Body], key: str) -> Self:
        """Return the element with the points of its pathway in the frames of the bodies; see `Element.placed`."""
        return self.model_copy(update={"pathway": self.pathway.placed(bodies, f"{key}.pathway")})


class PluginLookup(Protocol):
    """Interface through which validation and error messages access the models that plugins add to a spec."""

    def law_element(self, name: str) -> type[Law]:
        """Return the element class of the force law with this short or full name.

        Raises SpecError if there is no such law. The error has the key ``law``.
        """

    def joint_class(self, name: str | int) -> type[BaseModel] | None:
        """Return the class of the joints of a type that a plugin adds; None if there is no such type."""

    def joint_types(self) -> list[str]:
        """Return the types of joints that plugins add."""

    def selected_options(self, metadata: Sequence[object], item: str | int) -> type[BaseModel] | None:
        """Return the model of the options of a plugin item, such as a force law, that a field selects by name.

        `metadata`: metadata of the annotation of the field. `item`: full id of the item. Returns the model; None if
        fields with these metadata do not select an item.
        """

    def owners_of(self, key: str, options: type[BaseModel]) -> str:
        """Return a phrase that names the items with an option `key`, of the same kind as the item with these `options`.

        The phrase is empty if there are none.
        """


def _plugin_lookup(context: object) -> PluginLookup:
    """Return the lookup in a pydantic validation context, a mapping; by default, that of the installed plugins."""
    lookup: PluginLookup | None = context.get("plugins") if isinstance(context, Mapping) else None
    return lookup or higher_layers.installed_plugins()
