"""The open ``.part`` as HDF5 uses it. Each flush changes the file as a whole or not at all, as in a database.

HDF5 keeps no journal: it overwrites its tables in many pieces, and cannot read a file in which some of them are
missing. The stream therefore writes directly only what HDF5 appends to the file. Changed pages of what is already there
stay in memory until the next `PartStream.commit`, which appends them to the file as a journal with its SHA-256, then
overwrites the pages, and removes the journal. If the process is killed before the journal is whole, the file has the
contents of the commit before; afterwards, `complete_flush` repeats the rest of the commit. This is write-ahead logging
(Mohan et al., ARIES, ACM Transactions on Database Systems 17, 94-162, 1992) without undo. It protects against kills;
after a loss of power, only what `Target.sync` has waited for is certain.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from mbdkit.base import file_locks
from mbdkit.base.errors import ResourceError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer

PAGE = 4096  #: Size of a page [bytes].

_MAGIC = b"mbdkit journal 1"

#: The end of a journal, which follows the numbers of the pages and their contents: `_MAGIC`, the number of pages, the
#: size of the file after the commit, and the SHA-256 of all but the SHA-256.
_DIGEST = 32
_END = struct.Struct(f"<{len(_MAGIC)}sQQ{_DIGEST}s")


class PartStream(io.FileIO):
    """The open ``.part``, which is empty at first.

    HDF5 does not learn of failed writes: it would repeat them, and crash the interpreter if they fail again when it
    closes the file. If HDF5 opened the file itself, Windows could not rename it before the end of the run either.
    """

    def __init__(self, handle: int):
        super().__init__(handle, "r+", closefd=False)
        self._failure: OSError | None = None  # the first error of writing, after which nothing is written
        self._is_discarding = False
        self._pages: dict[int, bytearray] = {}  # changed pages below `_kept`, by number
        # The first page, without which the file is not in HDF5, is written last by the first commit as well.
        self._kept = 1
        self._size = 0  # of the file, with the journal if there is one

    def write(self, data: ReadableBuffer) -> int:
        """Write all bytes: those before the end of the last commit into pages in memory, the others to the file."""
        rest = whole = memoryview(data).cast("B")
        place = self.tell()
        try:
            while rest and not self._is_discarding and self._failure is None:
                if (number := place // PAGE) < self._kept:
                    start = place % PAGE
                    piece = rest[: PAGE - start]
                    if len(piece) == PAGE:
                        self._pages[number] = bytearray(piece)
                    else:
                        self._page(number)[start : start + len(piece)] = piece
                else:
                    piece = rest
                    _write(self.fileno(), place, piece)
                place, rest = place + len(piece), rest[len(piece) :]
        except OSError as error:
            self._failure = error
        return whole.nbytes

    def _page(self, number: int) -> bytearray:
        if number not in self._pages:
            self.seek(number * PAGE)
            self._pages[number] = bytearray((super().read(PAGE) or b"").ljust(PAGE, b"\0"))
        return self._pages[number]

    def readinto(self, buffer: WriteableBuffer) -> int:
        """Read bytes of the file with its changed pages; those after its end are zero."""
        values, start = memoryview(buffer).cast("B"), self.tell()
        count = 0
        while count < len(values) and (more := super().readinto(values[count:])):
            count += more
        values[count:] = bytes(len(values) - count)
        end = start + len(values)
        for number in range(start // PAGE, min(-(-end // PAGE), self._kept)) if self._pages else ():
            if (page := self._pages.get(number)) is not None:
                first, last = max(start, number * PAGE), min(end, (number + 1) * PAGE)
                values[first - start : last - start] = page[first - number * PAGE : last - number * PAGE]
        return len(values)

    def truncate(self, size: int | None = None) -> int:
        """Do nothing, because `commit` sets the size of the file."""
        return size or 0

    @contextlib.contextmanager
    def checked(self) -> Iterator[None]:
        """Raise the error of a failed write at the end of a block, in place of errors of HDF5 that follow from it."""
        try:
            yield
        finally:
            if self._failure is not None:
                raise self._failure

    def commit(self, size: int) -> None:
        """Let all that has been written since the last commit take effect at once; raise OSError if this fails.

        `size`: size of the file.
        """
        handle, pages = self.fileno(), self._pages
        numbers, end = struct.pack(f"<{len(pages)}Q", *pages), _END.pack(_MAGIC, len(pages), size, b"")
        journal = b"".join([numbers, *pages.values(), end[:-_DIGEST]])
        journal += hashlib.sha256(journal).digest()
        place = -(-max(size, os.fstat(handle).st_size) // PAGE) * PAGE  # behind all pages
        _write(handle, place, journal)
        self._size = place + len(journal)
        _apply(handle, pages, size)
        self._size, self._kept = size, max(1, -(-size // PAGE))
        self._pages.clear()

    def discard(self) -> None:
        """Discard what has been written since the last commit, and all that HDF5 will write when it closes the file."""
        self._is_discarding = True
        with contextlib.suppress(OSError):
            os.ftruncate(self.fileno(), self._size)


def _write(handle: int, place: int, data: bytes | memoryview) -> None:
    """Write all bytes, of which the system may take only some at a time."""
    rest = memoryview(data)
    os.lseek(handle, place, os.SEEK_SET)
    while rest:
        rest = rest[os.write(handle, rest) :]


def _apply(handle: int, pages: Mapping[int, bytes | bytearray], size: int) -> None:
    for number, page in pages.items():
        _write(handle, number * PAGE, memoryview(page))
    os.ftruncate(handle, size)


def complete_flush(part: Path) -> None:
    """Complete the last flush of a ``.part`` if its run was killed after the journal and before the end of the flush.

    Raises ResourceError if this is necessary, but the file cannot be written.
    """
    if not part.is_file() or _journal(part) is None:
        return
    try:
        with os.fdopen(file_locks.open_file(part, os.O_RDWR), "r+b", buffering=0) as stream:
            try:
                file_locks.lock(stream.fileno())
            except BlockingIOError:
                return  # a run is in the middle of a flush
            except OSError:
                pass  # the file system does not support locks
            if (journal := _journal(part)) is not None:
                _apply(stream.fileno(), *journal)
    except OSError as error:
        message = f"the run was killed in the middle of a flush, which cannot be completed here: {error.strerror}"
        raise ResourceError(f"{message}; copy the file to where it can be written", file=part) from error


def _journal(part: Path) -> tuple[Mapping[int, bytes], int] | None:
    """Return the changed pages by number, and the size of the file after the commit; None without a whole journal."""
    with contextlib.suppress(OSError, struct.error), part.open("rb") as stream:
        end = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, end - _END.size))
        magic, count, size, digest = _END.unpack(stream.read())
        length = count * (8 + PAGE) + _END.size
        if magic != _MAGIC or length > end:
            return None
        stream.seek(end - length)
        content = stream.read(length - len(digest))
        numbers = struct.unpack_from(f"<{count}Q", content)
        if hashlib.sha256(content).digest() == digest and max(size, *(PAGE * number for number in numbers), 0) <= end:
            return {number: content[(at := 8 * count + PAGE * k) : at + PAGE] for k, number in enumerate(numbers)}, size
    return None
