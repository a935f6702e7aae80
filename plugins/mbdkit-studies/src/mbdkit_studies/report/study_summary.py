"""Summary of a study as plain text, and as values for JSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

from mbdkit.base.plain_data import json_text
from mbdkit.base.text import counted, shown
from mbdkit.trust.criteria import LEVELS
from mbdkit_studies.compute.study_plan import StudyPlan
from mbdkit_studies.points.planned_points import Grid
from mbdkit_studies.report.study_headlines import headlines
from mbdkit_studies.report.worst_cases import worst_cases
from mbdkit_studies.results.study_notes import notes
from mbdkit_studies.spec.sample_section import central_range, unit_of
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_studies.store.study_index import STATUSES
from mbdkit_studies.study import Study


def summary(study: Study) -> str:
    """Return a plain text summary of a study: counts of runs, main results, folder, and failures with their reasons."""
    counts = Counter(study.statuses())
    runs = ", ".join(f"{counts[status]} {status.replace('-', ' ')}" for status in STATUSES if counts[status])
    beside = f"; reference runs: {len(study.references)}" if study.references else ""
    levels = Counter(study.verdicts())
    verdicts = ", ".join(f"{levels[level]} {level}" for level in LEVELS if levels[level])
    verdicts += " (failed runs are rated bad)" if counts["failed"] and levels["bad"] else ""
    lines = [
        ("study", " ".join(study.spec.title.split())),
        ("runs", f"{len(study.points)}: {runs}{beside}; numbered from 1, as in study.run(number=1)"),
        ("verdicts", verdicts + (" (of runs by themselves, without the reference)" if study.references else "")),
        *_answer(study),
        ("computed", f"{study.computed} now" if study.computed else "nothing now"),
        ("folder", str(study.folder)),
    ]
    text = [f"{label:<10} {shown(value)}" for label, value in lines if value]
    absent = Counter(point.reason for point in study.points if point.status == "left-out") if counts["left-out"] else {}
    text += [f"left out   {count} of {len(study.points)}: {shown(reason)}" for reason, count in absent.items()]
    text += [f"{label:<10} {shown(note)}" for label, note in notes(study)]
    text += [
        f"unfinished {counted(count, 'time')}: {shown(reason)}"
        for reason, count in Counter(study.unfinished).most_common(5)
    ]
    return "\n".join(text)


def _answer(study: Study) -> Iterator[tuple[str, str]]:
    """Yield the lines of the answer: the parts of the text on each measure, the first with the name of the measure."""
    for number, (name, told) in enumerate(headlines(study)):
        first, *others = told.split("; ")
        yield "" if number else "answer", f"{name}: {first}"
        yield from (("", f"  {part}") for part in others)


def plan_summary(plan: StudyPlan) -> str:
    """Return a plain text summary of a study before it runs: its runs, its axes, and the measures that it defines.

    For a study in blocks, only the specs of the samples of the plan (`StudyPlan.samples`) are validated by this
    function. Other specs are validated when their runs are computed.

    Raises
    ------
    SpecError
        If the spec of a sample is invalid.
    """
    spec = plan.spec
    lines = [("study", " ".join(spec.title.split())), *(_lines_of_blocks(plan) if spec.in_blocks else _lines_of(plan))]
    is_ensemble = spec.sample is None and not spec.tolerances
    lines += [*_grid_lines(plan.points.grids, has_members=is_ensemble), *_sample_lines(spec), *_tolerance_lines(plan)]
    lines += [("measure", f"{name} [{one.units}]: {one.long_name}") for name, one in plan.defined.items()]
    return "\n".join(f"{label:<10} {shown(value)}" for label, value in lines if value)


def _lines_of(plan: StudyPlan) -> Iterator[tuple[str, str]]:
    """Yield lines about the runs of a study with an archive for each."""
    absent = Counter(point.lacking for point in plan.points if point.lacking)
    made = len({point.run_id for point in plan.points if not point.lacking})
    references = len({point.reference_id for point in plan.points if not point.lacking and point.reference_id})
    different = f", {made} of them different" if made != len(plan.points) - absent.total() else ""
    yield "runs", f"{len(plan.points)}{different}{f'; reference runs: {references}' if references else ''}"
    yield from (("left out", f"{count}: the distribution {name} is not installed") for name, count in absent.items())


def _lines_of_blocks(plan: StudyPlan) -> Iterator[tuple[str, str]]:
    """Yield lines about the runs of a study in blocks."""
    checked = [point for point in plan.samples if not point.lacking and point.spec]
    blocks = counted(plan.blocks.count, "block")
    yield "runs", f"{len(plan.points)}, in {blocks}; the specs of {len(checked)} are valid"
    yield "store", str(plan.spec.store)


def _grid_lines(grids: Iterable[Grid], *, has_members: bool) -> Iterator[tuple[str, str]]:
    for grid in grids:
        if grid.name:
            yield "family", grid.name
        for key in grid.table if has_members else ():
            yield "values", f"{_with_unit(key, grid)}: {_few(grid.table[key].tolist())}"
        for axis in grid.axes:
            keys = " with ".join(_with_unit(key, grid) for key, _ in axis)
            yield "axis", f"{keys}: {_few([value.label for value in axis[0][1]])}"


def _with_unit(key: str, grid: Grid) -> str:
    unit = grid.stated_units.get(key, "")
    return f"{key} [{unit}]" if unit else key


def _sample_lines(spec: StudySpec) -> Iterator[tuple[str, str]]:
    if spec.sample is not None:
        sample = spec.sample
        each = f", {sample.runs_of_member} runs each" if sample.runs_of_member > 1 else ""
        yield "sample", f"{counted(sample.n, 'member')}{each}: {sample.method}, seed {sample.seed}"
        for key, given in sample.variables.items():
            (low, high), unit = central_range(given), unit_of(given)
            size = f"{low:.4g} to {high:.4g} {unit.si if unit else ''}".rstrip()
            yield "variable", f"{key}: {json_text(given)} (5 % to 95 %: {size})"
        if (estimated := spec.estimated()) is not None:
            for name, value, row in zip(estimated.names, estimated.values, estimated.factor, strict=True):
                yield "estimate", f"parameters.{name}: {value:.6g}, standard deviation {math.hypot(*row):.2g}"


def _tolerance_lines(plan: StudyPlan) -> Iterator[tuple[str, str]]:
    (grid, *_), tolerances = plan.points.grids, plan.spec.tolerances.values()
    for (key, column), given in zip(grid.table.items() if tolerances else (), tolerances, strict=True):
        yield "tolerance", f"{_with_unit(key, grid)}: {column[0]:.6g}, {given.limits[0]:g} to +{given.limits[1]:g}"


def _few(labels: Sequence[object]) -> str:
    """Return the number of values on an axis, and the first few values."""
    few = ", ".join(str(label) for label in labels[:6])
    return f"{counted(len(labels), 'value')}: {few}{', ...' * (len(labels) > 6)}"


def outcome(study: Study) -> dict[str, object]:
    """Return the results of running a study as values for JSON."""
    counts, levels = Counter(study.statuses()), Counter(study.verdicts())
    return {
        "path": str(study.folder),
        "title": study.spec.title,
        "status": study.status,
        "runs": len(study.points),
        "references": len(study.references),
        "computed": study.computed,
        **{status.replace("-", "_"): counts[status] for status in STATUSES},
        "answers": [{"name": name, "text": told} for name, told in headlines(study)],
        **({"worst_cases": [one.to_dict() for one in worst_cases(study)]} if study.spec.tolerances else {}),
        "notes": [{"about": label, "text": note} for label, note in notes(study)],
        "unfinished": list(study.unfinished),
        "verdicts": {level: levels[level] for level in LEVELS if levels[level]},
        "failures": [
            {
                "number": point.number,
                "reference": point.is_reference,
                "family": point.family,
                "axes": dict(point.axes),
                "run_id": point.run_id,
                "status_reason": point.reason,
            }
            for point in study.failures
        ],
    }
