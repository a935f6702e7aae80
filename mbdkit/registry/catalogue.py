"""The registry: installed items by kind and name, and a report on every attempt to load one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import groupby
from operator import attrgetter
from typing import Literal

from mbdkit.base.distributions import MBDKIT, normalized_name
from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass, replace
from mbdkit.base.text import did_you_mean, listed
from mbdkit.registry.element_items import ElementKind, JointKind, ModelKey, QuantityKind
from mbdkit.registry.feature_items import FEATURES
from mbdkit.registry.item import Item, Plugin
from mbdkit.registry.items import ITEM_CLASSES

Kind = str  #: Kind of a plugin: a key of `KINDS`.

_CLASSES: tuple[type[Item], ...] = (*ITEM_CLASSES, *FEATURES, ElementKind, JointKind, ModelKey, QuantityKind)
#: The item class of each kind.
KINDS: dict[Kind, type[Item]] = {item_class.kind: item_class for item_class in _CLASSES}


#: Names of models and integrators in the distributions that are published with mbdkit but installed separately.
SEPARATE = {
    "mbdkit-generalized-alpha": ("generalized-alpha",),
    "mbdkit-lobatto": ("lobatto-iiia", "lobatto-iiib", "lobatto-iiic", "lobatto-iiid"),
    "mbdkit-opensim": ("opensim",),
    "mbdkit-robots": ("urdf", "mjcf", "pylinkage"),
    "mbdkit-sundials": ("sundials-cvode", "sundials-ida"),
    "mbdkit-walker": ("walker",),
}


@dataclass(frozen=True)
class Origin:
    """Origin of an item: its distribution, the version of the distribution, and the entry point."""

    distribution: str
    version: str
    entry_point: str


@dataclass(frozen=True)
class Registered:
    """An item in the registry with its kind and origin.

    `plugin` is a `Plugin` for the kinds that have options; for other kinds it is another `Item`.
    """

    kind: Kind
    plugin: Plugin
    origin: Origin

    @property
    def name(self) -> str:
        """The short name."""
        return self.plugin.full_name

    @property
    def id(self) -> str:
        """The full id, ``distribution:name``."""
        return f"{self.origin.distribution}:{self.name}"

    @property
    def is_pure(self) -> bool:
        """Whether formulas of numbers may stand for the code of the item: it is mbdkit's own, or permits it."""
        return self.origin.distribution == MBDKIT or self.plugin.pure

    @property
    def spec_name(self) -> str:
        """The name in a canonical spec: the short name for mbdkit's own items, the full id for all others."""
        return self.name if self.origin.distribution == MBDKIT else self.id


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
        kinds = list(KINDS)
        self.items = tuple(sorted(items, key=lambda item: (kinds.index(item.kind), item.plugin.order)))
        #: Items whose code may depend on anything, in the order of `KINDS`.
        self.impure = tuple(item for item in self.items if not item.is_pure)
        self._reports = tuple(reports)
        self._of_kind = {kind: tuple(group) for kind, group in groupby(self.items, attrgetter("kind"))}
        self._accepted: dict[Kind, dict[str, Registered]] = {}
        self._named: dict[tuple[Kind | None, str], list[Registered]] = {}
        for item in self.items:
            self._named.setdefault((item.kind, item.name), []).append(item)

    @property
    def reports(self) -> tuple[Report, ...]:
        """Reports on items, failures and disabled entry points, with clashes of short names marked.

        Those of a distribution are together: first its items, in their order.
        """
        ranks = {(item.kind, item.id): rank for rank, item in enumerate(self.items)}
        distributions = list(dict.fromkeys(report.origin.distribution for report in self._reports))

        def place(report: Report) -> tuple[int, int]:
            rank = ranks.get((report.kind or "", report.id), len(ranks)) if report.status == "ok" else len(ranks)
            return distributions.index(report.origin.distribution), rank

        return tuple(self._with_clash(report) for report in sorted(self._reports, key=place))

    @property
    def failures(self) -> tuple[Report, ...]:
        """Reports on the items and entry points that could not be loaded."""
        return tuple(report for report in self._reports if report.status == "error")

    @property
    def entry_points(self) -> set[tuple[str, str]]:
        """Distribution and name of all entry points, whether they were loaded or not."""
        return {(report.origin.distribution, report.origin.entry_point.partition(" = ")[0]) for report in self._reports}

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
        return self._of_kind.get(kind, ())

    def only(self, distribution: str) -> Registry:
        """Return a registry with the items of one distribution only."""
        return Registry(
            (item for item in self.items if item.origin.distribution == distribution),
            (report for report in self._reports if report.origin.distribution == distribution),
        )

    def names(self, kind: Kind) -> list[str]:
        """Return the names of the items of one kind: the short name if it is unique, otherwise the full id."""
        return [self.accepted(item)[0] for item in self.of_kind(kind)]

    def by_accepted_name(self, kind: Kind) -> Mapping[str, Registered]:
        """Return the items of one kind by every name that a spec may use for them."""
        if kind not in self._accepted:
            self._accepted[kind] = {name: item for item in self.of_kind(kind) for name in self.accepted(item)}
        return self._accepted[kind]

    def accepted(self, item: Registered) -> list[str]:
        """Return every name that a spec may use for this item."""
        return [item.name, item.id] if self._namesakes(item.kind, item.name) == [item] else [item.id]

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
            others = ",".join(item.origin.distribution for item in namesakes if item.origin.distribution != MBDKIT)
            raise SpecError(
                f"the {label} name '{name}' is used by {owners}; write {ids}, or set MBDKIT_DISABLE_PLUGINS={others}, "
                "as for archives of runs",
                key=key,
            )
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
        """Return the reason why the distribution that has an item is not loaded, as the end of an error message.

        The result is empty if `name` is neither a full id nor the name of an item in `SEPARATE`, or if the distribution
        is installed and not excluded.
        """
        distribution, colon, _ = name.partition(":")
        if owner := next((owner for owner, names in SEPARATE.items() if name in names), ""):
            distribution, colon = owner, ":"
        here = [report for report in self._reports if report.origin.distribution == distribution]
        if not colon or not distribution:
            return ""
        if not here:
            folder = f" (`pip install ./plugins/{distribution}` in the sources)" if distribution in SEPARATE else ""
            return f"; '{name}' is provided by the distribution {distribution}, which is not installed{folder}"
        reasons = dict.fromkeys(report.error for report in here if report.status == "disabled" and report.error)
        return f"; {distribution} is {listed(reasons, 'and')}" if reasons else ""

    def without(self, wrong: Mapping[tuple[Kind | None, str], str]) -> Registry:
        """Return a registry without some items, which are failures; `wrong` holds the errors by kind and id."""
        reports = list(self._reports)
        for index, report in enumerate(reports):
            if report.status == "ok" and (error := wrong.get((report.kind, report.id))) is not None:
                reports[index] = replace(report, status="error", error=error)
        return Registry((item for item in self.items if (item.kind, item.id) not in wrong), reports)

    def _namesakes(self, kind: Kind, name: str) -> list[Registered]:
        """Return the items that a short name may mean: several if distributions clash."""
        items = self._named.get((kind, name), [])
        ours = [item for item in items if item.origin.distribution == MBDKIT]
        return ours if ours and KINDS[kind].is_reserved else items

    def _with_clash(self, report: Report) -> Report:
        if report.status != "ok" or report.kind is None:
            return report
        name = report.id.partition(":")[2]
        others = [item for item in self._named.get((report.kind, name), []) if item.id != report.id]
        keeps = self._namesakes(report.kind, name)
        if not others or [item.id for item in keeps] == [report.id]:
            return report
        owners = listed([f"{item.origin.distribution} {item.origin.version}" for item in others], "and")
        error = f"the short name '{name}' is also used by {owners}; write the long id '{report.id}'"
        return Report(report.id, report.kind, report.origin, "clash", error, report.seconds)
