"""The cache folder of compiled kernels, and the lock that is held while they are compiled.

Numba's own cache checks only the file that contains a kernel. After a change to a callee in another file, it would load
outdated machine code. The name of the cache folder therefore contains a hash of *all* kernel sources, the version of
Numba and the processor: ``<user cache>/mbdkit/<hash>``. It is determined when this module is imported.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import llvmlite.binding as llvm
from numba import config

from mbdkit.engine.jit.numba_version import INSTALLED, PLAIN

_PACKAGE = Path(__file__).resolve().parents[2]


def kernel_sources() -> list[Path]:
    """Return the source files of all kernels and of all functions that they call, sorted."""
    rooms = ("engine/jit", "engine/kernels", "stepping")
    return sorted(path for room in rooms for path in (_PACKAGE / room).glob("*.py"))


def fingerprint() -> str:
    """Return 16 hex digits that depend on all kernel sources, Numba, Python, the compile path and the processor."""
    digest = hashlib.sha256()
    for path in kernel_sources():
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    features = llvm.get_host_cpu_features().flatten()
    path_name = "plain" if PLAIN else "fast"
    digest.update(f"{INSTALLED} {path_name} {sys.version_info[:2]} {llvm.get_host_cpu_name()} {features}".encode())
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
    """Return a writable folder for compiled kernels; a temporary one, with a warning, if the user's is not writable."""
    folder = _user_cache() / fingerprint()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError) as error:
        warnings.warn(
            f"the cache folder {folder} cannot be written ({error}), so that kernels are compiled again in every "
            "process; set MBDKIT_CACHE_DIR to a writable folder",
            RuntimeWarning,
            stacklevel=2,
        )
        folder = Path(tempfile.mkdtemp(prefix="mbdkit-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


FOLDER = _open_cache()


@contextmanager
def cached_here() -> Iterator[None]:
    """Make Numba use `FOLDER` as its cache for functions that are decorated inside this context.

    CACHE_DIR corresponds to the documented environment variable NUMBA_CACHE_DIR, which Numba reads only once and
    applies to all packages. If a later version of Numba renames it, the lookup raises KeyError; kernels are then never
    cached in a wrong folder.
    """
    before = vars(config)["CACHE_DIR"]
    vars(config)["CACHE_DIR"] = str(FOLDER)
    try:
        yield
    finally:
        vars(config)["CACHE_DIR"] = before


def _marker() -> Path:
    """Return the path of the file that exists once all kernels have been compiled.

    Its name depends on the path and modification time of each source. Numba's own index files depend on them too, so
    Numba would compile kernels again after they change.
    """
    stamps = [f"{path} {path.stat().st_mtime_ns}" for path in kernel_sources()]
    return FOLDER / f"compiled-{hashlib.sha256(chr(10).join(stamps).encode()).hexdigest()[:16]}"


def is_warm() -> bool:
    """Return whether all kernels have been compiled into the cache folder."""
    return _marker().exists()


@contextmanager
def locked() -> Iterator[None]:
    """Hold the compile lock; wait until no other process holds it."""
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
    """Hold the compile lock; yield whether kernels remain to be compiled (another process may have compiled them)."""
    with locked():
        cold = not is_warm()
        yield cold
        if cold:
            _marker().touch()
