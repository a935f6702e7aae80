"""Classes of the items with which a plugin adds elements to mechanisms, and groups of quantities to archives."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from mbdkit.base.errors import PluginError
from mbdkit.registry.feature_items import Feature
from mbdkit.registry.item import Item
from mbdkit.registry.target import Target


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ElementKind(Feature):
    """A kind of elements of mechanisms: a key of the model ``mechanism`` with elements by name.

    Parameters
    ----------
    name
        Word for one element, such as ``muscle``.
    summary
        Description of the key in the schema of specs.
    order
        Elements of kinds of lower order are compiled first, which numbers their force elements and states: forces 0,
        friction in joints 200, expressions 900.
    key_in_model
        Key of the model, and attribute of `mbdkit.Mechanism`, such as ``muscles``.
    model
        Class of the elements, derived from `mbdkit.plugin.Element`.
    builder
        Name of the method of `mbdkit.Mechanism` that adds an element; empty if there is only `add`.
    method
        This method, a function whose first argument is the mechanism; by default, it takes the name of the element and
        the fields of `model` by name.
    section
        Key of the section of run specs that chooses how a run treats the elements; empty if there is none.
    section_model
        Class of this section, derived from `mbdkit.plugin.StrictModel`. All its fields have default values, and the
        first one is `treatment`, whose annotation is `mbdkit.plugin.TreatmentName`.
    only_in_runs
        Whether the elements act only in runs, and are ignored by equilibria and inverse dynamics.
    in_expressions
        Quantities that expressions of the state may contain, ``length``, ``rate`` or ``tension`` of the force element
        along a pathway, by the name in the expression.
    read_files
        Function that takes plain data of elements by name and the folder of the spec, and replaces in these data what
        specs give by the names of files.
    check_elements
        Function that takes elements by name, a mechanism or its data, and the beginning of key paths, and raises
        SpecError for elements that do not fit the other elements.
    check_run
        Function that takes the mechanism of a run, with its `treatments`, and raises SpecError for elements that the
        run does not support.
    forces
        Function that takes elements by name and returns force elements with laws along pathways by name, as
        `mbdkit.plugin.LawForce` describes. The elements act by these forces. By default, without `lower`, these are the
        elements themselves, which may be derived from `mbdkit.plugin.LineForce`.
    lower
        Function that takes elements by name, the `mbdkit.plugin.Lowering`, and the compiled `forces`, a tuple of
        `mbdkit.plugin.ActingForce`; it adds further forces and states, and returns what
        `CompiledMechanism.extensions` holds under `key_in_model`. By default, it holds the tuple.
    lower_expressions
        Function that takes this object and the `Lowering`, adds expressions of the state, and returns a new object. It
        must not add states.
    at_start
        Function that takes this object, the mechanism, the time [s] and the positions (B, 3) after assembly, and
        returns initial values of states by their index.
    members
        Function that takes this object and returns names and bodies of what archives record; by default, those of the
        elements.
    obstacle
        Function that takes this object, a `mbdkit.plugin.Workspace`, a time, positions and velocities at which a step
        failed, and returns a clause that names an element that cannot have this position, or an empty text.
    stiffest
        Function that takes this object and returns a clause that names an element for which explicit methods need small
        steps, or an empty text.
    sides
        Function that takes this object and a function that returns the indices in ``Topology.law_parameters`` of the
        parameters of a law, their number first. It returns the discontinuities of its laws, at which steps with
        derivatives end: objects like `mbdkit_gradients.law_corners.FurtherCondition`.
    gradient_doubts
        Function that takes this object and returns doubts about derivatives of runs.
    draw
        Function that takes a mechanism and an element, and returns lines to draw: lists of bodies and points in their
        frames [m]. By default, elements between two points are drawn as a line.
    example
        Name of a packaged example, a run of a mechanism with such elements, on which ``mbdkit plugins verify`` checks
        the kind.
    supports
        Sentences that refuse what the elements do not support, ``gradients`` or ``statics``, by its name.
    """

    kind: ClassVar[str] = "element-kind"
    key: ClassVar[str] = "model"

    key_in_model: str
    model: Target[type[Any]]
    builder: str = ""
    method: Target[Callable[..., Any]] | None = None
    section: str = ""
    section_model: Target[type[Any]] | None = None
    only_in_runs: bool = False
    in_expressions: Mapping[str, str] = field(default_factory=dict)
    read_files: Target[Callable[[Mapping[str, Any], Path], None]] | None = None
    check_elements: Target[Callable[[Mapping[str, Any], Any, str], None]] | None = None
    check_run: Target[Callable[[Any], None]] | None = None
    forces: Target[Callable[[Mapping[str, Any]], Mapping[str, Any]]] | None = None
    lower: Target[Callable[[Mapping[str, Any], Any, tuple[Any, ...]], Any]] | None = None
    lower_expressions: Target[Callable[[Any, Any], Any]] | None = None
    at_start: Target[Callable[..., Mapping[int, float]]] | None = None
    members: Target[Callable[[Any], Iterable[tuple[str, tuple[str, ...]]]]] | None = None
    obstacle: Target[Callable[..., str]] | None = None
    stiffest: Target[Callable[[Any], str]] | None = None
    sides: Target[Callable[[Any, Callable[[int], Any]], Iterable[Any]]] | None = None
    gradient_doubts: Target[Callable[[Any], Iterable[str]]] | None = None
    draw: Target[Callable[[Any, Any], list[list[tuple[str, tuple[float, float]]]]]] | None = None
    example: str = ""
    supports: Mapping[str, str] = field(default_factory=dict)

    def _check_key_in_model(self) -> None:
        for name in (self.key_in_model, self.builder or self.key_in_model):
            if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
                raise PluginError(f"the name {name!r} is not a letter followed by letters, digits and _")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class QuantityKind(Feature):
    """A kind of objects with quantities, which are a group of the archives of runs that have such objects.

    The module of the kind is imported only for such runs and archives.

    Parameters
    ----------
    target
        The `mbdkit.plugin.Kind`: its arrays, and how they are computed. It and its arrays are optional.
    group
        Name of the group; by default, that of the item.
    word
        Attribute of `Run` with the histories of the objects by name, and word for the kind in expressions; empty if
        there is neither.
    of
        Elements of mechanisms whose presence in a run makes it record the group: a key of
        `mbdkit.quantities.names.ArchiveNames.members`; by default, the group.
    names
        Function that takes a mechanism with such elements and returns the names of the objects; by default, those of
        the elements.
    peaks
        Quantities of which checked runs determine the largest values between their rows as well, such as
        ``normal_force``; of the negative quantity after a minus sign. The first one is a force: its largest values
        are compared with those of other runs, and their errors count in the verdict.
    modes
        Array of modes of the objects, at whose changes forces may be discontinuous.
    history
        Class of the history of an object, derived from `mbdkit.archive.named_columns.View` with the group as argument
        ``of``; by default, a class that has only the columns of the arrays.
    """

    kind: ClassVar[str] = "quantity"
    key: ClassVar[str] = "group"

    target: Target[Any]
    group: str = ""
    word: str = ""
    of: str = ""
    names: Target[Callable[[Any], list[str]]] | None = None
    peaks: tuple[str, ...] = ()
    modes: str = ""
    history: Target[type[Any]] | None = None

    def __post_init__(self) -> None:
        """Set names that are not given."""
        object.__setattr__(self, "group", self.group or self.name)
        object.__setattr__(self, "of", self.of or self.group)

    def _check_group(self) -> None:
        if not str(self.group).isidentifier():
            raise PluginError(f"its group {self.group!r} is not made of letters, digits and _")

    def _check_word(self) -> None:
        if not isinstance(self.word, str) or (self.word and not self.word.isidentifier()):
            raise PluginError(f"its word {self.word!r} is not made of letters, digits and _")

    def check_targets(self) -> None:
        """Check the kind, and that the class of histories exists; raises PluginError."""
        Item.check_targets(self)
        self.checked_kind()

    def checked_kind(self) -> Any:
        """Return the kind, which must have the group and the word of the item; raises PluginError."""
        for name in ("group", "word"):
            if (value := getattr(self.target(), name, None)) != getattr(self, name):
                raise PluginError(f"the {name} of its kind is {value!r}, not {getattr(self, name)!r}")
        return self.target()
