"""Types of joints that plugins add: values of the key `type` of joints, beside those that every mechanism may have."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, lru_cache
from typing import Any, cast

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, SerializationInfo, ValidationError, ValidationInfo
from pydantic_core import CoreSchema, core_schema, to_json

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import PluginError, blaming
from mbdkit.base.plain_data import plain
from mbdkit.base.strict_model import located_below, schema_of
from mbdkit.mechanism.joint_base import FunctionJoint, JointBase
from mbdkit.mechanism.model_methods import of_models
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.element_items import JointKind
from mbdkit.registry.item import described
from mbdkit.registry.manager import registry


def joint_kinds() -> Mapping[str, Registered]:
    """Return the items of all types of joints that plugins add, by each name that a spec may use."""
    return registry().by_accepted_name("joint-kind")


def joint_class(item: Registered) -> type[FunctionJoint]:
    """Return the class of the joints of a kind.

    Raises
    ------
    PluginError
        If it is not a class derived from `FunctionJoint`.
    """
    kind = cast(JointKind, item.plugin)
    found: object = kind.model()
    if not (isinstance(found, type) and issubclass(found, FunctionJoint)):
        raise PluginError(f"the `model` of {item.id} is {described(found)}, not a class derived from FunctionJoint")
    if taken := {"name", "a", "b"} & found.model_fields.keys():
        raise PluginError(
            f"the field '{min(taken)}' of {found.__name__} has the name of an argument of `Mechanism.{kind.builder}`; "
            "choose another name"
        )
    return found


def joint_builders() -> dict[str, str]:
    """Return the types of joints of all kinds by the names of the methods of `Mechanism` that add them."""
    return _builders(registry())


@lru_cache(maxsize=4)
def _builders(known: Registry) -> dict[str, str]:
    kinds = known.by_accepted_name("joint-kind")
    return {cast(JointKind, item.plugin).builder: name for name, item in kinds.items() if ":" not in name}


@cache
def joint_builder(kind: str) -> Callable[..., None]:
    """Return the method of `Mechanism` that adds a joint of a type, with the keys that it has in a spec."""

    def method(self, name, a, b, **keys):  # type: ignore[no-untyped-def]
        self.add("joints", name, type=kind, bodies=(a, b), **keys)

    item = joint_kinds()[kind]
    method.__name__ = cast(JointKind, item.plugin).builder
    method.__qualname__ = f"Mechanism.{method.__name__}"
    method.__doc__ = f"Connect bodies `a` and `b`: {item.plugin.summary}"
    return cast("Callable[..., None]", of_models(joint_class(item))(method))


class OfJointKinds:
    """Annotation of a union of joints that also accepts the types of joints that plugins add.

    Only the class of the given type is imported. The JSON schema is the union of all types.
    """

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of the union, with a validator and a serializer before it."""
        serializer = core_schema.wrap_serializer_function_ser_schema(self._serialized, info_arg=True)
        return core_schema.with_info_wrap_validator_function(self._validated, handler(source), serialization=serializer)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Return the JSON schema with all installed types."""
        union = handler(cast("Any", schema)["schema"])
        # the discriminator maps names of types to references, which types of plugins do not have
        kinds = [joint_class(item) for name, item in joint_kinds().items() if ":" not in name]
        union["oneOf"] = [*union["oneOf"], *(handler(schema_of(kind)) for kind in kinds)]
        return union

    @staticmethod
    def _serialized(joint: JointBase, handler: Any, info: SerializationInfo) -> object:
        if not isinstance(joint, FunctionJoint):
            return handler(joint)
        return joint.model_dump(
            mode=info.mode, by_alias=info.by_alias, exclude_unset=info.exclude_unset,
            exclude_defaults=info.exclude_defaults, exclude_none=info.exclude_none,
        )  # fmt: skip

    @staticmethod
    def _validated(data: Any, handler: Any, info: ValidationInfo) -> JointBase:
        name = data.get("type") if isinstance(data, Mapping) else None
        if isinstance(data, FunctionJoint):
            return data
        item = joint_kinds().get(name) if isinstance(name, str) else None
        if item is None:
            return cast(JointBase, handler(data))
        model, text = joint_class(item), to_json(plain({**data, "type": item.name}))
        try:
            if item.origin.distribution == MBDKIT:
                return model.model_validate_json(text)
            with blaming(f"joint kind {item.id} failed to check its options", ValidationError):
                return model.model_validate_json(text)
        except ValidationError as error:
            raise located_below(error, item.name) from None
