"""Nonlinear regressions with published answers, as problems of identification.

Misra1a and Thurber with their certified values are from the NIST Statistical Reference Datasets
(https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml); Puromycin is A1.3 of D. M. Bates, D. G. Watts, Nonlinear
Regression Analysis and Its Applications (1988), whose estimates are in 2.2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from mbdkit_identify.identify_spec import Sensor
from mbdkit_identify.measured_data import SignalData
from mbdkit_identify.problem import Problem
from mbdkit_identify.segments import Segment, Unknown


@dataclass(frozen=True)
class Regression:
    """Data, model, start, and published estimates with their standard errors and the residual sum of squares."""

    x: list[float]
    y: list[float]
    model: Callable[..., Any]
    start: tuple[float, ...]
    estimates: tuple[float, ...]
    errors: tuple[float, ...]
    squares: float

    lowest: float = -np.inf

    @property
    def problem(self) -> Problem:
        """The problem, with derivatives by complex steps, and with parameters from `lowest` on."""
        x, names = np.array(self.x), [f"b{k + 1}" for k in range(len(self.start))]
        places = {name: k for k, name in enumerate(names)}

        def values(given: dict[str, float], _: object) -> np.ndarray:
            return np.asarray(self.model(x, *given.values()))[None]

        def at(given: dict[str, float], _: object) -> SimpleNamespace:
            b = np.array([*given.values()])
            h = 1e-30 * np.maximum(np.abs(b), 1e-30)
            slopes = [self.model(x, *(b + 1j * step)).imag / step[k] for k, step in enumerate(np.diag(h))]
            return SimpleNamespace(values=values(given, _), derivatives=np.stack(slopes, axis=-1)[None])

        signal = SignalData("y", "", Sensor(), np.array(self.y), None, may_correlate=False)
        prepared: Any = SimpleNamespace(values=values, at=at, differences="")
        spec: Any = None
        segment = Segment("data", np.arange(len(x)), (signal,), spec, places, {})
        segment.prepared = prepared
        unknowns = [
            Unknown(name, start, self.lowest, size=abs(start)) for name, start in zip(names, self.start, strict=True)
        ]
        return Problem(unknowns, places, [segment])


MISRA1A = Regression(
    [77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0],
    [10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78],
    lambda x, a, b: a * (1 - np.exp(-b * x)),
    (250.0, 5e-4),
    (2.3894212918e2, 5.5015643181e-4),
    (2.7070075241, 7.2668688436e-6),
    1.2455138894e-1,
)
THURBER = Regression(
    [-3.067, -2.981, -2.921, -2.912, -2.840, -2.797, -2.702, -2.699, -2.633, -2.481, -2.363, -2.322, -1.501, -1.460,
     -1.274, -1.212, -1.100, -1.046, -0.915, -0.714, -0.566, -0.545, -0.400, -0.309, -0.109, -0.103, 0.010, 0.119,
     0.377, 0.790, 0.963, 1.006, 1.115, 1.572, 1.841, 2.047, 2.200],
    [80.574, 84.248, 87.264, 87.195, 89.076, 89.608, 89.868, 90.101, 92.405, 95.854, 100.696, 101.060, 401.672, 390.724,
     567.534, 635.316, 733.054, 759.087, 894.206, 990.785, 1090.109, 1080.914, 1122.643, 1178.351, 1260.531, 1273.514,
     1288.339, 1327.543, 1353.863, 1414.509, 1425.208, 1421.384, 1442.962, 1464.350, 1468.705, 1447.894, 1457.628],
    lambda x, a, b, c, d, e, f, g: (a + b * x + c * x**2 + d * x**3) / (1 + e * x + f * x**2 + g * x**3),
    (1300.0, 1500.0, 500.0, 75.0, 1.0, 0.4, 0.05),
    (1.2881396800e3, 1.4910792535e3, 5.8323836877e2, 7.5416644291e1, 9.6629502864e-1, 3.9797285797e-1, 4.9727297349e-2),
    (4.6647963344, 3.9571156086e1, 2.8698696102e1, 5.5675370270, 3.1333340687e-2, 1.4984928198e-2, 6.5842344623e-3),
    5.6427082397e3,
)  # fmt: skip
PUROMYCIN = Regression(
    [0.02, 0.02, 0.06, 0.06, 0.11, 0.11, 0.22, 0.22, 0.56, 0.56, 1.10, 1.10],
    [76, 47, 97, 107, 123, 139, 159, 152, 191, 201, 207, 200],
    lambda x, v, k: v * x / (k + x),
    (205.0, 0.08),
    (212.7, 0.06412),
    (6.947, 0.008281),
    1195.0,
)
