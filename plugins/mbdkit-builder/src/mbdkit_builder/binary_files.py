"""Read what shared libraries need and offer from their files, of all platforms, on any of them.

The machine code takes memory functions only from outside, whose results are the same everywhere.

The formats are those of the System V ABI (ELF), of ``mach-o/loader.h`` and ``mach-o/nlist.h`` (Mach-O), and of
Microsoft's specification "PE Format". Only 64-bit files are read.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from mbdkit.base.errors import MbdkitError

#: Functions that the machine code may take from the C library, by operating system.
MEMORY_FUNCTIONS = {
    "linux": {"memcpy", "memmove", "memset"},
    "macos": {"__bzero", "bzero", "dyld_stub_binder", "memcpy", "memmove", "memset", "memset_pattern16"},
    "windows": set[str](),
}


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


def text_at(content: bytes, at: int) -> str:
    """Return the text at a place of a file, up to the next byte 0."""
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
                    libraries.add(text_at(content, names + value))
            else:  # its symbols; the first one is none
                name, _, _, section = struct.unpack_from("<IBBH", content, at)
                (exported if section else imported).add(text_at(content, names + name))
    architecture = {62: "x86_64", 183: "arm64"}[machine]
    return LibraryFile(architecture, frozenset(libraries), frozenset(imported), frozenset(exported))


# --- macOS

_CPUS = {0x01000007: "x86_64", 0x0100000C: "arm64"}
_LINKER = {"__mh_dylib_header", "___dso_handle"}  #: Symbols that the linker adds.


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
            libraries.add(text_at(command, struct.unpack_from("<I", command, 8)[0]))
        if kind == 0x02:  # LC_SYMTAB
            begin, count, names, _ = struct.unpack_from("<IIII", command, 8)
            for at in range(begin, begin + 16 * count, 16):
                name, flags = struct.unpack_from("<IB", content, at)
                if flags & 0xE0 or not flags & 1:  # of a debugger, or local
                    continue
                symbol = text_at(content, names + name)
                if symbol not in _LINKER:
                    (exported if flags & 0x0E else imported).add(symbol.removeprefix("_"))
    architecture = _CPUS[struct.unpack_from("<I", content, 4)[0]]
    return LibraryFile(architecture, frozenset(libraries), frozenset(imported), frozenset(exported))


# --- Windows


def _pe(content: bytes) -> LibraryFile:
    header, sections = pe_header(content)
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
        exported |= {text_at(content, place(struct.unpack_from("<I", content, names + 4 * i)[0])) for i in range(count)}
    if directories[1][0]:
        at = place(directories[1][0])
        while (entry := struct.unpack_from("<IIIII", content, at))[3]:
            libraries.add(text_at(content, place(entry[3])).lower())
            names = place(entry[0] or entry[4])
            while name := struct.unpack_from("<Q", content, names)[0]:
                imported.add(f"#{name & 0xFFFF}" if name >> 63 else text_at(content, place(name) + 2))
                names += 8
            at += 20
    architecture = {0x8664: "x86_64", 0xAA64: "arm64"}[struct.unpack_from("<H", content, header + 4)[0]]
    return LibraryFile(architecture, frozenset(libraries), frozenset(imported), frozenset(exported))


def pe_header(content: bytes) -> tuple[int, list[tuple[int, int, int, int]]]:
    """Return where the header begins, and for each section: size, address, size in the file and begin in the file."""
    (header,) = struct.unpack_from("<I", content, 0x3C)
    (count,) = struct.unpack_from("<H", content, header + 6)
    (size,) = struct.unpack_from("<H", content, header + 20)
    return header, [struct.unpack_from("<IIII", content, header + 24 + size + 40 * i + 8) for i in range(count)]
