"""The forward run of a prediction: its controls are integrated by another method, with the machine code of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count, pairwise

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit_predict.transcription import Mesh, Transcription

Rates = Callable[[float, np.ndarray], np.ndarray]

PRECISION = 1e-9  #: Relative tolerance of the integration.
#: Methods; the second one, which is implicit where the motion is stiff, is used if the first one needs too many
#: evaluations, or its numbers overflow.
EXPLICIT, IMPLICIT = "DOP853", "LSODA"
BESIDE = 1e-9  #: Distance of states from jumps at which expressions are evaluated, as a share of an interval.
MOST_EVALUATIONS = 400  #: Largest number of evaluations of the explicit method in an interval.


@dataclass(frozen=True)
class Difference:
    """How a forward run differs from the prediction, as a share of the range of the motion.

    Ranges and differences are those of all coordinates x and y, and of all angles; differences of each first-order
    state are shares of its largest magnitude.

    Attributes
    ----------
    end, largest
        At the end, and the largest one at the ends of intervals; nan if the integration stopped before the end.
    of_intervals
        The sum of the differences of all intervals, each of which starts on the predicted motion.
    """

    end: float = np.nan
    largest: float = np.nan
    of_intervals: float = np.nan


def forward_difference(
    equations: EquationsOfMotion, method: Transcription, mesh: Mesh, *, is_beside: bool
) -> Difference:
    """Integrate the controls of a solution from the start on, and also each interval on its own; with `is_beside`, from
    and to states just beside the ends of intervals, where expressions may have no value.
    """
    names, chosen, points = method.system.compiled_states, method.spec.chosen.control_states, method.c
    n, size = equations.n, 2 * equations.n + len(names)
    rows = np.array([names.index(name) for name in chosen if name in names])  # unknowns of fibres are no states
    u = mesh.values["u"][[name in names for name in chosen]]
    controls, times = u.reshape(len(u), -1, len(points)), np.append(0.0, mesh.values["duration"] @ mesh.grid.ends)
    nodes = method.states_of_bodies(mesh, method.nodes(mesh), times).T
    predicted = np.zeros((len(nodes), size))
    predicted[:, np.delete(np.arange(size), 2 * n + rows)] = nodes
    starts = predicted[:-1].copy()
    if is_beside:
        later = np.vstack([method.values_at(mesh, name, np.array([BESIDE]))[..., 0] for name in "qvz"])
        starts[:, np.delete(np.arange(size), 2 * n + rows)] = method.states_of_bodies(mesh, later, times[:-1]).T
    scale = _scale(predicted, n)
    checked = np.delete(np.arange(size), np.concatenate([np.arange(n, 2 * n), 2 * n + rows]))
    ends, alone = list[np.ndarray](), list[np.ndarray]()
    powers, matrix = np.arange(len(points)), np.vander(points, increasing=True)
    try:
        for i, (begin, end) in enumerate(pairwise(times)):
            coefficients = np.linalg.solve(matrix, controls[:, i].T)

            def rates(
                t: float, y: np.ndarray, b: float = begin, h: float = end - begin, k: np.ndarray = coefficients
            ) -> np.ndarray:
                z = y[2 * n :].copy()
                z[rows] = ((t - b) / h) ** powers @ k
                a, _, of_states = equations.derivatives(t, y[:n], y[n : 2 * n], z)
                of_states[rows] = 0.0
                return np.concatenate([y[n : 2 * n], a, of_states])

            beside = BESIDE * (end - begin) * is_beside
            first, last = begin + beside, end - beside
            stops = [first, *(t for t in method.breaks if first < t < last), last]
            alone.append(_integrated(rates, stops, starts[i], scale))
            ends.append(_integrated(rates, stops, ends[-1], scale) if i else alone[0])
    except StepError:
        return Difference()
    differences, defects = ((abs(x - predicted[1:]) / scale)[:, checked].max(axis=1) for x in (ends, alone))
    return Difference(float(differences[-1]), float(differences.max()), float(defects.sum()))


def _integrated(rates: Rates, stops: Sequence[float], state: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return the state at the end of an interval, given its start, its end and the discontinuities in between."""
    from scipy.integrate import solve_ivp  # loaded while other processes solve the problem

    absolute = PRECISION * np.where(np.isfinite(scale), scale, 1.0)
    options: dict[str, float | np.ndarray] = {"rtol": PRECISION, "atol": absolute}
    for span in pairwise(stops):
        try:
            # one step, of which the error is estimated, is often enough
            result = solve_ivp(_counted(rates), span, state, EXPLICIT, first_step=span[1] - span[0], **options)
        except StepError:
            result = solve_ivp(rates, span, state, IMPLICIT, **options)
        state = np.asarray(result.y[:, -1])
        if not (result.success and np.all(np.isfinite(state))):
            raise StepError("not-finite", "the forward run stopped")
    return state


def _counted(rates: Rates) -> Rates:
    """Return a function that refuses more evaluations than the explicit method may need in an interval."""
    evaluations = count(1)

    def counted(t: float, y: np.ndarray) -> np.ndarray:
        if next(evaluations) > MOST_EVALUATIONS:
            raise StepError("step-too-small", "the explicit method needs too many evaluations")
        return rates(t, y)

    return counted


def _scale(states: np.ndarray, n: int) -> np.ndarray:
    """Return the ranges (2 n + Z,) of coordinates and velocities, infinite if nothing moves, and the largest magnitudes
    of states, because some hardly change.
    """
    ranges = np.concatenate([np.ptp(states[:, : 2 * n], axis=0), abs(states[:, 2 * n :]).max(axis=0)])
    for begin in (0, n):
        of_bodies = ranges[begin : begin + n].reshape(-1, 3)
        of_bodies[:, :2], of_bodies[:, 2] = of_bodies[:, :2].max(), of_bodies[:, 2].max()
    return np.where(ranges > 1e-9, ranges, np.inf)
