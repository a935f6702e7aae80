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
from mbdkit.base.lazy_names import homes_of
from mbdkit.engine.native import machine_code

#: Rooms of mbdkit that kernels may import; other packages have them in ``kernels``.
_ROOMS = ("engine/kernels/", "integrators/", "engine/native/", "laws/")
_ALWAYS = (
    "engine/kernels/elementary/__init__.py",  # imports the functions that take the place of the C library
    "engine/native/bundle.py",
    "engine/native/kernel.py",
    "engine/native/levels.py",
)
ELEMENTARY = "elementary"  #: Name of the object file with all elementary functions, which no symbol of a kernel has.
_IMPORT = re.compile(r"^(?:from|import) (\w+)\.([\w.]+)(?: import (?:\(([\w,\s]+)\)|([\w, ]+)))?", re.MULTILINE)


def module_of(symbol: str) -> str:
    """Return the source file of a symbol; see `mbdkit.engine.native.machine_code.source_file`."""
    if symbol == ELEMENTARY:
        return _ALWAYS[0]
    package, name = machine_code.package_of(symbol), symbol.rpartition("___")[2].partition("__")[0]
    for room in ("integrators/", "engine/kernels/") if package == machine_code.CORE else (f"{package}:kernels/",):
        folder = machine_code.source_file(room)
        for path in sorted(folder.rglob(f"{name}.py")):
            return f"{room}{path.relative_to(folder).as_posix()}"
    raise MbdkitError(f"there is no kernel '{symbol}'")


@cache
def _imported(file: str) -> tuple[str, ...]:
    paths = []
    for package, module, *names in _IMPORT.findall(machine_code.source_file(file).read_text(encoding="utf-8")):
        if package not in machine_code.kernel_packages():
            continue
        if (package, module) == (machine_code.CORE, "kernels"):
            paths += [_homes()[name.split()[0]] for name in "".join(names).split(",") if name.strip()]
            continue
        place = module.replace(".", "/")
        rooms, prefix = (_ROOMS, "") if package == machine_code.CORE else (("kernels/",), f"{package}:")
        modules = (place, *(f"{place}/{name.split()[0]}" for name in "".join(names).split(",") if name.strip()))
        paths += [f"{prefix}{path}.py" for path in modules if path.startswith(rooms)]
    return tuple(path for path in paths if machine_code.source_file(path).is_file())


@cache
def _homes() -> dict[str, str]:
    homes = homes_of(machine_code.source_file("kernels.py"))
    return {name: f"{module.partition('.')[2].replace('.', '/')}.py" for name, module in homes.items()}


@cache
def files_behind(file: str) -> tuple[str, ...]:
    """Return the files that the code of a module follows from, sorted."""
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
    names = sorted(path.name for path in Path(__file__).parent.glob("*.py"))
    return {name: machine_code.digest(f"{__package__}:{name}") for name in names if name not in _NOT_COMPILED}


#: Files of this package that have no influence on stored machine code.
_NOT_COMPILED = {
    "__main__.py",
    "contact_kernels.py",
    "element_kernels.py",
    "function_laws.py",
    "libraries.py",
    "binary_files.py",
    "method_stubs.py",
    "minimax.py",
    "packaged_laws.py",
    "sources.py",
}


@cache
def fingerprint(file: str) -> str:
    """Return 16 hex digits that depend on all files that the code of a module follows from."""
    digests = {path: machine_code.digest(path) for path in files_behind(file)} | builder_digests()
    text = "\n".join(f"{path} {digits}" for path, digits in digests.items())
    return hashlib.sha256(text.encode()).hexdigest()[:16]
