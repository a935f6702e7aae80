"""Selection of a model or an integrator by `name`: a discriminated union of the options of the installed plugins."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema, core_schema

from mbdkit.base.errors import SpecError, blaming
from mbdkit.base.plain_data import found
from mbdkit.base.text import listed
from mbdkit.registry.catalogue import Kind, Registered, Registry
from mbdkit.registry.item_options import item_of, named_options
from mbdkit.registry.manager import registry


@dataclass(frozen=True)
class Choice:
    """Annotation that turns a field into the union of the options of all plugins of one kind, discriminated by `name`.

    Parameters
    ----------
    kind
        ``"model"`` or ``"integrator"``.
    installed
        The registry to choose from; None for all installed plugins.
    """

    kind: Kind
    installed: Registry | None = None

    @property
    def registry(self) -> Registry:
        """The registry to choose from."""
        return self.installed if self.installed is not None else registry()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        items = self.registry.of_kind(self.kind)
        choices = {item.id: _blaming(item, handler.generate_schema(named_options(item))) for item in items}
        union: CoreSchema = core_schema.no_info_plain_validator_function(self._tag)
        if choices:
            union = core_schema.tagged_union_schema(choices, self._tag)
        return core_schema.no_info_before_validator_function(self._named, union)

    def _named(self, data: Any) -> Any:
        """Return `data` unchanged; raise SpecError unless it is a mapping with a name."""
        if not isinstance(data, Mapping):
            example = data if isinstance(data, str) and data in self.registry.names(self.kind) else "NAME"
            problem, key = f"should be a mapping such as `{{name: {example}}}`, not {found(data)}", ""
        elif "name" not in data:
            problem, key = f"is missing: the name of the {self.kind}", "name"
        elif not isinstance(data["name"], str):
            problem, key = f"should be text, not {found(data['name'])}", "name"
        else:
            return data
        raise SpecError(f"{problem}; installed: {listed(self.registry.names(self.kind))}", key=key)

    def _tag(self, data: Any) -> str | None:
        if isinstance(data, BaseModel):  # during serialization
            return item_of(data).id
        name = data.get("name") if isinstance(data, dict) else None
        return self.registry.get(self.kind, name).id if isinstance(name, str) else None


def _blaming(item: Registered, schema: CoreSchema) -> CoreSchema:
    """Return a schema of a plugin's options that raises PluginError if their validation fails in another way."""
    if item.origin.distribution == "mbdkit":
        return schema

    def validate(data: Any, handler: Callable[[Any], Any]) -> Any:
        with blaming(f"{item.kind} {item.id} failed to check its options", ValidationError):
            return handler(data)

    return core_schema.no_info_wrap_validator_function(validate, schema)


def choice_of(root: type[BaseModel], kind: Kind) -> Choice:
    """Return the `Choice` annotation of the field `kind` of a spec."""
    return next(extra for extra in root.model_fields[kind].metadata if isinstance(extra, Choice))


def registry_of(root: type[BaseModel]) -> Registry:
    """Return the registry in the `Choice` annotations of a spec; without any, the registry of installed plugins."""
    for field in root.model_fields.values():
        for extra in field.metadata:
            if isinstance(extra, Choice):
                return extra.registry
    return registry()
