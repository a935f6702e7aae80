"""Control of the step by an estimate of the local error: tolerances, exponents, and the first step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.kernels.observe import first_order_rates

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace


@dataclass(frozen=True)
class Control:
    """How steps are chosen.

    The estimate of an implicit method is of lower order than the method. Were it held to the tolerance itself, the
    error would fall with a power of the tolerance; so it is held to ``scale tolerance^(estimate_order / order)``, with
    which the step shrinks as the method needs for an error in proportion to the tolerance.

    Parameters
    ----------
    rtol, atol
        Tolerances of the user: relative, and absolute [m, rad, m/s, rad/s].
    order
        Order of the method.
    estimate_order
        Order of the estimate of the local error in the step.
    estimates
        1, or 2 where a second one of lower order keeps the first in check.
    scale
        Factor of the tolerance of the estimate.
    memory
        Share of the last error in the choice of a step (proportional-integral control), over the exponent of the error
        at hand: 0.2 keeps explicit methods calm at the edge of their stability. Implicit ones have no such edge; for
        them the errors follow the tolerance most evenly with 0.
    """

    rtol: float = 1e-6
    atol: float = 1e-8
    order: float = 1.0
    estimate_order: float = 1.0
    estimates: int = 1
    scale: float = 1.0
    memory: float = 0.0

    @property
    def inner_rtol(self) -> float:
        """The relative tolerance that the estimate is held to."""
        return float(self.scale * self.rtol ** (self.estimate_order / self.order))

    @property
    def inner_atol(self) -> float:
        """The absolute one, in the same proportion as the user has it."""
        return self.inner_rtol * self.atol / self.rtol

    @property
    def exponent(self) -> float:
        """What the step of a controller without memory goes by: 1 over the order of the estimate."""
        return 1.0 / self.estimate_order

    @property
    def share(self) -> float:
        """Exponent of the last error in the choice of a step, beta of Hairer and Wanner (1996), IV.2."""
        return self.memory / self.estimate_order

    @property
    def iteration_tolerance(self) -> float:
        """Relative change of accelerations at which the iteration of an implicit method ends."""
        return min(1e-3 * self.rtol, 1e-8)


FIXED_STEPS = Control()
"""Stands where nothing is controlled."""


def first_step(workspace: Workspace, span: float, control: Control) -> float:
    """Return a cautious first step [s] (Hairer, Norsett and Wanner 1993, II.4, first stage).

    Parameters
    ----------
    workspace
        The mechanism at its start.
    span
        Length of the run [s].
    control
        With the tolerances.
    """
    n3 = 3 * len(workspace.mechanism.bodies)
    y = np.concatenate([workspace.q0[:n3], workspace.v0[:n3], np.zeros(2)])
    rates = np.zeros_like(y)
    acc, lam = np.zeros((3, workspace.mechanism.size)), np.zeros((len(workspace.stepping_topology.pairs), 2))
    first_order_rates(workspace.stepping_engine, False, workspace.t0, y, acc, lam, rates)
    scale = control.atol + control.rtol * np.abs(y)
    d0, d1 = (float(np.sqrt(np.mean((x[:-2] / scale[:-2]) ** 2))) for x in (y, rates))
    guess = 0.01 * d0 / d1 if d0 > 1e-5 and 1e-5 < d1 < np.inf else 1e-6
    return float(min(guess, 0.01 * span))
