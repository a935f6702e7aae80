"""Stabilization of a run against constraint drift, independent of the choice of integration method."""

from __future__ import annotations

from typing import Literal

import numpy as np

from mbdkit.base.frozen import dataclass

Kind = Literal["none", "baumgarte", "projection"]


@dataclass(frozen=True)
class Stabilization:
    """Stabilization against drift of the constraints.

    - `kind`: ``none``; ``baumgarte``: the constraints are replaced by Phi'' + 2 alpha Phi' + beta^2 Phi = 0;
      ``projection``: positions and velocities are projected onto the constraints, with the least change in the mass
      metric.
    - `alpha`, `beta`: coefficients of Baumgarte's terms [1/s].
    - `every`: number of steps between projections, or between checks of the residuals if `bound` is given.
    - `bound`: project only if the residual of a constraint [m, rad] or its time derivative [m/s, rad/s] exceeds this
      bound. None: project in any case.
    - `symmetric`: whether each step is projected symmetrically (Hairer 2000): the state is displaced before the step
      and projected after it with the same multipliers.
    """

    kind: Kind = "none"
    alpha: float = 0.0
    beta: float = 0.0
    every: int = 1
    bound: float | None = None
    symmetric: bool = False

    @property
    def name(self) -> str:
        """Name used in the claims of methods: the kind, or ``symmetric-projection``."""
        return "symmetric-projection" if self.symmetric else self.kind

    def describe(self) -> str:
        """Return a description such as ``projection, every 5 steps``."""
        if self.kind == "baumgarte":
            return f"Baumgarte, alpha {self.alpha:g} 1/s, beta {self.beta:g} 1/s"
        if self.kind == "none":
            return "none"
        often = "every step" if self.every == 1 else f"every {self.every} steps"
        off = "" if self.bound is None else f", if a constraint residual exceeds {self.bound:g}"
        return f"{'symmetric ' * self.symmetric}projection, {often}{off}"

    @property
    def coefficients(self) -> np.ndarray:
        """(2,) alpha and beta for the kernels; zeros unless the kind is ``baumgarte``."""
        return np.array([self.alpha, self.beta] if self.kind == "baumgarte" else [0.0, 0.0])


NONE = Stabilization()
