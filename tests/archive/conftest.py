"""Fixtures for the tests of the archive."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbdkit.archive import writer

from .making import make


@pytest.fixture(scope="session")
def archive_made_once(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the content of `archive`."""
    path = tmp_path_factory.mktemp("archive") / "run.h5"
    make(path)
    return path.read_bytes()


@pytest.fixture
def archive(tmp_path: Path, archive_made_once: bytes) -> Path:
    """Return a complete archive of 11 rows, two bodies and two joints."""
    path = tmp_path / "run.h5"
    path.write_bytes(archive_made_once)
    return path


@pytest.fixture
def always_due(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make every flush due."""
    monkeypatch.setattr(writer, "FLUSH_INTERVAL", 0.0)
