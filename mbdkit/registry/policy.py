"""Which plugins may be loaded and how strictly: the plugin API's version, and what environment variables say."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version

from mbdkit.errors import PluginError, SpecError
from mbdkit.text import listed

API = 1
"""The plugin API that this mbdkit offers: hooks, what they return, and what a method, a law and a model are given.

It is raised when a plugin that worked would work no longer, never for what is merely new.
"""

OLDEST_API = 1
"""The oldest plugin API that is still served."""

API_NAME = "mbdkit_api"
"""The name under which a plugin's module says which API it was written for."""

ALLOW, DISABLE, STRICT = "MBDKIT_PLUGINS", "MBDKIT_DISABLE_PLUGINS", "MBDKIT_STRICT_PLUGINS"

_YES, _NO = {"1", "true", "yes", "on"}, {"", "0", "false", "no", "off"}


def check_api(module: object, distribution: str) -> None:
    """Raise PluginError where a plugin was written for an API that is not served here, saying which side to upgrade.

    A module that does not say counts as written for the first one.
    """
    wanted = getattr(module, API_NAME, 1)
    if isinstance(wanted, bool) or not isinstance(wanted, int):
        raise PluginError(f"its `{API_NAME}` is {wanted!r}, not a whole number such as {API}")
    served = f"mbdkit {version('mbdkit')} serves {API if OLDEST_API == API else f'{OLDEST_API} to {API}'}"
    if wanted > API:
        raise PluginError(f"it was written for plugin API {wanted} and {served}: upgrade mbdkit")
    if wanted < OLDEST_API:
        raise PluginError(f"it was written for plugin API {wanted} and {served}: upgrade {distribution}")


@dataclass(frozen=True)
class Policy:
    """Which distributions' plugins are loaded, and whether one that fails is an error.

    Parameters
    ----------
    allowed
        Distributions whose plugins may be loaded, beside mbdkit itself; None: all.
    disabled
        Distributions whose plugins are not.
    strict
        Whether mbdkit refuses to work where a plugin cannot be loaded, or one that is allowed is not there.
    """

    allowed: frozenset[str] | None = None
    disabled: frozenset[str] = frozenset()
    strict: bool = False

    @classmethod
    def of(cls, environment: Mapping[str, str] = os.environ) -> Policy:
        """Return what the environment variables say.

        Raises
        ------
        SpecError
            If `MBDKIT_STRICT_PLUGINS` is neither yes nor no.
        """
        strict = environment.get(STRICT, "").strip().lower()
        if strict not in _YES | _NO:
            raise SpecError(f"the environment variable {STRICT} is {strict!r}; it should be 1 or 0")
        allowed = environment.get(ALLOW)
        return cls(
            None if allowed is None else _names(allowed), _names(environment.get(DISABLE, "")), strict=strict in _YES
        )

    def reason_against(self, distribution: str) -> str | None:
        """Return why the plugins of a distribution are left out, or None."""
        name = _normal(distribution)
        if name == "mbdkit":
            return None
        if name in self.disabled:
            return f"left out by {DISABLE}"
        if self.allowed is not None and name not in self.allowed:
            return f"left out by {ALLOW}"
        return None

    def unknown(self, distributions: set[str]) -> str | None:
        """Return a sentence on names that are allowed or disabled and have no plugin installed, or None."""
        here = {_normal(name) for name in distributions}
        told = [
            f"{variable} names {listed([repr(name) for name in sorted(names - here)], 'and')}, "
            "of which no plugin is installed"
            for variable, names in ((ALLOW, self.allowed or frozenset()), (DISABLE, self.disabled))
            if names - here
        ]
        return "; ".join(told) or None


def _names(text: str) -> frozenset[str]:
    return frozenset(_normal(name) for name in re.split(r"[,\s]+", text) if name)


def _normal(name: str) -> str:
    """Return a distribution's name as packaging compares it."""
    return re.sub(r"[-_.]+", "-", name).lower()
