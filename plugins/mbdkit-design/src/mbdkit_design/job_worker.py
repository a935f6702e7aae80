"""Carries out the tasks of designs, in a worker process of this machine or in one that an executor has started."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path

from mbdkit.spec.reading import Document
from mbdkit_design.computing import plain_outcome
from mbdkit_design.design_loading import spec_class
from mbdkit_design.evaluation import ScenarioRuns
from mbdkit_studies import Message
from mbdkit_studies.compute import worker


def main() -> None:
    """Process tasks until standard input is closed."""
    worker.main(_carry)


def compute(tasks: Sequence[Message], of_version: str) -> list[Message]:
    """Carry out tasks in a process that an executor has started; see `mbdkit_studies.compute.worker.compute`."""
    return worker.compute(tasks, of_version, _carry)


def _carry(task: Message, notify: Callable[[str], None]) -> Message:
    runs = _scenario(json.dumps(task["spec"]), task["folder"])
    points = [[(tuple(path), value) for path, value in settings] for settings in task["settings"]]
    return {"status": "complete", "reason": "", "results": [*map(plain_outcome, runs.outcomes(points))]}


@lru_cache(maxsize=16)
def _scenario(text: str, folder: str) -> ScenarioRuns:
    """Return the runs of a scenario; cached, so that further points need less preparation."""
    data = json.loads(text)
    spec = spec_class(data)(**data)
    spec._document = Document(data, folder=Path(folder))
    return ScenarioRuns(spec)


if __name__ == "__main__":
    main()
