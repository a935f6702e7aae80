"""The sources of machine code: the files on which the code of a kernel depends, and their digests.

The code of a symbol follows from the module that defines it, from all modules of kernels that this one imports,
directly or not, and from the compiler.
"""

from __future__ import annotations

import hashlib
import re
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2]
_ROOMS = ("engine/kernels/", "stepping/", "engine/native/")
_ALWAYS = ("engine/native/bundle.py", "engine/native/kernel.py", "engine/native/levels.py")
_IMPORT = re.compile(r"^(?:from mbdkit\.([\w.]+) import|import mbdkit\.([\w.]+))", re.MULTILINE)


@cache
def digest(file: str) -> str:
    """Return 16 hex digits of the SHA-256 digest of a file of the package, without regard to line ends."""
    content = (PACKAGE / file).read_bytes().replace(b"\r\n", b"\n")
    return hashlib.sha256(content).hexdigest()[:16]


@cache
def _imported(file: str) -> tuple[str, ...]:
    text = (PACKAGE / file).read_text(encoding="utf-8")
    paths = ((first or second).replace(".", "/") + ".py" for first, second in _IMPORT.findall(text))
    return tuple(path for path in paths if path.startswith(_ROOMS) and (PACKAGE / path).is_file())


@cache
def files_behind(file: str) -> tuple[str, ...]:
    """Return the files that the code of a module follows from, sorted, relative to the package."""
    found, waiting = set(), [file, *_ALWAYS, "expressions/operations.py"]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += _imported(path)
    compiler = (path.relative_to(PACKAGE).as_posix() for path in (PACKAGE / "engine/compiler").glob("*.py"))
    return tuple(sorted({*found, *compiler} - _NOT_COMPILED))


_NOT_COMPILED = {
    "engine/native/machine_code.py", "engine/native/sources.py", "engine/compiler/__main__.py",
    "engine/compiler/libraries.py", "engine/compiler/function_laws.py", "engine/compiler/packaged_laws.py",
}  # fmt: skip
"""Files that have no influence on machine code."""


def fingerprint(file: str) -> str:
    """Return 16 hex digits that depend on all files that the code of a module follows from."""
    text = "\n".join(f"{path} {digest(path)}" for path in files_behind(file))
    return hashlib.sha256(text.encode()).hexdigest()[:16]
