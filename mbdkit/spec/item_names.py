"""Texts in specs that name what items of plugins add: criteria in `accept`, and treatments of elements."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import cast

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import PydanticKnownError, core_schema

from mbdkit.registry.feature_items import CriterionItem, Treatment
from mbdkit.registry.manager import registry


class ItemName(ABC):
    """Annotation of a text that is one of the names which are known when a spec is checked."""

    known: Sequence[str] = ()
    """Names for which plugins need not be asked."""

    @abstractmethod
    def names(self) -> list[str]:
        """Return the names, those of plugins last."""

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_after_validator_function(self._checked, core_schema.str_schema(strict=True))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        names = self.names()
        return {"enum": names, "type": "string"} if len(names) > 1 else {"const": names[0], "type": "string"}

    def _checked(self, name: str) -> str:
        if name in self.known or name in (names := self.names()):
            return name
        *first, last = [repr(known) for known in names]
        expected = f"{', '.join(first)} or {last}" if first else last
        raise PydanticKnownError("literal_error", {"expected": expected})


class CriterionName(ItemName):
    """Annotation of a text that names a criterion of a kind of specs.

    `kind`: name of the kind of specs. `known`: criteria that no item lists.
    """

    def __init__(self, kind: str, known: Sequence[str] = ()):
        self.kind, self.known = kind, known

    def names(self) -> list[str]:
        """See `ItemName`."""
        items = (cast(CriterionItem, item.plugin) for item in registry().of_kind(CriterionItem.kind))
        added = [name for item in items if self.kind in item.of for name in item.accepted]
        return list(dict.fromkeys([*self.known, *added]))


class TreatmentName(ItemName):
    """Annotation of a text that names a treatment of elements.

    `of`: key of the elements in the model. `known`: the treatment by default.
    """

    def __init__(self, of: str, known: str):
        self.of, self.known = of, (known,)

    def names(self) -> list[str]:
        """See `ItemName`."""
        items = registry().of_kind(Treatment.kind)
        return [registry().accepted(item)[0] for item in items if cast(Treatment, item.plugin).of == self.of]
