"""Where compiled kernels live, and the decorators that put them there.

Numba's own cache looks only at the file that holds a kernel, so a change in a callee of another file would go on
serving stale physics. Hence the cache folder is named after a hash of *all* kernel sources, the Numba version and the
processor: ``<user cache>/mbdkit/<hash>``. Importing this module decides the folder; `kernel` and `element` use it.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
from llvmlite import ir
from numba import cfunc, config, njit, types
from numba.extending import intrinsic

from mbdkit.engine.jit.part_compiler import PartCompiler

_PACKAGE = Path(__file__).resolve().parents[2]


def kernel_sources() -> list[Path]:
    """Return every source file whose text decides what a compiled kernel does, sorted."""
    rooms = ("engine/jit", "engine/kernels", "stepping")
    return sorted(path for room in rooms for path in (_PACKAGE / room).glob("*.py"))


def fingerprint() -> str:
    """Return 16 hex digits that change with any kernel source, the Numba version and the processor."""
    digest = hashlib.sha256()
    for path in kernel_sources():
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    features = llvm.get_host_cpu_features().flatten()
    digest.update(f"{numba.__version__} {sys.version_info[:2]} {llvm.get_host_cpu_name()} {features}".encode())
    return digest.hexdigest()[:16]


def _user_cache() -> Path:
    if chosen := os.environ.get("MBDKIT_CACHE_DIR"):
        return Path(chosen)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "mbdkit"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "mbdkit"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mbdkit"


def _open_cache() -> Path:
    """Return a writable folder for compiled kernels; a temporary one, with a warning, where the user's is not."""
    folder = _user_cache() / fingerprint()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError) as error:
        warnings.warn(
            f"the cache folder {folder} cannot be written ({error}): kernels are compiled anew in every process; "
            "set MBDKIT_CACHE_DIR to a folder that can",
            RuntimeWarning,
            stacklevel=2,
        )
        folder = Path(tempfile.mkdtemp(prefix="mbdkit-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


FOLDER = _open_cache()


@contextmanager
def cached_here() -> Iterator[None]:
    """Let Numba keep in the cache folder what is decorated meanwhile."""
    before = vars(config)["CACHE_DIR"]
    vars(config)["CACHE_DIR"] = str(FOLDER)
    try:
        yield
    finally:
        vars(config)["CACHE_DIR"] = before


_PLAIN: dict[int, Callable[..., Any]] = {}
"""Entries by their address, where nothing is compiled."""


class Entry:
    """A compiled function that kernels call by its address, so that they need not be compiled together with it.

    Its arguments are two addresses (int) and three numbers (float); it returns a status (int).
    """

    def __init__(self, function: Callable[[int, int, float, float, float], int]):
        self.function = function

    @cached_property
    def address(self) -> int:
        """Where it is; compiled, or read from the cache, when it is first asked for."""
        if vars(config)["DISABLE_JIT"]:
            _PLAIN[id(self)] = self.function
            return id(self)
        make: Any = cfunc
        done = FOLDER / f"entry-{self.function.__module__}.{self.function.__name__}"
        with ExitStack() as waiting:
            if is_warm() and not done.exists():  # else it only has to be read, or `compiling` holds the lock already
                print("mbdkit compiles the kernels of this method; this happens once ...", file=sys.stderr, flush=True)
                waiting.enter_context(_locked())
            with cached_here():
                self._compiled = make(_ENTRY, cache=True, error_model="numpy", _nrt=False)(self.function)
            done.touch()
        return int(self._compiled.address)


_ENTRY = types.int64(types.int64, types.int64, types.float64, types.float64, types.float64)


def entry(function: Callable[..., Any]) -> Entry:
    """Compile a function that kernels call by its address; see `Entry`."""
    return Entry(function)


def _call_plain(address, first, second, t, h, x):
    return _PLAIN[address](first, second, t, h, x)


@intrinsic
def _call_compiled(typing_context, address, first, second, t, h, x):
    """Call an `Entry` by its address."""

    def generate(context, builder, signature, arguments):
        word, real = ir.IntType(64), ir.DoubleType()
        kind = ir.FunctionType(word, [word, word, real, real, real])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])

    return types.int64(types.int64, types.int64, types.int64, types.float64, types.float64, types.float64), generate


call_entry: Any = _call_plain if vars(config)["DISABLE_JIT"] else _call_compiled
"""Calls the entry at an address with its five arguments."""


def _jit(function: Callable[..., Any], **options: Any) -> Any:
    """Compile without Numba's reference counts: kernels allocate nothing, and counting costs more than a pendulum."""
    compiler: Any = njit
    with cached_here():
        return compiler(function, error_model="numpy", _nrt=False, **options)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls: cached on disk, releases the interpreter lock, IEEE arithmetic."""
    return _jit(function, cache=True, nogil=True, no_cfunc_wrapper=True)


def part(function: Callable[..., Any], **options: Any) -> Any:
    """Compile a function that only kernels call; see `mbdkit.engine.jit.part_compiler`."""
    return _jit(function, pipeline_class=PartCompiler, no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function that only kernels call, copied into each of its callers."""
    return part(function, forceinline=True)


element = part


def _marker() -> Path:
    """Return the file that says: all kernels of these very files stand compiled (Numba goes by path and time)."""
    stamps = [f"{path} {path.stat().st_mtime_ns}" for path in kernel_sources()]
    return FOLDER / f"compiled-{hashlib.sha256(chr(10).join(stamps).encode()).hexdigest()[:16]}"


def is_warm() -> bool:
    """Return whether all kernels have been compiled into the cache folder."""
    return _marker().exists()


@contextmanager
def _locked() -> Iterator[None]:
    """Hold the compile lock, once no other process does."""
    with open(FOLDER / "lock", "w", encoding="ascii") as lock:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(lock.fileno(), msvcrt.LK_LOCK, 1)
        else:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextmanager
def compiling() -> Iterator[bool]:
    """Hold the compile lock; yields whether this process has to compile (another may have done it meanwhile)."""
    with _locked():
        cold = not is_warm()
        yield cold
        if cold:
            _marker().touch()
