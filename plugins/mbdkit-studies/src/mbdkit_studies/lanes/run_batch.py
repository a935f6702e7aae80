"""Many runs of a prepared spec at once, with the derivatives of their measures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import mbdkit_gradients
from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.plain_data import value_text
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.study_measures import built_in_measures
from mbdkit_studies.compute.carry_out import ensemble
from mbdkit_studies.spec.study_spec import Storing
from mbdkit_studies.study import Study

T = TypeVar("T")

Measures = str | Sequence[str] | Mapping[str, str]


@dataclass(frozen=True)
class RunBatch:
    """Results of N runs of one spec; see `PreparedRun.run_many`.

    Attributes
    ----------
    measures
        (N,) values of each measure in SI units, by name or expression as given; nan where a run has none.
    units
        Their units.
    statuses, verdicts
        Status and verdict of each run; the verdict is empty where a run has failed.
    hashes
        Hash of all arrays of each run (`Run.data_sha256`); empty where a run has failed.
    derivatives
        (N, K) derivatives of each measure with respect to the K parameters asked for, in SI units.
    notes
        Warnings of the runs, and why they take longer than others, each once.
    study
        The study that stores the runs, with their reasons of failure and their counters (`Study.to_frame`).
    """

    measures: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    statuses: Sequence[str]
    verdicts: Sequence[str]
    hashes: Sequence[str]
    derivatives: Mapping[str, np.ndarray]
    notes: tuple[str, ...]
    study: Study

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.statuses)

    def remake(self, index: int) -> Run:
        """Integrate a run again, and return it with all arrays; raise MbdkitError if its hash differs."""
        return self.study.remake(index)

    def __repr__(self) -> str:
        complete = [*self.statuses].count("complete")
        return f"<RunBatch: {len(self)} runs, {complete} complete; measures {', '.join(self.measures)}>"


def batch(
    spec: RunSpec,
    columns: Mapping[str, np.ndarray],
    measures: Measures,
    derivatives: Sequence[str],
    store: Storing,
    out: str | Path | None,
    workers: int,
) -> RunBatch:
    """Return many runs of a spec; `columns` has their values by key."""
    entries: object = "all"
    names = texts = {one.name: one.name for one in spec.defined_measures()}  # columns, and what is differentiated
    if measures != "all":
        entries, names, texts = _entries(spec, measures)
    if derivatives and texts.keys() != names.keys():
        raise SpecError(f"the measure '{min(names.keys() - texts.keys())}' has no derivatives", key="derivatives")
    if derivatives and not texts:
        raise SpecError("built-in measures have no derivatives; give `measures`", key="derivatives")
    of_texts = [*dict.fromkeys(texts.values())]
    gradient_at = mbdkit_gradients.gradients_at(spec, of_texts, derivatives) if derivatives else None
    notes = list[str]()
    executor = _InThisProcess() if workers == 1 else None
    asked: dict[str, Any] = {"measures": entries, "store": store, "out": out, "workers": workers}
    try:
        study = ensemble(spec, columns, executor=executor, notify=notes.append, **asked)
    except SpecError as error:
        place, _, rest = error.key.partition(":")
        if place == "variables":
            raise SpecError(error.message, key=f"parameters:{rest}") from None
        if place.startswith("measures["):  # the names of columns tell the user nothing
            raise SpecError(error.message, key="measures") from None
        raise
    table = study.columns()
    if measures == "all":
        names = {name: name for name in (*built_in_measures(), *texts) if name in table}
    units = {name: study.described(column)[0] for name, column in names.items()}
    statuses = study.statuses()
    slopes = {name: np.full((len(statuses), len(derivatives)), np.nan) for name in (texts if derivatives else ())}
    if gradient_at is not None:
        for run in np.flatnonzero([status == "complete" for status in statuses]).tolist():
            try:
                found = gradient_at({key: values[run].item() for key, values in columns.items()})
            except MbdkitError as error:
                notes.append(f"run {run + 1} has no derivatives: {error}")
                continue
            rows = dict(zip(of_texts, np.where(np.isnan(found.value)[:, None], np.nan, found.jacobian), strict=True))
            for name, text in texts.items():
                slopes[name][run] = rows[text]
    values = {name: table[column].copy() for name, column in names.items()}
    hashes = [*table["data_sha256"]]
    return RunBatch(values, units, statuses, study.verdicts(), hashes, slopes, tuple(dict.fromkeys(notes)), study)


class _InThisProcess(Executor):
    """Calls functions at once: to start a process takes longer than a hundred small runs."""

    def submit(self, function: Callable[..., T], /, *args: object, **options: object) -> Future[T]:
        future = Future[T]()
        try:
            future.set_result(function(*args, **options))
        except Exception as error:
            future.set_exception(error)
        return future


def _entries(spec: RunSpec, measures: Measures) -> tuple[list[object], dict[str, str], dict[str, str]]:
    """Return the key `measures` of a study, in which expressions have names, and the columns of measures and the
    expressions of those that have derivatives.
    """
    known, entries = {one.name for one in spec.defined_measures()}, list[object]()
    names, texts, taken = dict[str, str](), dict[str, str](), {*known}
    given = dict.fromkeys([measures] if isinstance(measures, str) else measures)
    for number, name in enumerate(given, 1):
        if not isinstance(name, str):
            raise SpecError(f"a measure is an expression or a name, not {value_text(name)}", key="measures")
        text = measures[name] if isinstance(measures, Mapping) else name
        names[name] = text
        if text in built_in_measures():
            entries.append(text)
            continue
        texts[name] = text
        if text not in known:  # measures of the spec are computed anyway
            names[name] = next(f"measure{k}" for k in count(number) if f"measure{k}" not in taken)
            taken.add(names[name])
            entries.append({names[name]: text})
    return entries, names, texts
