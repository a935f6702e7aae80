"""Worker process of a study: reads tasks as JSON lines from standard input, and writes results as JSON lines.

Start it as ``python -m mbdkit.studies.worker``. It exits immediately when its standard input is closed, even during a
task.
"""

from __future__ import annotations

import json
import math
import os
import queue
import sys
import threading
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

from mbdkit.batch import refusal
from mbdkit.errors import SpecError


def main() -> None:
    """Process tasks until standard input is closed."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # keep the output of plugins apart from the results
    tasks: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin, tasks), daemon=True).start()

    def answer(message: dict[str, Any]) -> None:
        answers.write(json.dumps(message) + "\n")
        answers.flush()

    def notify(text: str) -> None:
        answer({"note": text})

    while True:
        answer(_outcome(json.loads(tasks.get()), notify))


def _read(source: IO[str], tasks: queue.SimpleQueue[str]) -> None:
    for line in source:
        tasks.put(line)
    os._exit(0)  # the parent process is gone


def _outcome(task: dict[str, Any], notify: Any) -> dict[str, Any]:
    try:
        return _work(task, notify)
    except SpecError as error:
        if error.file == task["path"]:  # the folder of the study was changed, and the spec is not to blame
            return {"status": "missing", "reason": f"no-resources: {error}"}
        return asdict(refusal(error))
    except (Exception, SystemExit) as error:
        return asdict(refusal(error))


def _work(task: dict[str, Any], notify: Any) -> dict[str, Any]:
    from mbdkit.simulation import simulate
    from mbdkit.spec import RunSpec

    if "block" in task:
        from mbdkit.studies.compute_block import compute_block

        skip = {int(run): reason for run, reason in task["skip"].items()}
        failed = compute_block(task["folder"], task["block"], skip=skip, notify=notify)
        return {"status": "complete", "reason": "", "values": {"failed": failed}}
    spec = RunSpec(**task["spec"])
    if task["second"]:
        from mbdkit.studies.second_run_measures import second_run

        values, note = second_run(spec, task["second"], notify)
        told = {name: value if math.isfinite(value) else None for name, value in values.items()}
        return {"status": "complete", "reason": note, "values": told}
    if task["repeats"] == 0:
        with simulate(spec, path=Path(task["path"]), overwrite=True, notify=notify) as run:
            return {"status": run.status, "reason": run.status_reason}
    seconds = []
    for _ in range(task["repeats"] + 1):
        with simulate(spec, notify=notify) as run:
            seconds.append(float(run.stats["wall_s"]))
    return {"status": "complete", "reason": "", "seconds": seconds[1:]}  # without the warm-up run


if __name__ == "__main__":
    main()
