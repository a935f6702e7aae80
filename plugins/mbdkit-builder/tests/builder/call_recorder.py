"""Record calls of kernels, with all memory that they read and write, for `call_driver.c` on another platform.

``python call_recorder.py FILE`` simulates a few examples, writes the calls of their kernels into a file, and prints the
symbols of all machine code that these calls reach. All memory that a call can reach is known here: arrays that are
arguments, bundles (blocks of words at fixed addresses, see `mbdkit.engine.native.bundle`) and their arrays, programs of
force laws, and machine code that kernels call by its address. A call that reaches anything else, such as a law that
Numba has compiled, is not recorded.

The file consists of 64-bit words. The first one is the number of calls. A call is:

* length of the symbol in bytes, and the symbol, filled up with zeros to whole words;
* number of names, and each of them in the same way: symbols whose addresses are in the memory;
* number of blocks; for each of them its number of bytes, its address modulo 64, which the driver keeps, because lanes
  are aligned, and its content before the call, filled up to whole words;
* number of words that the call changes; for each of them block, offset and value;
* for the contents before the call and after it: number of addresses in the blocks, and each of them as block, offset,
  target, offset in the target. The target is a block, or -1 - i for the symbol with name i;
* the value that the call returns.

Offsets are in bytes. The argument of the kernel is block 0.
"""

from __future__ import annotations

import ctypes
import struct
import sys
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO
from weakref import WeakValueDictionary

import numpy as np

import mbdkit
from mbdkit.engine import force_laws
from mbdkit.engine.native import bundle, functions, kernel
from mbdkit.spec import load_spec
from mbdkit_studies.compute.compute_block import compute_block

JOINTS, INDEX_3 = {"formulation": "joint-coordinates"}, {"formulation": "index-3"}
RUNS: list[tuple[str, float, dict[str, Any]]] = [
    ("double-pendulum", 0.04, {"integrator": {"name": "rk4"}, "check": True}),
    ("double-pendulum", 0.04, {"integrator": {"name": "dop853", "adaptive": True}}),
    ("double-pendulum", 0.04, JOINTS | {"integrator": {"name": "taylor"}}),
    ("double-pendulum", 0.04, {"integrator": {"name": "gauss", "stages": 3}}),
    ("double-pendulum", 0.04, INDEX_3 | {"integrator": {"name": "lobatto-pair", "stages": 3}}),
    ("knee", 0.04, INDEX_3 | {"integrator": {"name": "radau-iia"}}),
    ("knee", 0.04, {"integrator": {"name": "scipy-radau"}}), ("bouncing-ball", 0.4, {}), ("limit-stop", 0.1, {}),
    ("belt", 0.1, {}),
    *((name, 0.04, {}) for name in ("car-axis", "elbow-curl", "flying-spaghetti", "squat", "sway", "walker")),
]  # fmt: skip
"""Names of examples, durations in s and further sections of their specs."""
INTEGRATORS_OF_ENSEMBLES: list[dict[str, Any]] = [
    {"name": "rk4"}, {"name": "dopri5", "adaptive": True}, {"name": "gauss", "stages": 2},
    {"name": "radau-iia", "adaptive": True},
]  # fmt: skip
"""Integrators of runs that are advanced together in lanes, and of gradients."""
MOST_CALLS = 4
"""Largest number of recorded calls of one kernel in one example."""


class Recorder:
    """Records calls of kernels into a file from its construction on."""

    def __init__(self, file: BinaryIO):
        self.file, self.counts, self.recorded, self.reached = file, Counter[str](), 0, set[str]()
        self._bundles: WeakValueDictionary[int, bundle.PinnedBundle] = WeakValueDictionary()
        self._programs: dict[int, np.ndarray] = {}
        self._symbols: dict[int, str] = {}
        file.write(bytes(8))
        self._replace("PinnedBundle.replace", bundle.PinnedBundle, self._pin)
        self._replace("_code_of", force_laws, self._keep_program)
        self._replace("address_of", kernel, self._name)
        self._replace("_CALL", kernel, self._caller)

    def close(self) -> None:
        """Write the number of calls."""
        self.file.seek(0)
        self.file.write(struct.pack("<q", self.recorded))

    @staticmethod
    def _replace(name: str, owner: Any, by: Callable[..., Any]) -> None:
        attribute = name.rpartition(".")[2]
        before = getattr(owner, attribute)
        setattr(owner, attribute, lambda *arguments, **named: by(before, *arguments, **named))

    def _pin(self, before: Any, pinned: bundle.PinnedBundle, content: Any) -> None:
        before(pinned, content)
        self._bundles[pinned.address] = pinned

    def _keep_program(self, before: Any, *arguments: Any, **named: Any) -> Any:
        found = before(*arguments, **named)
        if isinstance(found[2], np.ndarray):
            self._programs[found[1]] = found[2]
        return found

    def _name(self, before: Any, symbol: str) -> int:
        address = int(before(symbol))
        self._symbols[address] = symbol
        return address

    def _caller(self, before: Any, address: int) -> Any:
        call, symbol = before(address), self._symbols[address]
        return lambda block: self._record(call, symbol, block)

    def _record(self, call: Any, symbol: str, block: int) -> int:
        self.counts[symbol] += 1
        memory = _Memory(self, functions.DECLARED.kernels[symbol], block) if self.counts[symbol] <= MOST_CALLS else None
        if memory is None or not memory.is_known:
            return int(call(block))
        before = memory.contents()
        status = int(call(block))
        self._write(symbol, memory, before, memory.contents(), status)
        return status

    def _write(self, symbol: str, memory: _Memory, before: _Contents, after: _Contents, status: int) -> None:
        names = [_counted(name.encode()) for name in (symbol, *memory.names)]
        words = [names[0], struct.pack("<q", len(memory.names)), *names[1:], struct.pack("<q", len(memory.intervals))]
        changes = []
        for block, ((begin, end), *contents) in enumerate(zip(memory.intervals, before[0], after[0], strict=True)):
            filled = [content + bytes(-len(content) % 8) for content in contents]
            words.append(struct.pack("<qq", end - begin, begin % 64) + filled[0])
            old, new = (np.frombuffer(content, dtype=np.int64) for content in filled)
            changes += [struct.pack("<qqq", block, 8 * i, new[i]) for i in np.flatnonzero(old != new)]
        words += [struct.pack("<q", len(changes)), *changes]
        for _, addresses in (before, after):
            words.append(struct.pack("<q", len(addresses)))
            words += [struct.pack("<qqqq", *address) for address in addresses]
        self.file.write(b"".join(words) + struct.pack("<q", status))
        self.recorded += 1
        self.reached |= {symbol, *memory.names}


_Contents = tuple[list[bytes], list[tuple[int, int, int, int]]]
"""Contents of all intervals, and the addresses in them."""


class _Memory:
    """The memory that a call of a kernel can reach.

    Attributes
    ----------
    intervals
        Begin and end of each block; the first one begins with the argument of the kernel.
    names
        Symbols of the machine code that it can call.
    is_known
        Whether nothing else is within its reach.
    """

    def __init__(self, recorder: Recorder, called: kernel.Kernel, block: int):
        self._recorder = recorder
        self._found: set[tuple[int, int]] = set()
        self._integers: set[tuple[int, int]] = set()
        self._kept: list[Any] = []
        self._called: set[str] = set()
        self._empty: set[int] = set()
        size, behind, arrays, bundles = _layout(called)
        self._add(block, size, has_addresses=True)
        self._add(block + size, behind)
        for at in arrays:
            self._add_object(_word(block + 8 * at))
        for at, dtype, dimensions in bundles:
            self._add_array(block + 8 * at, dtype, dimensions)
        intervals = _merged(self._found)
        self.intervals = sorted(intervals, key=lambda interval: interval[0] != block)
        self.names = sorted(self._called)
        self._order = sorted((begin, end, i) for i, (begin, end) in enumerate(self.intervals))
        self._begins = [begin for begin, _, _ in self._order]
        self.is_known = not any(self._is_foreign(at, word) for at, word in self._possible_addresses())

    def _add(self, begin: int, size: int, *, has_addresses: bool = False) -> None:
        if size and (begin, begin + size) not in self._found:
            self._found.add((begin, begin + size))
        if size and has_addresses and (begin, begin + size) not in self._integers:
            self._integers.add((begin, begin + size))
            self._follow(begin, begin + size)

    def _follow(self, begin: int, end: int) -> None:
        """Add what the words of an interval point to."""
        for word in _words(begin, end):
            if word in self._recorder._symbols:
                self._called.add(self._recorder._symbols[word])
            elif (pinned := self._recorder._bundles.get(word)) is not None:
                self._kept.append(pinned)
                self._add(word, pinned._block.nbytes, has_addresses=True)
                at = word
                for x in bundle.arrays_of(pinned.bundle):
                    self._add_array(at, x.dtype, x.ndim)
                    at += 8 * (bundle.ARRAY_WORDS + 2 * x.ndim)
            elif (program := self._recorder._programs.get(word)) is not None:
                self._add(word, program.nbytes, has_addresses=True)

    def _add_array(self, at: int, dtype: np.dtype[Any], dimensions: int) -> None:
        """Add the data of an array whose words are at an address."""
        data, *rest = _words(at + 32, at + 40 + 16 * dimensions)
        sizes, strides = rest[:dimensions], rest[dimensions:]
        if all(sizes):
            extent = sum((size - 1) * stride for size, stride in zip(sizes, strides, strict=True)) + dtype.itemsize
            self._add(data, extent, has_addresses=dtype == np.int64)
        else:
            self._empty.add(at + 32)

    def _add_object(self, members: int) -> None:
        """Add an array object, of which a kernel reads the members up to the flags."""
        x = ctypes.cast(members - bundle.HEAD, ctypes.py_object).value
        self._kept.append(x)
        self._add(members, 56)
        if x.ndim:
            self._integers.add((members + 16, members + 32))
            self._add(_word(members + 16), 16 * x.ndim)
        if x.size:
            self._integers.add((members, members + 8))
            self._add(_word(members), x.nbytes, has_addresses=x.dtype == np.int64)

    def contents(self) -> _Contents:
        """Return the present content of all intervals."""
        addresses = []
        for at, word in self._possible_addresses():
            name = self._recorder._symbols.get(word)
            target = (-1 - self.names.index(name), 0) if name in self.names else self._place(word)
            place = self._place(at)
            if target is not None and place is not None:
                addresses.append((*place, *target))
        return [ctypes.string_at(begin, end - begin) for begin, end in self.intervals], addresses

    def _possible_addresses(self) -> Iterator[tuple[int, int]]:
        """Yield the words that may be addresses, each with its own address.

        Smaller words than 2^32 are numbers, except in programs whose heap is there: addresses of known memory.
        """
        for begin, end in _merged(self._integers):
            for at, word in zip(range(begin, end, 8), _words(begin, end), strict=True):
                is_high = 1 << 32 < word < 1 << 47
                if (is_high or (1 << 24 < word < 1 << 32 and self._place(word))) and at not in self._empty:
                    yield at, word

    def _is_foreign(self, at: int, word: int) -> bool:
        return self._place(word) is None and word not in self._recorder._symbols

    def _place(self, address: int) -> tuple[int, int] | None:
        """Return the block of an address, and its offset in the block."""
        i = bisect_right(self._begins, address) - 1
        if i < 0 or address >= self._order[i][1]:
            return None
        begin, _, block = self._order[i]
        return block, address - begin


def _layout(called: kernel.Kernel) -> tuple[int, int, list[int], list[tuple[int, np.dtype[Any], int]]]:
    """Return the layout of the argument of a kernel.

    It is the number of bytes of its arguments and of what follows, the words that are addresses of array objects, and
    the words at which the members of arrays of bundles begin, with the type and the number of dimensions of each array.
    """
    at, arrays, bundles = 0, [], []
    for kind in called.signature[0]:
        if hasattr(kind, "_fields"):
            for one in bundle.arrays_in(kind):
                bundles.append((at, one.dtype, one.dimensions))
                at += bundle.ARRAY_WORDS + 2 * one.dimensions
            continue
        if kind not in (int, float, bool):
            arrays.append(at)
        at += 1
    return 8 * at, 8 * (len(kernel.DTYPES) + len(called.results)), arrays, bundles


def _merged(intervals: set[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return intervals that neither overlap nor touch."""
    found: list[tuple[int, int]] = []
    for begin, end in sorted(intervals):
        if found and begin <= found[-1][1]:
            found[-1] = (found[-1][0], max(end, found[-1][1]))
        else:
            found.append((begin, end))
    return found


def _word(at: int) -> int:
    return ctypes.c_int64.from_address(at).value


def _words(begin: int, end: int) -> list[int]:
    return list((ctypes.c_int64 * ((end - begin) // 8)).from_address(begin))


def _counted(text: bytes) -> bytes:
    return struct.pack("<q", len(text)) + text + bytes(-len(text) % 8)


def main() -> None:
    """Simulate the examples and record their calls."""
    with Path(sys.argv[1]).open("wb") as file:
        recorder = Recorder(file)
        for name, end, sections in RUNS:
            recorder.counts.clear()
            mbdkit.run(name, **{"time": {"end": end, "step": end / 4}, **sections})
        for integrator in INTEGRATORS_OF_ENSEMBLES:
            recorder.counts.clear()
            spec = {"mbdkit": 1, "model": {"name": "double-pendulum", "angles": [0.0, 0.3]}, "integrator": integrator,
                    "time": {"end": 0.04, "step": 0.01}}  # fmt: skip
            out = Path(sys.argv[1]).with_suffix(f".{integrator['name']}")
            mbdkit.ensemble(spec, {"model.angles.0": np.linspace(0.0, 0.7, 8)}, out=out)
            compute_block(out, 0)  # again, in this process
            if "adaptive" not in integrator:
                for mode in ("forward", "adjoint"):
                    mbdkit.gradient(spec, "final(rod2.angle)", ["model.masses.1"], mode=mode)
        recorder.counts.clear()
        touching = load_spec(
            "bouncing-ball",
            [
                "model.bodies.ball.position.1=0.1", "integrator={name: rk4}", "time={end: 0.01, step: 0.002}",
                "events={}",
            ],
        )  # fmt: skip
        mbdkit.gradient(touching, "final(ball.y)", ["model.bodies.ball.mass"])
        recorder.counts.clear()
        mbdkit.inverse("walking")
        recorder.close()
    print(*sorted(recorder.reached))


if __name__ == "__main__":
    main()
