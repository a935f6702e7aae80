"""Opens untrusted HDF5 files, and refuses harmful contents before anything is read.

HDF5 follows external links, external storage and virtual datasets to other files, and allocates memory as declared in
the file. Therefore only trees of groups and of arrays of numbers and strings are accepted, with all values in the file
itself.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5l, h5o, h5s, h5t, h5z

from mbdkit.archive.hdf5_errors import DAMAGE, cause, closed_on_error, error_number, reading
from mbdkit.base import file_locks
from mbdkit.base.errors import ArchiveError, ResourceError, file_error
from mbdkit.base.files import check_regular
from mbdkit.base.text import shown

OBJECTS = 2_000  #: Largest number of groups and arrays; an archive has about 60.

DEPTH = 8  #: Deepest nesting of groups; an archive has one level.

ATTRIBUTES = 10_000  #: Largest number of attributes of a group or an array.

#: Largest ratio of the unpacked size of all compressed arrays, beyond `FREE`, to the size of the file.
#:
#: Compression reduces results to about 85 % of their size.
UNPACKED = 50

#: Compressed arrays, and rows of a killed run that were never written, may always have this total size [bytes], and
#: smaller files are not searched for holes.
FREE = 1 << 26

#: Largest uncompressed size of one chunk [bytes]; a chunk is decompressed in memory as a whole.
CHUNK = 1 << 28

TEXT = 1 << 30  #: Largest estimate of the total size of the strings of an attribute [bytes].

#: Longest string of fixed length [bytes]. Other programs may add such strings; those of an archive have variable
#: length.
FIXED = 1 << 12

_FEW = 64  # strings of an attribute that are read without an estimate of their size
_DEFLATE = 1032  # largest ratio of deflate
_FILTERS = {h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32}
_OF_SCALES = {b"CLASS", b"NAME", b"REFERENCE_LIST", b"DIMENSION_LIST"}
# Reference to a string of variable length, as it is stored in the file:
_DESCRIPTOR = np.dtype([("length", "<u4"), ("address", "<u8"), ("index", "<u4")])


def open_hdf5(path: Path, what: str, *, hint: str = "", objects: int = OBJECTS) -> h5py.File:
    """Open an HDF5 file for reading, after checking that reading it does no harm.

    `path`: an existing file. `what`: what the file should be, for messages, such as ``run archive``. `hint`: advice on
    a damaged file, which is appended to messages. `objects`: largest number of groups and arrays. Raises ResourceError
    if the file is in use, or the system refuses to read it. Raises SpecError if the file is not a regular file. Raises
    ArchiveError if it is not an HDF5 file, is damaged, or is refused because it refers to other files, links an object
    twice, declares more data than it holds, or has other contents that are not accepted.
    """
    check_regular(path)
    noun = what.rpartition(" ")[2]
    try:
        if file_locks.IS_WINDOWS and file_locks.is_locked(path):
            raise BlockingIOError  # HDF5 finds locks of its own only
        file = h5py.File(path, "r", locking="best-effort")
    except BlockingIOError:
        raise ResourceError(f"a run is still writing this {noun}; wait until it has ended", file=path) from None
    except DAMAGE as error:
        text = str(error)
        if "signature not found" in text:
            why = f"this is not an HDF5 file, so not a {what}"
            if path.suffix in (".yaml", ".yml", ".toml", ".json"):
                why += "; if it is a spec of runs, `mbdkit run` makes an archive from it"
        elif "truncated" in text:
            why = f"this {noun} is truncated: its end is missing, as after an incomplete copy"
        else:
            why = f"this file cannot be read: {cause(error)}"
            if number := error_number(error):
                raise file_error(number, why, file=path) from error
        raise ArchiveError("; ".join(filter(None, (why, hint))), file=path) from error
    with closed_on_error(file), reading("its structure", path, hint=hint or "it cannot be used"):
        _Inspection(file, path, objects).inspect()
    return file


def is_sparse(path: Path) -> bool:
    """Return whether a large file holds almost no data, so that reading its zeros would take very long."""
    status = os.stat(path)
    # File systems that compress store less than the size; those that do not count blocks report 0.
    on_disk = 512 * getattr(status, "st_blocks", 0)
    return bool(on_disk) and status.st_size > FREE and status.st_size > 1000 * on_disk


class _Inspection:
    """Visits every object of a file by its low-level identifier; of the values, only lengths of strings are read."""

    def __init__(self, file: h5py.File, path: Path, objects: int):
        self.path, self.objects = path, objects
        self.file = file
        self.size = os.stat(path).st_size
        if is_sparse(path):
            raise self.refused(f"it has {self.size:,} bytes, almost all of them holes")
        self.stored = self.unpacked = self.text = 0
        self.seen: set[int] = set()

    def refused(self, why: str) -> ArchiveError:
        return ArchiveError(f"this file is refused: {shown(why)}", file=self.path)

    def inspect(self) -> None:
        root = h5g.open(self.file.id, b"/")
        self.seen.add(h5o.get_info(root).addr)
        todo = [("", root, 0)]
        while todo:
            path, group, depth = todo.pop()
            self.attributes(path or "/", group)
            for name, kind in self.links(path, group):
                below = f"{path}/{name.decode(errors='replace')}".lstrip("/")
                if kind == h5o.TYPE_DATASET:
                    self.dataset(below, h5d.open(group, name))
                elif kind == h5o.TYPE_GROUP and depth < DEPTH:
                    todo.append((below, h5g.open(group, name), depth + 1))
                else:
                    raise self.refused(
                        f"groups are nested more than {DEPTH} deep"
                        if kind == h5o.TYPE_GROUP
                        else f"{below} is neither a group nor an array"
                    )

    def links(self, path: str, group: h5g.GroupID) -> list[tuple[bytes, int]]:
        """Return names and kinds of the members of a group; refuse soft and external links, second links to an object,
        and too many objects.
        """
        links: list[tuple[bytes, int]] = []
        words = {h5l.TYPE_SOFT: "a soft link", h5l.TYPE_EXTERNAL: "a link to another file"}
        if len(self.seen) + group.get_num_objs() > self.objects:
            raise self.refused(f"it has more than {self.objects:,} groups and arrays")
        others: list[str] = []

        def visit(name: bytes, link: h5l.LinkInfo) -> int | None:
            if link.type != h5l.TYPE_HARD:
                below = f"{path}/{name.decode(errors='replace')}".lstrip("/")
                others.append(f"{below} is {words.get(link.type, 'a link of unknown type')}")
                return 1
            links.append((name, 0))
            return None

        group.links.iterate(visit, info=True)
        if others:
            raise self.refused(others[0])
        for number, (name, _) in enumerate(links):
            info = h5o.get_info(group, name)
            if info.addr in self.seen:
                place = f"{path}/{name.decode(errors='replace')}".lstrip("/")
                raise self.refused(f"{place} is a hard link to a group or array that the file already contains")
            self.seen.add(info.addr)
            links[number] = name, info.type
        return links

    def attributes(self, path: str, item: h5g.GroupID | h5d.DatasetID) -> None:
        count = h5a.get_num_attrs(item)
        if count > ATTRIBUTES:
            raise self.refused(f"{path} has {count:,} attributes")
        for index in range(count):
            attribute = h5a.open(item, index=index)
            if attribute.name in _OF_SCALES:
                continue  # attributes of dimension scales are never read
            which = f"the attribute {attribute.name.decode(errors='replace')} of {path}"
            space, kind = attribute.get_space(), attribute.get_type()
            is_text = self.kind(which, kind, space)
            number = space.get_simple_extent_npoints()
            if number * kind.get_size() > self.size:
                raise self.refused(f"{which} declares more values than the file holds")
            if is_text and number > _FEW and number * self.size > TEXT and number * self.largest_heap() > TEXT:
                raise self.refused(f"{which} has {number:,} strings that may be too large for the memory")

    def largest_heap(self) -> int:
        """Return the size of the largest string collection (global heap) [bytes], found by searching the file for
        signatures.
        """
        largest = 0
        with self.path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
            at = content.find(b"GCOL")
            while at >= 0:
                largest = max(largest, int.from_bytes(content[at + 8 : at + 16], "little"))
                at = content.find(b"GCOL", at + 4)
        return min(largest, self.size)

    def kind(self, what: str, kind: h5t.TypeID, space: h5s.SpaceID) -> bool:
        """Return whether values are strings of variable length; refuse values that are neither strings nor numbers, and
        long strings of fixed length.
        """
        if space.get_simple_extent_type() == h5s.NULL:
            raise self.refused(f"{what} has no values and no type of number")
        if isinstance(kind, h5t.TypeStringID):
            if not kind.is_variable_str() and kind.get_size() > FIXED:
                raise self.refused(f"{what} has strings of the fixed length {kind.get_size():,}")
            return bool(kind.is_variable_str())
        if not isinstance(kind, h5t.TypeIntegerID | h5t.TypeFloatID):
            raise self.refused(f"{what} has values that are neither numbers nor strings")
        return False

    def dataset(self, path: str, item: h5d.DatasetID) -> None:
        self.attributes(path, item)
        plan = item.get_create_plist()
        if plan.get_layout() == h5d.VIRTUAL:
            raise self.refused(f"{path} is a virtual dataset, which takes its values from other arrays")
        if plan.get_layout() != h5d.CHUNKED and plan.get_external_count():
            raise self.refused(f"the values of {path} are in another file")
        space, kind = item.get_space(), item.get_type()
        is_text = self.kind(path, kind, space)
        size = space.get_simple_extent_npoints() * (_DESCRIPTOR.itemsize if is_text else kind.get_size())
        if not size:
            return
        stored = self.storage(path, item, plan.get_layout())
        self.stored += stored
        if plan.get_layout() == h5d.CHUNKED and plan.get_nfilters():
            self.compressed(path, item, plan, size, is_text)
        elif size > stored:
            # if the run was killed while HDF5 wrote its metadata, an array may declare rows that were never written
            self.unpacked += size - stored
            if self.file.attrs.get("status") != "running" or self.unpacked > FREE:
                raise self.refused(f"{path} declares {size:,} bytes, but the file holds {stored:,} of them")
        if self.stored > self.size:
            raise self.refused(f"its arrays declare {self.stored:,} bytes, but it has {self.size:,}")
        if is_text:
            self.strings(path, item, plan.get_layout(), size)

    def storage(self, path: str, item: h5d.DatasetID, layout: int) -> int:
        """Return the bytes of the file that an array occupies."""
        stored = int(item.get_storage_size())
        if layout == h5d.CONTIGUOUS and stored and ((start := item.get_offset()) is None or start + stored > self.size):
            raise self.refused(f"{path} declares {stored:,} bytes, which reach beyond the end of the file")
        return stored

    def compressed(self, path: str, item: h5d.DatasetID, plan: h5py.h5p.PropDCID, size: int, is_text: bool) -> None:
        filters = [plan.get_filter(number)[0] for number in range(plan.get_nfilters())]
        if len(set(filters)) < len(filters) or not _FILTERS.issuperset(filters):
            raise self.refused(f"{path} is not compressed by deflate")
        if is_text:
            raise self.refused(f"the strings of {path} are compressed")
        chunk = int(np.prod(plan.get_chunk(), dtype=object)) * item.get_type().get_size()
        self.unpacked += max(size, chunk)
        if chunk > CHUNK or self.unpacked > FREE + UNPACKED * self.size:
            raise self.refused(f"it is compressed and unpacks to {self.unpacked:,} bytes, but has {self.size:,}")
        most = [0]
        _each_chunk(item, lambda info: most.append(max(most.pop(), info.size)))
        if most[0] * (_DEFLATE if h5z.FILTER_DEFLATE in filters else 1) > max(CHUNK, 2 * chunk):
            raise self.refused(f"a compressed chunk of {path} has {most[0]:,} bytes, more than can be unpacked safely")

    def strings(self, path: str, item: h5d.DatasetID, layout: int, size: int) -> None:
        """Add the lengths of the strings of an array, and refuse the file if all its strings so far are longer than the
        file. This is possible if many strings share characters.
        """
        places: list[tuple[int, int]] = []
        if layout == h5d.CHUNKED:
            _each_chunk(item, lambda info: places.append((info.byte_offset, info.size)))
        elif layout == h5d.CONTIGUOUS:
            places.append((item.get_offset(), size))
        else:
            raise self.refused(f"the strings of {path} have a storage layout that is not supported")
        with self.path.open("rb") as stream:
            for start, length in places:
                stream.seek(start)
                values = np.frombuffer(stream.read(length // 16 * 16), _DESCRIPTOR)
                self.text += int(values["length"].sum(dtype=np.int64))
        if self.text > self.size:
            raise self.refused(f"its strings have {self.text:,} bytes, but it has {self.size:,}")


def _each_chunk(item: h5d.DatasetID, visit: Callable[[h5d.StoreInfo], None]) -> None:
    item.chunk_iter(lambda info: visit(info))
