"""The textbook's equations of motion of its four-bar linkage in three link angles.

Two particles of equal mass are fixed to the far ends of the first and the second of three massless links. The state
consists of the relative link angles q1, q2, q3 and the rate u1 of the first. The two other rates follow from the loop
constraint at velocity level. The loop constraint is not enforced at position level, so that integration error opens the
loop; this gap is the residual that the textbook plots.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

LENGTHS = np.array([0.8, 2.0, 1.0])  # m, first to third link
GROUND = 2.0  # m, between the supports
GRAVITY = 9.81  # m/s^2
START = math.radians(10.0)  # rad, initial angle of the first link
END = 30.0  # s
FRAMES = 600  # rows of the figures in the book, 20 per second


@dataclass(frozen=True)
class LoopRun:
    """Result of an integration of the textbook's equations.

    Attributes
    ----------
    residual
        Largest component of the gap of the loop over the rows of the figure [m].
    evaluations
        Number of evaluations of the right-hand side.
    seconds
        Wall time [s].
    """

    residual: float
    evaluations: int
    seconds: float


def gap(angles: np.ndarray) -> np.ndarray:
    """Return the gap (..., 2) of the loop [m] for relative link angles (..., 3) [rad]."""
    total = np.cumsum(angles, axis=-1)
    ends = np.stack([np.cos(total), np.sin(total)], axis=-1) * LENGTHS[:, None]
    return np.asarray(ends.sum(axis=-2) - (GROUND, 0.0))


def start() -> np.ndarray:
    """Return the start (q1, q2, q3, u1): at rest, first link at 10 degrees, third joint above the supports."""
    joint = LENGTHS[0] * np.array([math.cos(START), math.sin(START)])
    across = np.array([GROUND, 0.0]) - joint
    distance = float(np.hypot(*across))
    first, second = LENGTHS[1], LENGTHS[2]
    turn = math.acos((first**2 + distance**2 - second**2) / (2 * first * distance))
    coupler = math.atan2(across[1], across[0]) + turn
    end = joint + first * np.array([math.cos(coupler), math.sin(coupler)])
    return np.array([START, coupler - START, math.atan2(-end[1], GROUND - end[0]) - coupler, 0.0])


def rates(t: float, state: np.ndarray) -> np.ndarray:
    """Return the time derivative of the state (q1, q2, q3, u1); it does not depend on the masses, because they are
    equal.
    """
    total = np.cumsum(state[:3])
    along = np.stack([np.cos(total), np.sin(total)]) * LENGTHS  # (2, 3), one column per link
    across = np.stack([-along[1], along[0]])
    spin = np.array([state[3], *np.linalg.solve(across[:, 1:], -across[:, 0] * state[3])])
    # The gap has zero acceleration. By d'Alembert's principle, inertia forces and weight do no work in the virtual
    # rotation that keeps the loop closed.
    turns = np.array([1.0, *np.linalg.solve(across[:, 1:], -across[:, 0])])
    first, second = across * [1, 0, 0], across * [1, 1, 0]
    back = along * spin**2
    closing = np.concatenate([[0.0], np.linalg.solve(across[:, 1:], back.sum(axis=1))])
    inertia = work = 0.0
    for lever, centripetal in ((first, back[:, 0]), (second, back[:, 0] + back[:, 1])):
        direction = lever @ turns
        inertia += float(direction @ direction)
        work += float(direction @ (np.array([0.0, -GRAVITY]) + centripetal - lever @ closing))
    return np.array([spin[0], spin[1] - spin[0], spin[2] - spin[1], work / inertia])


def integrate(rtol: float, atol: float, shift: float = 0.0) -> LoopRun:
    """Integrate the textbook's equations with SciPy's default solver (Dormand-Prince, order 5), as the textbook does.

    Parameters
    ----------
    rtol, atol
        Tolerances; the book uses the defaults of the solver, 1e-3 and 1e-6.
    shift
        Perturbation of the second initial angle [rad], to measure the sensitivity to round-off.
    """
    begin = time.perf_counter()
    state = start() + np.array([0.0, shift, 0.0, 0.0])
    rows = np.linspace(0.0, END, FRAMES)
    result = solve_ivp(rates, (0.0, END), state, t_eval=rows, rtol=rtol, atol=atol, method="RK45")
    seconds = time.perf_counter() - begin
    return LoopRun(float(np.max(np.abs(gap(result.y[:3].T)))), int(result.nfev), seconds)
