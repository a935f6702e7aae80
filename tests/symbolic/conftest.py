"""Fixtures of this room."""

from __future__ import annotations

import numpy as np
import pytest

from mbdkit.engine.kernels import element_kernels


@pytest.fixture
def complex_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the square root of uncompiled kernels take complex numbers."""
    monkeypatch.setattr(element_kernels, "sqrt", np.emath.sqrt)
