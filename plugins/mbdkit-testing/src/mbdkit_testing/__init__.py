"""The conformance kit: named checks of plugins, for Python, pytest and ``mbdkit plugins verify``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbdkit_testing.check_result import Report, Result
from mbdkit_testing.kit import checks_of, verify
from mbdkit_testing.pytest_suite import Case, ConformanceWarning, cases, conformance

__all__ = [
    "Case",
    "ConformanceWarning",
    "Report",
    "Result",
    "cases",
    "check_force_law",
    "check_integrator",
    "check_model",
    "checks_of",
    "conformance",
    "verify",
]


def check_integrator(name: str, options: Mapping[str, Any] | None = None, *, quick: bool = False) -> Report:
    """Run all checks of an integrator; see `mbdkit_testing.kit.verify`."""
    return verify("integrator", name, options, quick=quick)


def check_model(name: str, options: Mapping[str, Any] | None = None, *, quick: bool = False) -> Report:
    """Run all checks of a model; see `mbdkit_testing.kit.verify`."""
    return verify("model", name, options, quick=quick)


def check_force_law(name: str, options: Mapping[str, Any] | None = None, *, quick: bool = False) -> Report:
    """Run all checks of a force law; see `mbdkit_testing.kit.verify`."""
    return verify("force-law", name, options, quick=quick)
