"""The end of every run: its archive or its arrays in memory are finished, and its measures are evaluated."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from operator import methodcaller
from pathlib import Path

import h5py
import numpy as np

from mbdkit.archive import layout
from mbdkit.archive.finished_run import ArrayWriter, FinishedRun
from mbdkit.archive.hdf5 import set_text
from mbdkit.archive.headlines import write_answers
from mbdkit.archive.measured_values import MeasuredValues
from mbdkit.archive.run import Run
from mbdkit.archive.run_contents import ArchiveContents, ArrayContents
from mbdkit.archive.run_writer import Ending, Origin, RunWriter
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base.logs import logger_of
from mbdkit.measures.take import take_all
from mbdkit.quantities.names import ArchiveNames, archive_names
from mbdkit.quantities.states import States
from mbdkit.runs.provenance import provenance
from mbdkit.runs.recorder import shared_forces
from mbdkit.spec import RunSpec
from mbdkit.spec.model_spec import ModelSpec

_LOG = logger_of("mbdkit.runs.simulation")

#: Function that evaluates the measures of a run, which is otherwise complete.
Measured = Callable[[Run], MeasuredValues]


def finish(
    writer: RunWriter, spec: ModelSpec, ending: Ending, *, measured: Measured | None = None, gradients: str = ""
) -> Run:
    """Finish what a writer has recorded, and return the run with its measures.

    - `writer`: the writer, which has all rows.
    - `spec`: spec of the run.
    - `ending`: how the run has ended.
    - `measured`: evaluates the measures; by default, `mbdkit.measures.take.take_all`.
    - `gradients`: gradients of the measures as JSON; empty if there are none.
    """
    if isinstance(writer, ArrayWriter):
        assert isinstance(spec, RunSpec)
        return run_in_memory(writer.finish(ending), spec, writer.created_utc, gradients)
    evaluate = measured or partial(_taken, spec)

    def complete(file: h5py.File) -> None:
        if spec.defined_measures():
            set_text(file, layout.MEASURES, evaluate(Run(file)).to_json())
        if gradients:
            set_text(file, layout.GRADIENTS, gradients)
        if ending.accuracy is not None:
            write_answers(file)

    assert isinstance(writer, ArchiveWriter)
    file = writer.finish(ending, completed=complete)
    return Run(ArchiveContents.just_written(writer) if file is None else file)


def run_in_memory(
    finished: FinishedRun | Callable[[], FinishedRun],
    settings: RunSpec,
    created_utc: str,
    gradients: str = "",
    spec: Callable[[], RunSpec] | None = None,
) -> Run:
    """Return a finished run with its measures.

    - `finished`: the run, or a function that is called when its results are needed.
    - `settings`: spec of the run or, if `spec` is given, of a run that differs in numbers of its model only.
    - `created_utc`: time at which the run began, ISO 8601.
    - `gradients`: gradients of the measures as JSON; empty if there are none.
    - `spec`: function that returns the spec of the run when it is needed.
    """
    contents = partial(
        ArrayContents, finished, settings if spec is None else spec, run_id=methodcaller("run_id"),
        created_utc=created_utc, provenance=provenance,
    )  # fmt: skip
    run = Run(contents())
    return Run(contents(measured=_taken(run.run_spec, run), gradients=gradients)) if settings.measures else run


def _taken(spec: ModelSpec, run: Run) -> MeasuredValues:
    values = take_all(run, spec)
    for name, reason in values.reasons.items():
        _LOG.warning("measure %s: %s", name, reason)
    return values


def finish_states(
    spec: ModelSpec,
    states: States,
    ending: Ending,
    provenance: Mapping[str, str | int | float],
    *,
    path: Path | None = None,
    overwrite: bool = False,
    names: ArchiveNames | None = None,
    rows: Mapping[str, np.ndarray] | None = None,
    optional: Iterable[str] | None = None,
    sizes: np.ndarray | None = None,
    measured: Measured | None = None,
) -> Run:
    """Write a motion that is known as a whole, such as a measured or an optimized one, and return the run.

    - `spec`: spec of the run.
    - `states`: the states at the recorded times, with accelerations and reactions.
    - `ending`: how the computation has ended. Counters that `Ending.stats` lacks are 0.
    - `provenance`: attributes of ``/provenance``; see `mbdkit.runs.provenance.model_provenance`.
    - `path`, `overwrite`: final name of the archive, None for an archive in memory, and whether an existing file may be
      replaced.
    - `names`: names of elements; by default, those of the mechanism.
    - `rows`: values of arrays that are not computed from states, by path; those of groups without elements are left
      out.
    - `optional`: paths of the optional arrays; by default, those of `rows` and of the elements of the mechanism.
    - `sizes`: (T - 1,) steps between the rows [s]; by default 0, for a motion that was not integrated.
    - `measured`: see `finish`.
    """
    mechanism, given, time = states.mechanism, rows or {}, states.time
    names = names or archive_names(mechanism)
    if optional is None:
        optional = (*given, *layout.of_elements(names), *(layout.FRICTION if mechanism.friction else ()))
    extra = {*optional, *(["constraints/singularity_distance"] if mechanism.solved_rows else [])}
    writer = ArchiveWriter(
        path,
        names,
        Origin.of(spec, provenance),
        arrays=layout.recorded_by(names, layout.QUANTITIES, frozenset(extra)),
        overwrite=overwrite,
        shared=shared_forces(mechanism),
    )
    try:
        of_run = {key: values for key, values in given.items() if key in writer.row_keys}
        writer.append(of_run | {key: array.take(states) for key, array in writer.recorded.items()})
        none = np.zeros(len(time) - 1, dtype=np.int64)
        counted = dict.fromkeys(("steps", "iterations", "iterations_max", "rejected"), none)
        sizes = np.zeros(len(none)) if sizes is None else sizes
        writer.append_numbered("steps", {"time": time[1:], "size": sizes, **counted})
        stats = {**dict.fromkeys(layout.COUNTERS, 0), **ending.stats}
        return finish(writer, spec, replace(ending, stats=stats), measured=measured)
    finally:
        writer.abandon()
