"""The report of a study."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit.trust.criteria import LEVELS, MISALIGNMENT
from mbdkit_report import (
    Answer,
    Cell,
    Column,
    Figure,
    NamedPose,
    ReportPage,
    Section,
    Table,
    Verdict,
    View,
    columns_of,
    drawing,
    environment,
    film_of,
    glance,
    key_words,
    methods,
)
from mbdkit_report.figures.quantity_text import count
from mbdkit_report.notebook.result_views import object_view
from mbdkit_report.pages.run_verdict import mechanism_size
from mbdkit_report.seams import report_of_folder
from mbdkit_studies.report.sample_figures import sample_figures, sample_tables
from mbdkit_studies.report.study_figures import measure_columns, study_figures, with_slope_guides
from mbdkit_studies.report.study_headlines import headlines
from mbdkit_studies.report.worst_cases import worst_case_tables
from mbdkit_studies.results.cost_at_error import is_timed
from mbdkit_studies.results.general_verdict import ADDED, added_texts, with_emphasis
from mbdkit_studies.results.judge import find_verdict, judge
from mbdkit_studies.results.point_selection import OPERATIONS, value
from mbdkit_studies.results.study_notes import notes
from mbdkit_studies.statistics.sample_groups import sample_groups
from mbdkit_studies.store.study_point import StudyPoint, axis_unit, point_words, valid_specs
from mbdkit_studies.study import Study

_FILMS = 6
_MEASURES = 4  #: Largest number of measures that the first section names.
_LISTED = 500  #: Largest number of runs of a study with a sample that the page lists.
#: Number of runs, evenly spaced over a study with a sample, whose specs and provenance the page shows. The first run of
#: each sample is added.
_READ = 20
_NUMBERS = 40_000  # approximate number of pose values of each animation
_COLUMNS = (
    (Column("largest misalignment", "m"), "misalignment_max"),
    (Column("energy balance", "J"), "energy_balance_max"),
    (Column("error at the end", "m"), "end_error"),
    (Column("right-side evaluations"), "rhs_evaluations"),
    (Column("Jacobians"), "jacobian_evaluations"),
    (Column("factorizations"), "factorizations"),
)
_TIMED_ONCE = ((Column("wall time, timed once", "s"), "wall_s"),)
_TIMED = (
    (Column("wall time, shortest", "s"), "wall_min_s"),
    (Column("median", "s"), "wall_median_s"),
    (Column("upper quartile", "s"), "wall_q3_s"),
)
#: Entries of the provenance that differ between the runs of a study.
_OF_A_RUN = ("command", "assembly", "model", "integrator")


def study_report(study: Study) -> ReportPage:
    """Return the report of a study, complete or not.

    Raises
    ------
    SpecError
        If the study names an unknown verdict.
    """
    states = Counter(study.statuses())
    verdict = _verdict(study)
    missing = states["missing"] + sum(point.status == "missing" for point in study.references)
    return ReportPage(
        title=" ".join((study.spec.title or study.folder.resolve().name).split()),
        settings=settings(study),
        alarm=f'{count(missing, "run")} missing: the command "mbdkit study" computes them' if missing else "",
        headline=(*added_texts(study), *_claims(verdict), *headlines(study, "±")),
        remarks=tuple(notes(study)),
        remarks_title=_remarks_title(study),
        verdict=verdict,
        beside_verdict=(ADDED,),
        begins_with_verdict=True,
        glance=_glance(study),
        films=tuple(_films(study)),
        failures=_failures(study),
        methods=methods(_specs(study), find_verdict(study.spec)[0].plugin.references if study.spec.verdict else ()),
        environment=_environment(study),
        reproduce=f"Save the spec below as study.yaml. {study.storage.HOW_TO_READ}",
        commands="mbdkit study study.yaml -o again\nmbdkit report again",
        spec=(study.folder / "study.yaml").read_text(encoding="utf-8"),
        spec_file="study.yaml",
    )


@object_view
def study_view(study: Study) -> View:
    """Return the view of a study."""
    title = " ".join(study.spec.title.split()) or study.folder.resolve().name
    answers = [f"{name}: {told}" for name, told in (*headlines(study, "±"), *notes(study))]
    return View(f"Study: {title}", (settings(study), *answers), tables=(runs_table(study),))


def settings(study: Study) -> str:
    """Return the numbers of runs of a study by status and verdict, as one line."""
    states = Counter(study.statuses())
    parts = [count(len(study.points), "run")]
    if len(study.families) > 1:
        parts.append(count(len(study.families), "family", "families"))
    names = [name for name in ("complete", "failed", "left-out") if states[name]]
    pairs = zip(study.verdicts(), study.statuses(), strict=True)
    levels = Counter(level for level, state in pairs if state == "complete")  # failed runs are rated bad, too
    verdicts = [f"{levels[level]:,} {level}" for level in ("doubtful", "bad") if levels[level]]
    return " \u00b7 ".join([*parts, *(f"{states[name]:,} {name.replace('-', ' ')}" for name in names), *verdicts])


def _glance(study: Study) -> Section:
    """Return what was asked, the verdicts on the runs with the first doubt, and the mechanism."""
    spec, levels = study.spec, Counter(study.verdicts())
    names = [measure.name for measure in spec.defined_measures()]
    few = [*names[:_MEASURES], *[f"{len(names) - _MEASURES} more"] * (len(names) > _MEASURES)]
    keys = dict.fromkeys(
        key_words(key) for name in study.families for key in (*study.axes(name), *study.grid(name).table)
    )
    over = "tolerances of" if spec.tolerances else "samples of" if spec.sample is not None else "different"
    asked = f"{listed(few, 'and') if few else 'errors and costs of runs'}, for {over} {listed(list(keys), 'and')}"
    doubts = [text for label, text in notes(study) if label in LEVELS[2:] or label in ("failed", "errors")]
    verdict = ", ".join(f"{levels[level]} {level}" for level in LEVELS if levels[level]) or "no runs"
    if (first := next(valid_specs(study.points), None)) is None:
        return glance(asked, verdict, doubts, None)
    mechanism = first.mechanism()
    pose = np.array([(*body.position, body.angle) for body in mechanism.bodies.values()])
    times = np.array([first.time.start, first.time.final])
    return glance(asked, verdict, doubts, drawing(NamedPose.of(mechanism, list(mechanism.bodies), pose, times)))


def _verdict(study: Study) -> Verdict:
    """Return the verdict of the study with the table of its runs. A study with a sample also has the charts and tables
    of the sample. Other studies have general charts if the verdict has no charts.
    """
    verdict = judge(study)
    figures: tuple[Figure, ...] = tuple(with_slope_guides(figure) for figure in verdict.figures)
    tables = verdict.tables
    if study.spec.tolerances:
        tables = (*tables, *worst_case_tables(study))
    elif study.spec.has_table:
        figures, tables = (*figures, *sample_figures(study)), (*tables, *sample_tables(study))
    else:
        figures = tuple(with_emphasis(figure, study.spec.added) for figure in figures or study_figures(study))
    return replace(verdict, figures=figures, tables=(*tables, runs_table(study)))


def _claims(verdict: Verdict) -> Iterator[tuple[str, str]]:
    """Yield a label and the numbers of claims by answer; nothing without claims."""
    words = {Answer.YES: "hold", Answer.PARTLY: "hold partly", Answer.NO: "do not hold", Answer.OPEN: "are open"}
    if answers := Counter(claim.answer for claim in verdict.claims):
        parts = [f"{answers[answer]} {text}" for answer, text in words.items() if answers[answer]]
        yield "claims", f"of {len(verdict.claims)}, {listed(parts, 'and')}"


def _remarks_title(study: Study) -> str:
    """Return the title of the remarks on single runs, with the numbers of runs that they are about."""
    states, levels = Counter(study.statuses()), Counter(study.verdicts())
    counts = {"bad": levels["bad"] - states["failed"], "doubtful": levels["doubtful"], "failed": states["failed"]}
    named = listed([f"{number:,} {name}" for name, number in counts.items() if number], "and")
    return f"Remarks on {named} runs" if named else "Remarks on the runs"


def _read(study: Study) -> Sequence[StudyPoint]:
    """Return the points whose specs and provenance the page shows: all, or a few of a study with a sample."""
    if not study.spec.has_table:
        return study.points
    first = [group.places[0] for group in sample_groups(study)]
    last = len(study.points) - 1
    return [study.points[place] for place in sorted({*first, *(last * k // (_READ - 1) for k in range(_READ))})]


def runs_table(study: Study) -> Table:
    """Return the table of the runs of a study: their values on the axes, status, verdict, measures and cost. Of a study
    with a sample, only the first runs are listed.
    """
    points = study.points[:_LISTED] if study.spec.has_table else study.points
    units = None
    if study.spec.has_table:
        units = {key: axis_unit(key, points) for key in dict.fromkeys(key for point in points for key in point.axes)}
    usual = [*_COLUMNS, *(_TIMED if is_timed(points) else _TIMED_ONCE)]
    asked = [entry for entry in measure_columns(study) if entry[1] not in {name for _, name in usual}]
    shown = {
        name: column for column, name in (*asked, *usual) if any(not math.isnan(value(point, name)) for point in points)
    }
    rows: list[tuple[Cell, ...]] = []
    for point in points:
        named = point.number, point.family, point_words(point, units), point.status, point.verdict
        rows.append((*named, *(_cell(point, name) for name in shown)))
    columns = (*columns_of("run; family; values; status; verdict"), *shown.values())
    if len(study.families) == 1:
        rows, columns = [(row[0], *row[2:]) for row in rows], (columns[0], *columns[2:])
    if len(points) < len(study.points):
        note = f"The index of the study has all {len(study.points)} runs; `mbdkit.load_study(...).to_frame()` shows it."
        return Table("runs", f"The first {len(points)} runs", columns, tuple(rows), note)
    return Table("runs", "All runs", columns, tuple(rows))


def _cell(point: StudyPoint, name: str) -> Cell:
    result = value(point, name)
    if math.isnan(result):
        return None
    return int(result) if name in OPERATIONS else result


def _failures(study: Study) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (point.number, ": ".join(filter(None, [point.family, point_words(point) or "reference"])), point.reason)
        for point in study.failures[: _LISTED if study.spec.has_table else None]
    ]
    text = f"The first {len(rows)} of {len(study.failures)}." if len(rows) < len(study.failures) else ""
    return Table("failures", "Runs that failed", columns_of("run; member; reason"), tuple(rows), text)


def _films(study: Study) -> Iterable[dict[str, object]]:
    """Yield one animation for each of the first families: of the run with the largest misalignment that is not rated
    bad or, if all are rated bad, of the run with the smallest. Studies with a sample have no animations.
    """
    if study.spec.has_table:
        return
    for name in list(study.families)[:_FILMS]:
        ranked = [point for point in study.family(name) if value(point, "misalignment_max") >= 0 and point.path]
        ranked.sort(key=lambda point: -value(point, "misalignment_max"))
        for point in ranked:
            run = study.run(point)
            assert run is not None
            with run:
                if len(run.time) <= 2:
                    break  # the start and the end are no animation
                if run.misalignment_max <= MISALIGNMENT.bad * mechanism_size(run) or point is ranked[-1]:
                    words = ": ".join(filter(None, [f"run {point.number}", name, point_words(point)]))
                    yield film_of(run, _NUMBERS, words)
                    break


def _specs(study: Study) -> list[dict[str, object]]:
    return [_spec_of(study, point) for point in (*_read(study), *study.references) if point.status != "left-out"]


def _spec_of(study: Study, point: StudyPoint) -> dict[str, object]:
    """Return the canonical spec of a run. If a plugin is not installed, or the spec names a file, which is not read,
    the spec is read from the archive or the block.
    """
    try:
        return dict(json.loads(point.spec.canonical_json()))
    except SpecError:
        if (run := study.run(point)) is None:
            raise
        with run:
            return dict(run.spec)


def _environment(study: Study) -> Table:
    """Return the table of the provenance of the runs that `_read` selects. Each entry lists its distinct values;
    entries that always differ between runs are left out.
    """
    said: dict[str, dict[str, None]] = {}
    points = [*_read(study), *study.references]
    for point in points[:: math.ceil(len(points) / _LISTED)]:  # opening a thousand archives would take a minute
        if (run := study.run(point)) is None:
            continue
        with run:
            for name, found in run.provenance.items():
                if not name.startswith(_OF_A_RUN):
                    said.setdefault(name, {})[str(found)] = None
    return environment({name: listed(found) for name, found in said.items()}, {"study": Path(study.folder).name})


@report_of_folder
@contextmanager
def study_page(folder: Path, workers: int) -> Iterator[ReportPage]:
    """Yield the report of the study in a folder; it is made by one process, so that `workers` has no effect."""
    from mbdkit_studies.compute.carry_out import load_study

    yield study_report(load_study(folder))
