"""Measures that are not in the archive of a run and are computed by a second run of the same spec."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.runs.simulation import simulate
from mbdkit.spec import RunSpec
from mbdkit.studies.reversal import reverse

REVERSALS = ("reversibility_defect", "reversibility_velocity_defect")


def second_run(spec: RunSpec, names: Sequence[str], notify: Callable[[str], None]) -> tuple[dict[str, float], str]:
    """Compute measures by a second run.

    Parameters
    ----------
    spec
        Spec of a run that is complete.
    notify
        Called with a message before an operation that takes long.

    Returns
    -------
    dict, str
        The measures by name, nan if they could not be computed, and the reason for that; an empty string if there is
        none.
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
    """Return the largest velocity misalignment of any joint over every step [m/s].

    The run is repeated in memory with every step recorded.

    Parameters
    ----------
    notify
        Called with a message before an operation that takes long.

    Returns
    -------
    float, str
        The measure, nan if the run fails, and the reason for that; an empty string if there is none.
    """
    every_step = json.loads(spec.canonical_json()) | {"output": {"every": 1, "quantities": ["joints"]}}
    try:
        with simulate(RunSpec(**every_step), notify=notify) as run:
            if run.status != "complete":
                return math.nan, run.status_reason
            return float(np.max(run.array("joints/velocity_misalignment"), initial=0.0)), ""
    except MbdkitError as error:  # for example, too many rows for the memory
        return math.nan, f"error: {error}"
