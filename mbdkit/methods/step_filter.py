"""Controllers of adaptive steps as digital filters: a row of coefficients (Soderlind 2003)."""

from __future__ import annotations

import math
from typing import Never

from mbdkit.base.errors import PluginError
from mbdkit.base.frozen import dataclass
from mbdkit.registry.seam import OwnSeam


@dataclass(frozen=True)
class StepFilter:
    """A controller of adaptive steps.

    After a step of size h_n with the error e_n, relative to its tolerance, the size of the next step is

        h_(n+1) = h_n (s/e_n)^(b1/k) (s/e_(n-1))^(b2/k) (s/e_(n-2))^(b3/k) (h_n/h_(n-1))^(-a2) (h_(n-1)/h_(n-2))^(-a3)

    where k is the order of the error estimate in the step size, and s = safety^k (Soderlind 2003, ACM TOMS 29, 1-26).
    As long as there are too few earlier steps, and after a rejected step, it is ``h safety e^(-1/k)``.

    Parameters
    ----------
    errors
        Coefficients b1, b2, b3 of the errors of the last three steps, with k, as in tables of controllers; trailing
        ones may be omitted.
    ratios
        Coefficients a2, a3 of the ratios of the last three step sizes; trailing ones may be omitted.
    safety
        Size at which the error equals s, as a share of the size at which it equals the tolerance.
    limits
        Smallest and largest ratio of the sizes of two consecutive steps.

    Raises
    ------
    PluginError
        If a value is not possible, or if the step sizes do not settle where the error depends on the step size alone,
        because a pole of the closed loop is not inside the unit circle.
    """

    errors: tuple[float, ...]
    ratios: tuple[float, ...] = ()
    safety: float = 0.9
    limits: tuple[float, float] = (0.2, 6.0)

    def __post_init__(self) -> None:
        for name, most in (("errors", 3), ("ratios", 2), ("limits", 2)):
            values: object = getattr(self, name)
            if not isinstance(values, tuple) or len(values) > most or not all(map(_is_number, values)):
                raise PluginError(f"the {name} of the controller are {values!r}, not a tuple of at most {most} numbers")
        if not (_is_number(self.safety) and 0.0 < self.safety < 1.0):
            raise PluginError(f"the safety factor of the controller is {self.safety!r}, not a number between 0 and 1")
        if not (len(self.limits) == 2 and 0.0 < self.limits[0] < 1.0 < self.limits[1]):
            raise PluginError(
                f"the limits of the controller are {self.limits!r}, not a number between 0 and 1 and one above 1"
            )
        object.__setattr__(self, "errors", (*map(float, self.errors), 0.0, 0.0, 0.0)[:3])
        object.__setattr__(self, "ratios", (*map(float, self.ratios), 0.0, 0.0)[:2])
        if not (largest := max(map(abs, self.poles()))) < 1.0:
            raise PluginError(
                f"the controller is unstable: a pole of the closed loop has the modulus {largest:.4g}, which must be "
                "less than 1"
            )

    def poles(self) -> tuple[complex, ...]:
        """Return the three poles of the closed loop.

        If the logarithm of the error is k log(h) plus a disturbance, deviations of the step size decay as their powers.
        """
        import numpy as np

        (b1, b2, b3), (a2, a3) = self.errors, self.ratios
        return tuple(map(complex, np.roots([1.0, a2 - 1.0 + b1, a3 - a2 + b2, b3 - a3])))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


@OwnSeam
def step_filter(options: Never, /) -> StepFilter:
    """Return the coefficients of the controller with these options."""
    raise NotImplementedError
