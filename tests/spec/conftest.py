"""A small spec to start from."""

from __future__ import annotations

from typing import Any

import pytest


@pytest.fixture
def small() -> dict[str, Any]:
    """A spec of few words, for a test to change."""
    run = {"integrator": {"name": "gauss", "stages": 2}, "time": {"end": 1.0, "step": 0.01}}
    return {"mbdkit": 1, "model": {"name": "double-pendulum"}, **run}
