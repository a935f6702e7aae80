"""Loading of plugins. Each entry point is loaded separately, so that a broken plugin causes a warning and leaves the
others usable.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar, cast

import pluggy

from mbdkit.base.distributions import MBDKIT, UnusableDistribution, entry_points, name_and_version, own_entry_points
from mbdkit.base.errors import MbdkitError, PluginError, SpecError, blaming, in_this_process, with_place
from mbdkit.base.interrupts import is_interrupt
from mbdkit.base.text import listed
from mbdkit.registry import hookspecs
from mbdkit.registry.catalogue import KINDS, Kind, Origin, Registered, Registry, Report
from mbdkit.registry.item import Item, Plugin, described
from mbdkit.registry.policy import STRICT, Policy, check_api, check_requirement

GROUP = hookspecs.PROJECT

log = logging.getLogger("mbdkit")


class EntryPoint(Protocol):
    """The attributes of `importlib.metadata.EntryPoint` that are used here."""

    @property
    def name(self) -> str:
        """Name of the entry point."""

    @property
    def value(self) -> str:
        """Name of the module."""

    @property
    def dist(self) -> object:
        """Distribution, an object with `name` and `version`."""

    def load(self) -> object:
        """Import the module."""


@functools.cache
def registry() -> Registry:
    """Return the registry of all installed plugins; loaded once in a process.

    Raises
    ------
    PluginError
        If the environment variable `MBDKIT_STRICT_PLUGINS` is set, and a plugin could not be loaded, or another
        variable names a distribution for which no plugin is installed.
    """
    loaded, policy = load_installed(), Policy.of()
    if policy.strict and loaded.failures:
        first = loaded.failures[0]
        raise PluginError(f"plugin '{first.id}' was not loaded: {first.error} ({STRICT} is set)")
    if policy.strict and (sentence := policy.unknown(loaded.entry_points)):
        raise PluginError(f"{sentence} ({STRICT} is set)")
    return loaded


@functools.cache
def installed() -> Registry:
    """Return the registry as `registry` does, without errors: the command line lists and finds commands in it.

    A wrong value of `MBDKIT_STRICT_PLUGINS` is thus reported by commands, not by ``--help``.
    """
    points, unusable = entry_points(GROUP)
    return load_registry(points, _lenient(), unusable, built_in())


@functools.cache
def built_in() -> Registry:
    """Return the registry of mbdkit's own plugins; no other plugin is imported."""
    policy = _lenient()
    return load_registry(
        point for point in own_entry_points(GROUP) if policy.reason_against(MBDKIT, point.name) is None
    )


def _lenient() -> Policy:
    """Return the policy of the environment, or if it is wrong, the default; commands report the error."""
    try:
        return Policy.of()
    except SpecError:
        return Policy()


def load_installed() -> Registry:
    """Return the registry of all installed plugins; those that cannot be loaded cause a warning, not an error.

    Raises SpecError if `MBDKIT_STRICT_PLUGINS` is not a truth value.
    """
    Policy.of()
    return installed()


def forget() -> None:
    """Load the plugins again when they are next asked for, because others were installed in this process."""
    registry.cache_clear()
    installed.cache_clear()
    built_in.cache_clear()


def checked(loaded: Registry, *, whole: bool = True) -> Registry:
    """Return a registry without the items that are wrong, which are failures in it.

    The objects behind the targets of all items are imported and checked, and integrators created with their defaults.
    If it is not the `whole` registry, items of mbdkit itself are not checked and no integrator is created, which takes
    seconds.
    """
    from mbdkit.registry.item_options import check_item

    wrong: dict[tuple[Kind | None, str], str] = {}
    for item in loaded.items if whole else (item for item in loaded.items if item.origin.distribution != MBDKIT):
        try:
            check_item(item, create=whole)
        except PluginError as error:
            wrong[item.kind, item.id] = str(error)
    return loaded.without(wrong)


def load_registry(
    points: Iterable[EntryPoint], policy: Policy | None = None, unusable: Iterable[UnusableDistribution] = (),
    own: Registry | None = None,
) -> Registry:  # fmt: skip
    """Load each entry point separately. If one fails, its items are skipped, a warning of one line is printed, and the
    failure is listed in the registry.

    `points`: entry points of the group ``mbdkit``. In the registry, the items of mbdkit itself come first, followed by
    the others in the order of their distributions. `policy`: decides which distributions are loaded; by default all of
    them. `unusable`: distributions whose entry points are not used, which are failures in the registry. `own`: what
    `built_in` has loaded already.
    """
    policy = policy or Policy()
    origins = [(_origin(point), point) for point in points]
    origins.sort(key=lambda pair: (pair[0].distribution != MBDKIT, pair[0].distribution, pair[1].name))
    manager = _manager()
    items = [*own.items] if own else []
    known = {(item.kind, item.id) for item in items}
    reports = [*own.reports] if own else []
    present = {(origin.distribution, entry_point.name) for origin, entry_point in origins}
    if not policy.strict and (unknown := policy.unknown(present)):
        log.warning("mbdkit: warning: %s", unknown)
    for origin, entry_point in origins:
        if reason := policy.reason_against(origin.distribution, entry_point.name):
            reports.append(Report(f"{origin.distribution}:{entry_point.name}", None, origin, "disabled", reason, 0.0))
            continue
        if own and origin.distribution == MBDKIT:
            continue
        begin = time.perf_counter()
        accepted: list[Registered] = []
        problems: list[tuple[str, Kind | None, str]] = []
        try:
            # stdout is reserved for the output of --json
            with contextlib.redirect_stdout(sys.stderr), in_this_process():
                if origin.distribution != MBDKIT:
                    check_requirement(entry_point.dist)
                module = entry_point.load()
                check_api(module, origin.distribution)
                for hook, thing in _offered(module, entry_point.name, manager):
                    _accept(hook, thing, module, origin, known, accepted, problems)
        except BaseException as error:  # a plugin may raise any exception, including SystemExit
            if is_interrupt(error):
                raise
            if origin.distribution == hookspecs.PROJECT and isinstance(error, MbdkitError):
                raise  # the installation or the environment is wrong
            problems.append((f"{origin.distribution}:{entry_point.name}", None, _sentence(error)))
        seconds = time.perf_counter() - begin
        items += accepted
        reports += [Report(item.id, item.kind, origin, "ok", None, seconds) for item in accepted]
        for identifier, failed_kind, sentence in problems:
            reports.append(Report(identifier, failed_kind, origin, "error", sentence, seconds))
            log.warning("mbdkit: warning: plugin '%s' was not loaded: %s", identifier, sentence)
    for folder, why in ((distribution.folder, distribution.why) for distribution in unusable):
        origin = Origin(folder, "unknown", "")
        if reason := policy.reason_against(folder, ""):
            reports.append(Report(folder, None, origin, "disabled", reason, 0.0))
        else:
            reports.append(Report(folder, None, origin, "error", why, 0.0))
            log.warning("mbdkit: warning: the plugins of %s were not loaded: %s", folder, why)
    return Registry(items, reports)


@functools.cache
def _manager() -> pluggy.PluginManager:
    """Return a manager that has one plugin at a time."""
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    return manager


def _offered(module: object, name: str, manager: pluggy.PluginManager) -> Iterator[tuple[str, object]]:
    if module is None:
        raise PluginError("it is None, which implements none of the hooks")
    manager.register(module, name)
    try:
        manager.check_pending()
        if not manager.get_hookcallers(module):
            hooks = listed(dict.fromkeys(item_class.hook for item_class in KINDS.values()), "and")
            raise PluginError(f"it implements none of the hooks {hooks}, marked with `mbdkit.hookimpl`")
        for hook in dict.fromkeys(item_class.hook for item_class in KINDS.values()):
            caller = getattr(manager.hook, hook)
            answers = caller()
            if caller.get_hookimpls() and not answers:
                raise PluginError(f"its hook `{hook}` returned None, not a list")
            for answer in answers:
                if not isinstance(answer, list | tuple | Iterator):
                    raise PluginError(f"its hook `{hook}` returned {described(answer)}, not a list")
                for thing in answer:
                    yield hook, thing
    finally:
        manager.unregister(module)


def _accept(
    hook: str,
    thing: object,
    module: object,
    origin: Origin,
    known: set[tuple[Kind, str]],
    accepted: list[Registered],
    problems: list[tuple[str, Kind | None, str]],
) -> None:
    name = getattr(thing, "name", None)
    identifier = f"{origin.distribution}:{name if isinstance(name, str) else '?'}"
    kind = next((kind for kind, item_class in KINDS.items() if _fits(thing, hook, item_class)), None)
    try:
        if kind is None:
            raise PluginError(f"its hook `{hook}` returned {described(thing)}, not an item of class {_classes(hook)}")
        check_api(module, origin.distribution, kind)
        cast(Item, thing).check()
        item = Registered(kind, cast(Plugin, thing), origin)
        if (kind, item.id) in known:
            raise PluginError(f"its distribution has another {KINDS[kind].label()} of the same name")
    except BaseException as error:
        if is_interrupt(error):
            raise
        kinds = [kind for kind, item_class in KINDS.items() if item_class.hook == hook]
        problems.append((identifier, kind or kinds[0], _sentence(error)))
    else:
        known.add((kind, item.id))
        accepted.append(item)


def _fits(thing: object, hook: str, item_class: type[Item]) -> bool:
    return isinstance(thing, item_class) and hook in (item_class.hook, Item.hook)


def _classes(hook: str) -> str:
    return listed([item_class.__name__ for item_class in KINDS.values() if hook in (item_class.hook, Item.hook)], "or")


def _origin(entry_point: EntryPoint) -> Origin:
    dist = entry_point.dist  # the backport `importlib_metadata`, where it is imported, has a class of its own
    if hasattr(type(dist), "metadata"):
        name, version = name_and_version(dist)
    else:
        name, version = (str(getattr(dist, key, None) or "unknown") for key in ("name", "version"))
    return Origin(name, version, f"{entry_point.name} = {entry_point.value}")


def _sentence(error: BaseException) -> str:
    return str(error) if type(error) is PluginError else with_place(error)


T = TypeVar("T")


def use(item: Registered, work: Callable[[], T], of: type | tuple[type, ...] = object) -> T:
    """Return what `work`, which calls the code of an item, returns.

    Errors of mbdkit itself and of its own items pass unchanged.

    Parameters
    ----------
    of
        Class of the result.

    Raises
    ------
    PluginError
        If the target of the item is missing, or its code raises another error or returns an object of another class.
    """
    if item.origin.distribution == MBDKIT:
        return work()
    name = f"the {KINDS[item.kind].label()} '{item.id}'"
    try:
        with blaming(f"{name} failed", MbdkitError):
            result = work()
    except PluginError as error:
        raise error if str(error).startswith(name) else PluginError(f"{name} failed: {error}") from error
    if not isinstance(result, of):
        raise PluginError(f"{name} returned {described(result)}, not {_words(of)}")
    return result


def _words(of: type | tuple[type, ...]) -> str:
    return f"an object of type {' or '.join(kind.__name__ for kind in (of if isinstance(of, tuple) else (of,)))}"
