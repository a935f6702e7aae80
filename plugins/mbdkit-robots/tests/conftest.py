"""Skips the tests if XML cannot be read safely, because a package is missing."""

from __future__ import annotations

import pytest

pytest.importorskip("defusedxml")
