"""Classes of the items with which a plugin adds elements to mechanisms, and groups of quantities to archives."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, ClassVar

from mbdkit.base.errors import PluginError
from mbdkit.base.frozen import dataclass, field
from mbdkit.registry.feature_items import Feature, check_identifier
from mbdkit.registry.item import Item, described, seams_of
from mbdkit.registry.target import Target


@dataclass(frozen=True, kw_only=True)
class ElementForces:
    """How elements act in runs, a part of an `ElementKind`.

    Parameters
    ----------
    only_in_runs
        Whether the elements act only in runs, and are ignored by equilibria and inverse dynamics.
    check_run
        Function that raises SpecError for elements that the run does not support.
    forces
        Function that returns force elements with laws along pathways. By default, without `lower`, these are the
        elements themselves, which may be derived from `mbdkit.plugin.LineForce`.
    lower
        Function that adds further forces and states, and returns what `CompiledMechanism.extensions` holds under
        `key_in_model`, the *handle*; by default, this is the tuple of the forces.
    lower_expressions
        Function that adds expressions of the state, and returns a new handle.
    members
        Function that returns names and bodies of what archives record; by default, those of the elements.
    """

    only_in_runs: bool = False
    check_run: Annotated[Target | None, "run_check"] = None
    forces: Annotated[Target | None, "element_forces"] = None
    lower: Annotated[Target | None, "lowering"] = None
    lower_expressions: Annotated[Target | None, "expression_lowering"] = None
    members: Annotated[Target | None, "recorded_members"] = None


@dataclass(frozen=True, kw_only=True)
class ElementFailures:
    """Explanations of failed steps by elements, a part of an `ElementKind`.

    Parameters
    ----------
    obstacle
        Function that names an element that cannot have the positions at which a step failed.
    stiffest
        Function that names an element for which explicit methods need small steps.
    """

    obstacle: Annotated[Target | None, "obstacle_clause"] = None
    stiffest: Annotated[Target | None, "stiffness_clause"] = None


@dataclass(frozen=True, kw_only=True)
class ElementDerivatives:
    """What runs with derivatives need of elements, a part of an `ElementKind`.

    Parameters
    ----------
    sides
        Function that returns the discontinuities of laws, at which steps with derivatives end.
    doubts
        Function that returns doubts about derivatives of runs.
    """

    sides: Annotated[Target | None, "law_sides"] = None
    doubts: Annotated[Target | None, "gradient_doubts"] = None


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
    in_expressions
        Quantities that expressions of the state may contain, ``length``, ``rate`` or ``tension`` of the force element
        along a pathway, by the name in the expression; ``normal.tension`` is that of the force element with the name of
        the element and ``.normal``.
    read_files
        Function that replaces in plain data of elements what specs give by the names of files.
    check_elements
        Function that raises SpecError for elements that do not fit the other elements.
    acts
        How the elements act in runs.
    at_start
        Function that returns initial values of states that follow from the positions after assembly.
    failures
        Explanations of failed steps.
    derivatives
        What runs with derivatives need.
    draw
        Function that returns lines to draw; by default, elements between two points are drawn as a line.
    example
        Name of a packaged example, a run of a mechanism with such elements, on which ``mbdkit plugins verify`` checks
        the kind.
    supports
        Sentences that refuse what the elements do not support, ``gradients`` or ``statics``, by its name.
    """

    kind: ClassVar[str] = "element-kind"
    key: ClassVar[str] = "model"

    key_in_model: str
    model: Target
    builder: str = ""
    method: Target | None = None
    section: str = ""
    section_model: Target | None = None
    in_expressions: Mapping[str, str] = field(default_factory=dict)
    read_files: Annotated[Target | None, "element_files"] = None
    check_elements: Annotated[Target | None, "element_check"] = None
    acts: ElementForces = ElementForces()
    at_start: Annotated[Target | None, "start_values"] = None
    failures: ElementFailures = ElementFailures()
    derivatives: ElementDerivatives = ElementDerivatives()
    draw: Annotated[Target | None, "element_lines"] = None
    example: str = ""
    supports: Mapping[str, str] = field(default_factory=dict)

    def targets(self) -> dict[str, Target]:
        """Return the targets by the names of their fields, also those of parts, such as ``acts.lower``."""
        return super().targets() | {
            f"{part}.{name}": target
            for part in ("acts", "failures", "derivatives")
            for name, target in vars(getattr(self, part)).items()
            if isinstance(target, Target)
        }

    def seam_of(self, field: str) -> str:
        """Return the decorator for the function behind a field, also of a part."""
        part, _, name = field.rpartition(".")
        return seams_of(type(getattr(self, part)))[name] if part else super().seam_of(field)

    def check(self) -> None:
        """Also check the classes of the parts; raises PluginError."""
        super().check()
        for name, part in (("acts", ElementForces), ("failures", ElementFailures), ("derivatives", ElementDerivatives)):
            if not isinstance(value := getattr(self, name), part):
                raise PluginError(f"its `{name}` is {described(value)}, not {part.__name__}(...)")

    def _check_key_in_model(self) -> None:
        for name in (self.key_in_model, self.builder or self.key_in_model):
            if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
                raise PluginError(f"the name {name!r} is not a letter followed by letters, digits and _")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JointKind(Feature):
    """A type of joints of two bodies whose constraints are functions of their relative pose, such as a pair of gears.

    Parameters
    ----------
    name
        Value of the key `type` of such joints, such as ``gear``. With underscores in place of dashes, it is also the
        name of the method of `mbdkit.Mechanism` that adds one.
    summary
        One line that describes the joint.
    model
        Class of the joints, derived from `mbdkit.plugin.FunctionJoint`.
    check_elements
        Function that raises SpecError for joints of this type that do not fit the other elements.
    example
        Name of a packaged example, a run of a mechanism with such a joint, on which ``mbdkit plugins verify`` checks
        the kind.
    """

    kind: ClassVar[str] = "joint-kind"
    key: ClassVar[str] = "type"

    model: Target
    check_elements: Annotated[Target | None, "element_check"] = None
    example: str = ""

    @property
    def builder(self) -> str:
        """Name of the method of `mbdkit.Mechanism` that adds such a joint."""
        return self.name.replace("-", "_")

    def _check_name(self) -> None:
        if not self.builder.isidentifier():
            raise PluginError(f"the name {self.name!r} is not made of letters, digits and -")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ModelKey(Feature):
    """A key of every model, such as ``devices``, with values by name that extend the mechanism which the model builds.

    Parameters
    ----------
    name
        The key. Models that have a parameter of this name do not get the key.
    summary
        Description of the key in the schema of specs.
    model
        Class of the values, derived from `mbdkit.plugin.StrictModel`.
    extend
        Function that adds elements to the mechanism.
    read_files
        Function that replaces in plain data of the values what specs give by the names of files.
    follow
        Function that returns a value of the key as a `mbdkit.plugin.runs.Follower`, whose bodies follow a measured
        motion of the mechanism, for specs of inverse dynamics with ``follows: dynamics``.
    """

    kind: ClassVar[str] = "model-key"
    key: ClassVar[str] = "model"

    model: Target
    extend: Annotated[Target, "model_extension"]
    read_files: Annotated[Target | None, "element_files"] = None
    follow: Annotated[Target | None, "follower"] = None

    _check_name = check_identifier


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class QuantityKind(Feature):
    """A kind of objects with quantities, which are a group of the archives of runs that have such objects.

    The module of the kind is imported only for such runs and archives.

    Parameters
    ----------
    target
        The object that `mbdkit.plugin.quantity_group` returns: its arrays, and how they are computed. It and its
        arrays are optional.
    group
        Name of the group; by default, that of the item.
    word
        Attribute of `Run` with the histories of the objects by name, and word for the kind in expressions; empty if
        there is neither.
    of
        Elements of mechanisms whose presence in a run makes it record the group: a key of
        `mbdkit.quantities.names.ArchiveNames.members`; by default, the group.
    names
        Function that returns the names of the objects of a mechanism; by default, those of the elements.
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

    target: Target
    group: str = ""
    word: str = ""
    of: str = ""
    names: Annotated[Target | None, "member_names"] = None
    peaks: tuple[str, ...] = ()
    modes: str = ""
    history: Target | None = None

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

    def checked_kind(self) -> object:
        """Return the kind, which must have the group and the word of the item; raises PluginError."""
        for name in ("group", "word"):
            if (value := getattr(self.target(), name, None)) != getattr(self, name):
                raise PluginError(f"the {name} of its kind is {value!r}, not {getattr(self, name)!r}")
        return self.target()
