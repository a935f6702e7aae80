"""Fixtures for all tests."""

from __future__ import annotations

import gc
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest
from threadpoolctl import threadpool_limits
from typer.testing import CliRunner

from mbdkit.base.errors import MissingPartError
from mbdkit.cli import app
from tests.first_party import PARTS, ROOT

if PARTS:
    pytest_plugins = ["tests.studies.fixtures_of_parts"]


def pytest_configure(config: pytest.Config) -> None:
    """Let processes of tests share compiled modules even where the environment forbids Python to write them.

    Hundreds of tests start a process, which otherwise compiles all modules that it imports. They are kept in a folder
    of their own, which is removed at the end.

    Also restore SIGINT where the shell started the tests with SIGINT ignored, as it does for background jobs. Processes
    that tests start and interrupt would inherit that.

    Linear algebra has one thread, as in runs and commands. Further threads wait in loops for their next call, at the
    cost of the other process of tests. Tests about threads ask for several themselves.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for processes that are started, those of xdist among them
    threadpool_limits(1, user_api="blas")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", None) and "PYTHONPYCACHEPREFIX" not in os.environ:
        folder = tempfile.mkdtemp(prefix="mbdkit-pycache-")
        os.environ["PYTHONPYCACHEPREFIX"] = folder
        config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect without searching for garbage, and let no later search visit the objects of modules and tests.

    There are millions of them: a third of the time of collection, and half a second of each later search.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


FACES = {
    ROOT / "mbdkit" / file
    for file in ("__init__.py", "spec/__init__.py", "base/lazy_names.py", "registry/accessors.py", "archive/run.py")
}
"""Files through which a test gets what parts offer."""


def _part_missing(error: BaseException | None) -> str:
    """Return which part a test itself asks for where the core is alone; empty if mbdkit does, which is a mistake."""
    while isinstance(error, pytest.Collector.CollectError):
        error = error.__cause__
    if PARTS or error is None:
        return ""
    if isinstance(error, ModuleNotFoundError):  # the core imports parts through its faces only
        return f"needs {error.name}" if (error.name or "").startswith("mbdkit_") else ""
    if not isinstance(error, MissingPartError):
        return ""
    files = [Path(file) for file in _files(error.__traceback__) if "importlib" not in file]
    while files and files[-1] in FACES:
        files.pop()
    return str(error) if files and ROOT / "tests" in files[-1].parents else ""


def _files(traceback: TracebackType | None) -> Iterator[str]:
    """Yield the file of each frame, the innermost last."""
    while traceback is not None:
        yield traceback.tb_frame.f_code.co_filename
        traceback = traceback.tb_next


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Generator[None, Any, Any]:
    """Skip modules of tests of the core that import a part that is not there."""
    report = yield
    failure = report.call.excinfo
    if report.failed and failure and (missing := _part_missing(failure.value)):
        report.outcome, report.longrepr = "skipped", (str(collector.path), 0, f"Skipped: {missing}")
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, object, object]:
    """Skip tests of the core that ask for a part that is not there."""
    try:
        return (yield)
    except ImportError as error:
        if missing := _part_missing(error):
            pytest.skip(missing)
        raise


def _listed(name: str) -> tuple[str, ...]:
    return tuple(line for line in (ROOT / "tests" / name).read_text("utf-8").splitlines() if line[0] != "#")


QUICK = _listed("quick.txt")
"""Files and folders of quick tests, by paths from the root, and ids of single ones."""

SLOW = {name: int(kept or 0) for name, _, kept in (line.partition(" ") for line in _listed("slow.txt"))}
"""Numbers of cases that run always, spread over those not marked as slow, by ids of tests without their cases."""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not import files without quick tests if only those are wanted."""
    if config.option.markexpr != "quick" or collection_path.suffix != ".py":
        return None
    path = collection_path.relative_to(ROOT).as_posix() if collection_path.is_relative_to(ROOT) else ""
    return None if any(path.startswith(listed.partition("::")[0]) for listed in QUICK) else True


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their markers
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that open a page in a browser, and those of the lists of slow and of quick ones."""
    cases: dict[str, list[pytest.Item]] = {name: [] for name in SLOW}
    for item in items:
        cases.get(item.nodeid.partition("[")[0], []).append(item)
    for name, every in cases.items():
        own = [case for case in every if not case.get_closest_marker("slow")]
        kept = {len(own) * k // SLOW[name] for k in range(SLOW[name])}
        for index, item in enumerate(own):
            if index not in kept:
                item.add_marker("slow")
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker("end_to_end")
        elif item.nodeid.startswith(QUICK) and not {"slow", "end_to_end", "benchmark"} & {
            m.name for m in item.iter_markers()
        }:
            item.add_marker("quick")


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


@pytest.fixture
def no_garbage_collection() -> Iterator[None]:
    """Keep collections, which visit all that earlier tests left in the process, out of times that a test measures."""
    gc.disable()
    yield
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _files_not_synchronized() -> Iterator[None]:
    """Do not wait until files are on the disk: those of tests need not survive a loss of power."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


COMPILING = re.compile(r"mbdkit compiles |\.\.\. compiled in ")
"""Notes on compilation."""


@pytest.fixture
def mbdkit() -> Callable[..., Any]:
    """Run a command in this process; the result has exit_code, stdout and stderr."""

    def invoke(*arguments: str, stdin: str | bytes | None = None) -> Any:
        return CliRunner().invoke(app, list(arguments), input=stdin, prog_name="mbdkit")

    return invoke


@pytest.fixture
def refusal(mbdkit: Callable[..., Any]) -> Callable[..., str]:
    """Run a command that must end with status 2 and one message, and leave no file behind; return the message."""

    def invoke(*arguments: str, stdin: str | None = None) -> str:
        before = sorted(os.listdir())
        result = mbdkit(*arguments, stdin=stdin)
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        assert "Traceback" not in result.stderr
        assert sorted(os.listdir()) == before
        told = result.stderr.splitlines()
        # with an empty cache, the notes on compilation come before
        first, *more = told[next((i for i, line in enumerate(told) if not COMPILING.match(line)), 0) :]
        assert first.startswith("error: ")
        assert all(line.startswith("  ") for line in more)
        return str(first.removeprefix("error: "))

    return invoke


@pytest.fixture
def mbdkit_process() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run a command in a process of its own."""

    def invoke(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
        command: Sequence[str] = [sys.executable, "-m", "mbdkit", *arguments]
        return subprocess.run(
            command, capture_output=True, text=True, check=False, env=os.environ | {"COLUMNS": "80"}, **options
        )

    return invoke
