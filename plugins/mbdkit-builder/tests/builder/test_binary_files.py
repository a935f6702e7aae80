"""The stored libraries of all platforms: what they need from outside and offer, read from their files."""

from __future__ import annotations

import hashlib
import json
import lzma
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from mbdkit.engine.native import machine_code
from mbdkit.engine.native.levels import PLATFORMS, Platform
from mbdkit_builder import binary_files
from mbdkit_builder.binary_files import load_commands, pe_header, text_at


@dataclass(frozen=True)
class MachOHeader:
    """What dyld checks first: the name of a library, and the oldest macOS for which it was linked."""

    name: str
    oldest: tuple[int, int]


def mach_o_header(content: bytes) -> MachOHeader:
    """Return the header of a library for macOS."""
    found: dict[str, Any] = {}
    for kind, command in load_commands(content):
        if kind == 0x0D:  # LC_ID_DYLIB
            found["name"] = text_at(command, struct.unpack_from("<I", command, 8)[0])
        if kind == 0x32:  # LC_BUILD_VERSION
            platform, version = struct.unpack_from("<II", command, 8)
            if platform == 1:
                found["oldest"] = (version >> 16, version >> 8 & 0xFF)
    return MachOHeader(**found)


def why_not_signed(content: bytes) -> str | None:
    """Return what is wrong with the ad-hoc signature of a Mach-O file; None if it is valid.

    The hash of every page is computed again. The signature must cover everything before it, and end the file.
    """
    place = next(
        (struct.unpack_from("<II", command, 8) for kind, command in load_commands(content) if kind == 0x1D), None
    )
    if place is None:
        return "there is no signature"
    begin, size = place
    if begin + size != len(content):
        return "the signature does not end the file"
    magic, _, count = struct.unpack_from(">III", content, begin)
    if magic != 0xFADE0CC0:
        return "there is no list of blobs"
    blobs = dict(struct.unpack_from(">II", content, begin + 12 + 8 * i) for i in range(count))
    at = begin + blobs[0]
    magic, _, version, flags, hashes, _, _, pages, limit = struct.unpack_from(">IIIIIIIII", content, at)
    hash_size, hash_kind, _, page_bits = struct.unpack_from(">BBBB", content, at + 36)
    if magic != 0xFADE0C02 or version < 0x20400 or (hash_size, hash_kind) != (32, 2):
        return "the code directory has another format"
    if not flags & 2:
        return "the signature is not ad hoc"
    step = 1 << page_bits
    if limit != begin or pages != -(-limit // step):
        return "the signature does not cover the file"
    for i in range(pages):
        page = content[i * step : min((i + 1) * step, limit)]
        if hashlib.sha256(page).digest() != content[at + hashes + 32 * i :][:32]:
            return f"page {i} has changed"
    return None


def time_of_linking(content: bytes) -> int:
    """Return the time of linking that the header of a library for Windows contains."""
    return int(struct.unpack_from("<I", content, pe_header(content)[0] + 8)[0])


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
