"""A run that the tests of notebooks share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import mbdkit


@pytest.fixture(scope="session")
def knee() -> Iterator[mbdkit.Run]:
    """A short run of the packaged knee."""
    with mbdkit.run("knee", time={"end": 0.2, "step": 0.01}) as run:
        yield run
