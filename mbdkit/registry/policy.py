"""Version of the plugin API, and the policy for loading plugins that environment variables define."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from mbdkit.base.distributions import normalized_name, own_version
from mbdkit.base.errors import PluginError, SpecError
from mbdkit.base.text import listed

#: Version of the plugin API: of the hooks, of their return values, and of the arguments of methods, laws and models.
#:
#: The version is increased when existing plugins would stop working, but not when features are added.
API = 1

OLDEST_API = 1  #: The oldest version of the plugin API that is still supported.

#: Name of the variable in which a plugin module declares the API version that it was written for.
API_NAME = "mbdkit_api"

#: Distribution and name of the entry point that cannot be left out: without it, mbdkit has no models.
CORE = ("mbdkit", "builtin")

ALLOW, DISABLE, STRICT = "MBDKIT_PLUGINS", "MBDKIT_DISABLE_PLUGINS", "MBDKIT_STRICT_PLUGINS"

_YES, _NO = {"1", "true", "yes", "on"}, {"", "0", "false", "no", "off"}


def check_api(module: object, distribution: str) -> None:
    """Raise PluginError if a plugin was written for an unsupported API version; the message says what to upgrade.

    A module without a declared version counts as written for version 1.
    """
    wanted = getattr(module, API_NAME, 1)
    if isinstance(wanted, bool) or not isinstance(wanted, int):
        raise PluginError(f"its `{API_NAME}` is {wanted!r}, not a whole number such as {API}")
    if OLDEST_API <= wanted <= API:
        return
    served = f"mbdkit {own_version()} supports {API if OLDEST_API == API else f'{OLDEST_API} to {API}'}"
    if wanted > API:
        raise PluginError(f"it was written for plugin API {wanted} and {served}: upgrade mbdkit")
    raise PluginError(f"it was written for plugin API {wanted} and {served}: upgrade {distribution}")


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
