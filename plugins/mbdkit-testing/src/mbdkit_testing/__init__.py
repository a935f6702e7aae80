"""The conformance kit: named checks of plugins, for Python, pytest and ``mbdkit plugins verify``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import lazy

if TYPE_CHECKING:
    from mbdkit_testing.check_result import Report, Result
    from mbdkit_testing.kit import checks_of, verify
    from mbdkit_testing.pytest_suite import Case, ConformanceWarning, cases, conformance

__all__ = [
    "Case",
    "ConformanceWarning",
    "Report",
    "Result",
    "cases",
    "check_element",
    "check_force_law",
    "check_integrator",
    "check_joint",
    "check_model",
    "checks_of",
    "conformance",
    "verify",
]


def check_element(name: str, *, quick: bool = False) -> Report:
    """Run all checks of a kind of elements; see `mbdkit_testing.kit.verify`."""
    return _verify("element-kind", name, None, quick=quick)


def check_integrator(name: str, options: Mapping[str, object] | None = None, *, quick: bool = False) -> Report:
    """Run all checks of an integrator; see `mbdkit_testing.kit.verify`."""
    return _verify("integrator", name, options, quick=quick)


def check_joint(name: str, *, quick: bool = False) -> Report:
    """Run all checks of a kind of joints; see `mbdkit_testing.kit.verify`."""
    return _verify("joint-kind", name, None, quick=quick)


def check_model(name: str, options: Mapping[str, object] | None = None, *, quick: bool = False) -> Report:
    """Run all checks of a model; see `mbdkit_testing.kit.verify`."""
    return _verify("model", name, options, quick=quick)


def check_force_law(name: str, options: Mapping[str, object] | None = None, *, quick: bool = False) -> Report:
    """Run all checks of a force law; see `mbdkit_testing.kit.verify`."""
    return _verify("force-law", name, options, quick=quick)


def _verify(kind: str, name: str, options: Mapping[str, object] | None, *, quick: bool) -> Report:
    from mbdkit_testing.kit import verify

    return verify(kind, name, options, quick=quick)


if not TYPE_CHECKING:
    _HOMES = {
        "check_result": ["Report", "Result"],
        "kit": ["checks_of", "verify"],
        "pytest_suite": ["Case", "ConformanceWarning", "cases", "conformance"],
    }
    __getattr__ = lazy(globals(), {name: f"{__name__}.{module}" for module, names in _HOMES.items() for name in names})
