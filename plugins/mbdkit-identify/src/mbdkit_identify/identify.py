"""`identify`: parameters of a model from measured motion, with intervals."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from mbdkit.plugin import MbdkitError, RunError, RunSpec, SpecError, listed
from mbdkit.plugin.equations import one_thread_of_linear_algebra
from mbdkit.plugin.specs import parameter_values, put, variable_path
from mbdkit.plugin.studies import PreparedSensitivities, prepare
from mbdkit_identify.blocks import BLOCKS, growth_by_blocks
from mbdkit_identify.estimation import best_fit, covariance_of, factors, failed, fit_at, fit_some
from mbdkit_identify.identifiability import Identifiability, combinations
from mbdkit_identify.identification import Doubt, Estimate, Identification, Profile, Residuals
from mbdkit_identify.identify_spec import IdentifySpec
from mbdkit_identify.intervals import Goal, interval_of, quantile
from mbdkit_identify.loading import data_of, load_identify_spec, spec_of_base
from mbdkit_identify.measured_data import read_experiment
from mbdkit_identify.misfit import doubts_of, useless
from mbdkit_identify.next_experiment import next_experiment
from mbdkit_identify.noise import Noise
from mbdkit_identify.posterior import posterior
from mbdkit_identify.probes import Probe, probe_sensitivities, probes_of, sensor_derivatives, sensor_probes
from mbdkit_identify.problem import Problem
from mbdkit_identify.segments import Unknown, segments_of, sensor_numbers

EXACT, DIFFERENCES = 1e-9, 1e-6  #: Relative errors of exact derivatives and of central differences.
#: Number of pairs of perturbed inputs by which the bias due to noise of measured inputs is estimated.
PERTURBATIONS = 8
DOUBTED = 7.88  #: Largest reduction of the sum of squares beyond an edge, which noise exceeds with probability 0.005.
FAST = 1e-3  #: Error of a clock whose effect is told.
MATTERS = 0.1  #: A bias is told if it exceeds this share of the standard deviation.


def identify(
    source: object, assignments: Iterable[str] = (), notify: Callable[[str], None] = lambda _: None, **sections: object
) -> Identification:
    """Estimate parameters of a model from measured motion, with intervals.

    Parameters
    ----------
    source
        A file, the name of a packaged identification, a mapping, or an `IdentifySpec`; see `mbdkit guide identify`.
    assignments
        Assignments to keys of the spec, such as ``"starts=8"``.
    notify
        Called with messages on the progress.
    **sections
        Top-level keys of the spec; they replace those in `source`.

    Raises
    ------
    SpecError
        If the spec or the data are not valid, with the key.
    RunError
        If runs fail at the start of the parameters.
    """
    begin = time.process_time()
    with one_thread_of_linear_algebra():
        spec = load_identify_spec(source, assignments, **sections)
        try:
            found = _Identification(spec, notify).result()
        except SpecError as error:
            raise spec.placed(error) from None
        except (np.linalg.LinAlgError, OverflowError) as error:
            raise RunError(
                f"the data cannot be fitted in floating-point numbers ({error}); check their units"
            ) from None

    return replace(found, seconds=time.process_time() - begin)


class _Identification:
    def __init__(self, spec: IdentifySpec, notify: Callable[[str], None]):
        self.spec, self.notify = spec, notify
        data = [read_experiment(spec, name) for name in spec.experiments]
        self.data = [one for one in data if one.experiment.role == "fit"]
        self.held_out = [one for one in data if one.experiment.role == "hold-out"]
        self.problem = Problem(*segments_of(spec, self.data))
        unknowns = self.problem.unknowns
        self.names = [one.name for one in unknowns if not one.is_initial]
        priors = sum(one.prior is not None for one in unknowns)
        if (count := len(self.problem.measured)) + priors <= len(unknowns):
            message = f"{count} measured values cannot determine {len(unknowns)} unknowns and the noise"
            raise SpecError(message, key="experiments")
        self.notes = [note for one in data for note in one.notes]
        self.doubts: list[Doubt] = []

    def result(self) -> Identification:
        """Return the result of all stages."""
        spec, problem = self.spec, self.problem
        self.fit = best_fit(problem, spec.starts, spec.seed, spec.loss, self.notify)
        if failed(self.fit):
            self.doubts.append(Doubt("", "runs fail at the best fit, so that the estimates mean nothing"))
        if not self.fit.is_settled:
            self.notes.append("the noise of the signals has not settled; its correlation may be close to 1")
        every = np.ones(len(self.fit.x), dtype=bool)
        self.plain_covariance = factors(self.fit)[0] * covariance_of(self.fit.jacobian, every)
        self.growth = self._growth()
        self.covariance = self.of_noise = self.plain_covariance * np.outer(self.growth, self.growth)
        if spec.loss != "linear":
            self.notes.append("with a robust loss, effects that the model may lack are not tested")
        self.notify("identifiability")
        self.known = self._identifiability()
        self.level = quantile(spec.intervals.level, max(len(self.fit.white) - np.sum(self.fit.free), 1))
        self._find_edges()
        self.bias = self._integration_bias()
        self._note_input_bias()
        if not spec.kinematic:
            self._note_clock()
        estimates, profiles = self._estimates()
        residuals = [*self._residuals(problem, self.fit.x, self.covariance, is_hold_out=False), *self._held_out()]
        self._check(residuals)
        following = next_experiment(self) if spec.candidates else None
        estimates, covariance = self._described(estimates)
        is_bad = failed(self.fit)
        return Identification(
            spec=data_of(spec),
            base=self.base_data(self.fit.x),
            level=spec.intervals.level,
            estimates=estimates,
            parameters=tuple(self.names),
            covariance=covariance,
            combinations=tuple(one.text for one in self.known.combinations),
            residuals=tuple(residuals),
            profiles=profiles,
            next_experiment=following,
            verdict="bad" if is_bad else "doubtful" if self.doubts else "good",
            doubts=tuple(self.doubts),
            notes=tuple(self.notes),
            cost=self.fit.cost,
            log_likelihood=problem.log_likelihood(problem.white(problem.predicted(self.fit.x) - problem.measured)),
            evaluations=(problem.runs, problem.derived),
            way=problem.differences or "exact",
            title=spec.title or f"Estimates of {listed(self.names, 'and')}",
            unknowns=len(self.fit.x) + sum(known is None for known in problem.known) + sum(problem.may_correlate),
        )

    # ---- what the data determine -----------------------------------------------------------------------------------

    def _identifiability(self) -> Identifiability:
        problem, x, base = self.problem, self.fit.x, None
        with suppress(SpecError):
            base = spec_of_base(self.base_data(x), None)

        def sensitivity(x: np.ndarray) -> np.ndarray:
            return problem.jacobian(np.clip(x, *problem.bounds))

        units = {one.name: one.unit for one in problem.unknowns}
        error = DIFFERENCES if problem.differences else EXACT
        return combinations([*units], x, sensitivity, spec=base, error=error, sizes=problem.sizes, units=units)

    def _find_edges(self) -> None:
        """Bound the parameters where runs fail within their intervals, and note these edges."""
        problem, fit = self.problem, self.fit
        for place in np.flatnonzero(self.known.identifiable[: len(self.names)] & fit.free[: len(self.names)]).tolist():
            along = self.level * self.covariance[place] / max(float(np.sqrt(self.covariance[place, place])), 1e-300)
            for side in (-1.0, 1.0):
                problem.bound_at_edge(fit.x, np.clip(fit.x + side * along, *problem.bounds))
        for place, text in problem.edges.items():
            self.notes.append(f"{text}; this counts as a bound, and intervals end there")
            _, gain = fit.further(fit.free | (np.arange(len(fit.x)) == place))
            if not fit.free[place] and gain > DOUBTED:
                told = (
                    f"{text}, but the data ask for it (statistic {gain:.4g}, limit {DOUBTED:.3g}): the model is wrong"
                )
                self.doubts.append(Doubt(problem.unknowns[place].name, told, (gain, DOUBTED)))

    def _growth(self) -> np.ndarray:
        """Return the factors (n,) by which blocks of the data increase deviations of parameters, and note them."""
        if self.spec.kinematic:
            return np.ones(len(self.fit.x))
        growth = growth_by_blocks(self.problem, self.fit, self.spec.intervals.level)
        if told := [f"{name} by {growth[place]:.2g}" for place, name in enumerate(self.names) if growth[place] > 1.0]:
            told[-1] += f"; they follow from {BLOCKS} blocks of the data"
            self.notes.append(f"residuals are not the noise that is assumed, and intervals grow: {listed(told, 'and')}")
        return growth

    # ---- biases ----------------------------------------------------------------------------------------------------

    def _integration_bias(self) -> np.ndarray:
        """Return the errors (n,) of the estimates that follow from the integration error of the runs."""
        problem, x, jacobian = self.problem, self.fit.x, self.fit.jacobian
        if self.spec.kinematic:
            return np.zeros(len(x))
        finer = [replace(one, spec=_finer(one.spec)) for one in problem.segments]
        other = Problem(problem.unknowns, problem.names, finer)
        other.noises = problem.noises
        change = other.predicted(x) - problem.predicted(x)
        if not np.all(np.isfinite(change)):
            self.notes.append("the integration error of the runs is not known, because runs with finer steps fail")
            return np.zeros(len(x))
        white = problem.white(change)
        bias = np.asarray(-covariance_of(jacobian, self.fit.free) @ (jacobian[: len(white)].T @ white))
        deviation = np.sqrt(np.diagonal(self.covariance))
        for place, name in enumerate(self.names):
            if abs(bias[place]) > max(deviation[place], 1e-12):
                self.doubts.append(
                    Doubt("integration", f"the integration error changes {name} by more than its standard deviation; "
                          "use smaller steps or tolerances in the base")
                )  # fmt: skip
        return bias

    def _note_input_bias(self) -> None:
        """Note the bias of the estimates due to the noise of measured inputs, and add its scatter to their covariance.

        The measured values are perturbed once more by noise of the same size, in pairs of opposite signs, whose mean
        effect is the bias of the first order in the variance (J. R. Cook, L. A. Stefanski, Journal of the American
        Statistical Association 89 (1994) 1314-1328).
        """
        problem, x = self.problem, self.fit.x
        if not any(one.input_deviations for one in self.data):
            return
        dice, shifts = np.random.default_rng(self.spec.seed), []
        for _ in range(PERTURBATIONS):
            noise = [
                {name: dice.normal(0.0, size, len(one.inputs[name][0])) for name, size in one.input_deviations.items()}
                for one in self.data
            ]
            for side in (1.0, -1.0):
                data = []
                for one, own in zip(self.data, noise, strict=True):
                    moved = {name: (one.inputs[name][0], one.inputs[name][1] + side * x) for name, x in own.items()}
                    data.append(replace(one, inputs=one.inputs | moved))
                other = Problem(*segments_of(self.spec, data))
                other.noises = problem.noises
                free, step = self.fit.free, np.zeros(len(x))
                step[free] = np.linalg.lstsq(other.jacobian(x)[:, free], -other.residuals(x), rcond=1e-12)[0]
                shifts.append(step)
        bias = np.mean(shifts, axis=0)
        spread = np.std(np.mean(np.reshape(shifts, (PERTURBATIONS, 2, -1)), axis=1), axis=0) / np.sqrt(PERTURBATIONS)
        # inputs that are noisy move predictions, as noise of the signals does
        self.covariance = self.covariance + np.cov(np.array(shifts).T).reshape(len(x), len(x))
        deviation = np.sqrt(np.diagonal(self.covariance))
        told = [
            f"{name} by {bias[place]:.2g} +- {spread[place]:.2g}"
            for place, name in enumerate(self.names)
            if abs(bias[place]) > MATTERS * deviation[place]
        ]
        self.notes.append(
            f"noise of the measured inputs biases {', '.join(told)}; the estimates are not corrected"
            if told
            else f"noise of the measured inputs biases no parameter by more than {MATTERS:g} standard deviations"
        )

    def _note_clock(self) -> None:
        """Note by how much a clock that runs slightly fast changes the estimates, which the data may not show."""
        problem, fit = self.problem, self.fit
        predicted, change, start = problem.predicted(fit.x), np.zeros(len(problem.measured)), 0
        for segment, some in zip(problem.segments, problem.valid, strict=True):
            for time_of in (segment.time[row] for row in some):
                part, start = slice(start, start + len(time_of)), start + len(time_of)
                if len(time_of) > 1:
                    change[part] = -FAST * (time_of - segment.time[0]) * np.gradient(predicted[part], time_of)
        white, deviation = problem.white(change), np.sqrt(np.diagonal(self.covariance))
        shift = covariance_of(fit.jacobian, fit.free) @ (fit.jacobian[: len(white)].T @ white)
        told = [
            f"{name} by {100 * shift[place] / fit.x[place]:+.2g} %"
            for place, name in enumerate(self.names)
            if self.known.identifiable[place] and fit.x[place] and abs(shift[place]) > MATTERS * deviation[place]
        ]
        if told:
            self.notes.append(
                "the estimates assume that the times of the files, and numbers that the base gives, are right: "
                f"a clock that is {100 * FAST:g} % fast changes {listed(told, 'and')}"
            )

    # ---- estimates -------------------------------------------------------------------------------------------------

    def goals(self) -> list[Goal]:
        """Return the parameters and expressions whose intervals are computed."""
        count, unknowns = len(self.fit.x), self.problem.unknowns[: len(self.names)]
        parameters = [_parameter(one, place, count) for place, one in enumerate(unknowns)]
        return parameters + [self._expression(name, text) for name, text in self.spec.intervals.of.items()]

    def _expression(self, name: str, text: str) -> Goal:
        known = {key: value for key, value in self.spec.run_spec.numbers.items() if key not in self.names}

        def value(x: np.ndarray) -> float:
            values = known | {one: float(x[place]) for place, one in enumerate(self.names) if one.isidentifier()}
            try:
                return parameter_values({**values, "_": text})["_"]
            except SpecError:  # the expression was checked when the spec was read: it is not finite here, such as 0/0
                return np.nan

        def slope(x: np.ndarray) -> np.ndarray:
            found = np.zeros(len(x))
            for place in range(len(self.names)):
                change = 1e-6 * self.problem.sizes[place] * np.eye(len(x))[place]
                found[place] = (value(x + change) - value(x - change)) / (2 * change[place])
            return found

        return Goal(name, value, slope)

    def is_determined(self, slope: np.ndarray) -> bool:
        """Return whether a goal has a slope, and no combination of parameters that is not determined changes it."""
        if not np.all(np.isfinite(slope)):
            return False
        lost = ~self.known.identifiable
        if not np.any(slope[lost]):
            return True
        names = [one.name for one in self.problem.unknowns]
        for one in self.known.combinations:
            places = [names.index(name) for name in one.names]
            size = np.abs(slope[places]) * np.abs(one.directions).max(axis=0)
            if np.any(np.abs(one.directions @ slope[places]) > 1e-3 * np.sum(size)):
                return False
        return not np.any(slope[lost & ~np.isin(names, [n for one in self.known.combinations for n in one.names])])

    def _estimates(self) -> tuple[dict[str, Estimate], dict[str, Profile]]:
        estimates: dict[str, Estimate] = {}
        profiles: dict[str, Profile] = {}
        for goal in self.goals():
            slope, value = goal.slope(self.fit.x), goal.value(self.fit.x)
            place = self.names.index(goal.name) if goal.name in self.names else None
            unit = "" if place is None else self.problem.unknowns[place].unit
            if not self.is_determined(slope):
                estimates[goal.name] = Estimate(goal.name, unit, value, -np.inf, np.inf, np.nan, False)
                continue
            self.notify(f"interval of {goal.name}")
            plain = float(slope @ self.plain_covariance @ slope)
            one = interval_of(
                self.problem, self.fit, goal, self.plain_covariance, self.spec.intervals.level,
                is_linear=self.spec.intervals.method == "linear",
                growth=float(np.sqrt(slope @ self.of_noise @ slope / plain)) if plain > 0.0 else 1.0,
            )  # fmt: skip
            if one.profile is not None:
                profiles[goal.name] = one.profile
            bias, half = abs(float(slope @ self.bias)), self.level * one.deviation
            deviation = float(np.sqrt(max(slope @ self.covariance @ slope, 0.0)))
            more = bias + self.level * deviation - half
            is_low, is_high = (place is not None and side[place] for side in (self.fit.at_low, self.fit.at_high))
            at = "lower" if is_low else "upper" if is_high else ""
            low, high = one.lower - more, one.upper + more
            lower = goal.low if at == "lower" else max(low, goal.low) if np.isfinite(low) else low
            upper = goal.high if at == "upper" else min(high, goal.high) if np.isfinite(high) else high

            total = np.nan if one.why else float(np.hypot(deviation, bias))
            estimates[goal.name] = Estimate(goal.name, unit, value, lower, upper, total, True, at, one.why)
        return estimates, profiles

    def _described(self, estimates: dict[str, Estimate]) -> tuple[dict[str, Estimate], np.ndarray]:
        """Return the estimates with means, and the covariance (K, K) of the parameters, nan where none describes them.

        If a bound or a curved effect of a parameter matters, both are those of samples of the posterior distribution.
        """
        count = len(self.names)
        lost = np.array([not estimates[name].identifiable for name in self.names])
        curved = np.array([bool(estimates[name].why) for name in self.names])
        mean, covariance = self.fit.x[:count], self.covariance[:count, :count]
        if np.any(curved):
            self.notify("samples of the posterior distribution")
            usable = self.spec.loss == "linear" and not failed(self.fit)
            if usable and (found := posterior(self.problem, self.fit, ~lost, self.spec.seed)) is not None:
                mean, covariance = found[0], found[1] * np.outer(self.growth[:count], self.growth[:count])
                covariance += (self.covariance - self.of_noise)[:count, :count]
            else:
                lost = lost | curved
        covariance = covariance + np.outer(self.bias, self.bias)[:count, :count]
        means = zip(self.names, np.where(lost, np.nan, mean).tolist(), strict=True)
        estimates = estimates | {name: replace(estimates[name], mean=value) for name, value in means}
        return estimates, np.where(lost | lost[:, None], np.nan, covariance)

    # ---- residuals -------------------------------------------------------------------------------------------------

    def _residuals(
        self, problem: Problem, x: np.ndarray, covariance: np.ndarray, *, is_hold_out: bool
    ) -> Iterator[Residuals]:
        """Yield the signals of a problem with their bands."""
        predicted, slopes = problem.predicted(x), problem.slopes(x)
        white = problem.white(predicted - problem.measured)
        of_fit = np.maximum(np.einsum("rk,kl,rl->r", slopes, covariance, slopes), 0.0)
        for key, data, piece, noise in zip(problem.signals, problem.data, problem.pieces, problem.noises, strict=True):
            some = piece.places
            band = self.level * np.sqrt(of_fit[some] + noise.deviation**2)
            measured, fitted = problem.measured[some], predicted[some]
            yield Residuals(
                *key, data.unit, problem.times[some], measured, fitted, white[some], noise.deviation, noise.correlation,
                is_hold_out, band, float(np.mean(np.abs(measured - fitted) <= band)),
            )  # fmt: skip

    def _held_out(self) -> list[Residuals]:
        """Return the signals of the experiments that are held out, predicted with the estimates.

        Their initial states, and parameters that only their sensors have, are estimated from their own data.
        """
        found: list[Residuals] = []
        noises = list(zip(self.problem.noises, self.problem.signals, strict=True))
        for one in self.held_out:
            problem = Problem(*segments_of(self.spec, [one]))
            x, own, names = problem.first.copy(), np.ones(len(problem.unknowns), dtype=bool), problem.names
            for name, place in names.items():
                if name in self.names:
                    x[place], own[place] = self.fit.x[self.names.index(name)], False
            for number, (key, known) in enumerate(zip(problem.signals, problem.known, strict=True)):
                same = [noise for noise, other in noises if other.quantity == key.quantity]
                if known is None and same:
                    problem.noises[number] = _pooled(same)
            try:
                x = fit_some(problem, x, own)
                fit = fit_at(problem, x)
                places = [names[name] for name in self.names if name in names]
                of_fit = [self.names.index(name) for name in self.names if name in names]
                shared = self.covariance[np.ix_(of_fit, of_fit)]
                own_covariance = covariance_of(fit.jacobian, own)
                # own unknowns follow the shared ones
                transfer = -own_covariance @ fit.jacobian.T @ fit.jacobian[:, places] + np.eye(len(x))[:, places]
                covariance = transfer @ shared @ transfer.T + own_covariance
                found += self._residuals(problem, x, covariance, is_hold_out=True)
            except MbdkitError as error:
                self.doubts.append(Doubt(one.name, f"the prediction of '{one.name}' fails: {error}"))
        return found

    def _check(self, residuals: Sequence[Residuals]) -> None:
        """Add the doubts about the model: effects that the residuals ask for, and residuals that are not noise."""
        problem, x = self.problem, self.fit.x
        numbers = {name: float(x[place]) for name, place in problem.names.items()}
        gains = [sensor_numbers(one.sensor, numbers)[0] for one in problem.data]
        angles = [one.quantity.endswith(".angle") for one in problem.data]
        turns = np.where(angles, 2.0 * np.pi * np.abs(gains), np.nan).tolist()
        fitted = [one for one in residuals if not one.is_hold_out]
        self.doubts += useless(fitted, turns, is_robust=self.spec.loss != "linear")

        if self.spec.loss != "linear":
            return
        self.notify("tests of the model")
        try:
            probes, columns = self._probes()
        except MbdkitError as error:
            self.notes.append(f"effects that the model may lack were not tested: {error}")
            return
        self.doubts += doubts_of(residuals, problem, self.fit, probes, columns, self.spec.intervals.level)

    def _probes(self) -> tuple[list[Probe], np.ndarray]:
        """Return effects that the model may lack, and the derivatives (R, P) of the predicted values by them."""
        problem, x = self.problem, self.fit.x
        units = {one.quantity: one.unit for one in problem.data}
        sensors = sensor_probes(units, list(dict.fromkeys(one.experiment for one in problem.segments)))
        mechanical: list[Probe] = []
        evaluators: dict[int, list[PreparedSensitivities]] = {}  # of windows that share runs
        parts = []
        for segment, some in zip(problem.segments, problem.valid, strict=True):
            plain, start = segment.given(x)
            if self.spec.kinematic:
                evaluators[id(segment.prepared)] = []
            elif id(segment.prepared) not in evaluators:
                spec = prepare(segment.spec).spec_with(plain)
                mechanical = mechanical or probes_of(spec)
                quantities = [signal.quantity for signal in segment.signals]
                some_probes = probe_sensitivities(spec, mechanical, quantities, segment.time, start)
                evaluators[id(segment.prepared)] = some_probes
            found = [one.at({}, start).derivatives for one in evaluators[id(segment.prepared)]]
            slopes = np.concatenate([np.zeros((len(segment.signals), len(segment.time), 0)), *found], axis=-1)
            shown, _ = segment.shown(segment.prepared.values(plain, start), None, x, problem.names)
            for row, signal in enumerate(segment.signals):
                gain = signal.sensor.gain
                own = slopes[row] * (x[problem.names[gain]] if isinstance(gain, str) else gain)
                of_sensor = sensor_derivatives(segment.experiment, signal.quantity, segment.time, shown[row], sensors)
                parts.append(np.concatenate([own, of_sensor], axis=-1)[some[row]])
        return [*mechanical, *sensors], np.concatenate(parts)

    # ---- specs -----------------------------------------------------------------------------------------------------

    def base_data(self, x: np.ndarray) -> dict[str, Any]:
        """Return the base with unknowns x (n,) as plain data."""
        base = self.spec.run_spec
        data = data_of(base)
        for place, name in enumerate(self.names):
            path = variable_path(name)
            if name in base.parameters or path[0] != "parameters":
                put(data, path, float(x[place]))
        return data


def _parameter(unknown: Unknown, place: int, count: int) -> Goal:
    """Return one of `count` unknowns as a goal."""
    direction = np.eye(count)[place]
    return Goal(unknown.name, lambda x: float(x[place]), lambda x: direction, unknown.low, unknown.high)


def _pooled(noises: Sequence[Noise]) -> Noise:
    """Return the noise of a quantity in another record, from that in several records."""
    if len(noises) == 1:
        return noises[0]
    deviation = float(np.sqrt(np.mean([noise.deviation**2 for noise in noises])))
    correlation = float(np.mean([noise.correlation for noise in noises]))
    return replace(noises[0], deviation=deviation, correlation=correlation)


def _finer(spec: RunSpec) -> RunSpec:
    """Return the spec of a run with half the step, or with a hundredth of the tolerances."""
    data = spec.sections()
    integrator = (
        data["integrator"].model_dump() if hasattr(data["integrator"], "model_dump") else dict(data["integrator"])
    )
    changed = {"integrator": integrator | {"name": spec.integrator_item.name}}
    if spec.claims.adaptive:
        integrator |= {key: integrator[key] / 100 for key in ("rtol", "atol") if integrator.get(key)}
    else:
        time_section = {"start": spec.time.start, "end": spec.time.final, "stops": list(spec.time.stops)}
        changed["time"] = time_section | {"step": (spec.time.step or 1.0) / 2}
    return spec_of_base(data | changed, spec._document)
