"""Compares runs of a study with the index, when they are read from their files or computed again."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from mbdkit.archive.layout import COUNTERS
from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.files_read import only_known
from mbdkit.base.text import listed
from mbdkit.measures.take import with_error
from mbdkit.runs.simulation import simulate
from mbdkit.spec.study_measures import expressions_of
from mbdkit_studies.measures import MEASURES, OF_CHECKED_RUNS
from mbdkit_studies.study_point import StudyPoint
from mbdkit_studies.study_spec import StudySpec


def check_stored(run: Run, point: StudyPoint, path: Path) -> None:
    """Check that a stored run is the one that the study plans, and that its data are those in the index.

    Parameters
    ----------
    path
        File of the run, which may have been replaced since the study was indexed.

    Raises
    ------
    SpecError
        If the spec of the run is not that of the point, or if its identifier or data differ from those in the index.
    """
    which = f"the reference run {point.run_id}" if point.is_reference else f"run {point.number}"
    another = run.run_id != point.run_id
    # The plugin of the model may not be installed, and files that the spec names are not read.
    with suppress(MbdkitError), only_known((), allowed=False):
        another = another or run.run_spec.sha256() != point.spec.sha256()
    if another:
        message = f"this file contains another run in place of {which} of the study"
        raise SpecError(f"{message}; move it to another folder, and run `mbdkit study` again", file=path)
    if run.data_sha256 != point.row.data_sha256:
        message = f"the data of {which} are not those that the study has indexed: data_sha256 differs"
        raise SpecError(f"{message}; run `mbdkit study` again to index what is in the folder", file=path)


def remake(study: StudySpec, point: StudyPoint, reference: Run | None, why: str) -> Run:
    """Integrate the run of a point again, and compare it with its row in the index.

    Parameters
    ----------
    reference
        Stored reference run against which errors are computed, if there is one.
    why
        Explanation of possible differences, which is appended to messages.

    Raises
    ------
    MbdkitError
        If data, measures, counters or verdict differ from those in the index.
    """
    run = simulate(point.spec, measures=expressions_of(study.defined_measures()))
    if run.data_sha256 != point.row.data_sha256:
        message = f"run {point.number}, computed again, has other data than the stored run"
        raise MbdkitError(f"{message}{why}")
    differing = [
        name
        for name, value in _numbers(study, point, run, reference)
        if not (value == point.values[name] or (math.isnan(value) and math.isnan(point.values[name])))
    ]
    if run.verdict != (point.verdict or run.verdict):
        differing.append("verdict")
    if differing:
        message = f"run {point.number}, computed again, has the same data, but the index has other values of"
        raise MbdkitError(f"{message} {listed(differing)}{why}")
    return run


def _numbers(study: StudySpec, point: StudyPoint, run: Run, reference: Run | None) -> Iterator[tuple[str, float]]:
    """Yield the numbers in the row of a point that are computed from its run and its reference run."""
    known: Mapping[str, float] = point.values
    for name, measure in (MEASURES if run.accuracy is None else {**MEASURES, **OF_CHECKED_RUNS}).items():
        if name in known and (reference is not None or not measure.needs):
            yield name, measure.of(run, reference)
    for defined in study.defined_measures():
        if defined.name in known:
            yield from with_error(defined, run, run.run_spec).items()
    for name in COUNTERS:
        if name in known and name in run.stats:
            yield name, float(run.stats[name])
