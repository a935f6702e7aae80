"""Cases of tests of which a few run by default, and the others with ``-m slow``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def slow(*cases: Any) -> list[Any]:
    """Return cases, each a value or a tuple of values, as parameters that are marked as slow."""
    return [pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow) for case in cases]


def slow_but(cases: Iterable[Any], *fast: Any) -> list[Any]:
    """Return cases as parameters of which all but `fast` are marked as slow."""
    return [one for case in cases for one in ([case] if case in fast else slow(case))]
