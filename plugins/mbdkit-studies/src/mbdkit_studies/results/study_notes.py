"""Notes on the answer of a study: which runs it is based on, its intervals, and bad, doubtful and failed runs."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

import numpy as np

from mbdkit.archive.headlines import MESH_ERROR
from mbdkit.base.distributions import MBDKIT
from mbdkit.base.terminal import for_shell
from mbdkit.base.text import counted, listed
from mbdkit.runs.method_evidence import evidence_of
from mbdkit_studies.statistics.sample_statistics import CONFIDENCE
from mbdkit_studies.store.study_index import BETWEEN_REASONS, STATUSES
from mbdkit_studies.store.study_point import StudyPoint, valid_specs
from mbdkit_studies.study import Study
from mbdkit_studies.texts import ERROR, without_numbers

_CODE = re.compile(r"[a-z-]+(?=: )")  #: Code at the beginning of the reason for a failure.

MOST_REASONS = 5  #: Largest number of different reasons that are printed for failures, and for each verdict.

MOST_SPECS = 200  #: Number of runs whose methods are looked at; studies may have many thousands.

MOST_RUNS = 6  #: Largest number of runs with the same reason whose numbers are printed.


def notes(study: Study) -> list[tuple[str, str]]:
    """Return pairs of a label and a sentence on the runs of a study, beside its headlines."""
    return [*_use(study), *_evidence(study), *_levels(study), *_failures(study), *_commands(study)]


def _use(study: Study) -> Iterator[tuple[str, str]]:
    """Yield notes on the runs that the answers are based on, on intervals, and on errors of the runs."""
    if not (defined := [measure.name for measure in study.spec.defined_measures()]):
        return
    is_bad = _rated(study, "bad")
    states = Counter("bad" if bad else status for bad, status in zip(is_bad, study.statuses(), strict=True))
    left = [f"{states[name]} {name.replace('-', ' ')}" for name in ("bad", *STATUSES[1:]) if states[name]]
    if left:
        runs = counted(len(study.points), "run")
        yield (
            "based on",
            f"{states['complete']} of {runs}, without {listed(left, 'and')}; these may differ systematically",
        )
    if study.spec.is_sampled:
        if (sample := study.spec.sample) is None:
            how = "they hold if the members were drawn at random and independently"
        elif sample.method == "random":
            how = f"from {sample.n} independent members"
        else:
            how = f"as if the {sample.n} members were drawn at random: with {sample.method}, they are usually too wide"
        yield "intervals", f"{100 * CONFIDENCE:g} % confidence, {how}"
    if any(name + ERROR in study.columns() for name in defined):
        if (first := next(valid_specs(study.points), None)) is not None and first.mechanism().beams:
            yield "errors", f"those of the runs do not include {MESH_ERROR}"
    elif "unknown" in study.verdicts():
        advice = "--set check=true, with another folder (-o), estimates those of the runs"
        yield "errors", f"not estimated; {advice}, which takes 4 to 15 times as long, or more"


def _evidence(study: Study) -> Iterator[tuple[str, str]]:
    """Yield what is known of the verification of the methods of other distributions in the first runs."""
    specs = islice(valid_specs(study.points), MOST_SPECS)
    chosen = [(spec.integrator_item, spec.integrator) for spec in specs if spec.choose != "method"]
    others = [(item.id, evidence_of(item, one)) for item, one in chosen if item.origin.distribution != MBDKIT]
    yield from (("evidence", f"{name}: {evidence}") for name, evidence in dict.fromkeys(others))


def _rated(study: Study, level: str) -> np.ndarray:
    """Return which runs (N,) are complete and have this verdict."""
    columns = study.columns()
    verdict, status = (np.asarray(columns[name], object) for name in ("verdict", "status"))
    return np.asarray((verdict == level) & (status == "complete"))


def _levels(study: Study) -> Iterator[tuple[str, str]]:
    """Yield the reasons why complete runs are rated bad or doubtful, and how many runs have each reason."""
    reasons = np.asarray(study.columns()["verdict_reasons"], object)
    has_answers = any(True for _ in study.spec.defined_measures())
    for level, use in (("bad", ", not used in answers"), ("doubtful", ", used in answers")):
        places = np.flatnonzero(_rated(study, level))
        found = [(place, one) for place in places.tolist() for one in str(reasons[place]).split(BETWEEN_REASONS)]
        for numbers, reason in _grouped(study.points, found):
            yield level, f"{numbers}{use if has_answers else ''}{reason}"


def _failures(study: Study) -> Iterator[tuple[str, str]]:
    """Yield the reasons why runs and reference runs failed, and how many runs have each reason."""
    columns = study.columns()
    status, reasons = (np.asarray(columns[name], object) for name in ("status", "status_reason"))
    references = [reference for reference in study.references if reference.status == "failed"]
    for points, found in (
        (study.points, [(place, str(reasons[place])) for place in np.flatnonzero(status == "failed").tolist()]),
        (references, [(place, one.reason) for place, one in enumerate(references)]),
    ):
        yield from (("failed", f"{numbers}{reason}") for numbers, reason in _grouped(points, found))


def _commands(study: Study) -> Iterator[tuple[str, str]]:
    """Yield the command that lists all runs with their reasons, if any are bad, doubtful or failed."""
    if "failed" in study.statuses() or {"bad", "doubtful"} & {*study.verdicts()}:
        yield "all runs", for_shell(["mbdkit", "archive", "export", str(study.folder), "--to", "csv"])


def _grouped(points: Sequence[StudyPoint], reasons: Iterable[tuple[int, str]]) -> Iterator[tuple[str, str]]:
    """Yield the runs of each group of reasons, and the first of these reasons with the values of its run. The largest
    groups come first; small groups are only counted.

    The reasons of a group have the same code or, without a code, differ only in numbers.

    Parameters
    ----------
    reasons
        Index of a run among the points, and a reason.
    """
    groups: dict[str, list[tuple[int, str]]] = {}
    for place, reason in reasons:
        code = _CODE.match(reason)
        groups.setdefault(code[0] if code else without_numbers(reason), []).append((place, reason))
    ordered = sorted(groups.values(), key=lambda one: -len({place for place, _ in one}))
    for group in ordered[:MOST_REASONS]:
        first, reason = points[group[0][0]], group[0][1].rstrip(".")
        kind = "reference" if first.is_reference else "run"
        places = [*dict.fromkeys(place for place, _ in group)]  # a run may have several reasons of one group
        numbers = ", ".join(str(points[place].number) for place in places[:MOST_RUNS])
        values = ", ".join(filter(None, (first.family, *first.label.split("; "))))
        example = ": ".join(filter(None, (f"{kind} {first.number}" if len(places) > 1 else "", values)))
        told = f"; {reason}{f' ({example})' if example else ''}" if reason else ""
        more = ", ..." if len(places) > MOST_RUNS else ""
        yield (f"{counted(len(places), kind)} ({numbers}{more})" if len(places) > 1 else f"{kind} {numbers}"), told
    if len(ordered) > MOST_REASONS:
        others = {place for group in ordered[MOST_REASONS:] for place, _ in group}
        yield f"{counted(len(others), 'run')} for other reasons", ""
