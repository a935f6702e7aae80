"""Integration methods as data: coefficients, options, claims and references, one method in a file.

The algorithms are in `mbdkit.stepping`. The hash of kernel sources excludes this folder, so that an edit does not cause
recompilation.

A file that defines ``FAMILY`` and ``INTEGRATORS`` adds its methods to mbdkit; see `integrators`.
"""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbdkit.registry.items import IntegratorPlugin

FAMILIES = ("explicit", "taylor", "collocation", "partitioned", "scipy")
"""Values of ``FAMILY`` in a module of a method, in the order in which `integrators` lists them; other values come
last.
"""


def integrators() -> list[IntegratorPlugin]:
    """Return the integrators of all modules of this folder that define ``INTEGRATORS``.

    Returns
    -------
    list of IntegratorPlugin
        Sorted by family, then by the order of convergence with default options, then by name. The integrators of a
        module stay together in their order; the first one determines their position in the list.
    """
    names = sorted(module.name for module in pkgutil.iter_modules(__path__, f"{__name__}."))
    modules = [importlib.import_module(name) for name in names]
    listed = sorted((module for module in modules if hasattr(module, "INTEGRATORS")), key=_place)
    return [integrator for module in listed for integrator in module.INTEGRATORS]


def _place(module: ModuleType) -> tuple[int, float, str]:
    first: IntegratorPlugin = module.INTEGRATORS[0]
    family = FAMILIES.index(module.FAMILY) if module.FAMILY in FAMILIES else len(FAMILIES)
    return family, first.claims(first.options()).order or 0.0, first.name
