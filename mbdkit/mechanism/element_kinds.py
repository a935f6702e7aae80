"""Kinds of elements that plugins add: keys of the model ``mechanism``, beside those that every mechanism may have."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Never, Protocol, TypeVar, cast

from pydantic import Field, TypeAdapter, create_model
from pydantic.fields import FieldInfo

from mbdkit.base import higher_layers
from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import MissingPartError, PluginError, SpecError
from mbdkit.base.parts import ELEMENTS_OF_PARTS
from mbdkit.base.strict_model import StrictModel
from mbdkit.mechanism.bodies import Body, Element, FromTo
from mbdkit.mechanism.joint_kinds import joint_kinds
from mbdkit.mechanism.joints import Joint
from mbdkit.mechanism.model_methods import of_models
from mbdkit.mechanism.pathways import LawForce
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.element_items import ElementDerivatives, ElementFailures, ElementForces, ElementKind, JointKind
from mbdkit.registry.feature_items import Treatment
from mbdkit.registry.item import described, seams_of
from mbdkit.registry.manager import log, registry, use
from mbdkit.registry.seam import OwnSeam, Seam
from mbdkit.registry.target import Target


class ChosenTreatment(NamedTuple):
    """The treatment of the elements of a kind in a run.

    `key`: key of the elements in the model. `section`: the section of the run spec, see
    `mbdkit.plugin.ElementKind.section_model`.
    """

    key: str
    section: Any

    @property
    def item(self) -> Treatment:
        """The treatment; raises SpecError if it is not installed."""
        return cast(Treatment, registry().get(Treatment.kind, self.section.treatment).plugin)

    @property
    def section_key(self) -> str:
        """Key of the section in run specs."""
        return element_kinds()[self.key].section

    @property
    def content(self) -> tuple[object, ...]:
        """The values of the section."""
        return tuple(value for _, value in self.section)

    def replaced(self, name: str) -> ChosenTreatment:
        """Return the same section with another treatment."""
        return self._replace(section=self.section.model_copy(update={"treatment": name}))


def reacting_among(treatments: Sequence[ChosenTreatment]) -> ChosenTreatment | None:
    """Return the treatment of elements whose reactions the steps determine; None if there is none."""
    return next((chosen for chosen in treatments if chosen.item.reacting), None)


AnyModel = TypeVar("AnyModel", bound=StrictModel)


def element_kinds() -> dict[str, ElementKind]:
    """Return the kinds of elements of all plugins by their key in the model, in their order.

    A warning names the kinds that are not used because mechanisms have an attribute with the name of their key or
    builder already.
    """
    return _kinds(registry())


@lru_cache(maxsize=4)
def _kinds(known: Registry) -> dict[str, ElementKind]:
    taken, kinds = set(higher_layers.names_of_mechanisms()), {}
    for item in sorted(known.of_kind("element-kind"), key=lambda item: item.origin.distribution != MBDKIT):
        kind = cast(ElementKind, item.plugin)
        own = {kind.key_in_model, kind.builder} - {""}
        if clash := sorted(own & taken):
            text = "mbdkit: warning: mechanisms have '%s' already, so the kind of elements '%s' is not used"
            log.warning(text, clash[0], item.id)
            continue
        taken |= own
        kinds[kind.key_in_model] = kind if item.origin.distribution == MBDKIT else _blaming(item, kind)
    return dict(sorted(kinds.items(), key=lambda item: item[1].order))


class _BlamingTarget(Target):
    """A function of a kind of elements, whose errors name the kind and its distribution."""

    def __init__(self, item: Registered, target: Target):
        super().__init__(target.where)
        self._item = item

    def __call__(self) -> Callable[..., object]:
        function = cast("Callable[..., object]", super().__call__())
        return lambda *arguments: use(self._item, lambda: function(*arguments))


Part = TypeVar("Part", ElementKind, ElementForces, ElementFailures, ElementDerivatives)


def _blaming(item: Registered, part: Part) -> Part:
    """Return a kind of a plugin, or a part of it, whose functions, if they are wrong, raise PluginError."""
    given = {name: target for name in seams_of(type(part)) if isinstance(target := getattr(part, name), Target)}
    changed: dict[str, Any] = {name: _BlamingTarget(item, target) for name, target in given.items()}
    if isinstance(part, ElementKind):
        changed |= {name: _blaming(item, getattr(part, name)) for name in ("acts", "failures", "derivatives")}
    return replace(part, **changed)


def kinds_in(data: Mapping[str, object]) -> list[ElementKind]:
    """Return the kinds of elements in the data of a mechanism.

    Raises SpecError if the part of mbdkit that adds a kind is not installed.
    """
    kinds = element_kinds()
    for key, part in ELEMENTS_OF_PARTS.items():
        if key in data and key not in kinds:
            raise SpecError(str(MissingPartError("a model with this key", part)), key=key)
    return [kind for key, kind in kinds.items() if key in data]


def kinds_with_section() -> dict[str, ElementKind]:
    """Return the kinds of elements that have a section in run specs, by the key of the section."""
    return {kind.section: kind for kind in element_kinds().values() if kind.section}


def kind_built_by(method: str) -> ElementKind | None:
    """Return the kind whose elements a method of `Mechanism` adds; None if there is none."""
    return next((kind for kind in element_kinds().values() if kind.builder == method), None)


def class_of(kind: ElementKind) -> type[Element]:
    """Return the class of the elements of a kind."""
    return cast("type[Element]", kind.model())


@cache
def builder_of(kind: ElementKind) -> Callable[..., object]:
    """Return the method of `Mechanism` that adds an element of a kind."""
    if kind.method is not None:
        return cast("Callable[..., None]", kind.method())

    def method(self: Any, name: str, **keys: Any) -> None:
        self.add(kind.key_in_model, name, **keys)

    method.__name__, method.__qualname__ = kind.builder, f"Mechanism.{kind.builder}"
    method.__doc__ = f"Add an element of kind {kind.name}."
    return cast("Callable[..., object]", of_models(class_of(kind))(method))


@OwnSeam
def element_forces(elements: Never, /) -> Mapping[str, LawForce]:
    """Return the force elements by which elements, given by name, act; with `points` in the frames of the bodies."""
    raise NotImplementedError


def forces_of(kind: ElementKind, elements: Mapping[str, object]) -> Mapping[str, LawForce]:
    """Return the force elements with laws by which elements of a kind act, by name; see `element_forces`.

    Raises PluginError if they are not objects as `LawForce` describes.
    """
    if (own := kind.acts.forces) is None and kind.acts.lower is not None:
        return {}
    forces: Mapping[str, object] = elements if own is None else element_forces.of(own)(elements)
    if not isinstance(forces, Mapping):
        raise PluginError(f"`forces` of the kind of elements '{kind.name}' returned {described(forces)}, not a mapping")
    for name, force in forces.items():
        what = f"the force element '{name}' of the kind of elements '{kind.name}'"
        for attribute in ("law_id", "force_law", "pathway"):
            if not hasattr(force, attribute):
                advice = "; give the kind `acts=ElementForces(...)` with `forces` or `lower`" if own is None else ""
                raise PluginError(f"{what} has no `{attribute}`, which an element with a force law has{advice}")
        if isinstance(force, FromTo) and force.points is None:
            raise PluginError(f"{what} has no `points`, the points in the frames of the bodies")
    return cast("Mapping[str, LawForce]", forces)


class ElementsByName(Protocol):
    """Elements of a mechanism, or of its data, by name."""

    @property
    def bodies(self) -> Mapping[str, Body]:
        """Bodies."""

    @property
    def joints(self) -> Mapping[str, Joint]:
        """Joints."""

    @property
    def coordinates(self) -> Mapping[str, object]:
        """Named coordinates."""


@OwnSeam
def element_check(elements: Never, mechanism: ElementsByName, prefix: str, /) -> None:
    """Raise SpecError for the first of the elements, given by name, that does not fit the other elements.

    `prefix` is the beginning of the key of the error.
    """
    raise NotImplementedError


@Seam
def element_files(elements: Mapping[str, object], folder: Path, /) -> None:
    """Replace in plain data of elements by name what they give by the names of files, in the folder of the spec."""
    raise NotImplementedError


def check_elements(elements: Mapping[str, Mapping[str, object]], mechanism: ElementsByName, prefix: str = "") -> None:
    """Raise SpecError for the first element, or joint, of a plugin's kind that does not fit the other elements.

    `elements`: elements by key in the model and name. `mechanism`: the mechanism, or its data. `prefix`: beginning of
    the key of the error.
    """
    further = element_kinds()
    for key, kind in () if further.keys().isdisjoint(elements) else further.items():
        if elements.get(key) and kind.check_elements is not None:
            element_check.of(kind.check_elements)(elements[key], mechanism, prefix)
    types = {cast(Joint, joint).type for joint in elements.get("joints", {}).values()}
    for name, item in joint_kinds().items() if types else ():
        if name in types and (check := cast(JointKind, item.plugin).check_elements) is not None:
            joints = {key: joint for key, joint in elements["joints"].items() if cast(Joint, joint).type == name}
            element_check.of(check)(joints, mechanism, prefix)


def field_of(kind: ElementKind) -> FieldInfo:
    """Return the field of the model `mechanism` for the elements of a kind, whose class is imported."""
    return FieldInfo.from_annotated_attribute(_named(kind), Field(default_factory=dict, description=kind.summary))


@cache
def elements_type(kind: ElementKind) -> TypeAdapter[Any]:
    """Return the type of the elements of a kind by name."""
    return TypeAdapter(_named(kind))


def _named(kind: ElementKind) -> Any:
    return dict.__class_getitem__((str, class_of(kind)))


@cache
def with_kinds(model: type[AnyModel], kinds: tuple[ElementKind, ...]) -> type[AnyModel]:
    """Return a class derived from that of the data of a mechanism, with fields for further kinds."""
    fields: dict[str, Any] = {kind.key_in_model: (_named(kind), field_of(kind)) for kind in kinds}
    derived = create_model(model.__name__, __base__=model, __module__=__name__, __doc__=model.__doc__, **fields)
    derived.ABSENT_BY_DEFAULT = (*model.ABSENT_BY_DEFAULT, *fields)  # type: ignore[attr-defined]
    return derived


def validated(model: type[AnyModel], data: object, mode: str, context: object) -> AnyModel:
    """Validate plain data in a mode of pydantic, ``json`` or ``python``."""
    if mode == "json":  # strict mode accepts a list for a tuple only in JSON
        return model.model_validate_json(json.dumps(data), context=context)
    return model.model_validate(data, context=context)
