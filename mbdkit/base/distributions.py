"""Entry points of the installed distributions, of which any may be damaged or take the name of mbdkit."""

from __future__ import annotations

import importlib.metadata
import re
from collections.abc import Iterable
from functools import cache, lru_cache
from importlib.metadata import Distribution, EntryPoint, EntryPoints

from mbdkit.base.frozen import dataclass

MBDKIT = "mbdkit"  #: The distribution of the core and of its own plugins.

_OWN = "mbdkit.builtin_plugin"  #: Value of the entry point that only mbdkit itself has.


@dataclass(frozen=True)
class UnusableDistribution:
    """A distribution whose entry points are not used.

    `folder`: name of the folder with its metadata. `why`: reason, as a sentence without a full stop.
    """

    folder: str
    why: str


def entry_points(group: str) -> tuple[list[EntryPoint], list[UnusableDistribution]]:
    """Return the entry points of a group, those of mbdkit itself first, and the distributions that are not usable.

    A damaged file of one distribution makes `importlib.metadata.entry_points` fail for all. If several distributions
    have one name, the first on the path counts, as for imports; for mbdkit, the one that is mbdkit.
    """
    points = own_entry_points(group)
    unusable: list[UnusableDistribution] = []
    known: set[str] = set()
    for distribution in importlib.metadata.distributions():
        if (name := normalized_name(_stem(distribution)[0])) and name != MBDKIT and name in known:
            continue
        known.add(name)
        try:
            text = distribution.read_text("entry_points.txt")
            some = list(distribution.entry_points.select(group=group)) if text and f"[{group}]" in text else []
        except Exception as error:  # not UTF-8, not in the form of entry points, or not readable
            unusable.append(UnusableDistribution(_folder(distribution), f"its entry points cannot be read ({error})"))
            continue
        if not some:
            continue
        if MBDKIT not in (name, normalized_name(name_and_version(distribution)[0])):
            points += some
        elif not _is_own(distribution):
            unusable.append(UnusableDistribution(_folder(distribution), "it is not mbdkit, but calls itself so"))
    return points, list(dict.fromkeys(unusable))  # a folder may be on the path twice


def own_entry_points(group: str) -> list[EntryPoint]:
    """Return the entry points of mbdkit itself."""
    return list(_own_points().select(group=group))


@lru_cache
def name_and_version(distribution: Distribution) -> tuple[str, str]:
    """Return name and version of a distribution; if its metadata cannot be read, those in the name of their folder.

    The metadata are parsed once for a distribution with many entry points.
    """
    name, version = _stem(distribution)
    try:
        metadata = distribution.metadata
        return str(metadata["Name"] or name or "unknown"), str(metadata["Version"] or version or "unknown")
    except Exception:  # not UTF-8, or not readable
        return name or "unknown", version or "unknown"


def normalized_name(distribution: str) -> str:
    """Return the name of a distribution in the normalized form of PEP 503, in which names are compared."""
    return re.sub(r"[-_.]+", "-", distribution).lower()


def version_of(name: str) -> str:
    """Return the version of an installed distribution; the name of a folder mostly has it, and is quickly read."""
    distribution = Distribution.from_name(name)
    return _stem(distribution)[1] or distribution.version


@cache
def own_version() -> str:
    """Return the version of mbdkit."""
    return next((name_and_version(own)[1] for own in _named_mbdkit() if _is_own(own)), "unknown")


@cache
def _own_points() -> EntryPoints:
    return next((own.entry_points for own in _named_mbdkit() if _is_own(own)), EntryPoints())


def _named_mbdkit() -> Iterable[Distribution]:
    return importlib.metadata.distributions(name=MBDKIT)


def _is_own(distribution: Distribution) -> bool:
    try:
        return any(point.value == _OWN for point in distribution.entry_points)
    except Exception:  # as in `entry_points`
        return False


def _folder(distribution: Distribution) -> str:
    """Return the name of the folder with the metadata, which distributions on the path have."""
    return str(getattr(getattr(distribution, "_path", None), "name", "unknown"))


def _stem(distribution: Distribution) -> tuple[str, str]:
    """Return name and version in the name of the folder with the metadata; empty if it has none."""
    name, _, version = _folder(distribution).rpartition(".")[0].partition("-")
    return name, version
