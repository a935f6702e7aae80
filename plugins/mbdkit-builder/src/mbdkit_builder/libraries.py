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
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from mbdkit.base.errors import MbdkitError
from mbdkit.engine.native import machine_code
from mbdkit.engine.native.levels import PLATFORMS, Level, Platform, this_platform
from mbdkit_builder import sources
from mbdkit_builder.binary_files import check_imports
from mbdkit_builder.sources import module_of

TOOLS = ("numba", "llvmlite", "ziglang")
#: Target of Zig and options of the linker, by operating system.
_LINK = {
    "linux": ("{}-linux-gnu.2.17", "-Wl,--as-needed", "-lm"),
    "macos": ("{}-macos.11.0",),
    # Without a C library, whose startup code would be linked. Memory functions and stack probes are those of Zig.
    "windows": ("{}-windows-gnu", "-nostdlib", "-rtlib=compiler-rt", "-Wl,--no-entry"),
}  # fmt: skip


class Code(NamedTuple):
    """What machine code is compiled for; as a text, such as ``linux-x86_64/x86-64-v3``."""

    platform: Platform
    level: Level

    def __str__(self) -> str:
        return f"{self.platform}/{self.level.name}"


def code_named(text: str) -> Code:
    """Return the code with a text; see `Code`."""
    known = {str(code): code for target in PLATFORMS for code in (Code(target, level) for level in target.levels)}
    return known[text]


def group_of(symbol: str) -> str:
    """Return the library of a symbol: ``lanes``, ``gradients``, ``collocation`` or ``core``."""
    name = module_of(symbol).rpartition("/")[2]
    if name.startswith("lane_"):
        return "lanes"
    if name.startswith("dual_") or symbol.endswith("__dual"):
        return "gradients"
    return "collocation" if name.startswith(("collocation", "lobatto")) else "core"


def build(folders: Mapping[Platform, Path], names: Iterable[str], *, only: str | None = None) -> None:
    """Build the libraries of platforms and their manifests into new folders.

    Every symbol is compiled, because the code of a symbol depends on which ones the same process compiled before it.

    Parameters
    ----------
    folders
        The folder of each platform, which is replaced.
    names
        All symbols.
    only
        Name of the only level to build, for comparison.
    """
    groups: dict[str, list[str]] = {}
    for symbol in names:
        groups.setdefault(group_of(symbol), []).append(symbol)
    with tempfile.TemporaryDirectory() as work:
        codes = [Code(target, level) for target in folders for level in target.levels if only in (None, level.name)]
        objects = _objects(codes, groups, Path(work) / "objects")
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            contents = list(
                pool.map(lambda item: _linked(item[0][0], item[1], item[0][1], Path(work)), objects.items())
            )
            for (target, name), content in zip(objects, contents, strict=True):
                check_imports(content, target.system, name)
            packed = list(pool.map(lambda content: lzma.compress(content, preset=9 | lzma.PRESET_EXTREME), contents))
        for target, into in folders.items():
            new = Path(work) / str(target)
            new.mkdir()
            digests = {}
            for (other, name), content, text in zip(objects, contents, packed, strict=True):
                if other == target:
                    (new / f"{name}.xz").write_bytes(text)
                    digests[name] = hashlib.sha256(content).hexdigest()
            listed = json.dumps(_manifest(groups, digests), indent=1, sort_keys=True) + "\n"
            (new / machine_code.MANIFEST).write_text(listed, encoding="utf-8", newline="\n")
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
        "files": {file: machine_code.digest(file) for file in files},
        "names": files,
        "modules": {module: [files.index(file) for file in found] for module, found in behind.items()},
        "symbols": {symbol: [group, module_of(symbol)] for group, names in groups.items() for symbol in names},
        "sha256": digests,
    }


def _objects(
    codes: list[Code], groups: Mapping[str, list[str]], folder: Path
) -> dict[tuple[Platform, str], list[Path]]:
    """Compile all symbols into a folder; return the object files of each library by platform and name of its file.

    Numba takes most of the time. Its result depends on the number of lanes, and only for `lanes`.
    """
    folder.mkdir(exist_ok=True)
    counts = sorted({code.level.lanes for code in codes}, reverse=True)
    _compile(codes, [sources.ELEMENTARY], folder)
    jobs = [([code for code in codes if code.level.lanes == lanes], groups.get("lanes", [])) for lanes in counts]
    for name in ("gradients", "collocation", "core"):
        own = [code for code in codes if code.level.of(name) == code.level.name]
        jobs += [(own, groups.get(name, [])[i::2]) for i in range(2)]
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        list(pool.map(lambda job: _compile(job[0], job[1], folder), jobs))
    found: dict[tuple[Platform, str], list[Path]] = {}
    for built, names in jobs:
        for code in built:
            for symbol in names:
                library = machine_code.name_of_library(group_of(symbol), code.platform, code.level.name)
                paths = found.setdefault((code.platform, library), [object_path(folder, sources.ELEMENTARY, code)])
                paths.append(object_path(folder, symbol, code))
    return dict(sorted(found.items(), key=lambda item: (str(item[0][0]), item[0][1])))


def object_path(folder: Path, symbol: str, code: Code) -> Path:
    """Return the path of the object file of a symbol; it contains the fingerprint of the present sources."""
    return folder / f"{symbol}-{code.platform}-{code.level.name}-{sources.fingerprint(module_of(symbol))}.o"


def _compile(codes: list[Code], names: list[str], folder: Path) -> None:
    names = [name for name in names if not all(object_path(folder, name, code).is_file() for code in codes)]
    if not names or not codes:
        return
    command = [sys.executable, "-P", "-m", __package__, "objects", "--into", str(folder), "--codes", *map(str, codes),
               "--symbols", *names]  # fmt: skip
    path = os.pathsep.join(filter(None, [str(machine_code.PACKAGE.parent), *sys.path]))
    environment = {
        "PYTHONPATH": path, "MBDKIT_KERNELS": machine_code.COMPILED, "MBDKIT_PROCESSOR": codes[0].level.name,
        "PYTHONHASHSEED": "0",
    }  # fmt: skip
    subprocess.run(command, env=os.environ | environment, check=True, stdin=subprocess.DEVNULL)


def _linked(target: Platform, objects: Iterable[Path], name: str, folder: Path) -> bytes:
    """Link object files to a library, `name`; return its content.

    Libraries for macOS are signed ad hoc by the linker, which processors of Apple require.
    """
    triple, *options = _LINK[target.system]
    architecture = {"arm64": "aarch64"}.get(target.architecture, target.architecture)
    into = folder / f"linked-{target}"
    into.mkdir(exist_ok=True)
    command = [sys.executable, "-m", "ziglang", "cc", "-target", triple.format(architecture), "-shared", "-s",
               "-o", name, *map(str, objects), *options]  # fmt: skip
    subprocess.run(command, check=True, cwd=into, stdin=subprocess.DEVNULL)
    content = bytearray((into / name).read_bytes())
    if target.system == "windows":
        # The time of linking, four bytes behind the header's signature, machine and number of sections.
        stamp = int.from_bytes(content[0x3C:0x40], "little") + 8
        content[stamp : stamp + 4] = bytes(4)
    return bytes(content)


def built_path(symbol: str, level: Level) -> Path:
    """Return the file of the library of one symbol, built from the present sources of its module."""
    return machine_code.BUILT / f"{symbol}-{level.name}-{sources.fingerprint(module_of(symbol))}.so"


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


def build_one(symbol: str, level: Level) -> Path:
    """Build the library of one symbol for this platform from the present sources; return its path."""
    path, code = built_path(symbol, level), Code(this_platform(), level)
    with tempfile.TemporaryDirectory() as work:
        path.parent.mkdir(exist_ok=True)
        names = [symbol, sources.ELEMENTARY]
        _compile([code], names, path.parent)
        objects = [object_path(path.parent, name, code) for name in names]
        content = _linked(code.platform, objects, f"{symbol}.so", Path(work))
    draft = path.with_suffix(f".{os.getpid()}")
    draft.write_bytes(content)
    draft.replace(path)
    for old in path.parent.glob(f"{symbol}-{level.name}-*.so"):
        if old != path:
            with suppress(OSError):  # Windows keeps the file of a loaded library
                old.unlink()
    return path
