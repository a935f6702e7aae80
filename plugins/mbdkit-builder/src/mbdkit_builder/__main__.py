"""``python -m mbdkit_builder``: build the machine code of the kernels.

build
    Build the stored libraries of this platform, or of another one, such as ``--platform linux-aarch64``, for all
    packages with kernels, or for those that are named. With ``--only SYMBOL``, build the library of one symbol in the
    folder ``built``.
check
    Build the libraries again and compare every byte with the stored ones, and the digests of their sources and of this
    package with those of the manifest. With ``--level x86-64-v3``, check only the libraries of this level.
objects
    Compile symbols to object files; `build` and `check` start processes that run this command.
contacts, elements, laws, methods
    Generate the kernels of contact rows, of elements or of the packaged force laws, or the signatures of methods that
    add elements; with ``--check``, compare them with the file in the repository.
list
    List all symbols and whether their stored code is up to date.
"""

from __future__ import annotations

import argparse
import filecmp
import importlib
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from mbdkit.engine.native import machine_code
from mbdkit.engine.native.levels import LEVELS, Platform, chosen_level, this_platform
from mbdkit.engine.native.machine_code import kernel_packages, stored_folder

_GENERATED = {
    "contacts": "contact_kernels",
    "elements": "element_kernels",
    "laws": "packaged_laws",
    "methods": "method_stubs",
}
"""Module that generates a file, by command."""


def main() -> int:
    """Run a command; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m mbdkit_builder", description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("build", "check", "objects"):
        command = commands.add_parser(name)
        command.add_argument("--platform", type=_platform, default=this_platform())
        if name != "objects":
            command.add_argument("packages", nargs="*")
        if name == "build":
            command.add_argument("--only")
        if name == "check":
            command.add_argument("--level")
        if name == "objects":
            command.add_argument("--into", type=Path, required=True)
            command.add_argument("--levels", nargs="+", required=True)
            command.add_argument("--symbols", nargs="+", required=True)
    commands.add_parser("list")
    for name in _GENERATED:
        commands.add_parser(name).add_argument("--check", action="store_true")
    given = parser.parse_args()
    if given.command == "list":
        return _list()
    if given.command in _GENERATED:
        from mbdkit_builder import generated_files

        module = importlib.import_module(f"mbdkit_builder.{_GENERATED[given.command]}")
        return generated_files.write(module.TARGET, module.generated(), check=given.check)
    if given.command == "objects":
        return _objects(given.platform, given.levels, given.symbols, given.into)
    if given.command == "check":
        return max(_check(package, given.platform, given.level) for package in given.packages or kernel_packages())
    if given.only:
        from mbdkit_builder.libraries import build_one

        print(build_one(given.only, given.platform, chosen_level()))
        return 0
    for package in given.packages or kernel_packages():
        _build(package, given.platform, stored_folder(package, given.platform))
    return 0


def _platform(text: str) -> Platform:
    system, _, architecture = text.partition("-")
    if system not in ("linux", "macos", "windows") or architecture not in LEVELS:
        raise argparse.ArgumentTypeError(f"'{text}' is not a platform such as linux-x86_64 or macos-aarch64")
    return Platform(system, architecture)


def _build(package: str, target: Platform, into: Path, *, only: str | None = None) -> None:
    from mbdkit_builder.libraries import build
    from mbdkit_builder.lowering import symbols

    build(target, symbols(package), into, only=only)
    size = sum(path.stat().st_size for path in into.iterdir())
    print(f"{into}: {size / 1e6:.2f} MB")


def _check(package: str, target: Platform, level: str | None) -> int:
    stored = stored_folder(package, target)
    with tempfile.TemporaryDirectory() as work:
        again = Path(work) / "again"
        _build(package, target, again, only=level)
        names = sorted({path.name for folder in (stored, again) for path in folder.glob("*")})
        if level:
            names = [name for name in names if name.endswith(f"-{level}.xz")]
        _, different, missing = filecmp.cmpfiles(stored, again, names, shallow=False)
        if level and _sources_in(stored) != _sources_in(again):
            different.append(machine_code.MANIFEST)
    if different or missing:
        print(f"the stored machine code of {package} is not what the sources say: {', '.join([*different, *missing])}")
        return 1
    print(f"the stored machine code of {package} is what the sources say, to the byte")
    return 0


def _sources_in(folder: Path) -> dict[str, Any]:
    """Return what the manifest in a folder says of sources, without the digests of libraries of all levels."""
    path = folder / machine_code.MANIFEST
    stored = json.loads(path.read_bytes()) if path.is_file() else {}
    return {key: value for key, value in stored.items() if key not in ("built with", "sha256")}


def _list() -> int:
    from mbdkit_builder.libraries import group_of
    from mbdkit_builder.lowering import symbols
    from mbdkit_builder.sources import builder_digests

    level = chosen_level()
    for package in kernel_packages():
        is_other = machine_code.manifest(package).get("builder") != builder_digests()
        for symbol in symbols(package):
            is_stored = machine_code.stored_file(symbol, level) is not None
            state = "differs from the builder" if is_other else "stored"
            state = state if is_stored else "differs from the sources"
            print(f"{symbol:<45} {group_of(symbol):<12} {state}")
    return 0


def _objects(target: Platform, levels: list[str], names: list[str], into: Path) -> int:
    from mbdkit_builder.libraries import object_path
    from mbdkit_builder.lowering import prepare, symbols
    from mbdkit_builder.object_code import emitted

    makers = symbols(machine_code.package_of(names[0]))
    prepare()
    known = {level.name: level for level in target.levels}
    for symbol in names:
        module = makers[symbol]()
        for level in levels:
            path = object_path(into, target, symbol, level)
            draft = path.with_suffix(f".{os.getpid()}")
            draft.write_bytes(emitted(module, symbol, target, known[level]))
            draft.replace(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
