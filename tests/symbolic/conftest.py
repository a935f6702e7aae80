"""Fixtures of this room."""

from __future__ import annotations

import numpy as np
import pytest

from mbdkit.engine import elements


@pytest.fixture
def complex_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the square root of uncompiled kernels take complex numbers."""
    monkeypatch.setattr(elements, "sqrt", np.emath.sqrt)
