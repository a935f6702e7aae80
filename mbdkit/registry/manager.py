"""The loader: every entry point by itself, so that a broken plugin costs a warning and nothing else."""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import logging
import re
import sys
import time
from collections.abc import Iterable, Iterator
from typing import Any, Protocol

import pluggy

from mbdkit.errors import PluginError
from mbdkit.mechanism.force_law import ForceLaw
from mbdkit.mechanism.law_element import Law
from mbdkit.registry import hookspecs
from mbdkit.registry.catalogue import Kind, Origin, Registered, Registry, Report
from mbdkit.registry.item_options import check_law_options, law_element, named_options
from mbdkit.registry.items import ForceLawPlugin, IntegratorPlugin, ModelPlugin, Plugin
from mbdkit.registry.policy import STRICT, Policy, check_api
from mbdkit.text import listed, one_line

GROUP = hookspecs.PROJECT
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")

HOOKS: dict[str, tuple[Kind, type]] = {
    "mbdkit_models": ("model", ModelPlugin),
    "mbdkit_integrators": ("integrator", IntegratorPlugin),
    "mbdkit_force_laws": ("force-law", ForceLawPlugin),
}

log = logging.getLogger("mbdkit")


class EntryPoint(Protocol):
    """What the loader asks of an entry point; `importlib.metadata.EntryPoint` is one."""

    @property
    def name(self) -> str:
        """What stands before the equals sign."""
        ...

    @property
    def value(self) -> str:
        """The module."""
        ...

    @property
    def dist(self) -> Any:
        """The distribution, with `name` and `version`."""
        ...

    def load(self) -> Any:
        """Import the module."""
        ...


@functools.cache
def registry() -> Registry:
    """Return the registry of everything installed; loaded once in a process.

    Raises
    ------
    PluginError
        If a plugin could not be loaded and the environment asks to be strict about it.
    """
    loaded, policy = load_installed(), Policy.of()
    if policy.strict and loaded.failures:
        first = loaded.failures[0]
        raise PluginError(f"plugin '{first.id}' was not loaded: {first.error} ({STRICT} is set)")
    if policy.strict and (sentence := policy.unknown(loaded.distributions)):
        raise PluginError(f"{sentence} ({STRICT} is set)")
    return loaded


def load_installed() -> Registry:
    """Return the registry of everything installed, loaded anew, whatever could not be loaded."""
    return load_registry(importlib.metadata.entry_points(group=GROUP), Policy.of())


def find_installed_law(name: str) -> type[Law]:
    """Return the element class of an installed force law; raises SpecError where there is none."""
    return law_element(registry().get("force-law", name))


def load_registry(entry_points: Iterable[EntryPoint], policy: Policy | None = None) -> Registry:
    """Load each entry point by itself; what fails is reported, warned of in one line, and left out.

    Parameters
    ----------
    entry_points
        Entry points of the group ``mbdkit``; mbdkit's own come first in the registry, the others by distribution.
    policy
        Which of them are loaded; None: all.
    """
    policy = policy or Policy()
    entry_points = sorted(entry_points, key=_order)
    items: list[Registered] = []
    reports: list[Report] = []
    if not policy.strict and (
        sentence := policy.unknown({_origin(entry_point).distribution for entry_point in entry_points})
    ):
        log.warning("mbdkit: warning: %s", sentence)
    for entry_point in entry_points:
        origin = _origin(entry_point)
        if reason := policy.reason_against(origin.distribution):
            reports.append(Report(f"{origin.distribution}:{entry_point.name}", None, origin, "disabled", reason, 0.0))
            continue
        begin = time.perf_counter()
        found: list[Registered] = []
        problems: list[tuple[str, Kind | None, str]] = []
        try:
            with contextlib.redirect_stdout(sys.stderr):  # stdout belongs to --json
                for kind, thing in _offered(entry_point, origin):
                    _accept(kind, thing, origin, [*items, *found], found, problems)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a plugin may raise anything, SystemExit included
            problems.append((f"{origin.distribution}:{entry_point.name}", None, _sentence(error)))
        seconds = time.perf_counter() - begin
        items += found
        reports += [Report(item.id, item.kind, origin, "ok", None, seconds) for item in found]
        for identifier, failed_kind, sentence in problems:
            reports.append(Report(identifier, failed_kind, origin, "error", sentence, seconds))
            log.warning("mbdkit: warning: plugin '%s' was not loaded: %s", identifier, sentence)
    return Registry(items, reports)


def _offered(entry_point: EntryPoint, origin: Origin) -> Iterator[tuple[Kind, object]]:
    module = entry_point.load()
    check_api(module, origin.distribution)
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    manager.register(module, entry_point.name)
    manager.check_pending()
    if not manager.get_hookcallers(module):
        raise PluginError(
            f"it implements none of the hooks {listed(list(HOOKS), 'and')}, marked with `mbdkit.hookimpl`"
        )
    for hook, (kind, _) in HOOKS.items():
        for answer in getattr(manager.hook, hook)():
            if not isinstance(answer, list | tuple):
                raise PluginError(f"its hook `{hook}` returned {_a(answer)}, not a list")
            for thing in answer:
                yield kind, thing


def _accept(
    kind: Kind,
    thing: object,
    origin: Origin,
    known: list[Registered],
    found: list[Registered],
    problems: list[tuple[str, Kind | None, str]],
) -> None:
    name = getattr(thing, "name", None)
    identifier = f"{origin.distribution}:{name if isinstance(name, str) else '?'}"
    try:
        item = Registered(kind, _checked(kind, thing), origin)
        named_options(item).model_json_schema()
        if any(other.kind == kind and other.id == item.id for other in known):
            raise PluginError(f"its distribution has another {kind.replace('-', ' ')} of the same name")
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        problems.append((identifier, kind, _sentence(error)))
    else:
        found.append(item)


def _checked(kind: Kind, thing: object) -> Plugin:
    from pydantic import BaseModel

    wanted = next(cls for of_kind, cls in HOOKS.values() if of_kind == kind)
    if not isinstance(thing, Plugin) or not isinstance(thing, wanted):
        raise PluginError(f"a hook for {kind.replace('-', ' ')}s returned {_a(thing)}, not {wanted.__name__}")
    if not isinstance(thing.name, str) or not NAME.fullmatch(thing.name):
        raise PluginError(f"the name {thing.name!r} is not made of letters, digits and . _ -")
    if not isinstance(thing.summary, str) or "\n" in thing.summary:
        raise PluginError("its summary is not one line of text")
    if not isinstance(thing.options, type) or not issubclass(thing.options, BaseModel):
        raise PluginError(f"its options are {_a(thing.options)}, not a class derived from pydantic.BaseModel")
    if not isinstance(thing.references, tuple) or not all(isinstance(entry, str) for entry in thing.references):
        raise PluginError("its references are not a tuple of texts")
    if isinstance(thing, ForceLawPlugin):
        if not isinstance(thing.law, ForceLaw):
            raise PluginError(f"its law is {_a(thing.law)}, not an ExpressionLaw or a FunctionLaw")
        check_law_options(thing.options)
        return thing
    for function in ("build",) if isinstance(thing, ModelPlugin) else ("create", "claims"):
        if not callable(getattr(thing, function)):
            raise PluginError(f"its `{function}` cannot be called")
    return thing


def _origin(entry_point: EntryPoint) -> Origin:
    dist = entry_point.dist
    name = getattr(dist, "name", None) or "unknown"
    version = getattr(dist, "version", None) or "unknown"
    return Origin(str(name), str(version), f"{entry_point.name} = {entry_point.value}")


def _order(entry_point: EntryPoint) -> tuple[bool, str, str]:
    distribution = _origin(entry_point).distribution
    return distribution != "mbdkit", distribution, entry_point.name


def _a(thing: object) -> str:
    if isinstance(thing, type):
        return f"the class {thing.__name__}"
    return "nothing" if thing is None else f"an object of type {type(thing).__name__}"


def _sentence(error: BaseException) -> str:
    return str(error) if isinstance(error, PluginError) else one_line(error)
