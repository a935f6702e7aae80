"""Collect the integrators that mbdkit ships from the modules of this folder."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

from mbdkit import methods
from mbdkit.registry.items import IntegratorPlugin

FAMILIES = ("explicit", "collocation", "partitioned", "scipy")
"""Values of ``FAMILY`` in a module of a method, in the order in which `integrators` lists them."""


def integrators() -> list[IntegratorPlugin]:
    """Return the integrators of all modules of `mbdkit.methods` that define ``INTEGRATORS``.

    Returns
    -------
    list of IntegratorPlugin
        Sorted by family, then by the order of convergence with default options, then by name. Integrators of one module
        keep their order; the first one determines the position of the module in the list.
    """
    names = sorted(module.name for module in pkgutil.iter_modules(methods.__path__, f"{methods.__name__}."))
    modules = [importlib.import_module(name) for name in names]
    found = sorted((module for module in modules if hasattr(module, "INTEGRATORS")), key=_place)
    return [integrator for module in found for integrator in module.INTEGRATORS]


def _place(module: ModuleType) -> tuple[int, float, str]:
    first: IntegratorPlugin = module.INTEGRATORS[0]
    return FAMILIES.index(module.FAMILY), first.claims(first.options()).order or 0.0, first.name
