"""Find and load machine code: the stored libraries, and libraries that a developer has built from changed sources.

The folder ``stored`` holds compressed shared libraries for each platform and processor level, and a manifest with the
digests of the sources that they were built from. Where these sources are unchanged, the stored code is used. Where they
differ, a developer's changes are compiled symbol by symbol into the folder ``built``, which is not part of the
distribution; this needs the extra ``dev``. Which version of the compiler built the stored code is not looked at here;
``python -m mbdkit_builder check`` does that.

Packages of plugins may have kernels of their own, in a subpackage ``kernels``, and their machine code beside it in a
folder ``stored``. They name themselves as entry points of the group ``mbdkit.kernels``.

A wheel for a platform has its libraries uncompressed, and they are loaded in place: programs that guard against
unpacked code block copies in other folders. A clone has those of all platforms compressed, because Git keeps every
version. There a library is decompressed once into the folder ``built``, under a name that contains its digest; where
this folder cannot be written, on Linux, into a file in memory. The digest of a library is compared with the manifest
before it is loaded.

With ``MBDKIT_JIT=1`` the stored code is not used, for comparison. With ``MBDKIT_KERNELS=python`` kernels run as
functions of Python, about a thousand times slower, to debug them.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import importlib.util
import json
import lzma
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path
from types import ModuleType
from typing import Any

from mbdkit.base.distributions import entry_points, own_entry_points
from mbdkit.base.errors import MbdkitError
from mbdkit.engine.native.levels import PLATFORMS, Level, Platform, chosen_level, is_able, this_platform

PACKAGE = Path(__file__).resolve().parents[2]
BUILDER = "mbdkit_builder"  #: The package that compiles; imported only for code that is not stored.
CORE = "mbdkit"
STORED = Path(__file__).parent / "stored"
BUILT = Path(__file__).parent / "built"
MANIFEST = "manifest.json"
_GROUP = "mbdkit.kernels"
#: Operating systems on which mbdkit as a whole has been run; on Windows, only its kernels have.
TESTED = ("linux",)

#: Value of ``MBDKIT_KERNELS`` in processes that compile kernels, and call some as functions of Python.
COMPILED = "compiled"
#: Whether kernels run as functions of Python.
IN_PYTHON = os.environ.get("MBDKIT_KERNELS") in ("python", COMPILED)
#: Whether this process compiles kernels, whose functions of `math` must stay as they are.
IS_COMPILED = os.environ.get("MBDKIT_KERNELS") == COMPILED
#: Whether kernels are compiled even if their stored code is up to date.
_COMPILE = os.environ.get("MBDKIT_JIT", "") not in ("", "0")


def address_of(symbol: str) -> int:
    """Return the address of the machine code of a symbol, which is loaded or compiled first if necessary.

    Raises MbdkitError if there is no such code for this platform and processor and it cannot be compiled, if the
    processor lacks instructions that the code needs, or if a stored library is damaged or cannot be loaded.
    """
    level = _usable_level()
    path = None if _COMPILE else stored_file(symbol, level)
    library = _built(symbol, level) if path is None else _load_stored(path, package_of(symbol))
    address = ctypes.cast(getattr(library, symbol), ctypes.c_void_p).value
    assert address is not None
    return address


def _usable_level() -> Level:
    level, levels = chosen_level(), this_platform().levels
    if levels and level not in levels:  # only the compiler uses levels of other platforms
        known = ", ".join(known.name for known in levels)
        raise MbdkitError(f"the environment variable MBDKIT_PROCESSOR should be one of {known}, not '{level.name}'")
    if not is_able(level):
        asked = "which MBDKIT_PROCESSOR asks for" if os.environ.get("MBDKIT_PROCESSOR") else "the lowest that is stored"
        raise MbdkitError(f"this processor lacks instructions of the level {level.name}, {asked}")
    return level


def package_of(symbol: str) -> str:
    """Return the package of the kernel with a symbol."""
    package, _, name = symbol.partition("___")
    return package if name else CORE


@cache
def folder_of(package: str) -> Path:
    """Return the folder of a package with kernels."""
    if package == CORE:
        return PACKAGE
    if (spec := importlib.util.find_spec(package)) is None or not spec.submodule_search_locations:
        raise MbdkitError(
            f"the package '{package}', which an entry point of the group mbdkit.kernels names, is missing"
        )
    return Path(spec.submodule_search_locations[0])


def stored_folder(package: str, target: Platform) -> Path:
    """Return the folder of the stored libraries of a package for a platform."""
    return (STORED if package == CORE else folder_of(package) / "stored") / str(target)


@cache
def kernel_packages() -> tuple[str, ...]:
    """Return the packages that have kernels, mbdkit itself first, those of other distributions last; of these, packages
    that cannot be imported are left out.
    """
    own = own_kernel_packages()
    named = {point.value for point in entry_points(_GROUP)[0]} - set(own)
    return (*own, *sorted(name for name in named if _is_package(name)))


@cache
def own_kernel_packages() -> tuple[str, ...]:
    """Return the packages of mbdkit that have kernels: the core, and parts."""
    return (CORE, *sorted(point.value for point in own_entry_points(_GROUP)))


def _is_package(name: str) -> bool:
    try:
        spec = importlib.util.find_spec(name)
    except Exception:  # not the name of a package, or its parent cannot be imported
        return False
    return spec is not None and bool(spec.submodule_search_locations)


@cache
def manifest(package: str = CORE) -> dict[str, Any]:
    """Return the manifest of the stored libraries of a package for this platform; empty if there are none.

    Raises MbdkitError if it is damaged.
    """
    path = stored_folder(package, this_platform()) / MANIFEST
    with _damage_reported(package):
        try:
            stored: dict[str, Any] = json.loads(path.read_bytes())
        except FileNotFoundError:
            return {}
        if any(not isinstance(stored[key], kind) for key, kind in _KINDS.items()):
            raise TypeError
    return stored


#: Suffix of a library by operating system; ``.so`` on others.
_SUFFIXES = {"macos": ".dylib", "windows": ".dll"}
#: Keys of the manifest, with the types of their values.
_KINDS = {"built with": dict, "files": dict, "modules": dict, "names": list, "sha256": dict, "symbols": dict}


@contextmanager
def _damage_reported(package: str) -> Iterator[None]:
    """Raise MbdkitError if reading the manifest, or looking up one of its values, raises an exception."""
    try:
        yield
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        path = stored_folder(package, this_platform()) / MANIFEST
        what = f"the list of the stored machine code, {path}, is damaged"
        raise MbdkitError(f"{what}: install {_distribution(package)} again") from error


def _distribution(package: str) -> str:
    with suppress(Exception):  # another distribution may be damaged
        return next(iter(packages_distributions().get(package, [])), package)
    return package


def stored_file(symbol: str, level: Level) -> Path | None:
    """Return the path of the stored library with a symbol; None if there is none or the sources have changed.

    Where the library is compressed, it is the path without ``.xz``.
    """
    package = package_of(symbol)
    stored = manifest(package)
    if symbol not in stored.get("symbols", {}):
        return None
    with _damage_reported(package):
        group, module = stored["symbols"][symbol]
        names = (stored["names"][i] for i in stored["modules"][module])
        if any(digest(name) != stored["files"][name] for name in names):
            return None
        target = this_platform()
        return stored_folder(package, target) / name_of_library(group, target, level.of(group))


def name_of_library(group: str, target: Platform, level: str) -> str:
    """Return the name of the file of a library; where it is compressed, ``.xz`` follows."""
    return f"{group}-{level}{_SUFFIXES.get(target.system, '.so')}"


def source_file(name: str) -> Path:
    """Return a source file by its path in mbdkit, or in another package, as in ``mbdkit_part:kernels/cones.py``."""
    package, _, path = name.rpartition(":")
    return folder_of(package or CORE) / path


@cache
def digest(file: str) -> str:
    """Return 16 hex digits of the SHA-256 digest of a file, without regard to line ends; see `source_file`."""
    content = source_file(file).read_bytes().replace(b"\r\n", b"\n")
    return hashlib.sha256(content).hexdigest()[:16]


@cache
def _load_stored(path: Path, package: str) -> ctypes.CDLL:
    _say_whether_untested()
    with _damage_reported(package):
        digest = manifest(package)["sha256"][path.name]
    try:
        return _loaded(path, digest)
    except OSError as error:
        raise MbdkitError(f"the stored machine code {path} cannot be loaded: {error}") from error


@cache
def _say_whether_untested() -> None:
    """Say on stderr, once for an installation, if nobody has run mbdkit on this platform."""
    mark = BUILT / f"{this_platform()}.untested"
    if this_platform().system in TESTED or mark.exists():
        return
    compare = "`mbdkit doctor` compares ten small runs with those of other platforms"
    print(f"note: mbdkit has never been tested on {this_platform()}; {compare}", file=sys.stderr, flush=True)
    with suppress(OSError):
        BUILT.mkdir(exist_ok=True)
        mark.touch()


def _loaded(path: Path, digest: str) -> ctypes.CDLL:
    """Load a library; raise MbdkitError if its digest is wrong, and OSError if it cannot be read or loaded."""
    if path.is_file():
        _check_digest(path, path.read_bytes(), digest)
        return ctypes.CDLL(str(path))
    unpacked = BUILT / f"{path.stem}-{digest[:16]}{path.suffix}"
    if unpacked.is_file() and hashlib.sha256(unpacked.read_bytes()).hexdigest() == digest:
        return ctypes.CDLL(str(unpacked))
    packed = path.with_name(f"{path.name}.xz")
    try:
        content = lzma.decompress(packed.read_bytes())
    except lzma.LZMAError:
        content = b""
    _check_digest(packed, content, digest)
    draft = unpacked.with_suffix(f".{os.getpid()}")
    try:
        BUILT.mkdir(exist_ok=True)
        draft.write_bytes(content)
    except OSError:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        if hasattr(os, "memfd_create"):  # only Linux has files in memory, for folders that are read-only
            return _from_memory_file(path.name, content)
        raise
    try:
        draft.replace(unpacked)
    except PermissionError:  # on Windows, if another process has loaded it in the meantime
        draft.unlink()
    for old in BUILT.glob(f"{path.stem}-*{path.suffix}"):
        if old != unpacked:
            with suppress(OSError):
                old.unlink()
    return ctypes.CDLL(str(unpacked))


def _check_digest(path: Path, content: bytes, digest: str) -> None:
    if hashlib.sha256(content).hexdigest() != digest:
        raise MbdkitError(f"the stored machine code {path} is damaged: install mbdkit again")


def _from_memory_file(name: str, content: bytes) -> ctypes.CDLL:
    # The file stays open. If it were closed, the next library could get the same number, hence the same path, and the
    # loader, which identifies libraries by their paths, would return this one.
    file = os.memfd_create(name)
    with open(file, "wb", closefd=False) as stream:
        stream.write(content)
    path = f"/proc/self/fd/{file}"
    if not os.path.exists(path):
        raise FileNotFoundError(path)
    return ctypes.CDLL(path)


def code_id() -> str:
    """Return a digest of the stored libraries of mbdkit for this platform, which identifies its machine code.

    Machine code of other distributions is looked up when it is used; their versions identify it.
    """
    digests = manifest().get("sha256", {})
    digests = digests | {
        f"{package}:{name}": digest
        for package in own_kernel_packages()[1:]
        for name, digest in manifest(package).get("sha256", {}).items()
    }
    return hashlib.sha256(json.dumps(digests, sort_keys=True).encode()).hexdigest()[:16] if digests else "none"


def code_report() -> dict[str, object]:
    """Return platform, processor level, number of lanes, whether stored code exists, and the tools that built it."""
    level = chosen_level()
    return {
        "platform": str(this_platform()),
        "processor_level": level.name,
        "lanes": level.lanes,
        "stored": bool(manifest()),
        "tested": this_platform().system in TESTED,
        "built_with": manifest().get("built with", {}),
    }


def code_text() -> str:
    """Return a text with platform, level and lanes of the machine code; it begins with "no" if none is stored."""
    level = chosen_level()
    where = f"machine code for {this_platform()}, level {level.name}, {level.lanes} lanes"
    where = where if manifest() else f"no {where}"
    return where if this_platform().system in TESTED else f"{where}; mbdkit has never been tested on this platform"


# --- code that is not stored


def builder(module: str) -> ModuleType:
    """Import a module of the builder; raises ImportError if the builder or Numba is not installed."""
    return importlib.import_module(f"{BUILDER}.{module}")


def _built(symbol: str, level: Level) -> ctypes.CDLL:
    if not _has_compiler():
        raise MbdkitError(_why_not())
    why = "MBDKIT_JIT is set" if _COMPILE else "its sources differ from those of the stored machine code"
    return ctypes.CDLL(str(builder("libraries").built_library(symbol, level, why)))


def _has_compiler() -> bool:
    return all(importlib.util.find_spec(name) is not None for name in (BUILDER, "numba", "ziglang"))


def _why_not() -> str:
    if not manifest():
        return (
            f"this installation of mbdkit has no machine code for {this_platform()}: install a wheel for this platform"
            if this_platform() in PLATFORMS
            else f"there is no machine code for {this_platform()}, only for {', '.join(map(str, PLATFORMS))}"
        )
    return (
        "the sources of the kernels differ from their stored machine code: install mbdkit again, or in a clone "
        "`pip install -e .[dev]`, which compiles what has changed"
    )
