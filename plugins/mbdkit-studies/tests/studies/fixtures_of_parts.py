"""Fixtures for all tests that depend on parts: studies without processes, and reports without pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.studies.pool_in_this_process import PoolInThisProcess

from mbdkit_report import Figure
from mbdkit_report.pages import report
from mbdkit_report.plot.charts import image_files, write_chart_images
from mbdkit_studies.compute import executor_pool, pool
from mbdkit_studies.compute.executor_pool import Pool
from tests.forked_worker import ForkedWorker


@pytest.fixture(scope="session", autouse=True)
def _studies_in_this_process() -> Iterator[None]:
    """Compute studies in the process of the tests, unless a test asks for `processes`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(executor_pool, "Pool", PoolInThisProcess)
        yield


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute studies in worker processes, which are forks of this one."""
    monkeypatch.setattr(executor_pool, "Pool", Pool)
    monkeypatch.setattr(pool, "subprocess", SimpleNamespace(Popen=ForkedWorker, PIPE=None))


@pytest.fixture
def new_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute studies in new processes, as outside of these tests."""
    monkeypatch.setattr(executor_pool, "Pool", Pool)


@pytest.fixture(scope="session", autouse=True)
def _small_pictures_of_reports() -> Iterator[None]:
    """Write small files in place of the pictures of reports, unless a test asks for `pictures`."""

    def write(charts: Iterable[Figure], folder: Path) -> list[Path]:
        folder.mkdir(exist_ok=True)
        files = image_files(charts, folder)
        for file in files:
            file.write_text("picture")
        return files

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "write_chart_images", write)
        yield


@pytest.fixture
def pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the first two pictures of each report; each takes a third of a second."""

    def write(charts: Iterable[Figure], folder: Path) -> list[Path]:
        return write_chart_images(list(charts)[:2], folder)

    monkeypatch.setattr(report, "write_chart_images", write)
