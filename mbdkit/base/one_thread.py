"""Linear algebra on one thread, so that results are bitwise identical for any number of threads.

The libraries behind NumPy and SciPy split sums among threads, so that rounding errors depend on the number of threads.
A study computes several runs at once and gives each run one thread; a run outside of studies must have the same
results.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_LOCK = threading.Lock()
_LIMITED = ExitStack()
_users = 0


def begin_with_one_thread() -> None:
    """Give linear algebra one thread from the beginning; has no effect after NumPy is imported, or if the user has
    chosen a number of threads.

    Starting and stopping other threads would take a fifth of a short run, and finding the libraries 2 %.
    """
    global _users
    chosen = os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if chosen == "1" and "numpy" not in sys.modules and all(map(_has_openblas, ("numpy", "scipy"))):
        _users = 1  # until the process ends


def _has_openblas(package: str) -> bool:
    """Return whether a package brings an OpenBLAS, which obeys the variable, as wheels for Linux and Windows do."""
    spec = find_spec(package)
    return bool(spec and spec.origin and any(Path(spec.origin).parents[1].glob(f"{package}.libs/*scipy_openblas*")))


@contextmanager
def one_thread_of_linear_algebra() -> Iterator[None]:
    """Limit each call of linear algebra to one thread within this context, for all threads of the process.

    Contexts may overlap in several threads; the limit is lifted at the end of the last one.
    """
    global _users
    with _LOCK:
        if _users == 0:
            _LIMITED.enter_context(_controller().limit(limits=1, user_api="blas"))
        _users += 1
    try:
        yield
    finally:
        with _LOCK:
            _users -= 1
            if _users == 0:
                _LIMITED.close()


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    """Return the controller of the thread pools of the loaded libraries; cached, because it takes about 10 ms."""
    from threadpoolctl import ThreadpoolController

    _load_library_of_scipy()
    return ThreadpoolController()


def _load_library_of_scipy() -> None:
    """Load the library behind `scipy.linalg`, without the modules that this package imports, which most runs do not
    need and which take a tenth of a second.
    """
    if "scipy.linalg" in sys.modules:
        return
    import ctypes

    import scipy

    folder = Path(scipy.__file__).parent / "linalg"
    try:
        ctypes.CDLL(str(next(folder.glob("_fblas*" + EXTENSION_SUFFIXES[-1]))))  # an extension that is linked with it
    except (StopIteration, OSError):  # SciPy was built in another way
        import scipy.linalg  # loads its library, too
