"""Table of all functions that get machine code of their own, by symbol, and their unoptimized LLVM modules."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from functools import partial
from typing import Any

from mbdkit.engine.native import machine_code
from mbdkit.engine.native.functions import DECLARED
from mbdkit_builder import (  # noqa: F401
    bundle_pointers,
    call_code,
    dual_complex,
    indices,
    lane_complex,
    object_code,
)
from mbdkit_builder.implementation import check_placeholders, define_overloads


def symbols(package: str = machine_code.CORE) -> dict[str, Callable[[], Any]]:
    """Return, for each symbol of a package, a function that makes its LLVM module; imports all kernels of mbdkit and of
    this package.
    """
    rooms = ["mbdkit.engine.kernels", "mbdkit.integrators"]
    for room in rooms if package == machine_code.CORE else [*rooms, f"{package}.kernels"]:
        for module in pkgutil.walk_packages(importlib.import_module(room).__path__, f"{room}."):
            importlib.import_module(module.name)
    found: dict[str, Callable[[], Any]] = {}
    found |= {name: partial(object_code.kernel_module, one) for name, one in DECLARED.kernels.items()}
    found |= {name: partial(object_code.entry_module, name, one.function) for name, one in DECLARED.entries.items()}
    for name, law in DECLARED.laws.items():
        found[name] = partial(object_code.law_module, name, law.function, duals=False)
        name = f"{name}__dual"
        found[name] = partial(object_code.law_module, name, law.function, duals=True)
    return {symbol: found[symbol] for symbol in sorted(found) if machine_code.package_of(symbol) == package}


def prepare() -> None:
    """Define everything that kernels use for Numba, and initialize LLVM; call once, after `symbols`."""
    define_overloads()
    indices.count_from_zero()
    bundle_pointers.define_loaders()
    check_placeholders()
    object_code.initialize()
