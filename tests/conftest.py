"""Fixtures for all tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from mbdkit.studies import executor_pool
from mbdkit.studies.pool import Pool
from tests.pool_in_this_process import PoolInThisProcess


@pytest.fixture
def in_tmp_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty folder, and return it."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session", autouse=True)
def _studies_in_this_process() -> Iterator[None]:
    """Compute studies in the process of the tests, unless a test asks for `processes`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(executor_pool, "Pool", PoolInThisProcess)
        yield


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute studies in processes of their own, as outside of these tests."""
    monkeypatch.setattr(executor_pool, "Pool", Pool)
