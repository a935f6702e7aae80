"""The stored libraries of all platforms: what they need from outside and offer, read from their files."""

from __future__ import annotations

import json
import lzma
from pathlib import Path

import pytest

from mbdkit.engine.native import machine_code
from mbdkit.engine.native.levels import PLATFORMS, Platform
from mbdkit_builder import binary_files

from .headers_of_libraries import MachOHeader, mach_o_header, time_of_linking, why_not_signed

LIBRARIES = {"linux": {"libc.so.6"}, "macos": {"/usr/lib/libSystem.B.dylib"}, "windows": set[str]()}


def stored_libraries(target: Platform) -> list[tuple[str, Path]]:
    """Return the packages and the files of the libraries of a platform."""
    packages = machine_code.kernel_packages()
    return [(one, path) for one in packages for path in machine_code.stored_folder(one, target).glob("*.xz")]


CASES = [
    pytest.param(target, package, path, id=f"{target} {package} {path.stem}")
    for target in PLATFORMS
    for package, path in stored_libraries(target)
]


@pytest.mark.parametrize(("target", "package", "path"), CASES)
def test_a_library_needs_memory_functions_only_and_offers_its_symbols(
    target: Platform, package: str, path: Path
) -> None:
    # expected: the elementary functions are part of the machine code, so that results do not depend on the C library
    found = binary_files.read(lzma.decompress(path.read_bytes()))
    manifest = json.loads((path.parent / machine_code.MANIFEST).read_bytes())
    group = path.name.partition("-")[0]
    assert found.architecture == {"aarch64": "arm64"}.get(target.architecture, target.architecture)
    assert found.exported == {symbol for symbol, (its_group, _) in manifest["symbols"].items() if its_group == group}
    assert found.imported <= binary_files.MEMORY_FUNCTIONS[target.system]
    assert found.libraries <= LIBRARIES[target.system]


@pytest.mark.parametrize(("target", "package", "path"), [case for case in CASES if case.values[0].system == "macos"])  # type: ignore[union-attr]
def test_a_library_for_macos_is_signed_and_runs_on_macos_11(target: Platform, package: str, path: Path) -> None:
    content = lzma.decompress(path.read_bytes())
    assert mach_o_header(content) == MachOHeader(path.stem, (11, 0))
    if target.architecture == "arm64":
        assert why_not_signed(content) is None
        changed = bytearray(content)
        changed[len(content) // 2] ^= 1
        assert "has changed" in str(why_not_signed(bytes(changed)))


@pytest.mark.parametrize(("target", "package", "path"), [case for case in CASES if case.values[0].system == "windows"])  # type: ignore[union-attr]
def test_a_library_for_windows_does_not_contain_the_time_of_linking(target: Platform, package: str, path: Path) -> None:
    assert time_of_linking(lzma.decompress(path.read_bytes())) == 0
