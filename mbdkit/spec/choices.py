"""The parts of specs that depend on plugins: models, integrators, and a class of elements for each force law.

The value of the field of a model or integrator is the options of the plugin that its key `name` chooses.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, cast

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
    create_model,
)
from pydantic_core import CoreSchema, SchemaValidator, core_schema

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import PluginError, SpecError, blaming
from mbdkit.base.frozen import dataclass
from mbdkit.base.plain_data import value_text
from mbdkit.base.strict_model import STRICT, schema_of
from mbdkit.base.text import listed
from mbdkit.mechanism.joint_kinds import joint_class, joint_kinds
from mbdkit.mechanism.law_element import Law
from mbdkit.registry.catalogue import Kind, Registered, Registry
from mbdkit.registry.item_options import class_name, is_of_item, item_of, name_type, named_options
from mbdkit.registry.manager import registry
from mbdkit.registry.model_keys import model_keys, options_with_keys

if TYPE_CHECKING:
    from pydantic.json_schema import JsonSchemaValue

    from mbdkit.registry.items import ForceLawPlugin, ModelPlugin


@dataclass(frozen=True)
class Choice:
    """Annotation of a field for the options of an installed plugin of one kind, which the key `name` chooses.

    Only the options of the chosen plugin are imported. The JSON schema is the union of the options of all plugins.

    `kind`: ``"model"``, ``"integrator"`` or ``"step-control"``. `installed`: the registry to choose from; None for all
    installed plugins. `optional`: whether the value may be None. `has_keys`: whether models have the keys that plugins
    add to every model.
    """

    kind: Kind
    installed: Registry | None = None
    optional: bool = False
    has_keys: bool = True

    @property
    def registry(self) -> Registry:
        """The registry to choose from."""
        return self.installed if self.installed is not None else registry()

    @staticmethod
    def build_model(options: BaseModel) -> object:
        """Return what the model that was chosen builds from its options; errors of a plugin name this model."""
        item = item_of(options)
        with blaming(f"model {item.id} failed to build"):
            return cast("ModelPlugin", item.plugin).build(options)

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(self._validated)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        if not self.has_keys:  # a reference to the union of all models in one of them would double the schema
            return {"type": "object", "properties": {"name": {"type": "string"}}, "required": ["name"]}
        items = self.registry.of_kind(self.kind)
        union = _union((item, self._keys(item, model_keys(item))) for item in items)
        return handler(core_schema.nullable_schema(union) if self.optional else union) if items else {}

    def _validated(self, data: object, info: core_schema.ValidationInfo) -> object:
        if data is None and self.optional:
            return None
        name = self._name(data)
        with SpecError.rekey("name"):  # its key is that of the section which usually has such a choice
            item = self.registry.get(self.kind, name)
        validator = _validator(item, self._keys(item, cast("Mapping[str, object]", data)))
        if info.mode == "json":  # strict mode accepts a list for a tuple, or a text for a path, only in JSON
            return validator.validate_json(json.dumps(data), context=info.context)
        return validator.validate_python(data, context=info.context)

    def _keys(self, item: Registered, given: Iterable[str]) -> tuple[str, ...]:
        """Return the model keys among those that are given."""
        return tuple(key for key in model_keys(item) if key in given) if self.has_keys else ()

    def _name(self, data: object) -> str:
        if not isinstance(data, Mapping):
            example = data if isinstance(data, str) and data in self.registry.names(self.kind) else "NAME"
            problem, key = f"should be a mapping such as `{{name: {example}}}`, not {value_text(data)}", ""
        elif "name" not in data:
            problem, key = f"is missing: the name of the {self.kind}", "name"
        elif not isinstance(data["name"], str):
            problem, key = f"should be text, not {value_text(data['name'])}", "name"
        else:
            return data["name"]
        raise SpecError(f"{problem}; installed: {listed(self.registry.names(self.kind))}", key=key)


@functools.cache
def _validator(item: Registered, keys: tuple[str, ...]) -> SchemaValidator:
    """Return the validator of the options of an item; the locations in its errors begin with the id of the item."""
    return SchemaValidator(_union([(item, keys)]))


def _union(items: Iterable[tuple[Registered, tuple[str, ...]]]) -> CoreSchema:
    choices = {item.id: _blaming(item, schema_of(options_with_keys(item, keys))) for item, keys in items}
    return core_schema.tagged_union_schema(choices, lambda data: next(iter(choices)))


def _blaming(item: Registered, schema: CoreSchema) -> CoreSchema:
    """Return a schema of a plugin's options that converts all errors except ValidationError to PluginError."""
    if item.origin.distribution == MBDKIT:
        return schema

    def validate(data: object, handler: Callable[[object], object]) -> object:
        with blaming(f"{item.kind} {item.id} failed to check its options", ValidationError):
            return handler(data)

    return core_schema.no_info_wrap_validator_function(validate, schema)


#: Type and field of the key `step_control`, which every integrator has.
STEP_CONTROL = (
    Annotated[BaseModel | None, Choice("step-control", optional=True)],
    Field(
        default=None,
        description="Controller of the size of adaptive steps: its name and its options. By default, explicit methods "
        "have a proportional-integral controller, and implicit ones an elementary one.",
    ),
)


def choice_of(root: type[BaseModel], kind: Kind) -> Choice:
    """Return the `Choice` annotation of the field `kind` of a spec."""
    return next(extra for extra in root.model_fields[kind].metadata if isinstance(extra, Choice))


def registry_of(root: type[BaseModel]) -> Registry:
    """Return the registry in the `Choice` annotations of a spec; if there are none, the registry of installed
    plugins.
    """
    metadata = (extra for field in root.model_fields.values() for extra in field.metadata)
    return next((extra.registry for extra in metadata if isinstance(extra, Choice)), None) or registry()


@functools.cache
def law_element(item: Registered) -> type[Law]:
    """Return the strict, frozen class of elements of type ``law`` for one force law, with its options as fields."""
    named_options(item)  # checks the item
    plugin: ForceLawPlugin = item.plugin  # type: ignore[assignment]
    namespace = {
        "__module__": __name__,
        "model_config": ConfigDict(**STRICT, title=item.name, use_attribute_docstrings=False),
        "force_law": plugin.law,
        "law_id": item.id,
        "law_options": plugin.options,
        "__mbdkit_item__": item,
    }
    element: type[BaseModel] = create_model(
        f"{class_name(item.name)}Law",
        __base__=type("Options", (plugin.options, Law), namespace),
        __doc__=plugin.summary,
        law=(name_type(item), Field(description=plugin.summary)),
    )
    return cast("type[Law]", element)


ADD_IN_PYTHON = (
    "; without this key, m = mbdkit.load_spec('FILE.yaml').mechanism() is the mechanism in Python, to which "
    "methods such as m.torsion_spring add elements, and which mbdkit.run(m, ...) runs"
)


@dataclass(frozen=True)
class RegistryLookup:
    """The `PluginLookup` of a registry.

    `registry`: function that returns the registry. It is called only when a law or an option is looked up.
    """

    registry: Callable[[], Registry] = registry

    def law_element(self, name: str) -> type[Law]:
        """Return the element class of the force law with this short or long name."""
        return law_element(self.registry().get("force-law", name))

    def joint_class(self, name: str | int) -> type[BaseModel] | None:
        """Return the class of the joints of a type that a plugin adds; None if there is no such type."""
        item = joint_kinds().get(name) if isinstance(name, str) else None
        return None if item is None else joint_class(item)

    def joint_types(self) -> list[str]:
        """Return the types of joints that plugins add."""
        return [name for name in joint_kinds() if ":" not in name]

    def selected_options(self, metadata: Sequence[object], item: str | int) -> type[BaseModel] | None:
        """Return the options of an item; None unless `metadata` contains a `Choice`."""
        for choice in metadata:
            if isinstance(choice, Choice):
                items = choice.registry.of_kind(choice.kind)
                return next(options_with_keys(known) for known in items if known.id == item)
        return None

    def owners_of(self, key: str, options: type[BaseModel]) -> str:
        """Return a phrase that names the other items of the same kind with an option `key`, or the section `model` if
        models have it; empty if there are none.
        """
        item = item_of(options) if is_of_item(options) else None
        if item is None and "model" not in options.model_fields:
            return ""
        others = []
        for other in self.registry().of_kind("model" if item is None else item.kind):
            with suppress(PluginError):  # the options of another plugin cannot be imported
                given = other.plugin.options
                keys = [*given.model_fields, *getattr(given, "further_keys", list)()]
                others += [f"'{other.name}'"] * (key in keys)
        if item is None or not others:
            return f"unknown key: '{key}' belongs under 'model', one level deeper" if others else ""
        message = f"'{key}' belongs to {listed(others, 'and')}, not to the {item.plugin.label()} '{item.name}'"
        if item.kind == "integrator":
            return f"{message} (to change the method, replace the whole section by `{{name: {item.name}}}`)"
        return message + (ADD_IN_PYTHON if item.kind == "model" and "'mechanism'" in others else "")
