"""Entry points of the installed distributions, of which any may be damaged or take the name of mbdkit."""

from __future__ import annotations

import importlib.metadata
import re
from collections.abc import Iterable
from contextlib import suppress
from functools import cache, lru_cache
from importlib.metadata import Distribution, EntryPoint, EntryPoints, PackageNotFoundError
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules

from mbdkit.base.frozen import dataclass

MBDKIT = "mbdkit"  #: The distribution of the core and of its own plugins.

_OWN = "mbdkit.builtin_plugin"  #: Value of the entry point that only mbdkit itself has.
_SUFFIXES = (".py", ".so", ".pyd")  #: Those of modules.
#: Begins of the names of modules that lie beside a package in a source folder, or that installers write.
_NO_CODE = ("test", "conftest", "setup", "__editable__")


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


def code_of_distribution(name: str) -> set[Path]:
    """Return the packages and modules of a distribution, at the top level or in a namespace; empty if not installed.

    In an editable installation, they are those in ``top_level.txt``, or those in the source folder that its ``.pth``
    file names.
    """
    with suppress(PackageNotFoundError):
        distribution = Distribution.from_name(name)
        files = [file for file in distribution.files or () if ".." not in file.parts]
        modules = {file.parts[0].partition(".")[0] for file in files if file.suffix in _SUFFIXES}
        modules |= set((distribution.read_text("top_level.txt") or "").split())
        for path in (Path(str(file.locate())) for file in files if file.suffix == ".pth"):
            modules |= {one.name for one in iter_modules(path.read_text(encoding="utf-8").splitlines())}
        code = set[Path]()
        for module in (one for one in modules if not one.startswith(_NO_CODE)):
            places = {Path(*file.parts[:2]) for file in files if file.parts[0] == module}
            code |= code_of_module(module) or {Path(str(distribution.locate_file(place))) for place in places}
        return code
    return set()


def code_of_module(name: str) -> set[Path]:
    """Return the folder of a package, or the file of a module, at the top level; empty for a namespace."""
    spec = find_spec(name)
    if spec is None or spec.origin is None:
        return set()
    return {Path(spec.origin).parent if spec.submodule_search_locations else Path(spec.origin)}


def required_by(*names: str, extras: bool = False) -> set[str]:
    """Return the names of the distributions that the metadata of some distributions require."""
    texts = list[str]()
    for name in names:
        with suppress(PackageNotFoundError):
            texts += Distribution.from_name(name).requires or ()
    return {normalized_name(re.split(r"[^\w.-]", x, maxsplit=1)[0]) for x in texts if extras or "extra ==" not in x}


def required_versions(name: str) -> dict[str, str]:
    """Return the versions of the installed distributions that the metadata of a distribution require, by name."""
    versions = dict[str, str]()
    for other in sorted(required_by(name)):
        with suppress(PackageNotFoundError):  # required on other platforms
            versions[other] = version_of(other)
    return versions


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
