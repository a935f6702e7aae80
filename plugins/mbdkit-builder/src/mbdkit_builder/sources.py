"""The sources of machine code: the files on which the code of a kernel depends, and their digests.

The code of a symbol follows from the module that defines it, from all modules of kernels that this one imports,
directly or not, and from the compiler.
"""

from __future__ import annotations

import hashlib
import re
from functools import cache
from pathlib import Path

from mbdkit.base.errors import MbdkitError
from mbdkit.engine.native.machine_code import PACKAGE, digest

_ROOMS = ("engine/kernels/", "integrators/", "engine/native/")
_ALWAYS = ("engine/native/bundle.py", "engine/native/kernel.py", "engine/native/levels.py")
_IMPORT = re.compile(r"^(?:from mbdkit\.([\w.]+) import|import mbdkit\.([\w.]+))", re.MULTILINE)


def module_of(symbol: str) -> str:
    """Return the source file of a symbol, relative to the package mbdkit."""
    name = symbol.partition("__")[0]
    for room in ("integrators", "engine/kernels"):
        if (PACKAGE / room / f"{name}.py").is_file():
            return f"{room}/{name}.py"
    raise MbdkitError(f"there is no kernel '{symbol}'")


@cache
def _imported(file: str) -> tuple[str, ...]:
    text = (PACKAGE / file).read_text(encoding="utf-8")
    paths = ((first or second).replace(".", "/") + ".py" for first, second in _IMPORT.findall(text))
    return tuple(path for path in paths if path.startswith(_ROOMS) and (PACKAGE / path).is_file())


@cache
def files_behind(file: str) -> tuple[str, ...]:
    """Return the files of mbdkit that the code of a module follows from, sorted, relative to the package."""
    found, waiting = set(), [file, *_ALWAYS, "expressions/operations.py"]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += _imported(path)
    return tuple(sorted(found - {"engine/native/machine_code.py"}))  # which only loads the code


@cache
def builder_digests() -> dict[str, str]:
    """Return the digests of the files of this package from which the code of every module follows."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    return {path.name: digest(str(path)) for path in files if path.name not in _NOT_COMPILED}


_NOT_COMPILED = {
    "__main__.py",
    "element_kernels.py",
    "function_laws.py",
    "generated_files.py",
    "libraries.py",
    "method_stubs.py",
    "packaged_laws.py",
    "sources.py",
}
"""Files of this package that have no influence on stored machine code."""


@cache
def fingerprint(file: str) -> str:
    """Return 16 hex digits that depend on all files that the code of a module follows from."""
    digests = {path: digest(path) for path in files_behind(file)} | builder_digests()
    text = "\n".join(f"{path} {digits}" for path, digits in digests.items())
    return hashlib.sha256(text.encode()).hexdigest()[:16]
