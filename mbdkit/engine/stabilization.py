"""How a run keeps its constraints from drifting: a choice of its own, told to the equations and to the stepper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Kind = Literal["none", "baumgarte", "projection"]


@dataclass(frozen=True)
class Stabilization:
    """What is done against the drift of constraints.

    Parameters
    ----------
    kind
        ``none``; ``baumgarte``: constraint accelerations are pulled back, Phi'' + 2 alpha Phi' + beta^2 Phi = 0;
        ``projection``: positions and velocities are moved onto the constraints by the least change in the mass metric.
    alpha, beta
        Of Baumgarte's terms [1/s].
    every
        Project, or look whether to project, after every k-th step.
    bound
        Project only where a constraint's residual exceeds it: Phi in metres and radians, or its rate per second; None
        projects in any case.
    symmetric
        Whether each step is projected symmetrically (Hairer 2000): moved off the constraints before it by the same
        multipliers as onto them after it.
    """

    kind: Kind = "none"
    alpha: float = 0.0
    beta: float = 0.0
    every: int = 1
    bound: float | None = None
    symmetric: bool = False

    @property
    def name(self) -> str:
        """What a method's claims call it: the kind, or ``symmetric-projection``."""
        return "symmetric-projection" if self.symmetric else self.kind

    def describe(self) -> str:
        """Return it in words, such as ``projection, every 5 steps``."""
        if self.kind == "baumgarte":
            return f"Baumgarte, alpha {self.alpha:g} 1/s, beta {self.beta:g} 1/s"
        if self.kind == "none":
            return "none"
        often = "every step" if self.every == 1 else f"every {self.every} steps"
        off = "" if self.bound is None else f", where a constraint is off by {self.bound:g}"
        return f"{'symmetric ' * self.symmetric}projection, {often}{off}"

    @property
    def coefficients(self) -> np.ndarray:
        """(2,) alpha and beta as the kernels take them; zeros unless it is Baumgarte's."""
        return np.array([self.alpha, self.beta] if self.kind == "baumgarte" else [0.0, 0.0])


NONE = Stabilization()
"""Nothing is done, and the drift of a method shows."""
