"""Measures: scalar results of each run of a study, computed for many runs at once; nan if undefined for a run."""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from mbdkit.archive.finished_runs import FinishedRuns
from mbdkit.archive.layout import COUNTERS
from mbdkit.archive.named_columns import NotRecordedError
from mbdkit.archive.peak_errors import missed_of_verdict
from mbdkit.archive.run import Run
from mbdkit.archive.run_contents import ArrayContents
from mbdkit.base.errors import MbdkitError
from mbdkit.measures.take import SpecMeasure
from mbdkit.mechanism.size import mechanism_sizes
from mbdkit.quantities.registered_kinds import kind_of_group
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit_report import Trend, trends
from mbdkit_studies.spec import reference_errors
from mbdkit_studies.spec.made_items import MadeItems
from mbdkit_studies.spec.reference_errors import EVERY_ROW, LAST_ROW, METHOD_MULTIPLIER, common_rows, offsets
from mbdkit_studies.spec.study_spec import REFERENCE, SECOND_RUN
from mbdkit_studies.texts import ERROR


class RunGroup:
    """R runs with the same names of bodies, joints and so on, which recorded the same arrays at the same T times.

    Parameters
    ----------
    runs
        The runs, at least one.
    reference
        Reference run, if the group is a single run and has one.
    results
        Results of the runs, if they are in memory.
    """

    def __init__(self, runs: Sequence[Run], reference: Run | None = None, results: FinishedRuns | None = None):
        self.runs, self.reference, self.results = runs, reference, results
        self._arrays: dict[str, np.ndarray] = {}

    @cached_property
    def first(self) -> Run:
        """The first run."""
        return self.runs[0]

    def __len__(self) -> int:
        return len(self.runs)

    @property
    def time(self) -> np.ndarray:
        """(T,) times of the rows [s]."""
        return self.first.time if self.results is None else self.results.arrays["time"][0]

    @cached_property
    def complete(self) -> np.ndarray:
        """(R,) whether a run reached its end."""
        if self.results is not None:
            return np.full(len(self), self.results.status == "complete")
        return np.array([run.status == "complete" for run in self.runs])

    @cached_property
    def trends(self) -> list[Trend]:
        """Trend of the energy balance of each run; raises ValueError if there are too few rows."""
        return trends(self.time, self.array("energy/balance"))

    def records(self, path: str) -> bool:
        """Return whether the runs recorded the array with this path in the layout of archives."""
        if self.results is None:
            return self.first.records(path)
        return any(array.path == path for array in self.results.layout)

    def array(self, path: str) -> np.ndarray:
        """Return the array with this path, stacked for all runs, (R, T, ...)."""
        if path not in self._arrays:
            key = kind_of_group(path.partition("/")[0]).by_path[path].key
            if self.results is not None and key in self.results.arrays:
                return self.results.arrays[key]
            self._arrays[path] = np.stack([run.array(path) for run in self.runs])
        return self._arrays[path]

    def everywhere(self, value: float) -> np.ndarray:
        """Return an array (R,) with the same value for each run."""
        return np.full(len(self), value)


class RunsInMemory(MadeItems[Run]):
    """Runs with their specs, each of which is made when it is needed."""

    def __init__(self, results: FinishedRuns, specs: Sequence[RunSpec]):
        super().__init__(len(results), lambda place: Run(ArrayContents(results.run(place), specs[place])))
        self.results, self.specs = results, specs

    def groups(self) -> Iterator[tuple[list[int], RunGroup]]:
        """Yield groups with the indices of their runs."""
        ends, times = self.results.lengths["time"].tolist(), self.results.arrays["time"]
        alike: dict[bytes, list[int]] = defaultdict(list)
        for index, end in enumerate(ends):
            alike[times[index, :end].tobytes()].append(index)
        for places in alike.values():
            if len(places) == len(self) and ends[0] == times.shape[1]:
                yield places, RunGroup(self, results=self.results)
            else:
                group = self.results.of_places(places)
                yield places, RunGroup(RunsInMemory(group, [self.specs[place] for place in places]), results=group)


@dataclass(frozen=True)
class Description:
    """Unit, in SI, and description of a measure."""

    units: str
    long_name: str


@dataclass(frozen=True)
class Measure(Description):
    """A scalar result of a run.

    Parameters
    ----------
    take
        Function of a group of R runs that returns their values, (R,). The value of a run does not depend on other runs.
    needs
        What the measure needs in addition to the run: `REFERENCE`, or an empty string.
    """

    take: Callable[[RunGroup], np.ndarray]
    needs: str = ""

    def of(self, run: Run, reference: Run | None = None) -> float:
        """Return the value of one run.

        Parameters
        ----------
        reference
            Reference run of `run`, if it has one.
        """
        return float(self.take(RunGroup([run], reference))[0])


def _one_by_one(take: Callable[[Run, Run | None], float]) -> Callable[[RunGroup], np.ndarray]:
    """Return a function for `Measure.take` that calls `take` with each run of a group and its reference run or None."""
    return lambda group: np.array([take(run, group.reference) for run in group.runs])


def _largest_of(values: np.ndarray) -> np.ndarray:
    """Return the largest value of each run, (R,), from values (R, ...); 0 for runs without values."""
    return np.asarray(np.max(values.reshape(len(values), -1), axis=1, initial=0.0))


def _recorded(path: str, take: Callable[[np.ndarray], np.ndarray]) -> Callable[[RunGroup], np.ndarray]:
    """Return a function for `Measure.take` of an array (R, T, ...); nan for runs that have not recorded it."""
    return lambda group: take(group.array(path)) if group.records(path) else group.everywhere(math.nan)


def _largest(path: str) -> Callable[[RunGroup], np.ndarray]:
    return _recorded(path, lambda values: _largest_of(np.abs(values)))


def _largest_norm(force: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(_largest_of(force[..., 0] * force[..., 0] + force[..., 1] * force[..., 1])))


def _last(values: np.ndarray) -> np.ndarray:
    return values[:, -1] if values.shape[1] else np.full(len(values), math.nan)


def _largest_value(units: str) -> Callable[[RunGroup], np.ndarray]:
    """Return a function for `Measure.take`: the largest absolute value of the force elements whose unit is `units`.

    The value is 0 if there are no such force elements.
    """

    def take(group: RunGroup) -> np.ndarray:
        try:
            forces = group.first.forces
        except NotRecordedError:
            return group.everywhere(math.nan)
        chosen = [index for index, force in enumerate(forces.values()) if force.units == units]
        return _largest_of(np.abs(group.array("forces/value")[:, :, chosen])) if chosen else group.everywhere(0.0)

    return take


def _compared(take: Callable[[Run, Run], float]) -> Callable[[RunGroup], np.ndarray]:
    """Return a function for `Measure.take` that compares runs with their reference; nan unless both are complete."""

    def of(run: Run, reference: Run | None) -> float:
        is_known = reference is not None and run.status == reference.status == "complete"
        return take(run, reference) if reference is not None and is_known else math.nan

    return _one_by_one(of)


def _error(part: slice, rows: slice) -> Callable[[RunGroup], np.ndarray]:
    """Return a function for `Measure.take`: the largest error of the coordinates `part` of any body.

    The error is the difference from the reference run, in `rows` of the run.
    """

    def take(run: Run, reference: Run) -> float:
        if run.status_reason or reference.status_reason:  # an event ended one of them early: end times may differ
            return math.nan
        return float(np.max(np.linalg.norm(offsets(run, reference, rows)[..., part], axis=-1), initial=0.0))

    return _compared(take)


def _rate_error(part: slice) -> Callable[[RunGroup], np.ndarray]:
    """Return a function for `Measure.take`: the largest error of the velocity components `part` of any body.

    The error is the difference from the reference run, at the times that both runs recorded, without the start.
    """

    def take(run: Run, reference: Run) -> float:
        mine, theirs = common_rows(run, reference)
        if not len(mine):
            return math.nan
        velocity = [which.array("trajectory/velocity") for which in (run, reference)]
        difference = (velocity[0][mine] - velocity[1][theirs])[..., part]
        return float(np.max(np.linalg.norm(difference, axis=-1), initial=0.0))

    return _compared(take)


def _multiplier_error(run: Run, reference: Run) -> float:
    is_recorded = all(which.records("constraints/multiplier") for which in (run, reference))
    return reference_errors.multiplier_error(run, reference) if is_recorded else math.nan


def _own_multipliers(group: RunGroup) -> np.ndarray:
    own = float(group.records(METHOD_MULTIPLIER)) if group.records("constraints/multiplier") else math.nan
    return group.everywhere(own)


def _trend(value: Callable[[Trend], float]) -> Callable[[RunGroup], np.ndarray]:
    """Return a function for `Measure.take`: a value that is based on the trend of the energy balance.

    The value is nan for runs that are not complete or have too few rows.
    """

    def take(group: RunGroup) -> np.ndarray:
        if not group.complete.any() or not group.records("energy/balance"):
            return group.everywhere(math.nan)
        try:
            return np.where(group.complete, [value(trend) for trend in group.trends], math.nan)
        except ValueError:
            return group.everywhere(math.nan)

    return take


def _duration(group: RunGroup) -> np.ndarray:
    return group.everywhere(float(group.time[-1] - group.time[0]) if len(group.time) else math.nan)


def _size(group: RunGroup) -> np.ndarray:
    if not len(group.time):
        return group.everywhere(math.nan)
    if group.results is not None and group.results.sizes is not None:
        return group.results.sizes
    try:
        mechanisms = [run.mechanism for run in group.runs]
    except MbdkitError:  # the file of a run does not hold it
        return group.everywhere(math.nan)
    return mechanism_sizes(mechanisms, group.array("trajectory/position")[:, 0])


_XY, _THETA = slice(0, 2), slice(2, 3)

_AGAINST_REFERENCE: Mapping[str, Callable[[RunGroup], np.ndarray]] = {
    "end_error": _error(_XY, LAST_ROW),
    "end_angle_error": _error(_THETA, LAST_ROW),
    "trajectory_error": _error(_XY, EVERY_ROW),
    "trajectory_angle_error": _error(_THETA, EVERY_ROW),
    "velocity_error": _rate_error(_XY),
    "angular_velocity_error": _rate_error(_THETA),
    "multiplier_error": _compared(_multiplier_error),
}

_TAKE: Mapping[str, Callable[[RunGroup], np.ndarray]] = {
    "misalignment_max": _one_by_one(lambda run, _: run.misalignment_max),
    "velocity_misalignment_max": _largest("joints/velocity_misalignment"),
    "angle_misalignment_max": _largest("joints/angle_misalignment"),
    "energy_balance_max": _largest("energy/balance"),
    "energy_balance_end": _recorded("energy/balance", _last),
    "energy_scale": _largest("energy/kinetic"),
    "reaction_force_max": _recorded("joints/reaction_force", _largest_norm),
    "element_force_max": _largest_value("N"),
    "element_torque_max": _largest_value("N m"),
    "driver_power_max": _largest("joints/driver_power"),
    **_AGAINST_REFERENCE,
    "own_multipliers": _own_multipliers,
    "energy_trend": _trend(lambda trend: trend.slope),
    "energy_trend_error": _trend(lambda trend: trend.error),
    "energy_oscillation": _trend(lambda trend: trend.oscillation),
    "duration": _duration,
    "mechanism_size": _size,
}


def _estimated(name: str) -> Callable[[RunGroup], np.ndarray]:
    """Return a function for `Measure.take`: an attribute of `Accuracy`; nan for a run that was not checked."""
    return _one_by_one(lambda run, _: math.nan if run.accuracy is None else getattr(run.accuracy, name))


def _reaction_error_share(run: Run, reference: Run | None) -> float:
    if run.accuracy is None or not run.records("joints/reaction_force"):
        return math.nan
    force = run.array("joints/reaction_force")
    missed = run.errors.missed("joints.force", run.joint_names, np.linalg.norm(force, axis=2))
    missed = missed_of_verdict(missed, run.joint_names, run.spec.get("measures") or {})
    worst = run.accuracy.figures(run.joint_names, force, missed).worst_joint
    return 0.0 if worst is None else worst.share


_OF_CHECKED_RUNS: Mapping[str, Callable[[RunGroup], np.ndarray]] = {
    "known_until": _estimated("known_until"),
    "reaction_error_share": _one_by_one(_reaction_error_share),
    "position_error_estimate": _estimated("position_error_max"),
    "angle_error_estimate": _estimated("angle_error_max"),
}

with (Path(__file__).parent / "measures.csv").open(encoding="utf-8", newline="") as _file:
    _DESCRIBED = {row["name"]: Description(row["units"], row["long_name"]) for row in csv.DictReader(_file)}

MEASURES: Mapping[str, Measure] = {
    name: Measure(**vars(_DESCRIBED[name]), take=take, needs=REFERENCE if name in _AGAINST_REFERENCE else "")
    for name, take in _TAKE.items()
}

#: Measures of runs whose spec has ``check: true``, in addition to those that the study requests.
OF_CHECKED_RUNS: Mapping[str, Measure] = {
    name: Measure(**vars(_DESCRIBED[name]), take=take) for name, take in _OF_CHECKED_RUNS.items()
}

#: Measures that need a second run: units and description.
SECOND: Mapping[str, Description] = {
    name: text for name, text in _DESCRIBED.items() if name not in (*MEASURES, *OF_CHECKED_RUNS)
}


def has_error(measure: DefinedMeasure, spec: RunSpec) -> bool:
    """Return whether a measure of the runs of a spec has an error estimate, which may be nan."""
    return spec.check and measure.item is None and SpecMeasure(measure, spec).is_taken


def other_values(run: Run, spec: RunSpec, defined: Iterable[DefinedMeasure]) -> dict[str, float]:
    """Return those values of a run, by column, that are computed for one run at a time: `defined` measures with their
    errors, and measures of checked runs.
    """
    values: dict[str, float] = {}
    for measure in defined:
        taken = SpecMeasure(measure, spec)
        values[measure.name] = value = taken.take(run)
        if has_error(measure, spec):
            values[measure.name + ERROR] = taken.error(value, run)
    checked = {} if run.accuracy is None else OF_CHECKED_RUNS
    return values | {name: measure.of(run) for name, measure in checked.items()}


def numbers_of(
    run: Run, reference: Run | None, spec: RunSpec, names: Iterable[str], defined: Iterable[DefinedMeasure]
) -> dict[str, float]:
    """Return the numbers of a run, by column: the built-in measures with these names, `other_values`, and counters."""
    group = RunGroup([run], reference)
    values = {name: float(MEASURES[name].take(group)[0]) for name in names}
    counters = {name: float(run.stats.get(name, math.nan)) for name in COUNTERS}
    return values | other_values(run, spec, defined) | counters


def built_in_measures() -> Mapping[str, str]:
    """Return the names of the built-in measures, each with what it needs in addition to the run."""
    return {name: measure.needs for name, measure in MEASURES.items()} | dict.fromkeys(SECOND, SECOND_RUN)


def worst_joint(run: Run) -> str:
    """Return the name of the joint with the largest misalignment over every step; empty if all are zero."""
    joints = sorted(run.joints.values(), key=lambda joint: -joint.misalignment_max)
    return joints[0].name if joints and joints[0].misalignment_max > 0 else ""
