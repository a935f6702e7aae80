"""What computes the studies of most tests: to start new processes would take most of their time."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from importlib import import_module

import mbdkit
from mbdkit_studies.compute.executor_pool import Pool
from mbdkit_studies.compute.tasks import Outcome, Task


class PoolInThisProcess(Pool):
    """Carries out tasks in this process, one after the other, unless there is another executor."""

    def work(self, tasks: Sequence[Task]) -> Iterator[tuple[Task, Outcome]]:
        if self.engine.executor is not None:
            yield from super().work(tasks)
            return
        for task in tasks:
            message = json.loads(json.dumps(task.message()))
            (answer,) = import_module(self.engine.program).compute([message], mbdkit.__version__)
            for note in answer.pop("notes"):
                self.say(note)
            yield task, Outcome.of(json.loads(json.dumps(answer)))
