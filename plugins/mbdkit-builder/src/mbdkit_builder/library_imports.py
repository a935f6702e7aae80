"""What a library of machine code takes from outside: memory functions only, whose results are the same everywhere."""

from __future__ import annotations

import struct
from collections.abc import Collection

from mbdkit.base.errors import MbdkitError

MEMORY_FUNCTIONS = frozenset({"memcpy", "memmove", "memset"})
_SYMBOLS = 11
"""Type of the section of an ELF file that holds the symbols for the loader."""


def imports(library: bytes) -> set[str]:
    """Return the names of the functions that a library takes from outside; `library` is an ELF file of 64 bits."""
    (start,), (size, count) = struct.unpack_from("<Q", library, 0x28), struct.unpack_from("<HH", library, 0x3A)
    sections = [struct.unpack_from("<IIQQQQIIQQ", library, start + i * size) for i in range(count)]
    names = set()
    for _, kind, _, _, first, length, link, _, _, step in sections:
        if kind == _SYMBOLS:
            for place in range(first, first + length, step):
                name, _, _, section = struct.unpack_from("<IBBH", library, place)
                if name and section == 0:
                    begin = sections[link][4] + name
                    names.add(library[begin : library.index(b"\0", begin)].decode())
    return names


def check_imports(library: bytes, name: str, allowed: Collection[str] = MEMORY_FUNCTIONS) -> None:
    """Raise MbdkitError if a library takes more than these functions from outside."""
    if others := sorted(imports(library) - set(allowed)):
        raise MbdkitError(
            f"the machine code {name} calls {', '.join(others)} of the C library, whose results depend on the machine: "
            "add a function to mbdkit.engine.kernels.elementary.FUNCTIONS"
        )
