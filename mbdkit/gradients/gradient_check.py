"""The check of a gradient: its derivative in one direction beside central differences of runs at two distances."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.gradients.gradient_parameters import Parameter
from mbdkit.spec import RunSpec
from mbdkit.spec.varied_specs import VariedSpecs

STEPS = (1e-4, 2e-4)
"""Distances of the runs from the parameters, as shares of these."""

ROUND_OFF = 1e-13
"""Assumed relative error of a measure of one run by rounding errors and by the tolerance of the stage equations."""

ALLOWED = 10.0
"""Multiple of the estimated error of the differences by which they may deviate."""

SMALLEST = 1e-7
"""A deviation below this share of the sum of the terms of the derivative is always allowed."""


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
        (2, M) the same by central differences at both distances.
    extrapolated
        (M,) the same extrapolated from both.
    error
        (M,) estimated error of the extrapolated differences.
    agrees
        (M,) whether the derivative is within the estimated error, and some allowance, of the differences.
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
        lines = []
        for m, name in enumerate(self.names):
            verb = "agrees with" if self.agrees[m] else "DISAGREES with"
            lines.append(
                f"{name}: the derivative in a random direction, {self.derivative[m]:.10g}, {verb} differences of runs, "
                f"{self.extrapolated[m]:.10g} (estimated error {self.error[m]:.1g}; at the two distances "
                f"{self.differences[0, m]:.10g} and {self.differences[1, m]:.10g})"
            )
        return "\n".join(lines)


def check_gradient(
    spec: RunSpec,
    parameters: Sequence[Parameter],
    measured: Callable[[Sequence[RunSpec]], np.ndarray],
    sizes: Mapping[str, float],
    jacobian: np.ndarray,
) -> GradientCheck:
    """Check a gradient by four runs.

    Parameters
    ----------
    measured
        Returns the measures (N, M) of N runs.
    sizes
        Sizes of the numbers that each measure is computed from, by its name.
    jacobian
        (M, K) their gradients.
    """
    signs = np.random.default_rng(18).choice([-1.0, 1.0], size=len(parameters))
    direction = signs * np.array([one.scale for one in parameters])
    specs = VariedSpecs(spec.canonical_json())
    shares = [share for step in STEPS for share in (step, -step)]
    runs = measured(
        [
            specs.spec(
                [(one.path, one.value + share * change) for one, change in zip(parameters, direction, strict=True)]
            )
            for share in shares
        ]
    )
    steps = np.array(STEPS)
    differences = (runs[::2] - runs[1::2]) / (2.0 * steps[:, None])
    ratio = (STEPS[1] / STEPS[0]) ** 2
    extrapolated = (ratio * differences[0] - differences[1]) / (ratio - 1.0)
    derivative = jacobian @ direction
    size = np.array([*sizes.values()])
    error = np.abs(extrapolated - differences[0]) + ROUND_OFF * size / STEPS[0]
    terms = np.sum(np.abs(jacobian * direction), axis=1)
    deviation = np.abs(derivative - extrapolated)
    agrees = deviation <= ALLOWED * error + SMALLEST * terms
    return GradientCheck(direction, steps, derivative, differences, extrapolated, error, agrees, tuple(sizes))
