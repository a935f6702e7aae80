"""SciPy and scikit-SUNDAE on right sides in Python, in minimal coordinates: the rods' angles and rates."""

from __future__ import annotations

import functools
import importlib.util
import warnings
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from .contender import TOLERANCES, Contender, Outcome, lost, timed
from .motions import Motion
from .rods import Array


def interpreted(motion: Motion) -> tuple[list[Contender], list[str]]:
    """Return SciPy's explicit methods, CVODE and IDA, and what is not installed."""
    methods = ("DOP853", "LSODA") if motion.rods.count == 2 else ("DOP853",)  # LSODA takes minutes for the chain
    found = [Contender("SciPy", method, functools.partial(_scipy, motion, method), TOLERANCES) for method in methods]
    if not importlib.util.find_spec("sksundae"):
        return found, ["scikit-sundae"]
    solvers = {
        "CVODE Adams": functools.partial(_cvode, motion, "Adams"),
        "CVODE BDF": functools.partial(_cvode, motion, "BDF"),
        "IDA": functools.partial(_ida, motion),
    }
    found += [Contender("scikit-sundae", method, run, TOLERANCES) for method, run in solvers.items()]
    return found, []


def _outcome(motion: Motion, state: Array | None, wall: float, cpu: float) -> Outcome:
    count = motion.rods.count
    if state is None:
        return lost(count, wall, cpu)
    return Outcome(wall, cpu, motion.rods.centres(state[:count]))


def _scipy(motion: Motion, method: str, tolerance: float) -> Outcome:
    """Run `solve_ivp`; of its own time most is what its steps cost in Python."""
    right_side, end, start = motion.rods.right_side(), motion.end, motion.start
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it raises the finest tolerance, and what too coarse ones do
        found, wall, cpu = timed(
            lambda: solve_ivp(
                right_side, (0.0, end), start, method=method, t_eval=[end], rtol=tolerance, atol=tolerance
            )
        )
    return _outcome(motion, found.y[:, -1] if found.success else None, wall, cpu)


def _cvode(motion: Motion, family: str, tolerance: float) -> Outcome:
    """Run CVODE; the Jacobian is CVODE's own, by differences, and seldom renewed."""
    from sksundae.cvode import CVODE

    right_side = motion.rods.right_side()

    def rates(time: float, state: Array, out: Array) -> None:
        out[:] = right_side(time, state)

    solver = CVODE(rates, method=family, rtol=tolerance, atol=tolerance, max_num_steps=10_000_000)
    return _sundials(motion, solver, (motion.start,))


def _ida(motion: Motion, tolerance: float) -> Outcome:
    """Run IDA on y' - f(t, y) = 0."""
    from sksundae.ida import IDA

    right_side = motion.rods.right_side()

    def residual(time: float, state: Array, slope: Array, out: Array) -> None:
        np.subtract(slope, right_side(time, state), out=out)

    solver = IDA(residual, rtol=tolerance, atol=tolerance, max_num_steps=10_000_000)
    return _sundials(motion, solver, (motion.start, np.array(right_side(0.0, motion.start))))


def _sundials(motion: Motion, solver: Any, start: tuple[Array, ...]) -> Outcome:
    with np.errstate(all="ignore"):
        found, wall, cpu = timed(lambda: solver.solve(np.array([0.0, motion.end]), *start))
    return _outcome(motion, found.y[-1] if found.success else None, wall, cpu)
