"""The plan of a study: its points, its different runs, and its measures, all checked before the first run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mbdkit.measures.take import Description
from mbdkit.spec import RunSpec
from mbdkit.spec.study_spec import StudySpec
from mbdkit.studies.column_names import check_column_names
from mbdkit.studies.defined_measures import describe_measures
from mbdkit.studies.planned_points import PlannedPoint, distinct_runs, plan_points
from mbdkit.studies.verdict_lookup import check_verdict


@dataclass(frozen=True)
class StudyPlan:
    """What a study will compute.

    Parameters
    ----------
    points
        Points in the order of the study, those that are left out included.
    runs
        Specs of the different runs by run id, references first.
    defined
        Units and descriptions of the measures that the study defines.
    """

    points: tuple[PlannedPoint, ...]
    runs: Mapping[str, RunSpec]
    defined: Mapping[str, Description]


def plan_study(spec: StudySpec) -> StudyPlan:
    """Return the plan of a study; the specs of all runs are validated, and their mechanisms are built.

    Raises
    ------
    SpecError
        If the study, one of its runs or one of its measures is invalid.
    """
    check_verdict(spec)
    check_column_names(spec)
    points = plan_points(spec)
    runs, references = {}, {}
    for point in points:
        if point.lacking:
            continue
        runs[point.run_id] = point.spec
        if point.reference is not None:
            references[point.reference_id] = point.reference
    return StudyPlan(points, references | runs, describe_measures(spec, distinct_runs(points)))
