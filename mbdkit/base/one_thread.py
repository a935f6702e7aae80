"""Linear algebra on one thread, so that results are bitwise identical for any number of threads.

The libraries behind NumPy and SciPy split sums among threads, so that rounding errors depend on the number of threads.
A study computes several runs at once and gives each run one thread; a run outside of studies must have the same
results.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_LOCK = threading.Lock()
_LIMITED = ExitStack()
_users = 0


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
