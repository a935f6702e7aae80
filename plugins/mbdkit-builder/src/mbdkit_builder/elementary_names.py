"""Elementary functions in LLVM modules: those of `mbdkit.engine.kernels.elementary` instead of the C library.

Numba translates functions of `math` and NumPy to calls of the C library, or to intrinsic functions of LLVM, which
become such calls, and `%` to an instruction that becomes a call of ``fmod``. All of them are renamed as soon as the
module of a function exists, since LLVM, which knows the meaning of these names, would otherwise compute values of
constants with the C library of this machine. They are declared without effects, and every library
contains their definitions (`mbdkit_builder.object_code.elementary_module`).
"""

from __future__ import annotations

import re

import llvmlite.binding as llvm
from numba import config
from numba.core.registry import cpu_target

from mbdkit.engine.kernels.elementary import FUNCTIONS

#: Functions of Numba's own library, and those of the C library that compute the same.
_ALIASES = {"numba_gamma": "tgamma"}
PREFIX = "mbdkit.elementary."  #: Beginning of the names of elementary functions in modules.
_NAMES = sorted({*FUNCTIONS, *(alias for alias, name in _ALIASES.items() if name in FUNCTIONS)})
_CALLED = re.compile(rf"""@"?(?:llvm\.)?({"|".join(_NAMES)})(?:\.f64)?"?(?=\()""")
_OWN = re.compile(rf"""@"?{re.escape(PREFIX)}(\w+)""")
_DECLARED = re.compile(rf"""^declare .*@"?{re.escape(PREFIX)}\w+"?\(.*$""", re.MULTILINE)
_PURE = "nounwind willreturn memory(none)"
_REMAINDER = re.compile(r"= frem (double \S+), (\S+)")

# Numba simplifies every function for a processor before its module is taken. Without these lines that would be the
# processor of this machine, and the stored code would depend on it.
config.CPU_NAME = "generic"  # type: ignore[attr-defined]
config.CPU_FEATURES = ""  # type: ignore[attr-defined]

# Numba executes none of the code that is stored. It does execute functions of users, whose duals call ours: as their
# values are those of the C library, so are their derivatives.
cpu_target.target_context.codegen()  # which makes LLVM look into the libraries of this process
for _name in FUNCTIONS:
    llvm.add_symbol(f"{PREFIX}{_name}", llvm.address_of_symbol(_name))


def with_own_names(code: str) -> str:
    """Return the code of a module in which elementary functions have names that mean nothing to LLVM."""
    code = _CALLED.sub(lambda match: f'@"{PREFIX}{_ALIASES.get(match[1], match[1])}"', code)
    code = _REMAINDER.sub(rf'= call double @"{PREFIX}fmod"(\1, double \2)', code)
    # A function may have been declared by two of its old names, or not at all.
    called = sorted(set(_OWN.findall(code)))
    code = _DECLARED.sub("", code)
    declared = (f'declare double @"{PREFIX}{name}"({_arguments(name)}) {_PURE}' for name in called)
    return "\n".join((code, *declared, ""))


def _arguments(name: str) -> str:
    return ", ".join(["double"] * FUNCTIONS[name].__code__.co_argcount)
