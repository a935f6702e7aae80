"""Goals and limits of a design at points of its variables."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np

from mbdkit.archive.finished_run import FinishedRun
from mbdkit.archive.run import Run
from mbdkit.archive.run_contents import ArrayContents
from mbdkit.base.errors import MbdkitError, ResourceError, SpecError
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.base.plain_data import Path, path_text, plain
from mbdkit.engine.linear_systems import product
from mbdkit.measures.take import SpecMeasure
from mbdkit.spec.reading import parse_key, variable_path
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.study_measures import DefinedMeasure
from mbdkit.spec.varied_specs import VariedSpecs
from mbdkit_biomech.inverse_dynamics.results.inverse_run import compute_run
from mbdkit_biomech.inverse_dynamics.results.measure_samples import SampledMeasures, sampled_measures
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec, varied_inverse
from mbdkit_design.design_spec import DesignSpec
from mbdkit_studies import Batches

Settings = Sequence[tuple[Path, object]]


@dataclass(frozen=True)
class Outcome:
    """Results of a scenario for given values of the variables.

    Attributes
    ----------
    values
        Goals and limits in their order; nan if the run failed.
    verdict
        Verdict on the run, or ``failed``.
    reason
        Reason why the run failed or is judged doubtful or bad; empty otherwise.
    errors
        Estimated errors of the values; nan where unknown, empty if errors are not estimated.
    """

    values: tuple[float, ...]
    verdict: str
    reason: str = ""
    errors: tuple[float, ...] = ()


@dataclass(frozen=True)
class Job:
    """A scenario to run with values of some of its keys.

    Parameters
    ----------
    scenario
        Name of the scenario.
    settings
        Key paths and values.
    """

    scenario: str
    settings: Settings

    @cached_property
    def values(self) -> dict[str, object]:
        """The values by key."""
        return {path_text(path): value for path, value in self.settings}

    @cached_property
    def key(self) -> str:
        """Text that identifies the job."""
        return json.dumps([self.scenario, self.values])


#: Function that returns the outcome of each job, computed or stored.
Source = Callable[[Sequence[Job]], list[Outcome]]


class ScenarioRuns:
    """The runs of one scenario.

    Parameters
    ----------
    spec
        Spec of the scenario, whose measures are the goals and limits.
    """

    def __init__(self, spec: RunSpec | InverseSpec):
        self.spec = spec
        assert spec._document is not None
        self._varied = VariedSpecs(json.dumps(plain(spec._document.data)))
        self._batches = Batches()

    def at(self, settings: Settings) -> RunSpec | InverseSpec:
        """Return the spec with these values.

        Raises
        ------
        SpecError
            If the spec is not valid.
        """
        if isinstance(self.spec, RunSpec):
            spec = self._varied.spec(settings)
            spec.mechanism()
            return spec
        return varied_inverse(self.spec, settings)

    def outcomes(self, points: Sequence[Settings]) -> list[Outcome]:
        """Return the outcomes of the scenario at some points; forward runs are vectorized if possible.

        Raises
        ------
        ResourceError
            If a resource, such as memory, is not available.
        """
        found: list[Outcome | None] = [None] * len(points)
        runs: dict[int, RunSpec] = {}
        for place, settings in enumerate(points):
            try:
                spec = self.at([*settings, *self._cheaper])
                if isinstance(spec, RunSpec):
                    runs[place] = spec
                else:
                    with one_thread_of_linear_algebra(), compute_run(spec) as run:
                        values = tuple(run.measures[measure.name] for measure in self._measures)
                        found[place] = _judged(values, run.verdict, run.verdict_reasons)
            except ResourceError:
                raise
            except MbdkitError as error:
                found[place] = self._failed(str(error))
        for (place, spec), result in zip(runs.items(), self._batches.simulate(runs.values()), strict=True):
            if not isinstance(result, FinishedRun) or result.status != "complete":
                if result.status == "missing":
                    raise ResourceError(result.reason)
                found[place] = self._failed(result.reason)
                continue
            stored = Run(ArrayContents(result, spec))
            measures = [SpecMeasure(measure, spec) for measure in self._measures]
            values = tuple(measure.take(stored) for measure in measures)
            errors = tuple(m.error(value, stored) for m, value in zip(measures, values, strict=True) if spec.check)
            found[place] = replace(_judged(values, result.judgement.level, result.judgement.reasons), errors=errors)
        return [one for one in found if one is not None]

    def sampled(self, settings: Settings) -> SampledMeasures | None:
        """Return goals and limits of inverse dynamics with samples that show their errors.

        The result is None for forward runs, and if the errors are unknown.
        """
        spec = self.at(settings)
        if isinstance(spec, RunSpec):
            return None
        with one_thread_of_linear_algebra():
            try:
                return sampled_measures(spec, [measure.name for measure in self._measures])
            except ResourceError:
                raise
            except MbdkitError:
                return None

    @property
    def _cheaper(self) -> Settings:
        """Settings that omit the error bars of inverse dynamics during a search, because error bars take ten times as
        long.
        """
        return [] if self.spec.spec_kind.is_integrated else [(("motion", "errors"), "none")]

    @cached_property
    def _measures(self) -> tuple[DefinedMeasure, ...]:
        return self.spec.defined_measures()

    def _failed(self, reason: str) -> Outcome:
        return Outcome((np.nan,) * len(self._measures), "failed", reason)


def _judged(values: tuple[float, ...], verdict: str, reasons: Sequence[str]) -> Outcome:
    """Return the outcome of a complete run, with the first reason if the run is judged doubtful or bad."""
    finite = tuple(value if np.isfinite(value) else np.nan for value in values)
    return Outcome(finite, verdict, reasons[0] if reasons and verdict in ("doubtful", "bad") else "")


def in_this_process(scenarios: Mapping[str, ScenarioRuns]) -> Source:
    """Return a source that computes each job in this process."""

    def source(jobs: Sequence[Job]) -> list[Outcome]:
        found: dict[str, Outcome] = {}
        for name, runs in scenarios.items():
            own = [job for job in jobs if job.scenario == name]
            found |= zip((job.key for job in own), runs.outcomes([job.settings for job in own]), strict=True)
        return [found[job.key] for job in jobs]

    return source


class Evaluator:
    """Evaluates a design at points of its variables.

    A coordinate of a point is 0 at the lower bound of a variable, and 1 at the upper bound.

    Parameters
    ----------
    spec
        The design.
    source
        Source of outcomes; by default, they are computed in this process.
    compared
        Name of the settings in `compare` of the design; by default, the settings of the design itself.

    Attributes
    ----------
    names
        Names of the goals, then of the limits.
    scenarios
        The runs of each scenario.
    runs, failures
        Number of runs so far, and number of failed runs.
    gradients
        Number of points so far at which exact derivatives were computed.
    least
        Smallest value of the first goal so far at a point that satisfies all limits; nan if there is none.
    why_differences
        Reason why derivatives are computed by differences of runs; empty as long as they are exact.

    Raises
    ------
    SpecError
        If an expression of a goal or limit is not valid for one of the scenarios.
    """

    def __init__(self, spec: DesignSpec, source: Source | None = None, compared: str = ""):
        self.spec, self.runs, self.failures, self.gradients, self.why_differences = spec, 0, 0, 0, ""
        self.least = np.nan
        self.names = tuple(measure.name for measure in spec.defined_measures())
        specs = spec.compared_specs[compared] if compared else spec.specs
        self.scenarios = tuple(ScenarioRuns(one) for one in specs.values())
        changes = spec.compare[compared] if compared else {}
        self._changes = [(parse_key(key), value) for key, value in changes.items()]
        here = dict(zip(spec.specs, self.scenarios, strict=True))
        self.source = in_this_process(here) if source is None else source
        self._known: dict[bytes, tuple[Outcome, ...]] = {}
        for name, one in spec.specs.items():
            for measure in spec.defined_measures():
                try:
                    SpecMeasure(measure, one).describe()
                except SpecError as error:
                    told = f"{error.message} (scenario '{name}')" if name else error.message
                    raise spec.placed(SpecError(told, key=path_text(measure.place))) from None

    @property
    def widths(self) -> np.ndarray:
        """Widths (n,) of the bounds of the variables."""
        return np.array([variable.width for variable in self.spec.chosen.values()])

    @property
    def first(self) -> np.ndarray:
        """Values (n,) of the variables at the start, as shares of the bounds."""
        return self.point({name: variable.first for name, variable in self.spec.chosen.items()})

    def point(self, variables: Mapping[str, float]) -> np.ndarray:
        """Return the point (n,) that corresponds to values of the variables."""
        return np.array([(variables[name] - one.bounds[0]) / one.width for name, one in self.spec.chosen.items()])

    def variables(self, x: np.ndarray) -> dict[str, float]:
        """Return the values of the variables at a point."""
        return {
            name: float(min(max(one.bounds[0] + share * one.width, one.bounds[0]), one.bounds[1]))
            for (name, one), share in zip(self.spec.chosen.items(), x, strict=True)
        }

    def settings(self, x: np.ndarray) -> Settings:
        """Return the key paths of the variables and their values at a point."""
        return [(variable_path(name), value) for name, value in self.variables(x).items()]

    def outcomes(self, points: np.ndarray) -> list[tuple[Outcome, ...]]:
        """Return the outcomes of all scenarios at points (N, n), for each point.

        Points that were evaluated before are not computed again.
        """
        keys = [np.ascontiguousarray(x).tobytes() for x in points]
        new = {key: self.settings(x) for key, x in zip(keys, points, strict=True) if key not in self._known}
        if new:
            jobs = [Job(name, [*one, *self._changes]) for one in new.values() for name in self.spec.specs]
            found = iter(self.run(jobs))
            outcomes = {key: tuple(islice(found, len(self.scenarios))) for key in new}
            self._known |= outcomes
            values = (np.array([one.values for one in outcome]) for outcome in outcomes.values())
            goals = [self.sums(some)[0] for some in values if not self.exceeded(some)]
            self.least = np.fmin.reduce([self.least, *goals])
        return [self._known[key] for key in keys]

    @property
    def evaluated(self) -> list[np.ndarray]:
        """All points (n,) that were evaluated, in order."""
        return [np.frombuffer(key) for key in self._known]

    def exceeded(self, values: np.ndarray) -> tuple[str, ...]:
        """Return the names of the limits that are violated by values of goals and limits (..., K).

        If the value of a limited measure is nan, its limit counts as violated.
        """
        limits = self.spec.subject_to.items()
        return tuple(name for name, limit in limits if not limit.holds(values[..., self.names.index(name)]))

    def run(self, jobs: Sequence[Job]) -> list[Outcome]:
        """Return the outcomes of jobs, and count them."""
        found = self.source(jobs)
        self.runs += len(jobs)
        self.failures += sum(one.verdict == "failed" for one in found)
        return found

    def values(self, points: np.ndarray) -> np.ndarray:
        """Return goals and limits (N, S, K) of S scenarios at points (N, n); nan where a run failed."""
        found = [one.values for outcome in self.outcomes(points) for one in outcome]
        return np.array(found).reshape(len(points), len(self.scenarios), len(self.names))

    @property
    def root_weights(self) -> np.ndarray:
        """Square roots (S,) of the weights of the scenarios."""
        return np.sqrt([situation.weight for situation in self.spec.situations.values()])

    def totals(self, x: np.ndarray) -> np.ndarray:
        """Return the goals (G,) at a point (n,): weighted sums over the scenarios, or their weighted sum of squares."""
        return self.sums(self.values(x[None])[0])

    def sums(self, outcomes: np.ndarray) -> np.ndarray:
        """Return the goals (G,) from values (S, K) of goals and limits in all scenarios; see `totals`."""
        values, weights = outcomes[:, : len(self.spec.goals)], self.root_weights**2
        if self.spec.sums_squares:
            return np.array([np.sum(weights * np.sum(values**2, axis=1))])
        return product(values.T, weights)
