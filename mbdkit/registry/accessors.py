"""Attributes of results that plugins compute: `Run.plot`, and others that a plugin adds."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, ClassVar, Self, cast

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import MissingPartError, PluginError
from mbdkit.base.text import listed
from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.feature_items import Accessor
from mbdkit.registry.manager import log, registry, use
from mbdkit.registry.target import Target


class AccessorAttributeError(PluginError, AttributeError):
    """A function of a plugin raised AttributeError, so that the object has no such attribute, as `hasattr` answers."""


class Extensible:
    """Base of the classes to which plugins add attributes; see `mbdkit.plugin.Accessor`.

    The attributes are added to the class when its first object is made. A method `__getattr__` would do without this,
    but IPython does not complete names of objects that have one.
    """

    _added: ClassVar[frozenset[str]]

    def __new__(cls, *_arguments: object, **_named: object) -> Self:
        """Make an object of the class, which has the attributes of plugins."""
        if "_added" not in vars(cls):
            known = accessors(cls)
            cls._added = frozenset(name for name in known if not hasattr(cls, name))
            for item in (item for name in known.keys() - cls._added for item in known[name]):
                if item.origin.distribution != MBDKIT:
                    sentence = "mbdkit: warning: %s.%s is an attribute of mbdkit itself, so '%s' is not used"
                    log.warning(sentence, cls.__name__, item.name, item.id)
            for name in cls._added:
                setattr(cls, name, _Computed(name))
        return super().__new__(cls)


class _Computed:
    """An attribute that is computed when it is first read, and then kept in the object."""

    def __init__(self, name: str):
        self.name = name

    def __get__(self, thing: object, owner: type) -> object:
        if thing is None:
            return self
        thing.__dict__[self.name] = value = computed(thing, self.name)
        return value


def accessors(kind: type) -> dict[str, list[Registered]]:
    """Return the accessors of a class by name; several distributions may offer the same name."""
    return _accessors(kind, registry())


@lru_cache(maxsize=64)
def _accessors(kind: type, known: Registry) -> dict[str, list[Registered]]:
    items: dict[str, list[Registered]] = {}
    for item in known.of_kind("accessor"):
        if cast(Accessor, item.plugin).of == kind.__name__:
            items.setdefault(item.name, []).append(item)
    return items


def computed(thing: object, name: str, part: str = "") -> Any:
    """Return the value of an attribute that a plugin computes, or the part of mbdkit with the name `part`.

    Raises
    ------
    MissingPartError
        If the part is not installed.
    PluginError
        If the function of the plugin fails, or several distributions have an attribute of this name.
    """
    items = accessors(type(thing)).get(name, [])
    if not (items := [item for item in items if item.origin.distribution == MBDKIT] or items):
        raise MissingPartError(f"{type(thing).__name__}.{name}", part)
    if len(items) > 1:
        owners = listed([f"{item.origin.distribution} {item.origin.version}" for item in items], "and")
        raise PluginError(f"{owners} both add the attribute `{name}`; exclude one by MBDKIT_DISABLE_PLUGINS")
    target = cast("Target[Callable[[object], object]]", cast(Accessor, items[0].plugin).target)
    try:
        return use(items[0], lambda: target()(thing))
    except PluginError as error:
        if isinstance(error.__cause__, AttributeError):
            raise AccessorAttributeError(str(error)) from error.__cause__
        raise
