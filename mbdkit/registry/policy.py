"""Versions of the plugin API, and the policy for loading plugins that environment variables define."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from importlib.metadata import PathDistribution
from typing import NamedTuple

from mbdkit.base.distributions import normalized_name, own_version
from mbdkit.base.errors import PluginError, SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.base.text import listed


class Family(NamedTuple):
    """Kinds of items that belong together, with the newest and the oldest supported version of the plugin API.

    The version is that of hooks and items, and of what mbdkit passes to their code. It is increased when existing
    plugins would stop working, but not when features are added.
    """

    kinds: tuple[str, ...]
    version: int = 1
    oldest: int = 1


#: The families; `kernels` is machine code of plugins, which has no items of its own.
FAMILIES: Mapping[str, Family] = {
    "methods": Family(("integrator", "step-control", "treatment")),
    "laws": Family(("force-law",)),
    "models": Family(("model", "model-key")),
    "elements": Family(("element-kind", "quantity")),
    "joints": Family(("joint-kind",)),
    "specs": Family(("spec-kind", "study", "measure", "command", "example", "guide-page", "file-format")),
    "reports": Family(("report-section", "plot-kind", "view", "headline", "summary-line", "table-format", "accessor")),
    "criteria": Family(("criterion",)),
    "kernels": Family(()),
}

#: Version of the plugin API by family.
API: Mapping[str, int] = {name: family.version for name, family in FAMILIES.items()}

#: Name of the variable in which a plugin module states the versions of the families for which it was written.
API_NAME = "mbdkit_api"

#: Distribution and name of the entry point that cannot be left out: without it, mbdkit has no models.
CORE = ("mbdkit", "builtin")

ALLOW, DISABLE, STRICT = "MBDKIT_PLUGINS", "MBDKIT_DISABLE_PLUGINS", "MBDKIT_STRICT_PLUGINS"

_REQUIREMENT = re.compile(r"mbdkit\s*(\[.*\]\s*)?\(?[<>=!~]", re.IGNORECASE)  # one with a version

_STATED = re.compile(rf"^Requires-Dist:\s*{_REQUIREMENT.pattern}", re.IGNORECASE | re.MULTILINE)

_YES, _NO = {"1", "true", "yes", "on"}, {"", "0", "false", "no", "off"}


def check_api(module: object, distribution: str, kind: str | None = None) -> None:
    """Raise PluginError if a plugin was written for an unsupported version of a family; it says what to upgrade.

    The family is that of a kind of items, by default that of machine code. A family whose version the module does not
    state counts as version 1.
    """
    stated: object = getattr(module, API_NAME, {})
    if not isinstance(stated, Mapping) or any(type(version) is not int for version in stated.values()):
        raise PluginError(f"its `{API_NAME}` is {stated!r}, not versions of families, such as {{'methods': 1}}")
    if unknown := [str(family) for family in stated if family not in API]:
        raise PluginError(f"its `{API_NAME}` names {listed(unknown, 'and')}; the families are {listed(API, 'and')}")
    family = next((name for name, family in FAMILIES.items() if kind in family.kinds), "kernels")
    wanted, (_, newest, oldest) = stated.get(family, 1), FAMILIES[family]
    if oldest <= wanted <= newest:
        return
    served = f"mbdkit {own_version()} supports {newest if oldest == newest else f'{oldest} to {newest}'}"
    upgraded = "mbdkit" if wanted > newest else distribution
    raise PluginError(f"it was written for version {wanted} of {family}, and {served}: upgrade {upgraded}")


def check_requirement(distribution: object) -> None:
    """Raise PluginError if a distribution requires another version of mbdkit than the installed one."""
    stated: list[str] = []
    with suppress(Exception):  # metadata that cannot be read, which state nothing
        # most distributions state no version, and their metadata need not be parsed
        text = distribution.read_text("METADATA") if isinstance(distribution, PathDistribution) else None
        if text is None or _STATED.search(text):
            stated += filter(_REQUIREMENT.match, getattr(distribution, "requires", None) or ())
    if not stated:
        return
    from packaging.requirements import Requirement

    for requirement in map(Requirement, stated):
        applies = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        if applies and not requirement.specifier.contains(own_version(), prereleases=True):
            wanted = f"mbdkit{requirement.specifier}"
            raise PluginError(f"it requires {wanted}, and mbdkit {own_version()} is installed: upgrade one of them")


@dataclass(frozen=True)
class Policy:
    """Distributions whose plugins are loaded, and whether a failure to load is an error.

    `allowed`: distributions whose plugins may be loaded, in addition to mbdkit itself; None allows all. `disabled`:
    distributions whose plugins are not loaded, and single entry points as ``distribution/entry-point``. `strict`:
    whether it is an error if a plugin cannot be loaded, or if no plugin is installed for a distribution in `allowed` or
    `disabled`.
    """

    allowed: frozenset[str] | None = None
    disabled: frozenset[str] = frozenset()
    strict: bool = False

    @classmethod
    def of(cls, environment: Mapping[str, str] = os.environ) -> Policy:
        """Return the policy that the environment variables define.

        Raises SpecError if `MBDKIT_STRICT_PLUGINS` is not a truth value such as 1 or 0.
        """
        strict = environment.get(STRICT, "").strip().lower()
        if strict not in _YES | _NO:
            raise SpecError(f"the environment variable {STRICT} is {strict!r}; it should be 1 or 0")
        allowed = environment.get(ALLOW)
        return cls(
            None if allowed is None else _names(allowed), _names(environment.get(DISABLE, "")), strict=strict in _YES
        )

    def reason_against(self, distribution: str, entry_point: str) -> str | None:
        """Return the reason why an entry point of a distribution is not loaded, or None if it is."""
        name = normalized_name(distribution)
        if name + "/" + normalized_name(entry_point) in self.disabled and (name, entry_point) != CORE:
            return f"left out by {DISABLE}"
        if name == "mbdkit":
            return None
        if name in self.disabled:
            return f"left out by {DISABLE}"
        if self.allowed is not None and name not in self.allowed:
            return f"left out by {ALLOW}"
        return None

    def unknown(self, entry_points: Iterable[tuple[str, str]]) -> str | None:
        """Return a message on the allowed or disabled names for which no plugin is installed; None if there are none.

        `entry_points`: distribution and name of each entry point.
        """
        here = {normalized_name(name) for pair in entry_points for name in (pair[0], "/".join(pair))}
        sentences = [
            f"{variable} names {listed([repr(name) for name in sorted(names - here)], 'and')}, "
            "for which no plugin is installed"
            for variable, names in ((ALLOW, self.allowed or frozenset()), (DISABLE, self.disabled))
            if names - here
        ]
        return "; ".join(sentences) or None


def _names(text: str) -> frozenset[str]:
    return frozenset(normalized_name(name) for name in re.split(r"[,\s]+", text) if name)
