"""Read what shared libraries need and offer from their files, of all platforms, on any of them.

The machine code takes memory functions only from outside, whose results are the same everywhere.

The formats are those of the System V ABI (ELF), of ``mach-o/loader.h``, ``mach-o/nlist.h`` and ``cs_blobs.h`` (Mach-O,
code signatures), and of Microsoft's specification "PE Format". Only 64-bit files are read.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from mbdkit.plugin import MbdkitError

MEMORY_FUNCTIONS = {
    "linux": {"memcpy", "memmove", "memset"},
    "macos": {"__bzero", "bzero", "dyld_stub_binder", "memcpy", "memmove", "memset", "memset_pattern16"},
    "windows": set[str](),
}
"""Functions that the machine code may take from the C library, by operating system."""


@dataclass(frozen=True)
class LibraryFile:
    """What a shared library needs and offers.

    Parameters
    ----------
    architecture
        ``x86_64`` or ``arm64``.
    libraries
        Libraries that it needs.
    imported, exported
        Symbols that it needs from them, and those that it offers, without versions and the underscore of macOS.
    """

    architecture: str
    libraries: frozenset[str]
    imported: frozenset[str]
    exported: frozenset[str]


def read(content: bytes) -> LibraryFile:
    """Return what the library with this content needs and offers.

    Raises
    ------
    ValueError
        If it is not a library of a known format.
    """
    if content[:4] == b"\x7fELF":
        return _elf(content)
    if content[:4] == b"\xcf\xfa\xed\xfe":
        return _mach_o(content)
    if content[:2] == b"MZ":
        return _pe(content)
    raise ValueError("this is not a shared library")


def check_imports(content: bytes, system: str, name: str) -> None:
    """Raise MbdkitError if a library of machine code takes more than memory functions from outside."""
    if others := sorted(read(content).imported - MEMORY_FUNCTIONS[system]):
        raise MbdkitError(
            f"the machine code {name} calls {', '.join(others)} of the C library, whose results depend on the machine: "
            "add a function to mbdkit.engine.kernels.elementary.FUNCTIONS"
        )


def _text(content: bytes, at: int) -> str:
    return content[at : content.index(b"\0", at)].decode()


# --- Linux


def _elf(content: bytes) -> LibraryFile:
    (machine,) = struct.unpack_from("<H", content, 18)
    (table,) = struct.unpack_from("<Q", content, 40)
    size, count = struct.unpack_from("<HH", content, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", content, table + i * size) for i in range(count)]
    libraries, imported, exported = set[str](), set[str](), set[str]()
    for _, kind, _, _, begin, length, link, _, _, item in sections:
        if kind not in (6, 11):
            continue
        names = sections[link][4]
        for at in range(begin + item * (kind == 11), begin + length, item):
            if kind == 6:  # the dynamic section
                tag, value = struct.unpack_from("<QQ", content, at)
                if tag == 1:
                    libraries.add(_text(content, names + value))
            else:  # its symbols; the first one is none
                name, _, _, section = struct.unpack_from("<IBBH", content, at)
                (exported if section else imported).add(_text(content, names + name))
    architecture = {62: "x86_64", 183: "arm64"}[machine]
    return LibraryFile(architecture, frozenset(libraries), frozenset(imported), frozenset(exported))


# --- macOS

_CPUS = {0x01000007: "x86_64", 0x0100000C: "arm64"}
_LINKER = {"__mh_dylib_header", "___dso_handle"}
"""Symbols that the linker adds."""


def load_commands(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the load commands of a Mach-O file, each with its number."""
    (count,) = struct.unpack_from("<I", content, 16)
    at = 32
    for _ in range(count):
        kind, size = struct.unpack_from("<II", content, at)
        yield kind & 0x7FFFFFFF, content[at : at + size]
        at += size


def _mach_o(content: bytes) -> LibraryFile:
    libraries, imported, exported = set[str](), set[str](), set[str]()
    for kind, command in load_commands(content):
        if kind == 0x0C:  # LC_LOAD_DYLIB
            libraries.add(_text(command, struct.unpack_from("<I", command, 8)[0]))
        if kind == 0x02:  # LC_SYMTAB
            begin, count, names, _ = struct.unpack_from("<IIII", command, 8)
            for at in range(begin, begin + 16 * count, 16):
                name, flags = struct.unpack_from("<IB", content, at)
                if flags & 0xE0 or not flags & 1:  # of a debugger, or local
                    continue
                symbol = _text(content, names + name)
                if symbol not in _LINKER:
                    (exported if flags & 0x0E else imported).add(symbol.removeprefix("_"))
    architecture = _CPUS[struct.unpack_from("<I", content, 4)[0]]
    return LibraryFile(architecture, frozenset(libraries), frozenset(imported), frozenset(exported))


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
            found["name"] = _text(command, struct.unpack_from("<I", command, 8)[0])
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


# --- Windows


def _pe(content: bytes) -> LibraryFile:
    header, sections = _pe_header(content)
    libraries, imported, exported = set[str](), set[str](), set[str]()

    def place(address: int) -> int:
        """Return where an address is in the file."""
        return next(
            address - at + begin for size, at, length, begin in sections if at <= address < at + max(size, length)
        )

    directories = [struct.unpack_from("<II", content, header + 136 + 8 * i) for i in range(2)]
    if directories[0][0]:
        at = place(directories[0][0])
        (count,) = struct.unpack_from("<I", content, at + 24)
        names = place(struct.unpack_from("<I", content, at + 32)[0])
        exported |= {_text(content, place(struct.unpack_from("<I", content, names + 4 * i)[0])) for i in range(count)}
    if directories[1][0]:
        at = place(directories[1][0])
        while (entry := struct.unpack_from("<IIIII", content, at))[3]:
            libraries.add(_text(content, place(entry[3])).lower())
            names = place(entry[0] or entry[4])
            while name := struct.unpack_from("<Q", content, names)[0]:
                imported.add(f"#{name & 0xFFFF}" if name >> 63 else _text(content, place(name) + 2))
                names += 8
            at += 20
    architecture = {0x8664: "x86_64", 0xAA64: "arm64"}[struct.unpack_from("<H", content, header + 4)[0]]
    return LibraryFile(architecture, frozenset(libraries), frozenset(imported), frozenset(exported))


def _pe_header(content: bytes) -> tuple[int, list[tuple[int, int, int, int]]]:
    """Return where the header begins, and for each section: size, address, size in the file and begin in the file."""
    (header,) = struct.unpack_from("<I", content, 0x3C)
    (count,) = struct.unpack_from("<H", content, header + 6)
    (size,) = struct.unpack_from("<H", content, header + 20)
    return header, [struct.unpack_from("<IIII", content, header + 24 + size + 40 * i + 8) for i in range(count)]


def time_of_linking(content: bytes) -> int:
    """Return the time of linking that the header of a library for Windows contains."""
    return int(struct.unpack_from("<I", content, _pe_header(content)[0] + 8)[0])
