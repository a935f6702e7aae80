"""Measures that the archive of a run does not hold, and that a second run of the same spec tells."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence

import numpy as np

from mbdkit.errors import MbdkitError
from mbdkit.simulation import simulate
from mbdkit.spec import RunSpec
from mbdkit.studies.reversal import reverse

REVERSALS = ("reversibility_defect", "reversibility_velocity_defect")


def second_run(spec: RunSpec, names: Sequence[str], notify: Callable[[str], None]) -> tuple[dict[str, float], str]:
    """Return measures of a run that is complete, each nan where there is none, and why there is none.

    Parameters
    ----------
    spec
        The run.
    names
        The measures wanted.
    notify
        Told what takes long.
    """
    values: dict[str, float] = {}
    notes = []
    if set(names) & set(REVERSALS):
        found = reverse(spec, notify)
        values |= dict(zip(REVERSALS, (found.defect, found.velocity_defect), strict=True))
        notes.append(found.note)
    if "velocity_misalignment_every_step" in names:
        values["velocity_misalignment_every_step"], note = velocity_misalignment(spec, notify)
        notes.append(note)
    return {name: values[name] for name in names}, " ".join(filter(None, notes))


def velocity_misalignment(spec: RunSpec, notify: Callable[[str], None]) -> tuple[float, str]:
    """Return the largest velocity misalignment of any joint over every step [m/s], and why there is none.

    The run is made once more in memory, every step of it recorded.

    Parameters
    ----------
    spec
        The run.
    notify
        Told what takes long.
    """
    every_step = json.loads(spec.canonical_json()) | {"output": {"every": 1, "quantities": ["joints"]}}
    try:
        with simulate(RunSpec(**every_step), notify=notify) as run:
            if run.status != "complete":
                return math.nan, run.status_reason
            return float(np.max(run.array("joints/velocity_misalignment"), initial=0.0)), ""
    except MbdkitError as error:  # too many rows for the memory
        return math.nan, f"error: {error}"
