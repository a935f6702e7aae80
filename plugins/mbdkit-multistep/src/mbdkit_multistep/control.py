"""What both methods share: interpolation in unequally spaced times, and the choice of order and step size.

Orders and sizes are chosen as in CVODE (Hindmarsh et al. 2005, section 2.1), by the estimated errors of the present
order and of those next to it; the order only changes after as many steps as its formula has points. Sizes change in
every step, because coefficients and matrices are computed in every step anyway.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np

import mbdkit
from mbdkit.plugin.methods import ControlledOptions

#: Factors of the estimated errors of the present and the lower order, and of the higher one, in the choice of the next
#: step. CVODE has 6 and 10, with which errors at the end of runs were two to twenty times as large, in steps that were
#: longer by a tenth to a fifth (pendulum, car axis, Andrews' mechanism).
BIAS, BIAS_ABOVE = 20.0, 30.0
#: Bounds of the size of a step over that of the last one. The upper one is that of DASSL: formulas of high order are
#: not stable in steps that go on growing faster.
LARGEST, SMALLEST = 2.0, 0.1


class MultistepOptions(ControlledOptions):
    """Options of a multistep method, whose steps are always adaptive."""

    adaptive: Literal[True] = True
    """Steps and orders are chosen by error estimates; `time.step` is the first step and may be omitted."""

    def tolerances(self) -> mbdkit.Tolerances:
        """Return the tolerances."""
        result = super().tolerances()
        assert result is not None  # because steps are adaptive
        return result


class Choice(NamedTuple):
    """Whether a step is accepted; size of the next step [s] or attempt; its order; steps until the order may change."""

    accepted: bool
    size: float
    order: int
    wait: int


def choice(errors: Mapping[int, float], order: int, wait: int, h: float) -> Choice:
    """Return the choice after a step of size `h`, from the errors over the tolerance of some orders."""
    error = errors[order]
    if not error <= 1.0:
        shrink = 0.9 * error ** (-1 / (order + 1)) if math.isfinite(error) else 0.25
        least = SMALLEST if order > 1 else SMALLEST**3  # after a start with a step of any size
        return Choice(False, h * min(max(shrink, least), 0.9), order, wait)
    growth = {
        k: ((BIAS_ABOVE if k > order else BIAS) * e + 1e-6) ** (-1 / (k + 1))
        for k, e in errors.items()
        if k == order or wait <= 1
    }
    best = max(growth, key=lambda k: growth[k])
    size = h * min(max(growth[best], SMALLEST), LARGEST)
    return Choice(True, size, best, max(wait - 1, 1) if best == order else best + 1)


def scale(
    tolerances: mbdkit.Tolerances, equations: mbdkit.EquationsOfMotion, begin: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """Return the tolerances of (q, v, z) in a step between two states."""
    length = min(1.0, equations.length) if tolerances.by_size else 1.0
    units = np.ones(len(begin))
    units[: 2 * equations.n] = np.tile([length, length, 1.0], 2 * equations.n // 3)
    values: np.ndarray = tolerances.atol * units + tolerances.rtol * np.maximum(np.abs(begin), np.abs(end))
    return values


def norm(error: np.ndarray, scales: np.ndarray) -> float:
    """Return the root mean square of an error over its tolerances."""
    return float(np.sqrt(np.mean((error / scales) ** 2)))
