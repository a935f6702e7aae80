"""The check of a gradient: its derivative in one direction, compared with differences of runs at two distances.

Runs with the same steps reveal errors of the differentiation. Runs by another method with small errors, which do not
have the same discretization error, show how far the derivative is from that of the exact motion.

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

import numpy as np

from mbdkit.base.plain_data import Path
from mbdkit.base.text import told_apart
from mbdkit.gradients.gradient_parameters import Parameter
from mbdkit.gradients.parameter_differences import PreparedDerivatives

STEPS = (1e-4, 2e-4)
"""Relative changes of the parameters in the runs."""

ROUND_OFF = 1e-13
"""Assumed relative error of a measure of one run, due to rounding and to the tolerance of the stage equations."""

NATURAL = np.finfo(float).eps / ROUND_OFF
"""Smallest size of a measure, relative to the natural size for its unit.

Smaller measures, such as the height of a rod that lies still, differ from zero only by rounding errors of the
coordinates and have no digits to compare.
"""

ALLOWED = 10.0
"""Largest accepted deviation of the derivative from the differences, as a multiple of their estimated error and of
their distance from the other method's differences.
"""

SMALLEST = 1e-7
"""Deviations below this share of the sum of the terms of the derivative are always accepted.

There is one term for each parameter; the sum is that of absolute values.
"""

REFERENCE_STEP = 5e-4
"""Relative change of the parameters in the runs by another method, whose measures are less exact."""
REFERENCE_ERROR = 3e-12
"""Assumed relative error of a measure of one run by another method, due to its tolerance."""
CORRECTED = 0.01
"""Largest expected error of the other method's differences after correction by extrapolation, as a share of the
correction.
"""

SCATTER = 3.0
"""Assumed error of the other method's differences, as a multiple of their change if the distance is doubled.

The changes of runs that pass discontinuities of laws with adaptive steps are irregular: the errors of their measures
depend on where steps fail. Measured at two links with a cable that goes slack twice.
"""
UNSURE = 1e-4
"""Largest error of the other method's differences, and largest discretization error, for which deviations are excused,
as a share of the sum of terms.
"""

LARGEST_DISCRETIZATION = 1e-2
"""Largest accepted difference from the derivative of the exact motion, as a share of the sum of the terms of the
derivative.
"""

NOTED = (5e-7, 5e-5)
"""Differences from the derivative of the exact motion above these shares of the sum of the terms are noted.

The first applies to smooth measures, the second to measures whose form changes inside steps.
"""

Settings = Sequence[tuple[Path, float]]
"""Key paths and their values."""

Measured = Callable[[Settings], Sequence[float]]
"""Function that returns the measures of a run with these values; nan if the run stops early."""


@dataclass(frozen=True)
class GradientCheck:
    """A gradient checked in one direction.

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
        and some tolerance, and with those of the other method within 1 %; true for measures without a derivative.
    names
        Names of the measures.
    reference_error
        (M,) estimated errors of `reference`.
    terms
        (M,) sums of the magnitudes of the terms of the derivative, one term for each parameter: the scale with which
        deviations are compared.
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
    reference_error: np.ndarray
    terms: np.ndarray

    @property
    def is_passed(self) -> bool:
        """Whether all measures agree."""
        return bool(np.all(self.agrees))

    @property
    def is_like_steps(self) -> np.ndarray:
        """(M,) whether the derivative agrees with the differences of runs with the same steps; false for nan."""
        return _is_like_steps(self.derivative, self.extrapolated, self.error, self.terms, self.reference)

    def __str__(self) -> str:
        return "\n".join(map(self._told, range(len(self.names))))

    def _told(self, m: int) -> str:
        """Return the check of one measure as text."""
        name = self.names[m]
        if np.isnan(self.derivative[m]):
            return f"{name}: there is no derivative to check"
        verb = "agrees with" if self.is_like_steps[m] else "DISAGREES with"
        return (
            f"{name}: the derivative in a random direction, {self.derivative[m]:.10g}, {verb} differences of runs, "
            f"{self.extrapolated[m]:.10g} (estimated error {self.error[m]:.1g}; at the two distances "
            f"{self.differences[0, m]:.10g} and {self.differences[1, m]:.10g}){self._reference(m)}"
        )

    def _reference(self, m: int) -> str:
        if np.isnan(self.reference[m]):
            return ""
        verb = "gives" if self.agrees[m] or not self.is_like_steps[m] else "DISAGREES and gives"
        return f"; another method {verb} {self.reference[m]:.10g}"


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

    def differences(self, measured: Measured, value: np.ndarray) -> np.ndarray:
        """Return differences (2, M) of second order, at both `STEPS`; `value` (M,) has the measures of the spec
        itself.
        """
        places = (1, 2) if self.is_one_sided else (-1, 1)
        runs = np.array([measured(self._settings(place * step)) for step in STEPS for place in places])
        first, second, steps = runs[::2], runs[1::2], np.array(STEPS)[:, None]
        if self.is_one_sided:
            return np.asarray((4.0 * (first - value) - (second - value)) / (2.0 * steps))
        return np.asarray((second - first) / (2.0 * steps))

    def of_reference(self, measured: Measured, step: float = REFERENCE_STEP) -> np.ndarray:
        """Return differences (M,) of second order at a distance."""
        places = (0, 1, 2) if self.is_one_sided else (-1, 1)
        runs = [np.array(measured(self._settings(place * step))) for place in places]
        if self.is_one_sided:
            return np.asarray((4.0 * (runs[1] - runs[0]) - (runs[2] - runs[0])) / (2.0 * step))
        return np.asarray((runs[1] - runs[0]) / (2.0 * step))

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
) -> GradientCheck:
    """Check a gradient by four runs with the same steps, and two or three runs by another method.

    If the latter differ from the gradient, runs at twice their distance show how exact they are.

    Parameters
    ----------
    measured
        Function that returns the measures for other values of the parameters.
    sizes
        Magnitudes of the numbers from which the measures are computed, by name of the measure.
    value, jacobian
        (M,) the measures, and (M, K) their gradients.
    reference
        Function that returns the measures by another method with small errors; None if there is none.
    """
    differences = direction.differences(measured, value)
    ratio = (STEPS[1] / STEPS[0]) ** 2
    extrapolated = (ratio * differences[0] - differences[1]) / (ratio - 1.0)
    derivative = jacobian @ direction.change
    error = np.abs(extrapolated - differences[0]) + ROUND_OFF * np.array([*sizes.values()]) / STEPS[0]
    terms = np.sum(np.abs(jacobian * direction.change), axis=1)
    other, other_error = np.full(len(derivative), np.nan), np.zeros(len(derivative))
    if reference is not None:
        correction = _correction(extrapolated - differences[0])
        other = direction.of_reference(reference) + correction  # the error of the differences is removed
        other_error = _reference_error(correction, sizes)
        if np.any(np.abs(derivative - other) > NOTED[0] * terms + other_error):
            wider = direction.of_reference(reference, 2.0 * REFERENCE_STEP) + 4.0 * correction
            scatter = np.nan_to_num(SCATTER * np.abs(wider - other))
            other_error = other_error + np.minimum(scatter, UNSURE * terms)
    agrees = _is_like_steps(derivative, extrapolated, error, terms, other)
    allowed = LARGEST_DISCRETIZATION * terms + other_error
    agrees &= (np.abs(derivative - other) <= allowed) | np.isnan(other)
    return GradientCheck(
        direction.change, np.array(STEPS), derivative, differences, extrapolated, error,
        agrees | np.isnan(derivative), tuple(sizes), other, other_error, terms,
    )  # fmt: skip


def _is_like_steps(
    derivative: np.ndarray, extrapolated: np.ndarray, error: np.ndarray, terms: np.ndarray, other: np.ndarray
) -> np.ndarray:
    """Return whether derivatives agree with differences of runs with the same steps; see `GradientCheck`."""
    discretization = np.minimum(ALLOWED * np.nan_to_num(np.abs(extrapolated - other)), UNSURE * terms)
    allowed = ALLOWED * error + SMALLEST * terms + discretization
    return np.asarray(np.abs(derivative - extrapolated) <= allowed)


def _correction(of_smallest: np.ndarray) -> np.ndarray:
    """Return the correction (M,) of differences at the distance `REFERENCE_STEP`.

    It follows from the correction `of_smallest` (M,) of differences at the distance `STEPS[0]`.
    """
    return np.asarray((REFERENCE_STEP / STEPS[0]) ** 2 * of_smallest)


def _reference_error(correction: np.ndarray, sizes: Mapping[str, float]) -> np.ndarray:
    """Return the largest expected error of the other method's differences after a correction (M,)."""
    return np.asarray(CORRECTED * np.abs(correction) + REFERENCE_ERROR * np.array([*sizes.values()]) / REFERENCE_STEP)


def check_doubts(check: GradientCheck, smooth: Sequence[bool]) -> list[str]:
    """Return a warning for each measure whose check fails, or whose derivative differs from that of runs with another
    method by more than `NOTED` and their estimated error.

    Parameters
    ----------
    smooth
        Whether each measure is smooth inside the steps, which selects the limit in `NOTED`.
    """
    of_steps = np.abs(check.derivative - check.extrapolated)
    away = np.abs(check.derivative - check.reference)
    is_alike = check.is_like_steps
    is_noted = away > np.where(smooth, NOTED[0], NOTED[1]) * check.terms + check.reference_error
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
            doubts.append(
                f"the derivative of '{name}' fails its check: in a random direction, it is {own}, but {other} by "
                f"differences of runs, {_percent(of_steps[m], check.terms[m])} of its scale away"
            )
        elif is_noted[m]:
            failed = "" if check.agrees[m] else " and fails its check"
            doubts.append(
                f"the derivative of '{name}' differs by {_percent(away[m], check.terms[m])} from that of runs with "
                f"another method{failed}; one of them is wrong by that much: use smaller steps or a smaller tolerance "
                f"if this is too much"
            )
    return doubts


def _percent(deviation: float, scale: float) -> str:
    return f"{100.0 * deviation / scale:.2g} %" if scale > 0.0 else "more than 100 %"
