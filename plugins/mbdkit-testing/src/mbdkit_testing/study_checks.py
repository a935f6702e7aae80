"""Checks of a packaged study: its spec expands to valid runs, and its verdict function handles missing runs."""

from __future__ import annotations

import tempfile
from functools import cached_property
from pathlib import Path
from typing import Any

from mbdkit_studies.compute.carry_out import study
from mbdkit_studies.folder.folder_lock import Shard
from mbdkit_studies.points.planned_points import PlannedPoints
from mbdkit_studies.results.judge import judge
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_testing.check import check
from mbdkit_testing.check_result import Result, failed, passed
from mbdkit_testing.item_checks import ItemUnderTest


class StudyUnderTest(ItemUnderTest[Any]):
    """A packaged study under test."""

    @cached_property
    def spec(self) -> StudySpec:
        """The spec of the packaged study, in its short form if it has one."""
        return load_study_spec(self.item.id, quick=callable(getattr(self.plugin, "spec", None)))


@check("study.spec")
def spec(subject: StudyUnderTest) -> Result:
    """The study spec is valid, and so is the first run of each family among the runs that need no further
    distributions.
    """
    points = PlannedPoints(subject.spec)
    first = {point.family: point for point in reversed(points) if not point.lacking}
    for point in first.values():
        point.spec.mechanism()
    return (
        passed(runs=len(points), families=len(first))
        if first
        else failed("none of its runs can be built with the installed distributions")
    )


@check("study.verdict")
def verdict(subject: StudyUnderTest) -> Result:
    """The verdict function handles a study in which only the first run was made, with at most 50 steps."""
    cut = subject.spec.model_dump(mode="json", exclude_unset=True)
    cut["overrides"] = {**cut.get("overrides", {}), "limits.max_steps": 50}
    cut["repeats"] = 1
    count = len(PlannedPoints(load_study_spec(cut)))
    with tempfile.TemporaryDirectory(prefix="mbdkit-study-") as folder:
        tiny = study(cut, out=Path(folder) / "study", shard=Shard(1, 2 * count), notify=lambda text: None)
        result = judge(tiny)
    return passed(claims=len(result.claims), tables=len(result.tables), figures=len(result.figures))


CHECKS = (spec, verdict)
