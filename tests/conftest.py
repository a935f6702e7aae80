"""Fixtures for all tests."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mbdkit.studies import executor_pool
from mbdkit.studies.pool import Pool
from tests.pool_in_this_process import PoolInThisProcess


def pytest_configure(config: pytest.Config) -> None:
    """Let processes of tests share compiled modules even where the environment forbids Python to write them.

    Hundreds of tests start a process, which otherwise compiles all modules that it imports. They are kept in a folder
    of their own, which is removed at the end.

    Also restore SIGINT where the shell started the tests with SIGINT ignored, as it does for background jobs. Processes
    that tests start and interrupt would inherit that.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", None) and "PYTHONPYCACHEPREFIX" not in os.environ:
        folder = tempfile.mkdtemp(prefix="mbdkit-pycache-")
        os.environ["PYTHONPYCACHEPREFIX"] = folder
        config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each process half of the tests in their order, to share fixtures, and at last a part of what is left."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)


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
