"""The conformance kit: one list of named checks for Python, for pytest and for ``mbdkit plugins verify``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbdkit.testing.kit import checks_of, verify
from mbdkit.testing.outcome import Finding, Report, Result
from mbdkit.testing.pytest_suite import Case, ConformanceWarning, cases, conformance

__all__ = [
    "Case",
    "ConformanceWarning",
    "Finding",
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
    """Take an integrator through all checks; see `mbdkit.testing.kit.verify`."""
    return verify("integrator", name, options, quick=quick)


def check_model(name: str, options: Mapping[str, Any] | None = None, *, quick: bool = False) -> Report:
    """Take a model through all checks; see `mbdkit.testing.kit.verify`."""
    return verify("model", name, options, quick=quick)


def check_force_law(name: str, options: Mapping[str, Any] | None = None, *, quick: bool = False) -> Report:
    """Take a force law through all checks; see `mbdkit.testing.kit.verify`."""
    return verify("force-law", name, options, quick=quick)
