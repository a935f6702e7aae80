"""``python -m mbdkit_builder``: build the machine code of the kernels.

build
    Build the stored libraries of this platform, of others, as in ``--platform linux-aarch64 --platform macos-arm64``,
    or of all platforms with ``--all``, for all packages with kernels, or for those that are named. With
    ``--only SYMBOL``, build the library of one symbol in the folder ``built``.
check
    Build the libraries of all platforms, or of some, again and compare every byte with the stored ones, and the digests
    of their sources and of this package with those of the manifests. With ``--level x86-64-v3``, check only the
    libraries of this level.
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
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mbdkit.engine.native import machine_code
from mbdkit.engine.native.levels import PLATFORMS, Level, Platform, chosen_level, this_platform

#: Module that generates a file, by command.
_GENERATED = {
    "contacts": "contact_kernels",
    "elements": "element_kernels",
    "laws": "packaged_laws",
    "methods": "method_stubs",
}


def main() -> int:
    """Run a command; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m mbdkit_builder", description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("build", "check"):
        command = commands.add_parser(name)
        command.add_argument("packages", nargs="*", help=f"by default all: {', '.join(machine_code.kernel_packages())}")
        command.add_argument("--platform", type=_platform, action="append", metavar="NAME")
    build, check = (commands.choices[name] for name in ("build", "check"))
    build.add_argument("--all", action="store_true")
    build.add_argument("--only")
    check.add_argument("--level")
    objects = commands.add_parser("objects")
    objects.add_argument("--into", type=Path, required=True)
    objects.add_argument("--codes", nargs="+", required=True)
    objects.add_argument("--symbols", nargs="+", required=True)
    commands.add_parser("list")
    for name in _GENERATED:
        commands.add_parser(name).add_argument("--check", action="store_true")
    given = parser.parse_args()
    if given.command == "list":
        return _list()
    if given.command in _GENERATED:
        module = importlib.import_module(f"mbdkit_builder.{_GENERATED[given.command]}")
        return write_generated(module.TARGET, module.generated(), check=given.check)
    if given.command == "objects":
        return _objects(given.codes, given.symbols, given.into)
    packages = given.packages or machine_code.kernel_packages()
    if given.command == "check":
        return max(_check(package, given.platform or list(PLATFORMS), given.level) for package in packages)
    if given.only:
        from mbdkit_builder.libraries import build_one

        print(build_one(given.only, chosen_level()))
        return 0
    targets = list(PLATFORMS) if given.all else given.platform or [this_platform()]
    for package in packages:
        _build(package, {target: machine_code.stored_folder(package, target) for target in targets})
    return 0


def write_generated(target: Path, text: str, *, check: bool) -> int:
    """Write a generated module, or check that it has this text; return the exit status."""
    if check:
        is_fresh = target.read_text(encoding="utf-8") == text
        print(f"{target.name} is {'fresh' if is_fresh else 'out of date'}")
        return 0 if is_fresh else 1
    target.write_text(text, encoding="utf-8", newline="\n")
    return 0


def _platform(text: str) -> Platform:
    system, _, architecture = text.partition("-")
    if (target := Platform(system, architecture)) not in PLATFORMS:
        raise argparse.ArgumentTypeError(f"'{text}' is not one of {', '.join(map(str, PLATFORMS))}")
    return target


def _build(package: str, folders: Mapping[Platform, Path], *, only: str | None = None) -> None:
    from mbdkit_builder.libraries import build
    from mbdkit_builder.lowering import symbols

    build(folders, symbols(package), only=only)
    for into in folders.values():
        size = sum(path.stat().st_size for path in into.iterdir())
        print(f"{into}: {size / 1e6:.2f} MB")


def _check(package: str, targets: Iterable[Platform], level: str | None) -> int:
    targets = [target for target in targets if level is None or level in (known.name for known in target.levels)]
    if not targets:
        print(f"none of these platforms has a level {level}")
        return 2
    wrong = []
    with tempfile.TemporaryDirectory() as work:
        folders = {target: Path(work) / str(target) for target in targets}
        _build(package, folders, only=level)
        for target, again in folders.items():
            stored = machine_code.stored_folder(package, target)
            names = sorted({path.name for folder in (stored, again) for path in folder.glob("*")})
            if level:
                names = [name for name in names if f"-{level}." in name]
            _, different, missing = filecmp.cmpfiles(stored, again, names, shallow=False)
            if level and _sources_in(stored) != _sources_in(again):
                different.append(machine_code.MANIFEST)
            wrong += [f"{target}/{name}" for name in [*different, *missing]]
    if wrong:
        print(f"the stored machine code of {package} is not what the sources say: {', '.join(wrong)}")
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
    for package in machine_code.kernel_packages():
        is_other = machine_code.manifest(package).get("builder") != builder_digests()
        for symbol in symbols(package):
            is_stored = machine_code.stored_file(symbol, level) is not None
            state = "differs from the builder" if is_other else "stored"
            state = state if is_stored else "differs from the sources"
            print(f"{symbol:<45} {group_of(symbol):<12} {state}")
    return 0


def _objects(codes: list[str], names: list[str], into: Path) -> int:
    from mbdkit_builder.libraries import code_named, object_path
    from mbdkit_builder.lowering import prepare, symbols
    from mbdkit_builder.object_code import elementary_module, emitted, optimized
    from mbdkit_builder.sources import ELEMENTARY

    makers = symbols(machine_code.package_of(names[0])) | {ELEMENTARY: elementary_module}
    prepare()
    for symbol in names:
        module, by_level = makers[symbol](), dict[Level, Any]()
        for code in map(code_named, codes):
            if code.level not in by_level:
                by_level[code.level] = optimized(module, symbol, code.level)
            path = object_path(into, symbol, code)
            draft = path.with_suffix(f".{os.getpid()}")
            draft.write_bytes(emitted(by_level[code.level], symbol, code.platform, code.level))
            draft.replace(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
