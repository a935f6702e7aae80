"""A packaged study with a verdict of its own."""

from itertools import pairwise
from pathlib import Path

import mbdkit


def verdict(study):
    from mbdkit.plugin.reports import Verdict

    complete = [point for point in study.points if point.status == "complete"]
    worst = [point.values["misalignment_max"] for point in complete]
    falls = all(finer < coarser for coarser, finer in pairwise(worst))
    words = "falls" if falls else "does not fall"
    return Verdict("step-ladder", "Steps", f"In {len(complete)} runs the drift {words} with the step.")


@mbdkit.hookimpl
def mbdkit_studies():
    spec = Path(__file__).parent / "step-ladder.yaml"
    return [mbdkit.StudyPlugin("step-ladder", "Drift of a double pendulum by step.", spec, verdict)]
