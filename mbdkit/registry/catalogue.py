"""The registry: installed items by kind and name, and a report on every attempt to load one."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, WithJsonSchema, create_model

from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import STRICT
from mbdkit.base.text import did_you_mean, listed
from mbdkit.registry.items import ITEM_CLASSES, Plugin
from mbdkit.registry.policy import normalized_name

Kind = str
"""Kind of a plugin: a key of `KINDS`."""

KINDS: dict[Kind, type[Plugin]] = {item_class.kind: item_class for item_class in ITEM_CLASSES}
"""The item class of each kind."""


@dataclass(frozen=True)
class Origin:
    """Origin of an item: its distribution, the version of the distribution, and the entry point."""

    distribution: str
    version: str
    entry_point: str


@dataclass(frozen=True)
class Registered:
    """An item in the registry with its kind and origin."""

    kind: Kind
    plugin: Plugin
    origin: Origin

    @property
    def name(self) -> str:
        """The short name."""
        return self.plugin.name

    @property
    def id(self) -> str:
        """The full id, ``distribution:name``."""
        return f"{self.origin.distribution}:{self.plugin.name}"

    @property
    def spec_name(self) -> str:
        """The name in a canonical spec: the short name for mbdkit's own items, the full id for all others."""
        return self.name if self.origin.distribution == "mbdkit" else self.id


@dataclass(frozen=True)
class Report:
    """Result of loading an entry point or one of its items, for ``mbdkit plugins list`` and ``doctor``.

    `status` is ``ok``, ``clash`` (two distributions use the short name; the full id is still valid), ``error``, or
    ``disabled`` (an environment variable excludes the distribution, which was not imported). `kind` is None if the
    report concerns an entry point as a whole, which is disabled or failed. `seconds` is the loading time of the entry
    point.
    """

    id: str
    kind: Kind | None
    origin: Origin
    status: Literal["ok", "clash", "error", "disabled"]
    error: str | None
    seconds: float


class Registry:
    """All items that could be loaded, and reports on all attempts.

    Parameters
    ----------
    items
        Loaded items; ids are unique within a kind.
    reports
        One report for each item, for each failure, and for each disabled entry point.
    """

    def __init__(self, items: Iterable[Registered], reports: Iterable[Report] = ()):
        self.items = tuple(items)
        self._reports = tuple(reports)

    @property
    def reports(self) -> tuple[Report, ...]:
        """Reports on items, failures and disabled entry points, with clashes of short names marked."""
        return tuple(self._with_clash(report) for report in self._reports)

    @property
    def failures(self) -> tuple[Report, ...]:
        """Reports on the items and entry points that could not be loaded."""
        return tuple(report for report in self._reports if report.status == "error")

    @property
    def distributions(self) -> set[str]:
        """Names of all distributions with an entry point, whether it was loaded or not."""
        return {report.origin.distribution for report in self._reports}

    def has_distribution(self, name: str) -> bool:
        """Return whether an item of a distribution was loaded.

        Parameters
        ----------
        name
            Name of the distribution. As in package indices, case is ignored, and dots, dashes and underscores are
            equal.
        """
        return normalized_name(name) in {normalized_name(item.origin.distribution) for item in self.items}

    def of_kind(self, kind: Kind) -> tuple[Registered, ...]:
        """Return the items of one kind."""
        return tuple(item for item in self.items if item.kind == kind)

    def only(self, distribution: str) -> Registry:
        """Return a registry with the items of one distribution only."""
        return Registry(
            (item for item in self.items if item.origin.distribution == distribution),
            (report for report in self._reports if report.origin.distribution == distribution),
        )

    def names(self, kind: Kind) -> list[str]:
        """Return the names of the items of one kind: the short name if it is unique, otherwise the full id."""
        return [item.id if len(self._namesakes(kind, item.name)) > 1 else item.name for item in self.of_kind(kind)]

    def accepted(self, item: Registered) -> list[str]:
        """Return every name that a spec may use for this item."""
        return [item.id] if len(self._namesakes(item.kind, item.name)) > 1 else [item.name, item.id]

    def get(self, kind: Kind, name: str) -> Registered:
        """Return the item of this kind with a short name or full id.

        Raises
        ------
        SpecError
            If there is no such item, or if several distributions use the short name.
        """
        namesakes = self._namesakes(kind, name)
        label, key = KINDS[kind].label(), KINDS[kind].key
        if len(namesakes) > 1:
            owners = listed([f"{item.origin.distribution} {item.origin.version}" for item in namesakes], "and")
            ids = listed([f"'{item.id}'" for item in namesakes], "or")
            raise SpecError(f"the {label} name '{name}' is used by {owners}; write {ids}", key=key)
        if namesakes:
            return namesakes[0]
        for item in self.of_kind(kind):
            if item.id == name:
                return item
        names = self.names(kind)
        message = f"there is no {label} '{name}'{did_you_mean(name, names)}; installed: {listed(names) or 'none'}"
        if self.failures:
            broken = listed([f"'{report.id}'" for report in self.failures], "and")
            message += f"; not loaded: {broken} (see `mbdkit plugins doctor`)"
        raise SpecError(message + self.advice(name), key=key)

    def advice(self, name: str) -> str:
        """Return the reason why the distribution in a full id is not loaded, as the end of an error message.

        The result is empty if `name` is not a full id, or if the distribution is installed and not excluded.
        """
        distribution, colon, _ = name.partition(":")
        here = [report for report in self._reports if report.origin.distribution == distribution]
        if not colon or not distribution:
            return ""
        if not here:
            return f"; '{name}' is provided by the distribution {distribution}, which is not installed"
        reasons = dict.fromkeys(report.error for report in here if report.status == "disabled" and report.error)
        return f"; {distribution} is {listed(reasons, 'and')}" if reasons else ""

    def _namesakes(self, kind: Kind, name: str) -> list[Registered]:
        return [item for item in self.of_kind(kind) if item.name == name]

    def _with_clash(self, report: Report) -> Report:
        if report.status != "ok" or report.kind is None:
            return report
        name = report.id.partition(":")[2]
        others = [item for item in self._namesakes(report.kind, name) if item.id != report.id]
        if not others:
            return report
        owners = listed([f"{item.origin.distribution} {item.origin.version}" for item in others], "and")
        error = f"the short name '{name}' is also used by {owners}; write the long id '{report.id}'"
        return Report(report.id, report.kind, report.origin, "clash", error, report.seconds)


@functools.cache
def named_options(item: Registered) -> type[BaseModel]:
    """Return the class of the item's options with the additional field for the name of the item.

    The class is strict and frozen even if the class of the plugin is not.
    """
    options: type[BaseModel] = create_model(
        class_name(f"{item.name} {item.kind}"),
        __base__=type(
            "Options",
            (item.plugin.options,),
            {"__module__": __name__, "model_config": ConfigDict(**STRICT, title=item.name)},
        ),
        __doc__=item.plugin.summary,
        **{item.plugin.name_key: (name_type(item), Field(description=item.plugin.summary))},  # type: ignore[call-overload]
    )
    options.__mbdkit_item__ = item  # type: ignore[attr-defined]
    return options


def name_type(item: Registered) -> Any:
    """Return the type of the key that names the item in a spec.

    The type accepts any name of the item, and converts it to the canonical one.
    """
    names = dict.fromkeys([item.spec_name, item.name, item.id])
    return Annotated[
        str,
        AfterValidator(lambda _: item.spec_name),
        WithJsonSchema({"type": "string", "enum": list(names)}),
    ]


def class_name(name: str) -> str:
    """Return a name in CamelCase."""
    return "".join(word.capitalize() for word in re.split(r"[^A-Za-z0-9]+", name))


def item_of(options: BaseModel | type[BaseModel]) -> Registered:
    """Return the registered item whose options these are."""
    item: Registered = options.__mbdkit_item__  # type: ignore[union-attr]
    return item


def is_of_item(options: type[BaseModel]) -> bool:
    """Return whether these are the options of a registered item."""
    return hasattr(options, "__mbdkit_item__")
