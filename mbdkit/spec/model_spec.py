"""Base classes of specs: strict, frozen pydantic models with readable validation errors, canonical JSON and a hash.

`ModelSpec` is the base class of the specs of runs and of inverse dynamics. It contains named parameters, and builds the
mechanism of its model.
"""

from __future__ import annotations

import hashlib
import json
import re
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar, cast

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    SerializerFunctionWrapHandler,
    ValidationError,
    create_model,
    model_serializer,
)

from mbdkit.base.errors import PluginError, SpecError, blaming
from mbdkit.base.files_read import FileRead, FilesRead, recording
from mbdkit.base.plain_data import LONGEST_TITLE, Path, canonical, canonical_text, plain, without_collection
from mbdkit.base.strict_model import FormatVersion, description
from mbdkit.mechanism.law_element import Law, PluginLookup
from mbdkit.mechanism.mechanism_seams import model_extension
from mbdkit.mechanism.parameters import (
    Written,
    WrittenText,
    in_terms_of,
    insert,
    parameter_values,
    with_expressions,
    without_units,
)
from mbdkit.mechanism.validation_errors import walk
from mbdkit.registry.catalogue import Kind, Registered, Registry
from mbdkit.registry.item_options import item_of
from mbdkit.registry.items import ModelPlugin
from mbdkit.registry.model_keys import model_keys
from mbdkit.spec.choices import Choice, RegistryLookup, registry_of
from mbdkit.spec.estimates import Estimated, Estimates
from mbdkit.spec.reading import Document, are_items, put
from mbdkit.spec.sections import QUANTITIES, Meta, Section
from mbdkit.spec.spec_kinds import kind_of

if TYPE_CHECKING:
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.registry.element_items import ModelKey
    from mbdkit.registry.feature_items import SpecKind
    from mbdkit.spec.study_measures import DefinedMeasure


class StrictSpec(Section):
    """Base class of all specs. Raises SpecError if the spec is not valid, with the key path."""

    EXPRESSIONS_IN: ClassVar[str] = ""
    """Section whose numbers may be expressions of `parameters`."""

    _document: Document | None = PrivateAttr(default=None)
    _numbers: dict[str, float] = PrivateAttr(default_factory=dict)
    _written: Written = PrivateAttr(default_factory=dict)
    _canonical: str = PrivateAttr(default="")

    @without_collection()
    def __init__(self, **data: object):
        plugins = RegistryLookup(lambda: registry_of(type(self)))

        def validate(values: object) -> None:
            # Every source is validated as JSON, because pydantic's strict mode accepts a list for a tuple only in JSON.
            text = json.dumps(values, allow_nan=False)
            try:
                self.__pydantic_validator__.validate_json(text, self_instance=self, context={"plugins": plugins})
            except ValidationError as error:
                if not _ITEMS.search(text) or not _complete_lists(values, error, type(self), plugins):
                    raise
                validate(values)

        try:
            values = plain(data)
            numbers = parameter_values(values.get("parameters")) if self.EXPRESSIONS_IN else {}
            if self.EXPRESSIONS_IN and isinstance(values.get("parameters"), Mapping):
                values["parameters"] = without_units(values["parameters"])
            section = (self.EXPRESSIONS_IN,)
            _, written = with_expressions(validate, values, type(self), numbers, section=section, plugins=plugins)
        except RecursionError:
            raise SpecError("this spec is nested too deeply, or contains itself") from None
        self._numbers, self._written = numbers, written

    @property
    def _private(self) -> Mapping[str, Any]:
        """The private attributes by name, which are read from here ten times as fast as from the model."""
        return self.__pydantic_private__ or {}

    @property
    def numbers(self) -> Mapping[str, float]:
        """The values of the parameters by name."""
        return self._numbers

    @property
    def written(self) -> Mapping[Path, WrittenText]:
        """The expressions that were given in place of numbers, by key path."""
        return cast(Written, self._private["_written"])

    def sections(self) -> dict[str, Any]:
        """Return the sections by name, with expressions as written."""
        sections = {name: getattr(self, name) for name in type(self).model_fields}
        held = self.EXPRESSIONS_IN
        if self._written:
            sections[held] = insert({held: canonical(sections[held])}, self._written)[held]
        return sections

    @model_serializer(mode="wrap")
    def _as_written(self, serialize: SerializerFunctionWrapHandler) -> object:
        data = serialize(self)
        return insert(plain(data), self._written) if self._written else data

    def placed(self, error: SpecError) -> SpecError:
        """Return an error about this spec with the file and line of its key, if the spec was read from a file."""
        return error if self._document is None else self._document.place(error)

    def canonical_json(self) -> str:
        """Return the spec as canonical JSON: with defaults, sorted option keys and the shortest form of each number.

        Expressions in place of numbers are not evaluated. Names given by the user (bodies, joints, forces) are not
        sorted, because the arrays of the archive have their order.
        """
        text: str = self._private["_canonical"]
        if not text:  # cached, because the model is frozen
            self._canonical = text = canonical_text(insert(canonical(self), self._written))
        return text

    def sha256(self) -> str:
        """Return the SHA-256 digest of the canonical JSON in UTF-8, in hexadecimal."""
        return hashlib.sha256(self.canonical_json().encode()).hexdigest()


#: JSON of items of a list that is left at its default, by index, such as ``{"0": 0.1}``; see `reading.put`.
_ITEMS = re.compile(r'\{"\d{1,9}": ')


def _complete_lists(data: Any, error: ValidationError, root: type[BaseModel], plugins: PluginLookup) -> bool:
    """Replace items of lists that are left at their defaults by the whole lists, in place.

    `error`: the error of the validation of the data, for which these items are mappings. Returns whether there are any.
    """
    is_changed = False
    for details in error.errors(include_url=False):
        items = details["input"]
        path, owner = walk(details["loc"], root, plugins) if items and are_items(items) else ((), None)
        fields = {} if owner is None else {info.alias or name: info for name, info in owner.model_fields.items()}
        if owner is None or path[-1] not in fields:
            continue
        default = canonical(fields[str(path[-1])].get_default(call_default_factory=True))
        holder = data
        for part in path[:-1]:
            holder = holder[part]
        if isinstance(default, list) and holder[path[-1]] == items:  # the location within a union is not known
            holder[path[-1]] = default
            for place, value in _leaves(items, path):
                put(data, place, value)
            is_changed = True
    return is_changed


def _leaves(items: Mapping[str, object], path: Path) -> Iterator[tuple[Path, object]]:
    """Yield key paths and values of items of a list, and of items of these."""
    for index, value in items.items():
        if value and are_items(value):
            yield from _leaves(cast(Mapping[str, object], value), (*path, index))
        else:
            yield (*path, index), value


class ModelSpec(StrictSpec):
    """Base class of the specs of runs and of inverse dynamics.

    Raises
    ------
    SpecError
        If the spec is not valid, with the key path.
    """

    model_config = ConfigDict(defer_build=True)  # building the schema of the model would import plugins

    EXPRESSIONS_IN: ClassVar[str] = "model"
    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ()
    """Keys that the canonical form omits if they have their default values.

    The spec in the archive of a plain run is therefore short.
    """

    mbdkit: FormatVersion
    """Version of the spec format."""
    title: Annotated[str, Field(max_length=LONGEST_TITLE)] = ""
    """Title of the run, free text."""
    meta: Meta = Meta()
    """Description, creator and licence, which archives name."""
    parameters: dict[str, float | str] = Field(default_factory=dict)
    """Named numbers. Any number of the model may be an expression of them, such as `0.5*crank`. Motions, events and
    other parameters, in any order, may also contain them. Angles may be written as `degrees(45)`. `from: FILE.h5` takes
    the estimates of an identification that the spec uses; numbers beside it take precedence."""
    estimates: Estimates | None = None
    """Which parameters are estimates, with their covariance. `parameters: {from: FILE.h5}` writes this section when a
    spec is loaded."""
    model: Annotated[BaseModel, Choice("model")]
    """The model: its name and its parameters."""

    _mechanism: Any = PrivateAttr(default=None)
    _run_id: str = PrivateAttr(default="")
    _files: FilesRead = PrivateAttr(default_factory=FilesRead)

    @property
    @abstractmethod
    def span(self) -> tuple[float, float] | None:
        """Start and end of the motion [s]; None if the spec does not give them."""

    @property
    @abstractmethod
    def items(self) -> list[Registered]:
        """The registry entries of everything that the spec selects, such as the model."""

    @abstractmethod
    def defined_measures(self) -> tuple[DefinedMeasure, ...]:
        """Return the measures of the result."""

    @property
    def estimated(self) -> Estimated | None:
        """The parameters that are estimates, with their covariance; None if there are none."""
        result = None if self.estimates is None else self.estimates.within(self.parameters)
        return result if result and result.names else None

    @property
    def recorded(self) -> frozenset[str]:
        """Groups of quantities that the archive contains in addition to the trajectory."""
        return frozenset(QUANTITIES)

    @property
    def checks_measures(self) -> bool:
        """Whether comparison runs estimate the errors of measures."""
        return False

    @property
    def undecided(self) -> str:
        """Clause on why errors of measures are unknown if the errors of the motion are not known to its end; empty if
        they are known.
        """
        return ""

    @property
    def spec_kind(self) -> SpecKind:
        """The kind of the spec, which says how its runs are computed and differentiated."""
        return kind_of(self.sections())

    @property
    def event_names(self) -> tuple[str, ...]:
        """Names of the events."""
        return ()

    @property
    def actuator_units(self) -> Mapping[str, str]:
        """Units of the values of the actuators that inverse dynamics may have, N or N m, by name."""
        return {}

    @property
    def result_names(self) -> Mapping[str, Sequence[str]]:
        """Names of the objects of results that are no elements of the mechanism, by the word of their kind."""
        return {}

    @property
    def model_item(self) -> Registered:
        """The registry entry of the model, including its origin."""
        return item_of(self.model)

    @property
    def model_plugin(self) -> ModelPlugin:
        """The model plugin."""
        return cast(ModelPlugin, self.model_item.plugin)

    @property
    def force_law_items(self) -> list[Registered]:
        """The registry entries of the force laws that the mechanism uses, without duplicates, sorted by full name."""
        laws = {item_of(force) for force in self.mechanism().forces.values() if isinstance(force, Law)}
        return sorted(laws, key=lambda item: item.id)

    def _in_terms_of(self, text: str, texts: Mapping[str, str]) -> str:
        """Return an expression of parameters with texts in place of some, by name, also where others contain these."""
        return in_terms_of(text, texts, self.parameters, self.numbers)

    def mechanism(self) -> Mechanism:
        """Return the mechanism that the model builds from its parameters; it is built once and cached.

        Raises SpecError if the parameters do not define a valid mechanism, or if another section does not fit the
        mechanism, such as an event that refers to an unknown quantity. Raises PluginError if the model plugin fails.
        """
        built: Mechanism | None = self._private["_mechanism"]  # called ten times for each run
        if built is None:
            with self.recording_files():
                built = self._build()
            self.adopt(built)
        return built

    def adopt(self, mechanism: Mechanism, files: Iterable[FileRead] = ()) -> None:
        """Take a mechanism, such as that in an archive, as the one that the model builds from `files`. Raises SpecError
        if the other sections are not compatible with it.
        """
        self._accept(mechanism)
        self._mechanism = mechanism
        self._files.update(dict.fromkeys(files))

    @property
    def folder(self) -> FilePath:
        """Folder to which names of files are relative: the folder of the spec, or else the current folder."""
        return FilePath() if self._document is None else self._document.folder

    @property
    def files_read(self) -> tuple[FileRead, ...]:
        """The files that were read so far for the mechanism and the data."""
        return tuple(self._files)

    def recording_files(self) -> AbstractContextManager[None]:
        """Return a context in which the files that are read are added to `files_read`."""
        return recording(self._files)

    def extends(self, key: ModelKey) -> bool:
        """Return whether the values of a key of models are part of the mechanism."""
        return True

    def _accept(self, mechanism: Mechanism) -> None:
        """Raise SpecError if the other sections are not compatible with the mechanism."""

    def _build(self) -> Mechanism:
        from mbdkit.engine.native.levels import chosen_level
        from mbdkit.mechanism.mechanism import Mechanism

        chosen_level()  # refuses a wrong MBDKIT_PROCESSOR, for which no model is to blame
        try:
            with blaming(f"model {self.model_item.id} failed to build"):
                mechanism: Any = self._built()
            if isinstance(mechanism, Mechanism) and self.span is not None:
                mechanism.check_span(*self.span)
        except SpecError as error:
            is_located = error.key.startswith(("model", "controls.", "parameters."))
            raise error if is_located else error.located(prefix="model") from None
        if not isinstance(mechanism, Mechanism):
            raise PluginError(f"model {self.model_item.id} built {type(mechanism).__name__}, not a Mechanism")
        return mechanism

    def _built(self) -> Any:
        try:
            mechanism = self.model_plugin.build(self.model)
            for name, key in model_keys(self.model_item).items():
                if self.extends(key) and (values := getattr(self.model, name, None)):
                    model_extension.of(key.extend)(values, cast("Mechanism", mechanism))
                    cast("Mechanism", mechanism).validate()
            return mechanism
        except (ArithmeticError, RuntimeWarning, ValidationError) as error:
            kinds = {one["type"] for one in error.errors()} if isinstance(error, ValidationError) else set()
            if kinds - {"finite_number"} or self.model_item.origin.distribution != "mbdkit":
                raise
            raise SpecError("a parameter is so large or so small that numbers overflow", key="model") from None

    def run_id(self) -> str:
        """Return 16 hexadecimal digits that identify this spec and the versions of the plugins it uses."""
        identifier: str = self._private["_run_id"]
        if not identifier:
            self._run_id = identifier = self._identifier()
        return identifier

    def _identifier(self) -> str:
        used = [f"{item.id}=={item.origin.version}" for item in self.items]
        return hashlib.sha256("\n".join([self.canonical_json(), *used]).encode()).hexdigest()[:16]


_CHOSEN: tuple[Kind, ...] = ("model", "integrator")  #: Kinds of plugin that a spec selects by name.

S = TypeVar("S", bound=ModelSpec)


def choosing_from(installed: Registry, base: type[S]) -> type[S]:
    """Return a class of specs that selects from the given registry instead of the installed plugins."""
    fields: dict[str, Any] = {
        kind: (Annotated[BaseModel, Choice(kind, installed)], Field(description=description(base, kind)))
        for kind in _CHOSEN
        if kind in base.model_fields
    }
    return create_model(base.__name__, __base__=base, __module__=base.__module__, __doc__=base.__doc__, **fields)
