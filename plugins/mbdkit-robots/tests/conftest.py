"""Skips the tests where XML cannot be read safely."""

from __future__ import annotations

import pytest

pytest.importorskip("defusedxml")
