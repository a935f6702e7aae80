"""The cache folder of compiled kernels, and the lock that is held while they are compiled.

Numba's own cache checks only the file that contains a kernel. After a change to a callee in another file, it would load
outdated machine code. The name of the cache folder therefore contains a hash of *all* kernel sources, the version of
Numba and the processor: ``<user cache>/mbdkit/<hash>``. It is determined when this module is imported.

Every file begins with the SHA-256 digest of its name and content, which is checked when the file is read: executing
damaged machine code would crash the process or compute wrong numbers. A damaged file is replaced. A folder that cannot
be written is read only; a run never fails because of its cache.

Numba stores the LLVM bitcode of a function beside its machine code, for other functions that may be compiled later and
include it. No kernel is included in this way, and reading the bitcode takes most of the loading time, so that only its
symbols are kept.

`KernelCache` uses internals of Numba: the attribute `_cache` of compiled functions, `Cache._index_key`, the reduced
form of a `CompileResult`, and the module for linking of its library.
"""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import pickle
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba.core.caching import FunctionCache
from numba.core.ccallback import CFunc
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature
from numba.extending import is_jitted

from mbdkit.base.errors import MbdkitError
from mbdkit.base.files import replacing
from mbdkit.engine.jit.lane_width import WIDTH
from mbdkit.engine.jit.numba_version import INSTALLED, PLAIN

log = logging.getLogger("mbdkit")

_PACKAGE = Path(__file__).resolve().parents[2]
_DIGEST = hashlib.sha256().digest_size  # bytes
_TEMPORARY = "mbdkit-"
"""Prefix of the name of a temporary cache folder of this process."""


def kernel_sources() -> list[Path]:
    """Return the source files of all kernels and of all functions that they call, sorted."""
    rooms = ("engine/jit", "engine/kernels", "stepping")
    paths = (path for room in rooms for path in (_PACKAGE / room).glob("*.py"))
    return sorted([_PACKAGE / "expressions/operations.py", *paths])


def fingerprint() -> str:
    """Return 16 hex digits that depend on all kernel sources, Numba, Python, compile path, processor and lanes."""
    digest = hashlib.sha256()
    for path in kernel_sources():
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    features = llvm.get_host_cpu_features().flatten()
    path_name = "plain" if PLAIN else "fast"
    digest.update(f"{INSTALLED} {path_name} {sys.version_info[:2]} {llvm.get_host_cpu_name()} {features}".encode())
    digest.update(f" {WIDTH} lanes".encode())
    return digest.hexdigest()[:16]


def _user_cache() -> Path:
    if chosen := os.environ.get("MBDKIT_CACHE_DIR"):
        return Path(chosen)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "mbdkit"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "mbdkit"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mbdkit"


def _open_cache() -> Path:
    """Return the folder for compiled kernels; a temporary one, with a warning, if the user's cannot be created."""
    try:
        folder = _user_cache() / fingerprint()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError) as error:  # RuntimeError: the user has no home folder
        log.warning(
            "mbdkit: warning: the cache folder cannot be created (%s), so that kernels are compiled again in every "
            "process; set MBDKIT_CACHE_DIR to a writable folder",
            error,
        )
        try:
            folder = Path(tempfile.mkdtemp(prefix=_TEMPORARY))
        except OSError:
            return Path(os.devnull) / "mbdkit"  # nothing can be stored
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


FOLDER = _open_cache()


@cache
def _warn_once(message: str) -> None:
    log.warning("mbdkit: warning: %s", message)


def _digest(path: Path, content: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + b"\0" + content).digest()


def stored(path: Path) -> bytes | None:
    """Return the content of a file of the cache; None if it does not exist, cannot be read or is damaged."""
    try:
        whole = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        _warn_once(f"compiled code in the cache {FOLDER} cannot be read ({error.strerror or error})")
        return None
    content = whole[_DIGEST:]
    if _digest(path, content) == whole[:_DIGEST]:
        return content
    _warn_once(f"compiled code in the cache {FOLDER} is damaged, and is compiled again")
    return None


def store(path: Path, content: bytes) -> None:
    """Write a file of the cache atomically; warn once if that is not possible."""
    try:
        with replacing(path) as draft:
            draft.write_bytes(_digest(path, content) + content)
    except (OSError, MbdkitError) as error:
        reason = error.__cause__ or error
        _warn_once(
            f"compiled code cannot be kept in the cache {FOLDER} ({getattr(reason, 'strerror', None) or reason}), so "
            "that it is compiled again in the next process; set MBDKIT_CACHE_DIR to a writable folder"
        )


class KernelCache(FunctionCache):
    """The machine code of a function in `FOLDER`, one file for each signature.

    Numba's own class would share one index file between signatures, in which processes can overwrite each other's
    entries, and needs a writable folder.
    """

    def __init__(self, function: Callable[..., Any]):
        self._py_func = function
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._cache_path = str(FOLDER)
        self.enable()

    def _file(self, signature: Any, codegen: Any) -> Path:
        key = repr(self._index_key(signature, codegen))
        return FOLDER / f"{self._name}-{hashlib.sha256(key.encode()).hexdigest()[:16]}.code"

    def flush(self) -> None:
        """Do nothing: if the sources change, another folder is used."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled function for a signature; None if it is not in the cache."""
        target_context.refresh()
        content = stored(self._file(sig, target_context.codegen()))
        if content is None:
            return None
        result = CompileResult._rebuild(target_context, *pickle.loads(content))
        machine_code = result._asdict()["library"]
        machine_code._shared_module = None  # symbols only: Numba then refuses to include it in another function
        return result

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the compiled function for a signature."""
        parts = data._asdict()
        if not parts["lifted"] and not parts["library"].has_dynamic_globals:  # other functions cannot be stored
            (name, kind, (machine_code, _)), *others = data._reduce()
            symbols = _symbols(parts["library"]._get_module_for_linking())
            store(self._file(sig, data.codegen), dumps(((name, kind, (machine_code, symbols)), *others)))


def _symbols(module: llvm.ModuleRef) -> bytes:
    """Return the bitcode of a module that defines the same names, without their contents."""
    empty = ir.Module()
    for function in module.functions:
        if not function.is_declaration:
            body = ir.Function(empty, ir.FunctionType(ir.VoidType(), ()), function.name).append_basic_block()
            ir.IRBuilder(body).unreachable()
    for variable in module.global_variables:
        if not variable.is_declaration:
            ir.GlobalVariable(empty, ir.IntType(8), variable.name).initializer = ir.Constant(ir.IntType(8), 0)
    return bytes(llvm.parse_assembly(str(empty)).as_bitcode())


def cached(compiled: Any) -> Any:
    """Make a function compiled by ``numba.njit`` use the cache, and return it."""
    if is_jitted(compiled):  # not with NUMBA_DISABLE_JIT=1
        compiled._cache = KernelCache(compiled.py_func)  # type: ignore[attr-defined]
    return compiled


def cached_cfunc(signature: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator like ``numba.cfunc`` that uses the cache."""

    def compile_callback(function: Callable[..., Any]) -> Any:
        callback: Any = CFunc(function, normalize_signature(signature), locals={}, options=options)
        callback._cache = KernelCache(function)
        callback.compile()
        return callback

    return compile_callback


_MARKER = FOLDER / "compiled"
_compiled_here = False
"""Whether this process has compiled all kernels; needed if the folder is read-only."""


def is_shared() -> bool:
    """Return whether other processes of this user use the same cache folder, and files can be written there."""
    return os.access(FOLDER, os.W_OK) and not FOLDER.name.startswith(_TEMPORARY)


def exists(path: Path) -> bool:
    """Return whether a file of the cache exists and is accessible."""
    return os.path.exists(path)


def mark(path: Path) -> None:
    """Create an empty file in the cache, if possible."""
    with suppress(OSError):
        path.touch()


def is_warm() -> bool:
    """Return whether all kernels have been compiled into the cache folder, or by this process."""
    return _compiled_here or exists(_MARKER)


@contextmanager
def locked() -> Iterator[None]:
    """Hold the compile lock; wait until no other process holds it. Without a writable folder there is no lock."""
    try:
        lock = open(FOLDER / "lock", "w", encoding="ascii")  # noqa: SIM115
    except OSError:
        yield
        return
    with lock:
        with suppress(OSError):  # some network file systems have no locks
            if sys.platform == "win32":
                import msvcrt

                msvcrt.locking(lock.fileno(), msvcrt.LK_LOCK, 1)
            else:
                import fcntl

                fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextmanager
def compiling() -> Iterator[bool]:
    """Hold the compile lock; yield whether kernels remain to be compiled (another process may have compiled them)."""
    global _compiled_here
    with locked():
        cold = not is_warm()
        yield cold
        if cold:
            mark(_MARKER)
            _compiled_here = True
