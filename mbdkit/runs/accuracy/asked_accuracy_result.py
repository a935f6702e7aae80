"""Determines whether a checked run reaches the requested accuracy, and the reason if it does not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from mbdkit.archive.accuracy import Accuracy
from mbdkit.base.text import listed
from mbdkit.engine.workspace import Workspace
from mbdkit.runs.accuracy.chosen_method import Candidate, Choice
from mbdkit.runs.accuracy.position_measure import PositionMeasure
from mbdkit.spec import RunSpec
from mbdkit.stepping.interface import Failure

AS_GIVEN = "The spec gives method and step (`choose: nothing`)."
"""Reason given if method and step were chosen before."""


def with_asked(accuracy: Accuracy, spec: RunSpec, workspace: Workspace, choice: Choice | None) -> Accuracy:
    """Return the estimates with the requested accuracy, the one reached, and the choice of method and step.

    Parameters
    ----------
    accuracy
        Estimates of the check.
    spec, workspace
        The run, whose spec gives method and step.
    choice
        How they were chosen; None if the spec gave them.
    """
    if spec.accuracy is None:
        return accuracy
    reached = PositionMeasure.of(spec, workspace).known(accuracy)
    if choice is None:
        given = Candidate.of(spec)
        setting = given.integrator.get("rtol") if given.adaptive else spec.time.step
        chosen = given.name(float(setting)) if setting is not None else str(given.integrator["name"])
    else:
        chosen = choice.chosen
    return replace(
        accuracy,
        asked=spec.accuracy,
        reached=reached,
        chosen=chosen,
        why=AS_GIVEN if choice is None else choice.why,
    )


def missed_because(accuracy: Accuracy, tried: Sequence[Choice], failure: Failure | None = None) -> str:
    """Return the reason why the requested accuracy is not reached, as a clause; empty if it is reached, or if nothing
    was chosen.

    `failure` is the reason why the run ended early, or None.
    """
    if accuracy.is_reached or not tried:
        return ""
    if failure is not None:
        return f"the run ended early: {failure.sentence.rstrip('.')}"
    methods = list(dict.fromkeys(str(choice.candidate.integrator["name"]) for choice in tried))
    limits = [choice.limited for choice in tried if choice.limited]
    attempts = "one attempt" if len(tried) == 1 else f"{len(tried)} attempts with smaller steps"
    why = limits[-1] if limits else f"{attempts} did not suffice"
    if len(methods) > 1:
        why += f"; the best of {listed(methods, 'and')} is returned"
    if not accuracy.is_complete:
        until = "at any time" if math.isnan(accuracy.known_until) else f"after t = {accuracy.known_until:.4g} s"
        return f"no estimate is confirmed {until}, as is the case in chaotic motions, which amplify errors; {why}"
    return why
