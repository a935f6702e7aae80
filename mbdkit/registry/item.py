"""Base classes of the items that plugins offer."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from types import EllipsisType
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar, cast, get_type_hints

from mbdkit.base.errors import PluginError
from mbdkit.base.frozen import dataclass, field
from mbdkit.registry.seam import Arguments, check_marked, fitted
from mbdkit.registry.target import Target

if TYPE_CHECKING:
    from pydantic import BaseModel

T = TypeVar("T")

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True, eq=False, repr=False)
class Item:
    """Base of the items that plugins offer; the class of an item is its kind.

    `name`: short name. `summary`: one line that describes the item. `order`: position among the items of its kind;
    items of the same order keep the order in which they are loaded. `pure`: whether the code of the item computes its
    results from its arguments alone, and uses their numbers only in ``+ - * / // % **``, comparisons, ``abs``, ``min``,
    ``max`` and the functions of `mbdkit.plugin.equations.elementary`. This permits mbdkit to replace calls by formulas
    that it records once, and to keep results, in runs that differ in numbers only (``mbdkit.prepare``,
    ``mbdkit.ensemble``, repeated runs of a mapping). Anything else that code does with a recorded number, such as
    ``float(x)``, a key of a dictionary, an array or a text, ends the recording, and the runs are computed one by one,
    as those with code that is not `pure` always are. Purity is not checked otherwise: code that also depends on files,
    random numbers or its earlier calls must not claim it.

    A new kind needs a subclass with the class attributes below and an entry in `ITEM_CLASSES`. The hook `mbdkit_items`
    returns items of every kind. All kinds are loaded, named and listed in the same way, and their errors are reported
    in the same way.

    Items are light: code that they need is named by a `Target`, which is imported when it is first used.
    """

    kind: ClassVar[str]
    """Name of the kind, such as ``force-law``."""
    hook: ClassVar[str] = "mbdkit_items"
    """Name of the hook that returns a list of such items."""
    key: ClassVar[str]
    """Key in a spec whose value names such an item, or another word for its place; error messages mention it."""
    is_reserved: ClassVar[bool] = True
    """Whether a short name that mbdkit uses keeps its meaning when another distribution uses it too."""
    arguments: ClassVar[Mapping[str, Arguments]] = {}
    """Arguments of the functions in fields that are `Given`, which need no decorator if they are not targets."""

    name: str
    summary: str
    order: int = field(default=500, kw_only=True)
    pure: bool = field(default=False, kw_only=True)

    @property
    def full_name(self) -> str:
        """The name that only one item of this kind and distribution has."""
        return self.name

    @classmethod
    def label(cls) -> str:
        """Return the name of the kind as it is written in sentences."""
        return cls.kind.replace("-", " ")

    def check(self) -> None:
        """Check the fields, because a plugin may pass any objects; objects behind targets are not imported.

        Raises
        ------
        PluginError
            If a field has the wrong type.
        """
        if not isinstance(self.name, str) or not NAME.fullmatch(self.name):
            raise PluginError(f"the name {self.name!r} is not made of letters, digits and . _ -")
        if not isinstance(self.summary, str) or "\n" in self.summary:
            raise PluginError("its summary is not one line of text")
        if not isinstance(self.order, int) or isinstance(self.order, bool):
            raise PluginError(f"its order is {described(self.order)}, not a whole number")
        if not isinstance(self.pure, bool):
            raise PluginError(f"its `pure` is {self.pure!r}, not True or False")
        self._check_fields(name for name, value in vars(self).items() if not isinstance(value, Target))

    def check_targets(self) -> None:
        """Import the objects behind the targets and check them; raises PluginError.

        Called by ``mbdkit plugins doctor``, by the conformance kit, and when the item is first used.
        """
        targets = self.targets()
        for name, target in targets.items():
            target()
            if seam := self.seam_of(name):
                check_marked(target, seam, name)
        self._check_fields(targets)

    def targets(self) -> dict[str, Target]:
        """Return the targets by the names of their fields."""
        return {name: value for name, value in vars(self).items() if isinstance(value, Target)}

    def seam_of(self, field: str) -> str:
        """Return the decorator of `mbdkit.plugin.seams` for the function behind a field; empty if there is none."""
        return self.arguments[field].seam if field in self.arguments else ""

    def _check_fields(self, names: Iterable[str]) -> None:
        for name in names:
            if (check := getattr(self, f"_check_{name}", None)) is not None:
                check()
            elif name in self.arguments and not callable(getattr(self, name)):
                raise PluginError(f"its `{name}` cannot be called")

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash((type(self), self.name))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r})"


def _seams_of(owner: type) -> Mapping[str, str]:
    hints = get_type_hints(owner, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items() if hasattr(hint, "__metadata__")}


#: Returns the decorators that annotations such as ``Annotated[Target, "model_extension"]`` name, by field of a class.
seams_of: Callable[[type], Mapping[str, str]] = cache(_seams_of)


class Given(Generic[T]):
    """A field that is given as an object or as a `Target` of it; reading the field returns the object in both cases.

    `default`: value of the field if it is not given; `...` if it must be given.
    """

    def __init__(self, default: T | EllipsisType = ...):
        self.default = default

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, item: object, kind: type | None = None) -> T:
        if item is None:  # dataclasses read the default of a field here, if it has one
            if isinstance(self.default, EllipsisType):
                raise AttributeError(self.name)
            return self.default
        value = vars(item)[self.name]
        thing = value() if isinstance(value, Target) else value
        plugin = cast(Item, item)
        if not callable(thing) or (arguments := plugin.arguments.get(self.name)) is None:
            return cast(T, thing)
        owner = value if isinstance(value, Target) else f"`{self.name}` of the {plugin.label()} '{plugin.name}'"
        return cast(T, fitted(thing, arguments, owner))

    def __set__(self, item: object, value: T | Target) -> None:
        vars(item)[self.name] = value


class Plugin(Item):
    """Base of the kinds that have hooks of their own. Fields whose types are `Given` may be targets."""

    name_key: ClassVar[str] = "name"
    """Key in a spec that gives the name of the item; the options of the item are further keys beside it."""
    is_reserved: ClassVar[bool] = False
    added: ClassVar[Mapping[str, Target]] = {}
    """Keys that mbdkit itself adds to the options of every item of the kind: type and field of each, for pydantic."""

    if TYPE_CHECKING:

        @property
        def options(self) -> type[BaseModel]:
            """Pydantic model of the options."""

        @property
        def references(self) -> tuple[str, ...]:
            """BibTeX entries of the sources."""

    def claimed(self) -> Mapping[str, object]:
        """Return the claims of the item with default options, by name; empty if the item makes no claims."""
        return {}

    def _check_options(self) -> None:
        from pydantic import BaseModel

        if not isinstance(self.options, type) or not issubclass(self.options, BaseModel):
            raise PluginError(f"its options are {described(self.options)}, not a class derived from pydantic.BaseModel")

    def _check_references(self) -> None:
        if not isinstance(self.references, tuple) or not all(isinstance(entry, str) for entry in self.references):
            raise PluginError("its references are not a tuple of texts")


def described(thing: object) -> str:
    """Return a noun phrase for the class of an object, as a part of an error message."""
    if isinstance(thing, type):
        return f"the class {thing.__name__}"
    return "nothing" if thing is None else f"an object of type {type(thing).__name__}"
