"""The executors that a command can select: Dask, and jobs of submitit as a `concurrent.futures.Executor`."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import shutil
import subprocess
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any

from mbdkit.base.errors import SpecError
from mbdkit.base.text import counted, one_line, shown
from mbdkit_studies.folder.owned_folder import JOBS

MOST_JOBS = 100  #: Default of the largest number of jobs into which the tasks of a study are divided.

MOST_THREADS = 10_000  #: Largest number of jobs that are awaited at the same time.

INTERVAL = 0.5  #: Interval at which the jobs are checked [s].

PATIENCE = 10.0  #: Time to wait for cancelled jobs to end [s].

QUEUE_INTERVAL = 5.0  #: Interval at which Slurm is asked for its jobs where it has no accounting [s].


class SlurmQueue:
    """The jobs of this user that Slurm has not ended, as `squeue` lists them.

    submitit learns the states of jobs from `sacct`, which knows none where Slurm has no accounting, as is its default.
    """

    def __init__(self) -> None:
        self._answers: deque[frozenset[str]] = deque(maxlen=2)
        self._asked = -math.inf
        self._lock = threading.Lock()

    def forget(self) -> None:
        """Discard the answers, which do not list the jobs that are submitted later."""
        self._answers.clear()

    def lacks(self, job: str) -> bool:
        """Return whether the last two answers do not list a job: its result may need a moment to become visible."""
        with self._lock:
            if time.monotonic() - self._asked >= QUEUE_INTERVAL:
                self._asked = time.monotonic()
                command = ["squeue", "--noheader", "--array", "--format=%i", f"--user={os.getuid()}"]
                with contextlib.suppress(OSError, subprocess.SubprocessError):  # Slurm does not answer
                    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=TIMEOUT)
                    self._answers.append(frozenset(done.stdout.split()))
            return len(self._answers) == 2 and not any(job in answer for answer in self._answers)


class SubmititExecutor(ThreadPoolExecutor):
    """Jobs of a scheduler such as Slurm; a thread waits for each of them.

    Parameters
    ----------
    begin
        Function that returns the executor of submitit; called when the first job is submitted.
    jobs
        Largest number of jobs into which tasks are divided.
    """

    def __init__(self, begin: Callable[[], Any], jobs: int = MOST_JOBS):
        super().__init__(MOST_THREADS)
        self.jobs = jobs
        self.has_lost = False  # whether a job has ended without a result
        self._begin = begin
        self._executor: Any = None
        self._queue = SlurmQueue()
        self._is_ending = False

    def submit_all(self, function: Callable[..., Any], values: Sequence[object], *rest: object) -> list[Future[Any]]:
        """Submit jobs that call ``function(value, *rest)``, one for each value, as one array of jobs."""
        if self._executor is None:
            self._executor = self._begin()
        jobs = self._executor.map_array(function, values, *([value] * len(values) for value in rest))
        self._queue.forget()
        return [self.submit(self._result, job) for job in jobs]

    def _result(self, job: Any) -> Any:
        """Return the result of a job after waiting for it, or cancel it if this executor is shut down."""
        try:
            while not job.done():
                if self._is_lost(job):
                    raise RuntimeError(f"Slurm has ended the job {job.job_id}, which has left no result")
                if self._is_ending:
                    self._cancel(job)
                    raise CancelledError
                time.sleep(INTERVAL)
            if (error := job.exception()) is not None:
                raise error
            return job.result()
        except CancelledError:
            raise
        except Exception:  # of the job, or for example because a file of submitit cannot be read
            self.has_lost = True
            raise

    def _is_lost(self, job: Any) -> bool:
        """Return whether a job, whose state Slurm does not know, has ended without a result."""
        return not job.done() and job.state == "UNKNOWN" and self._queue.lacks(job.job_id)

    def _cancel(self, job: Any) -> None:
        """Cancel a job, and wait until it ends, for at most `PATIENCE`."""
        job.cancel(check=False)
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until and not (job.done() or self._is_lost(job)):
            time.sleep(INTERVAL / 5)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Cancel the jobs if `cancel_futures`, and wait until they end if `wait`."""
        self._is_ending = cancel_futures
        super().shutdown(wait)


TIMEOUT = 10  #: Time for a Dask scheduler to answer [s].

MINUTES = 60  #: Time limit of a job unless `time` is given [min].

#: Options of submitit that are lists: commands before and after the job, and arguments of srun.
_LISTS = ("setup", "teardown", "srun_args")

_FLAGS = {"true": True, "false": False}


def _check(executor: str, workers: int | None, scheduler: str | None, slurm: Sequence[str]) -> None:
    """Raise SpecError if options are inconsistent."""
    if slurm and executor != "submitit":
        raise SpecError("--slurm is for --executor submitit")
    if scheduler is not None and executor == "local":
        raise SpecError("--scheduler is for --executor dask or submitit")
    if executor == "dask" and scheduler and workers is not None:
        raise SpecError(
            "--workers cannot be combined with --scheduler and --executor dask: start the workers by `dask worker`"
        )
    if executor == "submitit" and scheduler not in (None, "slurm", "local"):
        raise SpecError(f"with submitit, --scheduler is slurm or local, not {shown(scheduler)}")


def opened(
    name: str,
    workers: int | None,
    folder: Path,
    notify: Callable[[str], None],
    *,
    scheduler: str | None = None,
    slurm: Sequence[str] = (),
) -> contextlib.AbstractContextManager[Executor | None]:
    """Return a context with the requested executor, which closes it, or with None for processes on this machine.

    Parameters
    ----------
    name
        ``local``, ``dask`` or ``submitit``.
    workers
        Number of processes, or of jobs; None for the default.
    folder
        Folder of the study.
    notify
        Called with messages, such as one before the study waits for workers, and the location of the logs of lost jobs.
    scheduler, slurm
        See the options of `mbdkit study`.

    Raises
    ------
    SpecError
        If options are inconsistent, a package is not installed, no Dask scheduler answers, or there is no Slurm on this
        machine.
    """
    _check(name, workers, scheduler, slurm)
    if name == "dask":
        return _dask(scheduler, workers, notify)
    if name == "submitit":
        return _submitit(scheduler or "slurm", slurm, workers, folder, notify)
    return contextlib.nullcontext()


def _package(name: str, extra: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise SpecError(
            f"--executor {extra} needs the package {name}, which is not installed: pip install 'mbdkit[{extra}]'"
        ) from error


@contextlib.contextmanager
def _dask(scheduler: str | None, workers: int | None, notify: Callable[[str], None]) -> Iterator[Executor]:
    distributed = _package("distributed", "dask")
    with contextlib.ExitStack() as stack:
        if not scheduler:
            count = workers or os.cpu_count() or 1
            local = distributed.LocalCluster(
                count, 1, host="127.0.0.1", dashboard_address=None, silence_logs=logging.ERROR
            )
            scheduler = str(stack.enter_context(local).scheduler_address)
            notify(f"without --scheduler, Dask runs on this machine, with {counted(count, 'worker')}")
        place = {"scheduler_file": scheduler} if Path(scheduler).is_file() else {"address": scheduler}
        try:
            if "address" in place:  # if the address is wrong, creating a client would print a traceback
                distributed.comm.resolve_address(scheduler)
            client = distributed.Client(**place, timeout=TIMEOUT, set_as_default=False)
        except Exception as error:  # a scheduler of another version, or another server, may answer
            raise SpecError(
                f"no Dask scheduler answers at {shown(scheduler)} ({one_line(error)}); start one by `dask scheduler`"
            ) from error
        stack.enter_context(_without_logs("distributed", "tornado", "asyncio"))
        stack.enter_context(client)  # entered last, so that it is closed before the logs are enabled again
        if not client.scheduler_info()["workers"]:
            notify("the Dask cluster has no workers yet; the study waits for them (`dask worker ADDRESS`)")
        yield client.get_executor(pure=False)


@contextlib.contextmanager
def _without_logs(*packages: str) -> Iterator[None]:
    """Silence the logs of packages, which repeat what the study reports itself, such as the loss of a scheduler."""
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in packages]
    before = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


@contextlib.contextmanager
def _submitit(
    cluster: str, slurm: Sequence[str], workers: int | None, folder: Path, notify: Callable[[str], None]
) -> Iterator[SubmititExecutor]:
    submitit = _package("submitit", "submitit")
    options = _sbatch_options(slurm)
    if cluster == "slurm" and shutil.which("sbatch") is None:
        raise SpecError(
            "there is no Slurm on this machine: the command sbatch is not found; "
            "`--scheduler local` runs the jobs on this machine"
        )
    files: list[Path] = []

    def begin() -> Any:
        files.append(Path(tempfile.mkdtemp(prefix=JOBS, dir=folder)))
        executor = submitit.AutoExecutor(folder=files[0], cluster=cluster)
        known = executor._executor._valid_parameters() if cluster == "slurm" else ()
        more = {name: value for name, value in options.items() if name not in known}
        given = {f"slurm_{name}": value for name, value in options.items() if name in known}
        if more and cluster == "slurm":
            given["slurm_additional_parameters"] = more
        executor.update_parameters(name="mbdkit", timeout_min=MINUTES, **given)
        return executor

    executor = SubmititExecutor(begin, workers or MOST_JOBS)
    try:
        with _without_logs("submitit"):  # which warns of every answer of `sacct` without accounting
            yield executor
    finally:
        executor.shutdown(cancel_futures=True)
        if executor.has_lost:
            notify(f"some jobs were lost; their logs are in {shown(files[0])}")
        else:
            for path in files:
                shutil.rmtree(path, ignore_errors=True)


def _sbatch_options(texts: Sequence[str]) -> dict[str, Any]:
    """Return options of sbatch by name, with the underscores and types that submitit expects."""
    options: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        name = name.strip().lstrip("-").replace("-", "_")
        if not equals or not name.isidentifier() or not value:
            raise SpecError(f"--slurm needs an option of sbatch as K=V, such as time=60, not {shown(text)}")
        if name == "time" and not value.isdecimal():
            raise SpecError(f"--slurm time needs a whole number of minutes, such as time=60, not {shown(value)}")
        if name in _LISTS:
            options[name] = [*options.get(name, ()), value]
        else:
            options[name] = int(value) if value.isdecimal() else _FLAGS.get(value, value)
    return options
