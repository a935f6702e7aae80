"""Studies that an executor computes: the same results, lost workers, workers that cannot compute, and wrong options."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.studies.stored_studies import index_hash
from tests.studies.study_of_executors import BASE
from threadpoolctl import threadpool_info, threadpool_limits
from typer.testing import CliRunner

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.base.terminal import command_line, executing
from mbdkit.cli import app
from mbdkit_studies.compute import executor_pool, executors, worker
from mbdkit_studies.compute.executor_pool import Pool
from mbdkit_studies.compute.executors import SubmititExecutor
from mbdkit_studies.compute.tasks import Task
from mbdkit_studies.folder.owned_folder import JOBS


def pendulums(**options: Any) -> mbdkit.Study:
    """Return an ensemble of twelve double pendulums in four blocks."""
    return mbdkit.ensemble(BASE, {"model.angles.0": np.linspace(-1.0, 1.0, 12)}, block=3, **options)


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Study:
    """The ensemble, run by one process of this machine."""
    return pendulums(out=tmp_path_factory.mktemp("executors") / "local")


class Here(Executor):
    """Computes at once, in this process, unless `trouble` raises an exception for a call, counted from 1."""

    def __init__(self, trouble: Callable[[int], None] = lambda call: None):
        self.calls, self.trouble = 0, trouble

    def submit(self, function: Any, /, *arguments: Any, **options: Any) -> Future[Any]:
        self.calls += 1
        future: Future[Any] = Future()
        try:
            self.trouble(self.calls)
            future.set_result(function(*arguments, **options))
        except Exception as error:
            future.set_exception(error)
        return future


class LostError(Exception):
    """What an executor raises for a task whose worker is gone."""


def losing(*calls: int) -> Here:
    """Return an executor that loses the workers of some calls."""

    def trouble(call: int) -> None:
        if call in calls:
            raise LostError("the worker is gone")

    return Here(trouble)


def test_threads_give_the_index_of_local_processes(blocks, finished, small, tmp_path):
    with ThreadPoolExecutor(2) as executor:
        study = pendulums(out=tmp_path / "blocks", executor=executor)
        files = mbdkit.study(small, out=tmp_path / "files", executor=executor)
    assert (study.computed, files.computed) == (12, 5)
    assert index_hash(study.folder) == index_hash(blocks.folder)
    assert index_hash(files.folder) == index_hash(finished.folder)


def test_a_lost_worker_costs_its_task_one_retry(blocks, tmp_path):
    executor = losing(2)
    study = pendulums(out=tmp_path / "s", executor=executor)
    assert executor.calls == 5
    assert (study.status, study.unfinished) == ("complete", ())
    assert index_hash(study.folder) == index_hash(blocks.folder)


def test_a_run_that_is_lost_twice_has_failed_and_is_tried_again_by_the_next_call(finished, small, tmp_path):
    study = mbdkit.study(small, out=tmp_path / "s", executor=losing(3, 6))
    (failed,) = study.failures
    assert failed.reason.startswith("worker-died: two processes that computed it died; the second one was lost by")
    assert failed.reason.endswith("LostError: the worker is gone.")
    assert study.unfinished == (failed.reason,)
    assert mbdkit.study(small, out=tmp_path / "s", executor=Here()).computed == 1
    assert index_hash(study.folder) == index_hash(finished.folder)


def test_processes_of_this_machine_complete_what_a_broken_executor_has_not(blocks, tmp_path):
    def trouble(call: int) -> None:
        if call > 2:
            raise BrokenExecutor("a process of the pool is gone")

    said: list[str] = []
    study = pendulums(out=tmp_path / "s", executor=Here(trouble), notify=said.append)
    assert study.status == "complete"
    why = "BrokenExecutor: a process of the pool is gone"
    assert said == [f"the executor failed, and processes on this machine compute the rest ({why})"]
    assert index_hash(study.folder) == index_hash(blocks.folder)


def test_runs_of_a_dask_cluster_without_scheduler_are_missing_and_computed_by_the_next_call(
    blocks, monkeypatch, tmp_path
):
    class Lost(Here):
        """Never ends the third call and those that follow, as a client that has lost its scheduler."""

        def submit(self, function: Any, /, *arguments: Any, **options: Any) -> Future[Any]:
            if self.calls < 2:
                return super().submit(function, *arguments, **options)
            self._client = SimpleNamespace(status="closed")
            return Future()

    monkeypatch.setattr(executor_pool, "LOOK", 0.01)
    study = pendulums(out=tmp_path / "s", executor=Lost())
    reason = "no-resources: the connection to the Dask scheduler is lost."
    assert {point.reason for point in study.points if point.status == "missing"} == {reason}
    assert sum(point.status == "complete" for point in study.points) == 6
    assert set(study.unfinished) == {reason}
    assert pendulums(out=tmp_path / "s").computed == 6
    assert index_hash(tmp_path / "s") == index_hash(blocks.folder)


def test_runs_that_an_executor_cancels_are_missing_and_not_taken_for_deaths_of_workers(blocks, tmp_path):
    class Cancelling(Here):
        """Cancels the third call and those that follow, as Dask does when its scheduler is killed."""

        def submit(self, function: Any, /, *arguments: Any, **options: Any) -> Future[Any]:
            if self.calls < 2:
                return super().submit(function, *arguments, **options)
            future: Future[Any] = Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            return future

    study = pendulums(out=tmp_path / "s", executor=Cancelling())
    assert set(study.unfinished) == {"no-resources: the executor cancelled tasks; is its scheduler running?"}
    assert not study.failures
    assert pendulums(out=tmp_path / "s").computed == 6
    assert index_hash(tmp_path / "s") == index_hash(blocks.folder)


def test_an_executor_that_is_shut_down_computes_nothing_and_its_refusal_is_told(tmp_path):
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    study = pendulums(out=tmp_path / "s", executor=executor)
    assert set(study.statuses()) == {"missing"}
    assert study.unfinished[0].startswith("no-resources: the executor refuses tasks: RuntimeError: cannot schedule new")


def test_a_worker_records_the_command_of_the_study_and_none_of_its_own(tmp_path):
    with executing(["mbdkit", "study", "pendulums.yaml"]):
        of_command = Task("run", {}, tmp_path / "run.h5").message()
    of_python = Task("run", {}, tmp_path / "run.h5").message()

    def carry(task, notify):
        return {"status": "complete", "reason": command_line()}

    with executing(["another", "command"]):
        answers = worker.compute([of_command, of_python], mbdkit.__version__, carry)
    assert [answer["reason"] for answer in answers] == ["mbdkit study pendulums.yaml", ""]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda task: task | {"path": "/nowhere/runs/block-000000.h5"}, "cannot access the folder /nowhere/runs;"),
        (lambda task: task | {"version": "0.0.1"}, "the study needs 0.0.1; install the same version there"),
    ],
)
def test_a_worker_that_cannot_compute_says_why(change, words, monkeypatch, tmp_path):
    compute = worker.compute

    def elsewhere(tasks: list[dict[str, Any]], version: str) -> list[dict[str, Any]]:
        changed = [change(task) for task in tasks]
        return compute(changed, changed[0].get("version", version))

    monkeypatch.setattr(worker, "compute", elsewhere)
    study = pendulums(out=tmp_path / "s", executor=Here())
    assert set(study.statuses()) == {"missing"}
    assert words in study.unfinished[0]


def test_a_block_that_this_machine_does_not_see_is_missing(monkeypatch, tmp_path):
    monkeypatch.setattr(worker, "_work", lambda task, notify: {"status": "complete", "reason": ""})
    study = pendulums(out=tmp_path / "s", executor=Here())
    assert set(study.statuses()) == {"missing"}
    assert "has written block-000000.h5, which is not in the folder of the study here" in study.unfinished[0]


def test_a_worker_without_mbdkit_is_told(tmp_path):
    def trouble(call: int) -> None:
        raise ModuleNotFoundError("No module named 'mbdkit'")

    study = pendulums(out=tmp_path / "s", executor=Here(trouble))
    assert "a worker of the executor cannot begin: ModuleNotFoundError: No module named 'mbdkit'" in study.unfinished[0]


def test_an_interrupt_cancels_what_is_not_begun(blocks, monkeypatch, tmp_path):
    begun: list[Future[Any]] = []

    class Waiting(Here):
        def submit(self, function: Any, /, *arguments: Any, **options: Any) -> Future[Any]:
            future = super().submit(function, *arguments, **options) if not begun else Future()
            begun.append(future)
            return future

    work = Pool.work

    def interrupted(self: Any, tasks: Any) -> Any:
        yield next(work(self, tasks))
        raise KeyboardInterrupt

    monkeypatch.setattr(Pool, "work", interrupted)
    with pytest.raises(KeyboardInterrupt):
        pendulums(out=tmp_path / "s", executor=Waiting())
    monkeypatch.undo()
    assert [future.cancelled() for future in begun] == [False, True, True, True]
    assert mbdkit.load_study(tmp_path / "s").statuses().count("complete") == 3
    assert pendulums(out=tmp_path / "s", executor=Here()).computed == 9
    assert index_hash(tmp_path / "s") == index_hash(blocks.folder)


def test_linear_algebra_has_one_thread_as_in_local_processes(monkeypatch, tmp_path):
    threads: list[int] = []

    def noting(task: Any, notify: Any) -> Any:
        threads.extend(pool["num_threads"] for pool in threadpool_info())
        return {"status": "missing", "reason": "no-resources: none."}

    monkeypatch.setattr(worker, "_work", noting)
    with threadpool_limits(2):
        pendulums(out=tmp_path / "s", executor=Here())
    assert set(threads) == {1}


class Job:
    """A job of submitit that is done when it is first looked at, or is lost."""

    def __init__(self, value: Any, is_lost: bool):
        self.value, self.is_lost = value, is_lost

    def done(self) -> bool:
        return True

    def exception(self) -> Exception | None:
        return LostError("the job was killed") if self.is_lost else None

    def result(self) -> Any:
        return self.value


class Jobs:
    """An executor with the methods of submitit's that are used; the first job is lost in its second block."""

    def __init__(self) -> None:
        self.arrays: list[list[int]] = []

    def map_array(self, function: Any, *columns: Any) -> list[Job]:
        calls = list(zip(*columns, strict=True))
        self.arrays.append([len(messages) for messages, *_ in calls])
        is_first = len(self.arrays) == 1
        return [self._job(function, *call, is_lost=is_first and not place) for place, call in enumerate(calls)]

    def _job(self, function: Any, messages: Any, *rest: Any, is_lost: bool) -> Job:
        return Job(function(messages[:1] if is_lost else messages, *rest), is_lost)


def test_jobs_are_submitted_as_an_array_and_lost_ones_again(blocks, tmp_path):
    jobs = Jobs()
    study = pendulums(out=tmp_path / "s", executor=SubmititExecutor(lambda: jobs, jobs=1))
    assert jobs.arrays == [[4], [1, 3]]  # the block at which the job was lost, and the others
    assert index_hash(study.folder) == index_hash(blocks.folder)
    assert pendulums(out=tmp_path / "t", executor=Jobs()).status == "complete"


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put commands of a Slurm without accounting on the path; the file that is returned is its queue of jobs."""
    pytest.importorskip("submitit")
    commands, queue = tmp_path / "commands", tmp_path / "queue"
    commands.mkdir()
    for name, code in {
        "sbatch": f"printf '7_0\\n7_1\\n' > {queue}; echo Submitted batch job 7",
        "squeue": f"cat {queue}",
        "sacct": "echo Slurm accounting storage is disabled >&2; exit 1",
        "scancel": "true",
        "srun": "true",
    }.items():
        (commands / name).write_text(f"#!/bin/sh\n{code}\n")
        (commands / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(commands), prepend=os.pathsep)
    monkeypatch.setattr(executors, "INTERVAL", 0.01)
    monkeypatch.setattr(executors, "QUEUE_INTERVAL", 0.05)
    return queue


def test_a_job_that_slurm_without_accounting_no_longer_lists_is_lost(slurm, tmp_path):
    notes: list[str] = []
    with executors.opened("submitit", 2, tmp_path, notes.append, scheduler="slurm") as executor:
        killed, running = executor.submit_all(abs, [-1, -2])
        with pytest.raises(TimeoutError):
            killed.result(0.5)
        slurm.write_text("7_1\n")
        with pytest.raises(RuntimeError, match="Slurm has ended the job 7_0, which has left no result"):
            killed.result(10.0)
        assert not running.done()
        slurm.write_text("")
        assert running.exception(10.0) is not None
    assert notes == [f"some jobs were lost; their logs are in {next(tmp_path.glob(f'{JOBS}*'))}"]


def test_what_is_no_executor_is_refused(tmp_path):
    with pytest.raises(SpecError, match=r"executor: needs a concurrent\.futures\.Executor"):
        pendulums(out=tmp_path / "s", executor=2)
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--executor dask --scheduler x://y", "no Dask scheduler answers at x://y"),
        ("--executor dask --scheduler tcp://127.0.0.1:9 --workers 2", "--workers cannot be combined with --scheduler"),
        ("--executor submitit --scheduler there", "--scheduler is slurm or local, not there"),
        ("--executor submitit --scheduler local --slurm time", "needs an option of sbatch as K=V"),
        ("--executor submitit --scheduler local --slurm time=1:00", "needs a whole number of minutes"),
        ("--executor submitit", "the command sbatch is not found"),
        ("--scheduler tcp://127.0.0.1:9", "--scheduler is for --executor dask or submitit"),
        ("--slurm time=60", "--slurm is for --executor submitit"),
    ],
)
def test_options_that_do_not_fit_are_refused(options, words, monkeypatch, tmp_path):
    pytest.importorskip("distributed")
    pytest.importorskip("submitit")
    monkeypatch.setenv("PATH", str(tmp_path))
    result = CliRunner().invoke(app, ["study", "paper", "-o", str(tmp_path / "s"), *options.split()])
    assert result.exit_code == 2
    assert words in result.stderr
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(("name", "package"), [("dask", "distributed"), ("submitit", "submitit")])
def test_a_package_that_is_not_installed_is_named_with_its_extra(name, package, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, package, None)
    scheduler = ["--scheduler", "tcp://127.0.0.1:9"] if name == "dask" else []
    command = ["study", "paper", "-o", str(Path(tmp_path) / "s"), "--executor", name, *scheduler]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 2
    assert f"needs the package {package}, which is not installed: pip install 'mbdkit[{name}]'" in result.stderr
