"""Build the stored machine code: object files in several processes, libraries by the linker of Zig, and a manifest.

Separate libraries contain the code of gradients, of lanes (several runs advanced together by SIMD instructions), of
collocation methods, and all other code, so that a run loads only what it uses. Code for lanes is built for every level
of a platform (set of processor instructions, `mbdkit.engine.native.levels`), since the number of lanes depends on the
level. Other code is not built for levels that use the code of another level.
"""

from __future__ import annotations

import hashlib
import json
import lzma
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mbdkit.base.errors import MbdkitError
from mbdkit.engine.native.levels import Level, Platform
from mbdkit.engine.native.machine_code import MANIFEST, PACKAGE, digest
from mbdkit_builder import sources
from mbdkit_builder.library_imports import check_imports
from mbdkit_builder.sources import module_of

BUILT = PACKAGE / "engine/native/built"
TOOLS = ("numba", "llvmlite", "ziglang")
_LINK = {
    "linux": "{}-linux-gnu.2.17", "macos": "{}-macos.11.0", "windows": "{}-windows-gnu",
}  # fmt: skip
_SUFFIX = {"linux": ".so", "macos": ".dylib", "windows": ".dll"}


def group_of(symbol: str) -> str:
    """Return the library of a symbol: ``lanes``, ``gradients``, ``collocation`` or ``core``."""
    name = module_of(symbol).rpartition("/")[2]
    if name.startswith("lane_"):
        return "lanes"
    if name.startswith("dual_") or symbol.endswith("__dual"):
        return "gradients"
    return "collocation" if name.startswith(("collocation", "lobatto")) else "core"


def build(target: Platform, names: Iterable[str], into: Path, *, only: str | None = None) -> None:
    """Build the libraries of a platform and their manifest into a new folder.

    Every symbol is compiled, because the code of a symbol depends on which ones the same process compiled before it.

    Parameters
    ----------
    target
        The platform.
    names
        All symbols.
    into
        The folder, which is replaced.
    only
        Name of the only level to build, for comparison.
    """
    groups: dict[str, list[str]] = {}
    for symbol in names:
        groups.setdefault(group_of(symbol), []).append(symbol)
    with tempfile.TemporaryDirectory() as work:
        levels = [level for level in target.levels if only in (None, level.name)]
        objects = _objects(target, levels, groups, Path(work))
        new = Path(work) / "libraries"
        new.mkdir()
        digests = {}
        for (group, level), paths in sorted(objects.items()):
            packed = new / f"{group}-{level}.xz"
            content = _linked(target, paths, Path(work) / f"{group}-{level}{_SUFFIX[target.system]}")
            if target.system == "linux":
                check_imports(content, f"{group}-{level}")
            packed.write_bytes(lzma.compress(content, preset=9 | lzma.PRESET_EXTREME))
            digests[packed.name] = hashlib.sha256(packed.read_bytes()).hexdigest()
        text = json.dumps(_manifest(groups, digests), indent=1, sort_keys=True) + "\n"
        (new / MANIFEST).write_text(text, encoding="utf-8", newline="\n")
        shutil.rmtree(into, ignore_errors=True)
        shutil.copytree(new, into)


def _manifest(groups: Mapping[str, list[str]], digests: Mapping[str, str]) -> dict[str, Any]:
    modules = sorted({module_of(symbol) for names in groups.values() for symbol in names})
    behind = {module: sources.files_behind(module) for module in modules}
    files = sorted({file for found in behind.values() for file in found})
    return {
        "built with": {
            "python": ".".join(platform.python_version_tuple()[:2]),
            **{name: version(name) for name in TOOLS},
        },
        "builder": sources.builder_digests(),
        "files": {file: digest(file) for file in files},
        "names": files,
        "modules": {module: [files.index(file) for file in found] for module, found in behind.items()},
        "symbols": {symbol: [group, module_of(symbol)] for group, names in groups.items() for symbol in names},
        "sha256": digests,
    }


def _objects(
    target: Platform, levels: list[Level], groups: Mapping[str, list[str]], folder: Path
) -> dict[tuple[str, str], list[Path]]:
    """Compile all symbols into a folder; return the object files of each library."""
    folder.mkdir(exist_ok=True)
    jobs: list[tuple[list[str], list[str]]] = [([level.name], groups.get("lanes", [])) for level in levels]
    for name in ("gradients", "collocation", "core"):
        own = [level.name for level in levels if level.of(name) == level.name]
        jobs += [(own, groups.get(name, [])[i::2]) for i in range(2)]
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        list(pool.map(lambda job: _compile(target, job[0], job[1], folder), jobs))
    found: dict[tuple[str, str], list[Path]] = {}
    for built, names in jobs:
        for name in built:
            for symbol in names:
                found.setdefault((group_of(symbol), name), []).append(object_path(folder, target, symbol, name))
    return found


def object_path(folder: Path, target: Platform, symbol: str, level: str) -> Path:
    """Return the path of the object file of a symbol; it contains the fingerprint of the present sources."""
    return folder / f"{symbol}-{target}-{level}-{sources.fingerprint(module_of(symbol))}.o"


def _compile(target: Platform, levels: list[str], names: list[str], folder: Path) -> None:
    names = [name for name in names if not all(object_path(folder, target, name, one).is_file() for one in levels)]
    if not names:
        return
    command = [sys.executable, "-P", "-m", __package__, "objects", "--platform", str(target), "--into",
               str(folder), "--levels", *levels, "--symbols", *names]  # fmt: skip
    path = os.pathsep.join(filter(None, [str(PACKAGE.parent), *sys.path]))
    environment = {
        "PYTHONPATH": path, "MBDKIT_KERNELS": "python", "MBDKIT_PROCESSOR": levels[0], "PYTHONHASHSEED": "0",
    }  # fmt: skip
    subprocess.run(command, env=os.environ | environment, check=True, stdin=subprocess.DEVNULL)


def _linked(target: Platform, objects: Iterable[Path], path: Path) -> bytes:
    """Link object files to a library at `path`; return its content."""
    architecture = target.architecture
    command = [sys.executable, "-m", "ziglang", "cc", "-target", _LINK[target.system].format(architecture), "-shared",
               "-s", "-o", path.name, *map(str, objects), "-lm"]  # fmt: skip
    subprocess.run(command, check=True, cwd=path.parent, stdin=subprocess.DEVNULL)
    return path.read_bytes()


def built_path(symbol: str, level: Level) -> Path:
    """Return the file of the library of one symbol, built from the present sources of its module."""
    return BUILT / f"{symbol}-{level.name}-{sources.fingerprint(module_of(symbol))}.so"


def built_library(symbol: str, level: Level, why: str) -> Path:
    """Return the library of one symbol; if it is not built yet, a process builds it, and `why` is printed.

    Raises
    ------
    MbdkitError
        If it cannot be compiled.
    """
    path = built_path(symbol, level)
    if path.is_file():
        return path
    print(f"mbdkit compiles {symbol}: {why} ...", file=sys.stderr, flush=True)
    command = [sys.executable, "-P", "-m", __package__, "build", "--only", symbol]
    environment = os.environ | {
        "MBDKIT_PROCESSOR": level.name, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
    }  # fmt: skip
    done = subprocess.run(command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if done.returncode != 0:
        raise MbdkitError(f"{symbol} cannot be compiled:\n{done.stdout}{done.stderr}")
    return path


def build_one(symbol: str, target: Platform, level: Level) -> Path:
    """Build the library of one symbol from the present sources, for a developer; return its path."""
    path = built_path(symbol, level)
    with tempfile.TemporaryDirectory() as work:
        path.parent.mkdir(exist_ok=True)
        _compile(target, [level.name], [symbol], path.parent)
        one = object_path(path.parent, target, symbol, level.name)
        content = _linked(target, [one], Path(work) / f"{symbol}.so")
    draft = path.with_suffix(f".{os.getpid()}")
    draft.write_bytes(content)
    draft.replace(path)
    for old in path.parent.glob(f"{symbol}-{level.name}-*.so"):
        if old != path:
            old.unlink(missing_ok=True)
    return path
