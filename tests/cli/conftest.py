"""A spec for tests of the command line."""

from __future__ import annotations

import pytest

from tests.spec_texts import SMALL


@pytest.fixture
def small() -> str:
    """A spec of few words, for a test to change."""
    return SMALL
