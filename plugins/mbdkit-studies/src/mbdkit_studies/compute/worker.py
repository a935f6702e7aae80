"""Carries out the tasks of a study, in a worker process of this machine or in one that an executor has started.

``python -m mbdkit_studies.compute.worker`` reads tasks as JSON lines from standard input, and writes results as JSON
lines. It exits immediately when its standard input is closed, even during a task. Executors call `compute`.
"""

from __future__ import annotations

import json
import math
import os
import queue
import signal
import socket
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO

from mbdkit.archive.run import Run
from mbdkit.base.called_functions import calls_allowed
from mbdkit.base.distributions import own_version
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.base.terminal import executing
from mbdkit.base.text import shown
from mbdkit_studies.compute.batch import refusal
from mbdkit_studies.compute.tasks import DIFFERS, Message

#: Function that carries out the task described by a message, and returns the answer.
#:
#: Its second argument is a function that passes notes to the user.
Carry = Callable[[Message, Callable[[str], None]], Message]


def main(carry: Carry | None = None) -> None:
    """Carry out tasks by `carry`, by default those of studies, until standard input is closed."""
    carry = carry or _work
    if hasattr(signal, "SIGBREAK"):  # Ctrl-Break reaches all processes of a console of Windows
        signal.signal(signal.SIGBREAK, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # keep the output of plugins apart from the results
    tasks: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin, tasks), daemon=True).start()

    def answer(message: Message) -> None:
        answers.write(json.dumps(message) + "\n")
        answers.flush()

    def notify(text: str) -> None:
        answer({"note": text})

    while True:
        answer(_outcome(json.loads(tasks.get()), notify, carry))


def _read(source: IO[str], tasks: queue.SimpleQueue[str]) -> None:
    for line in source:
        tasks.put(line)
    os._exit(0)  # the parent process is gone


#: Lock held while tasks are computed, because threads of one process would compete for the interpreter and share its
#: state.
_ONE_AT_A_TIME = threading.Lock()


def compute(tasks: Sequence[Message], of_version: str, carry: Carry | None = None) -> list[Message]:
    """Carry out tasks in a process that an executor has started, possibly on another machine.

    Parameters
    ----------
    tasks
        Messages of the tasks, see `mbdkit_studies.compute.tasks`.
    of_version
        The version of mbdkit with which the study is computed; workers with other versions refuse tasks.
    carry
        Function that carries out a task; by default, a task of a study.

    Returns
    -------
    list
        Answer to each task, in the form that worker processes use, with the notes of the task and the name of this
        machine.
    """
    with _ONE_AT_A_TIME, one_thread_of_linear_algebra():
        return [_answered(task, of_version, carry or _work) for task in tasks]


def _answered(task: Message, of_version: str, carry: Carry) -> Message:
    notes: list[str] = []
    host = socket.gethostname()
    if own_version() != of_version:
        why = f"{host} has mbdkit {own_version()}, the study needs {of_version}; install the same version there."
    elif not Path(task["path"]).parent.is_dir():
        folder = shown(Path(task["path"]).parent)
        why = f"{host} cannot access the folder {folder}; it must be on a file system that all workers share."
    else:
        return _outcome(task, notes.append, carry) | {"notes": notes, "host": host}
    return {"status": "missing", "reason": f"no-resources: {why}", "notes": notes, "host": host}


def _outcome(task: Message, notify: Callable[[str], None], carry: Carry) -> Message:
    try:
        with executing(task["command"]), calls_allowed(task["call"]):
            return carry(task, notify)
    except SpecError as error:
        if error.file == task["path"]:  # the folder of the study was changed, so the spec is not the cause
            return {"status": "missing", "reason": f"no-resources: {error}"}
        return asdict(refusal(error))
    except OSError as error:  # which names no file if reading or writing an open one has failed
        where = shown(error.filename or task["path"])
        return {"status": "missing", "reason": f"no-resources: {where}: {error.strerror or error}"}
    except (Exception, SystemExit) as error:
        return asdict(refusal(error))


def _work(task: Message, notify: Callable[[str], None]) -> Message:
    from mbdkit.runs.simulation import simulate
    from mbdkit.spec.run_spec import RunSpec

    if "block" in task:
        from mbdkit_studies.compute.compute_block import compute_block
        from mbdkit_studies.compute.varied_runs import DifferenceError

        skip = {int(run): reason for run, reason in task["skip"].items()}
        try:
            failed = compute_block(task["folder"], task["block"], skip=skip, notify=notify)
        except DifferenceError as error:
            return {"status": DIFFERS, "reason": str(error)}
        return {"status": "complete", "reason": "", "values": {"failed": failed}}
    spec = RunSpec(**json.loads(task["spec"]))
    if "second" in task:
        from mbdkit_studies.spec.second_run_measures import second_run

        values, note = second_run(spec, task["second"])
        told = {name: value if math.isfinite(value) else None for name, value in values.items()}
        return {"status": "complete", "reason": note, "values": told}
    if "timing" in task:
        for _ in range(1 if task["timing"] else 2):  # the very first run is for warm-up
            with simulate(spec) as run:
                answer = {"status": "complete", "reason": "", "seconds": [float(run.stats["wall_s"])]}
        return answer
    path, measures = Path(task["path"]), task["measures"]
    with _continued(path, measures) or simulate(spec, path=path, overwrite=True, measures=measures) as run:
        for warning in run.warnings:
            notify(f"warning: {warning}")
        return {"status": run.status, "reason": run.status_reason}


def _continued(path: Path, measures: Sequence[str]) -> Run | None:
    """Continue the run that an interrupted call has left; return None if there is none that can be continued."""
    from mbdkit.archive.part_file import checkpoint_path, part_path
    from mbdkit.runs.resuming import continue_run

    part = part_path(path)
    if not checkpoint_path(part).is_file():
        return None
    try:
        return continue_run(part, overwrite=True, measures=measures, files=True)
    except MbdkitError:  # such as another version of mbdkit; the run is made anew
        return None


if __name__ == "__main__":
    main()
