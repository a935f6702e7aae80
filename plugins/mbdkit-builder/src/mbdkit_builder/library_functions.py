"""Elementary functions in LLVM modules: those of `mbdkit.engine.kernels.elementary` instead of the C library.

Numba translates functions of `math` and NumPy to calls of the C library, or to intrinsic functions of LLVM, which
become such calls, and `%` to an instruction that becomes a call of ``fmod``. All of them are renamed as soon as the
module of a function exists, since LLVM, which knows the meaning of these names, would otherwise compute values of
constants with the C library of this machine. The definitions are linked before a module is optimized.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import types
from numba.core.registry import cpu_target

from mbdkit.engine.kernels.elementary import FUNCTIONS

_ALIASES = {"numba_gamma": "tgamma"}
"""Functions of Numba's own library, and those of the C library that compute the same."""
_PREFIX = "mbdkit.elementary."
_NAMES = sorted({*FUNCTIONS, *(alias for alias, name in _ALIASES.items() if name in FUNCTIONS)})
_CALLED = re.compile(rf"""@"?(?:llvm\.)?({"|".join(_NAMES)})(?:\.f64)?"?(?=\()""")
_OWN = re.compile(rf"""@"?{re.escape(_PREFIX)}(\w+)""")
_DECLARED = re.compile(rf"""^declare .*@"?{re.escape(_PREFIX)}\w+"?\(.*$""", re.MULTILINE)
_REMAINDER = re.compile(r"= frem (double \S+), (\S+)")

# Numba executes none of the code that is stored. It does execute functions of users, whose duals call ours: as their
# values are those of the C library, so are their derivatives.
cpu_target.target_context.codegen()  # which makes LLVM look into the libraries of this process
for _name in FUNCTIONS:
    llvm.add_symbol(f"{_PREFIX}{_name}", llvm.address_of_symbol(_name))


def with_own_names(code: str) -> str:
    """Return the code of a module in which elementary functions have names that mean nothing to LLVM."""
    code = _CALLED.sub(lambda match: f'@"{_PREFIX}{_ALIASES.get(match[1], match[1])}"', code)
    code = _REMAINDER.sub(rf'= call double @"{_PREFIX}fmod"(\1, double \2)', code)
    # A function may have been declared by two of its old names, or not at all.
    called = sorted(set(_OWN.findall(code)))
    code = _DECLARED.sub("", code)
    declared = (f'declare double @"{_PREFIX}{name}"({_arguments(name)})' for name in called)
    return "\n".join((code, *declared, ""))


def _arguments(name: str) -> str:
    return ", ".join(["double"] * FUNCTIONS[name].__code__.co_argcount)


def link_definitions(module: Any) -> None:
    """Add the definitions of the elementary functions that a module declares."""
    for name in [one.name for one in module.functions if one.is_declaration and one.name.startswith(_PREFIX)]:
        module.link_in(llvm.parse_bitcode(_definition(name.removeprefix(_PREFIX))))


@cache
def _definition(name: str) -> bytes:
    """Return the module of an elementary function, as a C function of doubles."""
    from mbdkit_builder.object_code import linked_module

    function = FUNCTIONS[name]
    count = function.__code__.co_argcount
    arguments = (types.float64,) * count

    def wrap(context: Any, builder: Any, callee: Any, signature: Any, given: list[Any]) -> None:
        _, result = context.call_conv.call_function(builder, callee, signature.return_type, arguments, given)
        builder.ret(result)

    kind = ir.FunctionType(ir.DoubleType(), [ir.DoubleType()] * count)
    module = linked_module(f"{_PREFIX}{name}", function, arguments, kind, wrap, is_inlined=True)
    for one in module.functions:
        if not one.is_declaration:
            one.linkage = "linkonce_odr"
    return module.as_bitcode()
