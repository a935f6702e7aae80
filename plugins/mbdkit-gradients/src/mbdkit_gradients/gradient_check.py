"""The check of a gradient, and the errors of its entries, the derivatives of one measure with respect to one parameter.

The derivative in one direction is compared with differences of runs at two distances. Runs with the same steps reveal
errors of the differentiation. The gradient of a run by another, more accurate method, which does not have the same
discretization error, shows how far each entry is from that of the exact motion. Differences of runs by the other method
show in turn whether that gradient is right.

Where a law or an extremum changes its form inside a step, the time of the change is differentiated along the motion
between the ends of steps, not along that of the steps. The derivative then differs from the limit of the differences by
a discretization error. The distance of the differences from the runs by another method estimates it, without use of the
derivative.

The differences are central. If the spec is not valid on one side of a parameter, such as a damping of zero, they are
one-sided and of the same order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from mbdkit.base.plain_data import Path
from mbdkit.base.text import counted, listed, plus_minus, told_apart
from mbdkit_gradients.gradient_parameters import Parameter
from mbdkit_gradients.parameter_differences import PreparedDerivatives

STEPS = (1e-4, 2e-4)  #: Relative changes of the parameters in the runs.

#: Assumed relative error of a measure of one run, due to rounding and to the tolerance of the stage equations.
ROUND_OFF = 1e-13

#: Smallest size of a measure, relative to the natural size for its unit.
#:
#: Smaller measures, such as the height of a rod that lies still, differ from zero only by rounding errors of the
#: coordinates and have no digits to compare.
NATURAL = np.finfo(float).eps / ROUND_OFF

#: Largest accepted deviation of the derivative from the differences, as a multiple of their estimated error and of
#: their distance from the other method's differences.
ALLOWED = 10.0

#: Deviations below this share of the sum of the terms of the derivative are always accepted.
#:
#: There is one term for each parameter; the sum is that of absolute values.
SMALLEST = 1e-7

#: Relative change of the parameters in the runs by another method, whose measures are less exact.
REFERENCE_STEP = 5e-4
#: Assumed relative error of a measure of one run by another method, due to its tolerance.
REFERENCE_ERROR = 3e-12
#: Largest expected error of differences after correction by extrapolation, as a share of the correction.
CORRECTED = 0.01

#: Assumed error of the other method's differences, as a multiple of their change if the distance is doubled.
#:
#: The changes of runs that pass discontinuities of laws with adaptive steps are irregular: the errors of their measures
#: depend on where steps fail. Measured at two links with a cable that goes slack twice.
SCATTER = 3.0
#: Deviations of the other method's differences from its gradient above this share of the sum of terms, plus the
#: estimated error of the differences, cause runs at twice the distance.
SUSPECT = 5e-7
#: Largest error of the other method's differences, and largest discretization error, for which deviations are excused,
#: as a share of the sum of terms.
UNSURE = 1e-4

LARGEST_ERROR = 1e-2  #: Largest accepted error of an entry, as a share of the entry.

#: Largest error of an entry, times the size of the parameter, that is always accepted, as a share of the magnitude of
#: the numbers from which the measure is computed.
NEGLIGIBLE = 1e-6

Settings = Sequence[tuple[Path, float]]

#: Function that returns the measures of a run with these values; nan if the run stops early.
Measured = Callable[[Settings], Sequence[float]]

DIGITS = 10  #: Largest number of printed digits of an entry.

ADVICE = "use smaller steps or a smaller tolerance"  #: Advice about inaccurate derivatives of smooth runs.

MOST_NAMED = 3  #: Largest number of parameters that a doubt about a measure names.


@dataclass(frozen=True)
class GradientCheck:
    """A gradient checked in one direction, with the errors of its entries.

    Attributes
    ----------
    direction
        (K,) change of each parameter in the direction: its size with a random sign.
    steps
        (2,) distances of the runs, as shares of `direction`.
    derivative
        (M,) derivative of each measure in the direction, by the gradient.
    differences
        (2, M) the derivatives by differences of second order at both distances.
    extrapolated
        (M,) the derivatives extrapolated from both differences.
    error
        (M,) estimated error of the extrapolated differences.
    reference
        (M,) the derivatives by differences of runs of another method with small errors; nan if no such run is complete.
    agrees
        (M,) whether the derivative agrees with the differences within their estimated error, the discretization error
        and some tolerance, and whether all entries are accurate; true for measures without a derivative.
    names
        Names of the measures.
    terms
        (M,) sums of the magnitudes of the terms of the derivative, one term for each parameter: the scale with which
        deviations in the direction are compared.
    entry
        (M, K) the entries of the gradient.
    entry_error
        (M, K) their estimated errors; nan if unknown.
    is_accurate
        (M, K) whether the error of the entry is at most 1 % of the entry or negligible; true if the error is unknown.
    parameters
        Names of the parameters.
    """

    direction: np.ndarray
    steps: np.ndarray
    derivative: np.ndarray
    differences: np.ndarray
    extrapolated: np.ndarray
    error: np.ndarray
    agrees: np.ndarray
    names: tuple[str, ...]
    reference: np.ndarray
    terms: np.ndarray
    entry: np.ndarray
    entry_error: np.ndarray
    is_accurate: np.ndarray
    parameters: tuple[str, ...]

    @property
    def is_passed(self) -> bool:
        """Whether the check has succeeded for all measures: see `agrees`."""
        return bool(np.all(self.agrees))

    @property
    def is_like_steps(self) -> np.ndarray:
        """(M,) whether the derivative agrees with the differences of runs with the same steps; false for nan."""
        return _is_like_steps(self.derivative, self.extrapolated, self.error, self.terms, self.reference)

    def __str__(self) -> str:
        return "\n".join(map(self._told, range(len(self.names))))

    def _told(self, m: int) -> str:
        name = self.names[m]
        if np.isnan(self.derivative[m]):
            return f"{name}: there is no derivative to check"
        verb = "agrees with" if self.is_like_steps[m] else "DISAGREES with"
        return (
            f"{name}: the derivative in a random direction, {self.derivative[m]:.10g}, {verb} differences of runs, "
            f"{self.extrapolated[m]:.10g} (estimated error {self.error[m]:.1g}; at the two distances "
            f"{self.differences[0, m]:.10g} and {self.differences[1, m]:.10g}){self._others(m)}"
        )

    def _others(self, m: int) -> str:
        """Return the derivative of a measure by another method, and its inaccurate entries, as text."""
        by_another = "" if np.isnan(self.reference[m]) else f"; another method gives {self.reference[m]:.10g}"
        if self.is_accurate[m].all():
            return by_another
        return f"{by_another}; INACCURATE with respect to {listed(compress(self.parameters, ~self.is_accurate[m]))}"


@dataclass(frozen=True)
class Direction:
    """A direction in which a gradient is checked.

    Attributes
    ----------
    parameters
        The K parameters.
    change
        (K,) change of each parameter: its size with a random sign, or the sign that keeps the spec valid.
    is_one_sided
        Whether the spec is valid for changes in this direction, but not in the opposite one.
    """

    parameters: Sequence[Parameter]
    change: np.ndarray
    is_one_sided: bool

    @classmethod
    def random(cls, parameters: Sequence[Parameter], prepared: PreparedDerivatives) -> Direction:
        """Return a random direction; every call returns the same one."""
        signs = np.random.default_rng(18).choice([-1.0, 1.0], size=len(parameters))
        signs = np.where(prepared.side != 0, prepared.side, signs)
        return cls(parameters, signs * prepared.seeds.scale, bool(np.any(prepared.side)))

    def difference(self, measured: Measured, step: float, value: np.ndarray | None = None) -> np.ndarray:
        """Return differences (M,) of second order at a distance; `value` (M,) has the measures of the spec itself, if
        they are known.
        """
        if self.is_one_sided and value is None:
            value = np.array(measured(self._settings(0.0)))
        places = (1, 2) if self.is_one_sided else (-1, 1)
        first, second = (np.array(measured(self._settings(place * step))) for place in places)
        if self.is_one_sided:
            return np.asarray((4.0 * (first - value) - (second - value)) / (2.0 * step))
        return np.asarray((second - first) / (2.0 * step))

    def _settings(self, share: float) -> Settings:
        return [
            (one.path, one.value + share * change) for one, change in zip(self.parameters, self.change, strict=True)
        ]


def check_gradient(
    direction: Direction,
    measured: Measured,
    sizes: Mapping[str, float],
    value: np.ndarray,
    jacobian: np.ndarray,
    reference: Measured | None = None,
    reference_jacobian: Callable[[], np.ndarray] | None = None,
) -> GradientCheck:
    """Check a gradient by four runs with the same steps, and by two to four runs and the gradient of another method.

    Parameters
    ----------
    measured
        Function that returns the measures for other values of the parameters.
    sizes
        Magnitudes of the numbers from which the measures are computed, by name of the measure.
    value, jacobian
        (M,) the measures, and (M, K) their gradients.
    reference, reference_jacobian
        Functions that return the measures by another, more accurate method, and then their gradients (M, K), nan where
        unknown; None if the computation has no discretization error.
    """
    differences = np.array([direction.difference(measured, step, value) for step in STEPS])
    ratio = (STEPS[1] / STEPS[0]) ** 2
    extrapolated = (ratio * differences[0] - differences[1]) / (ratio - 1.0)
    derivative = jacobian @ direction.change
    size = np.array([*sizes.values()])
    rounding, correction = ROUND_OFF * size / STEPS[0], extrapolated - differences[0]
    error = np.abs(correction) + rounding
    terms = np.sum(np.abs(jacobian * direction.change), axis=1)
    other, witness = np.full(len(derivative), np.nan), jacobian
    if reference is None:
        unexplained = np.abs(derivative - extrapolated) + CORRECTED * np.abs(correction) + rounding
    else:
        correction = (REFERENCE_STEP / STEPS[0]) ** 2 * correction
        near, unsure = direction.difference(reference, REFERENCE_STEP), np.zeros(len(derivative))
        if reference_jacobian is not None:
            witness = reference_jacobian()
        # the part of the deviation of that gradient from its differences that their estimated error does not explain
        along, scale = witness @ direction.change, np.sum(np.abs(witness * direction.change), axis=1)
        rounding = REFERENCE_ERROR * size / REFERENCE_STEP
        if np.any(np.abs(along - near - correction) > SUSPECT * scale + CORRECTED * np.abs(correction) + rounding):
            # the correction is wrong if the runs are irregular, as if they step over the beginning of a contact
            own = (near - direction.difference(reference, 2.0 * REFERENCE_STEP)) / 3.0
            unsure = 3.0 * SCATTER * np.minimum(np.abs(own - correction), np.abs(own))
            unsure = np.minimum(np.nan_to_num(unsure), UNSURE * scale)
            correction = np.where(np.abs(own) < np.abs(correction), own, correction)
        other, other_error = near + correction, CORRECTED * np.abs(correction) + rounding + unsure
        unexplained = np.maximum(np.abs(along - other) - other_error, 0.0)
    entry_error = np.abs(jacobian - witness) + unexplained[:, None] / np.abs(direction.change)
    scaled = np.abs(direction.change) * np.stack([entry_error, np.abs(jacobian)])
    is_accurate = ~(scaled[0] > np.maximum(LARGEST_ERROR * scaled[1], NEGLIGIBLE * size[:, None]))
    agrees = _is_like_steps(derivative, extrapolated, error, terms, other) & is_accurate.all(axis=1)
    return GradientCheck(
        direction.change, np.array(STEPS), derivative, differences, extrapolated, error,
        agrees | np.isnan(derivative), tuple(sizes), other, terms, jacobian, entry_error, is_accurate,
        tuple(parameter.name for parameter in direction.parameters),
    )  # fmt: skip


def _is_like_steps(
    derivative: np.ndarray, extrapolated: np.ndarray, error: np.ndarray, terms: np.ndarray, other: np.ndarray
) -> np.ndarray:
    """Return whether derivatives agree with differences of runs with the same steps; see `GradientCheck`."""
    discretization = np.minimum(ALLOWED * np.nan_to_num(np.abs(extrapolated - other)), UNSURE * terms)
    allowed = ALLOWED * error + SMALLEST * terms + discretization
    return np.asarray(np.abs(derivative - extrapolated) <= allowed)


def check_doubts(check: GradientCheck, advice: Callable[[], str] = str) -> list[str]:
    """Return a warning for each measure whose check fails, or whose errors are unknown.

    `advice`: function that returns a clause about a run that is not smooth; empty if it is.
    """
    of_steps = np.abs(check.derivative - check.extrapolated)
    is_alike = check.is_like_steps
    doubts = []
    for m, name in enumerate(check.names):
        if np.isnan(check.derivative[m]):
            continue
        if np.isnan(of_steps[m]):
            doubts.append(
                f"the derivative of '{name}' could not be checked: a run with other values of the parameters stopped "
                f"early"
            )
        elif not is_alike[m]:
            own, other = told_apart(check.derivative[m], check.extrapolated[m])
            scale = check.terms[m]
            share = f"{100.0 * of_steps[m] / scale:.2g} %" if scale > 0.0 else "more than 100 %"
            doubts.append(
                f"the derivative of '{name}' fails its check: in a random direction, it is {own}, but {other} by "
                f"differences of runs, {share} of its scale away{(why := advice()) and ': '}{why}"
            )
        elif not check.is_accurate[m].all():
            doubts.append(inaccurate_entries(check, m, advice() or ADVICE))
        elif np.isnan(check.entry_error[m]).any():
            doubts.append(
                f"the errors of the derivatives of '{name}' are unknown: no run by another, more accurate method could "
                f"be differentiated{(why := advice()) and ': '}{why}"
            )
    return doubts


def inaccurate_entries(check: GradientCheck, m: int, advice: str = ADVICE) -> str:
    """Return a clause about the entries of a measure whose errors are too large, the largest relative errors first."""
    size = np.maximum(np.abs(check.entry[m]), np.finfo(float).tiny)
    worst_first = np.argsort(-check.entry_error[m] / size, kind="stable").tolist()
    found = [k for k in worst_first if not check.is_accurate[m, k]]
    texts = [plus_minus(check.entry[m, k], check.entry_error[m, k], digits=DIGITS) for k in found[:MOST_NAMED]]
    named = [f"'{check.parameters[k]}', {text}" for k, text in zip(found, texts, strict=False)]
    others = f"; and to {counted(len(found) - MOST_NAMED, 'other parameter')}" if len(found) > MOST_NAMED else ""
    return f"the derivative of '{check.names[m]}' is inaccurate with respect to {'; '.join(named)}{others}: {advice}"
