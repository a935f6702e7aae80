"""The result of an identification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mbdkit.plugin import HtmlView, SpecError, listed, plus_minus, table

VERDICTS = ("good", "doubtful", "bad")


@dataclass(frozen=True)
class Estimate:
    """An estimated parameter, or an expression of parameters.

    Attributes
    ----------
    name, unit
        Name and SI unit.
    value
        The estimate.
    lower, upper
        Limits of the interval; infinite where the data give no limit within the bounds.
    deviation
        Standard deviation, which includes the integration error; nan if the data do not determine the value, or if none
        describes the estimate.
    identifiable
        Whether the data determine the value.
    at_bound
        "lower" or "upper" if the estimate is at this bound, so that its interval is one-sided; else "".
    why
        Why no standard deviation describes the errors of the estimate, such as a bound in its interval; empty if one
        does.
    mean
        The value that other specs take with the covariance: the estimate, or the mean of the posterior distribution if
        `why` of a parameter is not empty; nan if there is no covariance.
    """

    name: str
    unit: str
    value: float
    lower: float
    upper: float
    deviation: float
    identifiable: bool
    at_bound: str = ""
    why: str = ""
    mean: float = np.nan


@dataclass(frozen=True)
class Profile:
    """The profile likelihood of one estimate.

    Attributes
    ----------
    name
        Name of the estimate.
    values
        (N,) fixed values, increasing.
    costs
        (N,) increase of the sum of squares, or of another loss, of the whitened residuals, minimized over all other
        unknowns.
    threshold
        Increase at the limits of the interval, which is smaller near a bound of the parameter.
    """

    name: str
    values: np.ndarray
    costs: np.ndarray
    threshold: float


@dataclass(frozen=True)
class Residuals:
    """Data, fit and residuals of one signal of an experiment.

    Attributes
    ----------
    experiment, quantity, unit
        The signal; the unit of its values.
    time
        (T,) times [s]; values that were not measured are left out.
    measured, fitted
        (T,) values.
    white
        (T,) whitened residuals, with mean 0 and deviation 1 if model and noise are right.
    deviation, correlation
        Standard deviation of the noise, and its correlation from sample to sample.
    is_hold_out
        Whether the data did not affect the parameters.
    band
        (T,) half width of the band that contains the measured value with the probability of the intervals.
    covered
        Share of the values within the band.
    """

    experiment: str
    quantity: str
    unit: str
    time: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
    white: np.ndarray
    deviation: float
    correlation: float
    is_hold_out: bool
    band: np.ndarray
    covered: float

    @property
    def rms(self) -> float:
        """Root mean square of the differences between data and fit."""
        return float(np.sqrt(np.mean((self.measured - self.fitted) ** 2)))


@dataclass(frozen=True)
class Doubt:
    """A reason to doubt the model or the data.

    Attributes
    ----------
    place
        What the misfit points to, such as ``friction in the joint 'hub'`` or ``clock of the experiment 'swing'``; empty
        for findings without a place.
    text
        The finding, as a sentence.
    strength
        Statistic of the test that found it, and its limit.
    """

    place: str
    text: str
    strength: tuple[float, float] = (np.nan, np.nan)


@dataclass(frozen=True)
class NextExperiment:
    """The expected intervals after one of the candidates was added to the experiments.

    Attributes
    ----------
    narrows
        Name of the estimate that is to be narrowed most.
    half_widths
        Expected half widths of the interval of each estimate, by candidate and by name of the estimate; those of
        ``""`` are the present ones.
    best
        The candidate with the narrowest interval.
    """

    narrows: str
    half_widths: Mapping[str, Mapping[str, float]]
    best: str


@dataclass(frozen=True)
class Identification(HtmlView):
    """Parameters of a model, estimated from measured motion.

    Attributes
    ----------
    spec
        The spec as plain data, and the base with the estimates in place, as plain data.
    estimates
        The parameters and the expressions of `intervals.of`, by name.
    parameters
        Names of the K parameters.
    covariance
        (K, K) covariance of the parameters; nan for those that the data do not determine, or that it does not describe.
        If `why` of a parameter is not empty, it is that of samples of the posterior distribution.
    combinations
        Sentences on the combinations of parameters that the data determine or do not.
    residuals
        The signals of the experiments, also of those held out.
    profiles
        Profiles by name of the estimate; empty for linear intervals.
    next_experiment
        The comparison of the candidates; None without candidates.
    verdict
        ``good``, ``doubtful`` or ``bad``.
    doubts
        Its reasons.
    notes
        Notes that do not question the result.
    cost
        Sum of squares of the whitened residuals.
    log_likelihood
        Logarithm of the likelihood of the data, with which models are compared.
    evaluations
        Numbers of runs and of runs with derivatives.
    way
        How derivatives were computed: "exact", or why they are differences.
    seconds
        Processor time [s].
    unknowns
        Number of unknowns: parameters, initial values, and deviations and correlations of noise that are estimated.
    """

    spec: Mapping[str, Any]
    base: Mapping[str, Any]
    level: float
    estimates: Mapping[str, Estimate]
    parameters: tuple[str, ...]
    covariance: np.ndarray
    combinations: tuple[str, ...]
    residuals: tuple[Residuals, ...]
    profiles: Mapping[str, Profile]
    next_experiment: NextExperiment | None
    verdict: str
    doubts: tuple[Doubt, ...]
    notes: tuple[str, ...]
    cost: float
    log_likelihood: float
    evaluations: tuple[int, int]
    way: str = "exact"
    seconds: float = 0.0
    unknowns: float = 0
    title: str = field(default="")

    def __getitem__(self, name: str) -> Estimate:
        return self.estimates[name]

    @property
    def hold_out(self) -> tuple[Residuals, ...]:
        """The signals of experiments that did not affect the parameters."""
        return tuple(one for one in self.residuals if one.is_hold_out)

    @property
    def information_criterion(self) -> float:
        """Akaike's criterion, ``2*unknowns - 2*log_likelihood``; of two models of the same data, the better has the
        smaller value (H. Akaike, IEEE Transactions on Automatic Control 19 (1974) 716-723).
        """
        return 2.0 * self.unknowns - 2.0 * self.log_likelihood

    def compare(self, other: Identification) -> str:
        """Return which of two models explains the same data better, by likelihood and by the data held out.

        Raises
        ------
        SpecError
            If the data differ.
        """
        pairs = list(zip(self.residuals, other.residuals, strict=False))
        if len(self.residuals) != len(other.residuals) or not all(
            (a.experiment, a.quantity) == (b.experiment, b.quantity) and np.array_equal(a.measured, b.measured)
            for a, b in pairs
        ):
            raise SpecError("two models are compared by the same data, but these differ")
        gain = other.information_criterion - self.information_criterion
        better = f"the {'first' if gain > 0 else 'second'} model explains the data better"
        verdict = better if abs(gain) > 2 else "both models explain the data equally well"
        lines = [f"{verdict}: Akaike's criterion of the second minus that of the first is {gain:.4g}"]
        lines += [
            f"{a.experiment}: {a.quantity} held out, root mean square error {a.rms:.4g} and {b.rms:.4g} {a.unit}"
            for a, b in pairs
            if a.is_hold_out
        ]
        return "\n".join(lines)

    def rows(self) -> list[list[str]]:
        """Return the estimates as rows of a table: name, value with deviation, limits and unit."""
        rows = []
        for one in self.estimates.values():
            if not one.identifiable:
                rows.append([one.name, "not determined by the data", "", "", one.unit])
                continue
            low, high = (f"{x:.6g}" if np.isfinite(x) else "no limit" for x in (one.lower, one.upper))
            value = plus_minus(one.value, one.deviation) if np.isfinite(one.deviation) else f"{one.value:.6g}"
            value += f", at its {one.at_bound} bound" if one.at_bound else ""
            rows.append([one.name, value, low, high, one.unit])
        return rows

    def summary(self) -> str:
        """Return the result as text."""
        level = f"{100 * self.level:g} %"
        lines = [table([["parameter", "value", f"{level} from", "to", "unit"], *self.rows()])]
        lines += self.combinations
        for one in self.residuals:
            told = "predicted" if one.is_hold_out else "fitted"
            lines.append(
                f"{one.experiment}: {one.quantity} {told} with a root mean square error of {one.rms:.3g} {one.unit}; "
                f"{100 * one.covered:.0f} % of the values lie within the band of {level}"
            )
        if self.next_experiment is not None:
            best = self.next_experiment
            width = best.half_widths[best.best][best.narrows]
            now = best.half_widths[""][best.narrows]
            if np.isfinite(width):
                lines.append(
                    f"next experiment: '{best.best}' narrows the interval of {best.narrows} most, from +- {now:.3g} to "
                    f"+- {width:.3g}"
                )
            else:
                lines.append(f"next experiment: none of the candidates determines {best.narrows}")
        lines += [f"verdict: {self.verdict}{'' if not self.doubts else ', because'}"]
        lines += [f"  - {doubt.text}" for doubt in self.doubts]
        lines += [f"note: {note}" for note in self.notes]
        runs, derived = self.evaluations
        ways = "exact derivatives" if self.way == "exact" else f"differences, because {self.way}"
        lines.append(f"{runs} runs, {derived} runs with derivatives ({ways}), {self.seconds:.1f} s of processor time")
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"Identification of {listed(self.parameters, 'and')}: {self.verdict}"
