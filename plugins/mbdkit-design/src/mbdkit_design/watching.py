"""The state of a study or design that another process computes, from the files in its folder."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import counted, listed
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.store import DesignFolder
from mbdkit_studies import storage_in


@dataclass(frozen=True)
class Work:
    """The progress of a study or design.

    Parameters
    ----------
    text
        The progress in words.
    done, total
        Number of runs or blocks that are done, and their total number; the latter is nan for a design, whose end
        depends on its search.
    is_complete
        Whether the result exists, and no process is computing.
    owners
        The processes that compute the study or design, in words.
    """

    text: str
    done: int
    total: float
    is_complete: bool
    owners: tuple[str, ...]

    def line(self, before: Work | None = None, seconds: float = math.nan) -> str:
        """Return the state as one line, with the remaining time, estimated from an earlier state `seconds` ago."""
        parts = [self.text]
        if self.is_complete:
            parts.append("complete")
        elif not self.owners:
            parts.append("no process is computing it; the same command continues it")
        else:
            parts.append(f"computed by {listed(self.owners, 'and')}")
            result = self.done - before.done if before is not None else 0
            if result > 0 and math.isfinite(self.total):
                parts.append(f"about {_duration((self.total - self.done) * seconds / result)} left")
        return "; ".join(parts)


def work_in(folder: Path) -> Work:
    """Return the state of the study or design in a folder.

    Raises
    ------
    SpecError
        If the folder contains neither.
    """
    if (folder / "design.yaml").is_file():
        return _of_design(folder)
    if (folder / "study.yaml").is_file():
        return _of_study(folder)
    raise SpecError("this folder contains no study (study.yaml) and no design (design.yaml)", file=str(folder))


def _of_study(folder: Path) -> Work:
    storage = storage_in(folder)
    done, total, owners = storage.done, storage.count, tuple(storage.folder.owners())
    is_complete = storage.folder.index.is_file() and not owners
    return Work(f"{done} of {counted(total, storage.CONTENT)}", done, total, is_complete, owners)


def _of_design(folder: Path) -> Work:
    paths, spec = DesignFolder(folder), load_design_spec(folder / "design.yaml")
    values = []
    lines = paths.points.read_text("utf-8").splitlines()[1:] if paths.points.is_file() else []
    goal = next(iter(spec.goals))
    for line in lines:
        try:
            result = json.loads(line)["values"]
            is_allowed = all(limit.holds(np.array(result[name], float)) for name, limit in spec.subject_to.items())
            values.append(result[goal] if is_allowed else None)
        except (ValueError, KeyError, TypeError):  # the line is still being written
            continue
    known = [value for value in values if isinstance(value, int | float)]
    which = " within the limits" if spec.subject_to else ""
    least = f", least {goal} of a run{which} {min(known):.4g}" if known else ""
    owners = tuple(paths.owners())
    complete = paths.result.is_file() and not owners  # comparisons and robustness are computed after the result
    return Work(f"{counted(len(values), 'run')}{least}", len(values), math.nan, complete, owners)


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
