"""Kinds of quantities by group and by word: those of the table, and those of plugins.

Groups and words of plugins are known without an import. The module with the arrays of a plugin's kind is imported when
a mechanism has elements of the kind, an archive has its group, or an expression contains its word.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache, lru_cache
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import MissingPartError, PluginError
from mbdkit.base.parts import GROUPS_OF_PARTS
from mbdkit.quantities.array import Array, Kind, Recorded
from mbdkit.quantities.names import ArchiveNames
from mbdkit.quantities.table import KINDS
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.element_items import QuantityKind
from mbdkit.registry.manager import log, registry, use

if TYPE_CHECKING:
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.quantities.states import States

_OF_CORE: Mapping[str, Kind] = {kind.group: kind for kind in KINDS}


def added_kinds() -> Mapping[str, Registered]:
    """Return the items of class `mbdkit.plugin.QuantityKind` by group, in the order of the groups of archives."""
    return _added(registry())


@lru_cache(maxsize=4)
def _added(known: Registry) -> Mapping[str, Registered]:
    items: dict[str, Registered] = {}
    for item in sorted(known.of_kind("quantity"), key=lambda item: item.origin.distribution != MBDKIT):
        group = cast(QuantityKind, item.plugin).group
        if group in _OF_CORE or group in items:
            owner = f"'{items[group].id}'" if group in items else "mbdkit itself"
            log.warning("mbdkit: warning: the group '%s' belongs to %s, so '%s' is not used", group, owner, item.id)
        else:
            items[group] = item
    return items


def item_of_group(group: str) -> QuantityKind:
    """Return the item of a group of a plugin."""
    return cast(QuantityKind, added_kinds()[group].plugin)


def order_of(group: str) -> float:
    """Return the place of a group in archives: the groups of the core have 0, 10, ..., those of mbdkit's own parts the
    order of their items, and those of other plugins come last.
    """
    if group in _OF_CORE:
        return 10.0 * list(_OF_CORE).index(group)
    item = added_kinds().get(group)
    return cast(QuantityKind, item.plugin).order if item and item.origin.distribution == MBDKIT else math.inf


def groups() -> tuple[str, ...]:
    """Return the names of all groups with quantities, in the order of archives."""
    return tuple(sorted((*_OF_CORE, *added_kinds()), key=order_of))


def words() -> Mapping[str, str]:
    """Return the groups by the words of their kinds in expressions, which are also attributes of `Run`."""
    return _words(registry())


@lru_cache(maxsize=4)
def _words(known: Registry) -> Mapping[str, str]:
    of_core = {kind.word: kind.group for kind in KINDS if kind.word}
    added = {cast(QuantityKind, item.plugin).word: group for group, item in _added(known).items()}
    return {word: group for word, group in added.items() if word} | of_core


def kind_of_group(group: str) -> Kind:
    """Return the kind of a group; raise KeyError if there is none.

    Raises MissingPartError if the part of mbdkit with the group is not installed. Raises PluginError if the plugin with
    the group does not provide its kind.
    """
    if group in GROUPS_OF_PARTS and group not in added_kinds():
        raise MissingPartError(f"the group {group}", GROUPS_OF_PARTS[group])
    return _OF_CORE[group] if group in _OF_CORE else _imported(added_kinds()[group])


def kind_of_word(word: str) -> Kind:
    """Return the kind with a word; raise KeyError if there is none."""
    return kind_of_group(word if word in GROUPS_OF_PARTS else words()[word])


@cache
def _imported(item: Registered) -> Kind:
    kind = cast(Kind, use(item, cast(QuantityKind, item.plugin).checked_kind, Kind))
    if item.origin.distribution == MBDKIT:
        return kind
    if not kind.is_optional or not all(array.optional for array in kind.arrays):
        raise PluginError(f"the quantity '{item.id}' has arrays that are not optional, as those of plugins must be")
    return replace(kind, arrays=tuple(_blaming(item, array) for array in kind.arrays))


def _blaming(item: Registered, array: Array) -> Array:
    if not isinstance(array, Recorded):
        return array

    def take(states: States) -> np.ndarray:
        values: np.ndarray = use(item, lambda: array.take(states), np.ndarray)
        if values.ndim < len(array.dims) or len(values) != len(states.time):
            shape = f"{values.shape}, not ({len(states.time)}, {', '.join(array.dims[1:])})"
            raise PluginError(f"the quantity '{item.id}' returned {array.path} with the shape {shape}")
        return values

    return replace(array, take=take)


def kinds_of_others(mechanism: Callable[[], Mechanism]) -> Mapping[str, Registered]:
    """Return the items of other distributions, by group, whose elements the mechanism of a function has."""
    others = {group: item for group, item in added_kinds().items() if item.origin.distribution != MBDKIT}
    return {group: item for group, item in others.items() if getattr(mechanism(), item_of_group(group).of, None)}


def kinds(among: Iterable[str] = ()) -> tuple[Kind, ...]:
    """Return the kinds of the core, and those of plugins whose groups are `among` the given ones, in their order."""
    wanted = frozenset(among)
    return tuple(kind_of_group(group) for group in groups() if group in _OF_CORE or group in wanted)


def kinds_of(names: ArchiveNames) -> tuple[Kind, ...]:
    """Return the kinds of the core, and those of plugins of which a mechanism has elements."""
    present = {of for of, members in names.members if members}
    return kinds(group for group in added_kinds() if item_of_group(group).of in present) if present else KINDS


class Peaks(NamedTuple):
    """Quantities of the elements of a kind whose largest values checked runs determine; see `QuantityKind.peaks`.

    `of`: key of the elements in the model. `quantities`: quantities as `QuantityKind.peaks` has them, after the word of
    the kind and a dot. `names`: names of the elements.
    """

    of: str
    quantities: tuple[str, ...]
    names: list[str]


def peaks_of(names: ArchiveNames) -> list[Peaks]:
    """Return the quantities of a mechanism whose largest values checked runs determine between their rows."""
    peaks = []
    for item in (cast(QuantityKind, item.plugin) for item in added_kinds().values()):
        if item.peaks and (members := names.names_of(item.of)):
            quantities = (f"{'-' * peak.startswith('-')}{item.word}.{peak.lstrip('-')}" for peak in item.peaks)
            peaks.append(Peaks(item.of, tuple(quantities), members))
    return peaks


def mode_arrays() -> list[str]:
    """Return the paths of the arrays of modes, at whose changes forces may be discontinuous."""
    items = ((group, cast(QuantityKind, item.plugin)) for group, item in added_kinds().items())
    return [f"{group}/{item.modes}" for group, item in items if item.modes]


def array_at(path: str) -> Array | None:
    """Return the array at a path of archives; None if there is none."""
    group = path.partition("/")[0]
    if group not in _OF_CORE and group not in added_kinds():
        return None
    return kind_of_group(group).by_path.get(path)


def sizes_of(names: ArchiveNames) -> dict[str, int]:
    """Return the lengths of the axes that do not grow, by name."""
    along = {name: texts for kind in kinds_of(names) for name, texts in kind.names_along.items()}
    return {name: len(texts(names)) for name, texts in along.items()}
