"""The check of a gradient: its derivative in one direction, compared with differences of runs at two distances.

The differences are central. If the spec is not valid on one side of a parameter, such as a damping of zero, they are
one-sided and of the same order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.base.plain_data import Path
from mbdkit.gradients.gradient_parameters import Parameter
from mbdkit.gradients.parameter_differences import PreparedDerivatives

STEPS = (1e-4, 2e-4)
"""Relative changes of the parameters in the runs."""

ROUND_OFF = 1e-13
"""Assumed relative error of a measure of one run by rounding errors and by the tolerance of the stage equations."""

ALLOWED = 10.0
"""Multiple of the estimated error of the differences by which they may deviate."""

SMALLEST = 1e-7
"""A deviation below this share of the sum of the terms of the derivative is always allowed."""

Settings = Sequence[tuple[Path, float]]
"""Key paths and their values."""

Measured = Callable[[Settings], Sequence[float]]
"""Returns the measures of a run with these values, nan if it stops early."""


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
        (2, M) the same by differences of second order at both distances.
    extrapolated
        (M,) the same extrapolated from both.
    error
        (M,) estimated error of the extrapolated differences.
    agrees
        (M,) whether the derivative is within the estimated error, and some allowance, of the differences; true where
        there is no derivative, so that nothing is claimed.
    names
        Names of the measures.
    """

    direction: np.ndarray
    steps: np.ndarray
    derivative: np.ndarray
    differences: np.ndarray
    extrapolated: np.ndarray
    error: np.ndarray
    agrees: np.ndarray
    names: tuple[str, ...]

    @property
    def is_passed(self) -> bool:
        """Whether all measures agree."""
        return bool(np.all(self.agrees))

    def __str__(self) -> str:
        return "\n".join(map(self._told, range(len(self.names))))

    def _told(self, m: int) -> str:
        """Return the check of one measure as text."""
        name = self.names[m]
        if np.isnan(self.derivative[m]):
            return f"{name}: there is no derivative to check"
        verb = "agrees with" if self.agrees[m] else "DISAGREES with"
        return (
            f"{name}: the derivative in a random direction, {self.derivative[m]:.10g}, {verb} differences of runs, "
            f"{self.extrapolated[m]:.10g} (estimated error {self.error[m]:.1g}; at the two distances "
            f"{self.differences[0, m]:.10g} and {self.differences[1, m]:.10g})"
        )


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
        Whether the spec is valid for changes in this direction only, but not in the opposite one.
    """

    parameters: Sequence[Parameter]
    change: np.ndarray
    is_one_sided: bool

    @classmethod
    def random(cls, parameters: Sequence[Parameter], prepared: PreparedDerivatives) -> Direction:
        """Return a random direction, the same one in every call."""
        signs = np.random.default_rng(18).choice([-1.0, 1.0], size=len(parameters))
        signs = np.where(prepared.side != 0, prepared.side, signs)
        return cls(parameters, signs * prepared.seeds.scale, bool(np.any(prepared.side)))

    def differences(self, measured: Measured, value: np.ndarray) -> np.ndarray:
        """Return differences (2, M) of second order, at both `STEPS`; `value` (M,) is that of the spec itself."""
        places = (1, 2) if self.is_one_sided else (-1, 1)
        runs = np.array([measured(self._settings(place * step)) for step in STEPS for place in places])
        first, second, steps = runs[::2], runs[1::2], np.array(STEPS)[:, None]
        if self.is_one_sided:
            return np.asarray((4.0 * (first - value) - (second - value)) / (2.0 * steps))
        return np.asarray((second - first) / (2.0 * steps))

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
) -> GradientCheck:
    """Check a gradient by four runs.

    Parameters
    ----------
    measured
        Returns the measures for other values of the parameters.
    sizes
        Magnitude of the numbers from which each measure is computed, by name.
    value, jacobian
        (M,) the measures, and (M, K) their gradients.
    """
    differences = direction.differences(measured, value)
    ratio = (STEPS[1] / STEPS[0]) ** 2
    extrapolated = (ratio * differences[0] - differences[1]) / (ratio - 1.0)
    derivative = jacobian @ direction.change
    error = np.abs(extrapolated - differences[0]) + ROUND_OFF * np.array([*sizes.values()]) / STEPS[0]
    terms = np.sum(np.abs(jacobian * direction.change), axis=1)
    deviation = np.abs(derivative - extrapolated)
    agrees = (deviation <= ALLOWED * error + SMALLEST * terms) | np.isnan(derivative)
    return GradientCheck(
        direction.change, np.array(STEPS), derivative, differences, extrapolated, error, agrees, tuple(sizes)
    )
