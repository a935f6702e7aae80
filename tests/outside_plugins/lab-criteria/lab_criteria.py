"""Two criteria: runs without gravity, and short records of measured motion, are doubtful."""

from mbdkit.plugin import CriterionItem, Finding, Target, hookimpl
from mbdkit.plugin.runs import data_criterion
from mbdkit.plugin.seams import spec_criterion


@spec_criterion
def weightless(spec, measures):
    if any(spec.mechanism().gravity):
        return []
    return [Finding("weightless", "doubtful", "there is no gravity in this laboratory's run", key="model.gravity")]


@data_criterion
def short(result, bars):
    time = result.motion.time
    if time[-1] - time[0] >= 2.0:
        return []
    return [Finding("short-record", "doubtful", f"the record has {time[-1] - time[0]:.3g} s only", key="motion")]


@hookimpl
def mbdkit_items():
    here = "lab_criteria"
    return [
        CriterionItem(
            name="weightless", summary="Runs without gravity.", stage="spec", find=Target(f"{here}:weightless")
        ),
        CriterionItem(
            name="short-record",
            summary="Records that are too short.",
            stage="data",
            find=Target(f"{here}:short"),
            of=frozenset({"inverse"}),
        ),
    ]
