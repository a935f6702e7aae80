"""The next experiment: which of some candidates narrows an interval most."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from mbdkit.plugin import SpecError, path_text
from mbdkit.plugin.studies import PreparedSensitivities
from mbdkit_identify.estimation import Fit, covariance_of
from mbdkit_identify.identification import NextExperiment
from mbdkit_identify.identify_spec import IdentifySpec
from mbdkit_identify.intervals import Goal
from mbdkit_identify.loading import overridden
from mbdkit_identify.measured_data import ExperimentData, SignalData
from mbdkit_identify.problem import Problem
from mbdkit_identify.segments import segments_of

TIMES = 101  #: Number of times at which the interval of a quantity is computed.


class Done(Protocol):
    """What is known after the estimation; see `mbdkit_identify.identify`."""

    spec: IdentifySpec
    problem: Problem
    fit: Fit
    names: list[str]
    data: list[ExperimentData]
    level: float

    def goals(self) -> list[Goal]:
        """Return the parameters and expressions whose intervals are computed."""

    def is_determined(self, slope: np.ndarray) -> bool:
        """Return whether the data determine a goal with these derivatives (n,)."""

    def base_data(self, x: np.ndarray) -> dict[str, Any]:
        """Return the base with unknowns x (n,) as plain data."""


def next_experiment(done: Done) -> NextExperiment:
    """Return the expected intervals after each candidate was added to the experiments.

    The derivatives of the candidate's signals at the estimates are added to those of the experiments. To be narrowed is
    what `narrow` of the spec says, or the first of `intervals.of`, or else the parameter whose interval is widest
    relative to its value.
    """
    goals = [*done.goals(), *_asked(done)]
    known = [goal for goal in goals if done.is_determined(goal.slope(done.fit.x))]
    widths = {"": _widths(done, goals, done.fit.jacobian, done.fit.free)}
    for name in done.spec.candidates:
        widths[name] = _widths(done, goals, *_with_candidate(done, name))
    of = done.spec.intervals.of
    if done.spec.narrow is not None:
        narrows = done.spec.narrow.quantity
    elif of:
        narrows = next(iter(of))
    else:
        relative = {goal.name: widths[""][goal.name] / max(abs(goal.value(done.fit.x)), 1e-300) for goal in known}
        narrows = max(relative, key=relative.__getitem__) if relative else goals[0].name
    best = min(done.spec.candidates, key=lambda name: np.nan_to_num(widths[name][narrows], nan=np.inf))
    return NextExperiment(narrows, widths, best)


def _asked(done: Done) -> list[Goal]:
    """Return what `narrow` of the spec asks for, if it does, as one goal for each time of its run."""
    if (narrow := done.spec.narrow) is None:
        return []
    spec = overridden(done.spec.run_spec, done.base_data(done.fit.x), narrow.overrides, ("narrow",))
    own = [name for name in done.names if name in spec.parameters or name.startswith("model.")]
    times = np.linspace(spec.time.start, spec.time.final, TIMES)
    with SpecError.rekey("narrow.quantity"):
        slopes = PreparedSensitivities(spec, narrow.quantity, times, own).at({}).derivatives[0]
    wide = np.zeros((TIMES, len(done.fit.x)))
    wide[:, [done.names.index(name) for name in own]] = slopes
    return [Goal(narrow.quantity, lambda x: np.nan, lambda x, slope=slope: slope) for slope in wide]  # type: ignore[misc]


def _widths(done: Done, goals: list[Goal], jacobian: np.ndarray, free: np.ndarray) -> dict[str, float]:
    covariance = covariance_of(jacobian, free)
    norms = np.maximum(np.linalg.norm(jacobian[:, free], axis=0), 1e-300)
    _, values, directions = np.linalg.svd(jacobian[:, free] / norms, full_matrices=False)
    lost = directions[values < 1e-7 * values[0]]
    found: dict[str, float] = {}
    for goal in goals:
        slope = np.pad(goal.slope(done.fit.x), (0, jacobian.shape[1] - len(done.fit.x)))
        weighted = slope[free] / norms
        is_lost = np.any(np.abs(lost @ weighted) > 1e-3 * np.linalg.norm(weighted))
        width = np.inf if is_lost else done.level * float(np.sqrt(max(slope @ covariance @ slope, 0.0)))
        found[goal.name] = max(found.get(goal.name, 0.0), width)  # of all times of a quantity
    return found


def _with_candidate(done: Done, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of the whitened residuals with those of a candidate, and which unknowns are free."""
    spec, problem = done.spec, done.problem
    candidate = spec.candidates[name]
    where = path_text(("candidates", name))
    like = candidate.like or done.data[0].name
    data = next((one for one in done.data if one.name == like), None)
    if data is None:
        raise SpecError(f"'{like}' is held out; name an experiment with the role fit", key=f"{where}.like")
    own = spec.model_copy()
    own._base = overridden(spec.run_spec, done.base_data(done.fit.x), candidate.overrides, ("candidates", name))
    time = data.time
    if candidate.duration is not None:
        interval = float(np.median(np.diff(time)))
        time = time[0] + interval * np.arange(max(3, round(candidate.duration / interval) + 1))
    noise_of = {key.quantity: one for key, one in zip(problem.signals, problem.noises, strict=True)}
    sensors = {one.quantity: one.sensor for other in reversed(done.data) for one in other.signals} | spec.sensors
    sensors |= {one.quantity: one.sensor for one in data.signals}
    signals = tuple(
        SignalData(quantity, "", sensors[quantity], np.zeros(len(time)), noise_of[quantity].deviation, False)
        for quantity in candidate.observed or [signal.quantity for signal in data.signals]
    )
    added = replace(data, name=name, time=time, signals=signals)
    extra = Problem(*segments_of(own, [added]))
    names = extra.names
    extra.noises = [noise_of[key.quantity] for key in extra.signals]
    x, columns = extra.first.copy(), [done.names.index(parameter) for parameter in names]
    x[: len(names)] = done.fit.x[columns]  # parameters are the first unknowns
    slopes = extra.white(extra.slopes(x))
    count, fresh = len(done.fit.x), len(x) - len(names)
    wide = np.zeros((len(slopes), count + fresh))
    wide[:, [*columns, *range(count, count + fresh)]] = slopes
    known = np.pad(done.fit.jacobian, ((0, 0), (0, fresh)))
    return np.concatenate([known, wide]), np.concatenate([done.fit.free, np.ones(fresh, dtype=bool)])
