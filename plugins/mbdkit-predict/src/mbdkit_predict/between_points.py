"""What a solution leaves of the equations between its collocation points, by a second quadrature with many nodes.

A solution satisfies the equations at its collocation points, whatever they contain in between: a pulse that no point
meets is not part of the problem on its mesh, and a mesh of twice as many intervals may miss it as well. The polynomials
of the solution are therefore put into the equations at `NODES` times of the motion, and at ever denser ones towards the
ends of phases, where motions from or to rest meet friction that almost jumps. What remains of the equations of motion,
the constraints and the rates of the states, and the error of the quadrature of integrands, change the objective to
first order by their integrals times the multipliers (dual-weighted residuals: R. Becker and R. Rannacher, Acta Numerica
10:1-102, 2001). The forces that remain are also compared with those that act, because multipliers may vanish where
these remain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdkit.mechanism.values import curve_of
from mbdkit_predict.grid import weights
from mbdkit_predict.point_functions import ARGUMENTS, OF_POINTS
from mbdkit_predict.transcription import Mesh, Transcription

#: Least number of nodes in a motion, as many as there are samples of a motion in runs; and before the objective is
#: accurate.
NODES, FEW = 10_000, 1_000
#: Ends of panels that resolve jumps of some width at the ends of phases, where expressions may have no value, as shares
#: of the outermost panels.
GRADED = 2.0 ** -np.arange(1, 31)
PANEL = 5  #: Nodes of the Gauss-Legendre formula of each of the panels into which an interval is divided.
BULK = 0.99  #: Share of what remains that the intervals have which are divided.
#: Least size of moments relative to forces, and of changes of states relative to the states: smaller ones are noise.
LEAST = 1e-6


class Residual(NamedTuple):
    """What a solution leaves of the equations, for each of N intervals."""

    change: np.ndarray  #: (N,) First-order change of the objective.
    #: (N,) Largest impulse of the forces that remain, as a share of the largest impulse of the forces that act in the
    #: whole motion. Forces, moments and the rates of each state are compared apart.
    impulse: np.ndarray

    def is_large(self, change: float, impulse: float) -> np.ndarray:
        """Return the fewest intervals (N,) that make up `BULK` of each sum beyond its limit, none if both are within
        them (W. Doerfler, SIAM Journal on Numerical Analysis 33:1106-1124, 1996).
        """
        chosen = np.zeros(len(self.change), dtype=bool)
        for sizes, limit in ((abs(self.change), change), (self.impulse, impulse)):
            order = np.argsort(-sizes)
            if sizes.sum() > limit:
                chosen[order[: 1 + np.searchsorted(np.cumsum(sizes[order]), BULK * sizes.sum())]] = True
        return chosen


def residual_between_points(method: Transcription, mesh: Mesh, least: int = NODES, *, is_held: bool = True) -> Residual:
    """Return what a solution leaves of the equations between its collocation points, by so many nodes at least.

    Operations that jump are held or not.
    """
    values, count, b = mesh.values, len(mesh.grid.phase), method.b
    lengths, every = values["duration"] @ mesh.grid.lengths, np.arange(count)
    _, own_rates, own_integrands, _ = own = _evaluated(method, mesh, values, mesh.times, every)
    at_rest = _evaluated(method, mesh, {**values, "a": 0.0 * values["a"]}, mesh.times, every)[-1]
    whole = own_integrands @ b
    multipliers = method.multipliers(mesh, whole @ lengths)
    even = np.linspace(0.0, 1.0, -(-least // (count * PANEL)) + 1)
    graded = np.unique(np.concatenate([even, even[1] * GRADED, 1.0 - even[1] * GRADED]))[1:-1]
    last = np.array(mesh.grid.ends_of_phases())
    outer = np.union1d(last, np.append(0, last[:-1] + 1))
    change, impulse = np.zeros(count), np.zeros((len(at_rest) + len(own_rates), count))
    for chosen, ends in ((np.setdiff1d(every, outer), even), (outer, graded)):
        if len(chosen):
            change[chosen], impulse[:, chosen] = _remaining(
                method, mesh, own, multipliers, chosen, ends, is_held=is_held
            )
    acting = abs(np.concatenate([at_rest, own_rates]))
    acting[: len(at_rest)] *= 2.0  # those of inertia, and those that they balance
    states = abs(values["z"]).max(axis=1, initial=0.0)
    return Residual(change, _largest_share(impulse, acting @ b @ lengths, states, method.system.is_angle))


def _remaining(
    method: Transcription,
    mesh: Mesh,
    own: Sequence[np.ndarray],
    multipliers: Sequence[np.ndarray],
    chosen: np.ndarray,
    ends: np.ndarray,
    *,
    is_held: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the change of the objective (K,) and the impulses of forces and rates (rows, K) of K chosen intervals, by
    panels with given ends, as shares of an interval.
    """
    values, b = mesh.values, method.b
    lengths = (values["duration"] @ mesh.grid.lengths)[chosen]
    nodes, weight = np.polynomial.legendre.leggauss(PANEL)
    sizes = 0.5 * np.diff(ends)[:, None]
    shares, weight = (ends[:-1, None] + sizes * (nodes + 1.0)).ravel(), (sizes * weight).ravel()
    times = (values["duration"] @ mesh.grid.ends[:, chosen] - lengths)[:, None] + lengths[:, None] * shares
    at, of = np.tile(shares, len(chosen)), np.repeat(chosen, len(shares))
    x = {name: method.values_at(mesh, name, at, of) for name in OF_POINTS}
    for name, table in method.spec.tables.items():
        x["u"][method.spec.chosen.control_states.index(f"measured.{name}")] = curve_of(table)(times.ravel())
    at_nodes = weights(method.c, shares)

    def between(at_points: np.ndarray) -> np.ndarray:
        return np.asarray(at_points.reshape(len(at_points), len(mesh.grid.phase), len(b))[:, chosen] @ at_nodes)

    closed, rates, integrands, forces = _evaluated(method, mesh, x, times, chosen, is_held=is_held)
    _, own_rates, own_integrands, _ = own
    by_integrals, by_motion, by_rates = multipliers
    defects = between(own_rates) - rates
    missed = (between(by_motion) * np.concatenate([forces, closed])).sum(axis=0)
    missed += (between(by_rates) * defects).sum(axis=0)
    change = lengths * (by_integrals @ (integrands @ weight - own_integrands[:, chosen] @ b) - missed @ weight)
    return change, abs(np.concatenate([forces, defects]) @ weight) * lengths


def _evaluated(
    method: Transcription,
    mesh: Mesh,
    values: Mapping[str, np.ndarray],
    times: np.ndarray,
    chosen: np.ndarray,
    *,
    is_held: bool = True,
) -> tuple[np.ndarray, ...]:
    """Return constraints, rates, integrands and forces, (rows, N, K), of unknowns at K times in each of N chosen
    intervals.
    """
    x = {name: values[name].reshape(len(values[name]), times.size) for name in OF_POINTS}
    p, count = ca.repmat(mesh.values["p"], 1, times.size), len(chosen)
    given = [*(x[name] for name in ARGUMENTS), p, times.reshape(1, -1), x["mu"]]
    sides = [method.sides[:, np.repeat(mesh.grid.phase[chosen], times.size // count)]] if is_held else []
    results = (method.stage if is_held else method.functions.unheld).map(times.size)(*given, *sides)
    rows = (np.array(results[k]) for k in (0, 2, 3, 4))
    return tuple(row.reshape(len(row), count, times.size // count) for row in rows)


def _largest_share(values: np.ndarray, sizes: np.ndarray, states: np.ndarray, is_angle: np.ndarray) -> np.ndarray:
    """Return the largest values (N,) of forces, moments and rates (rows, N), each as a share of the largest size of its
    kind (rows,); sizes are at least `LEAST` of all forces, or of the states (Z,).
    """
    count = len(is_angle)
    kinds = np.concatenate([-1 - is_angle, np.arange(len(states))])
    largest = np.array([sizes[kinds == kind].max() for kind in kinds])
    least = np.concatenate([np.full(count, sizes[:count].max(initial=0.0)), states])
    largest = np.maximum(largest, LEAST * least)
    return np.asarray((values / np.where(largest > 0.0, largest, np.inf)[:, None]).max(axis=0, initial=0.0))


def change_by_held(method: Transcription, mesh: Mesh) -> tuple[float, float]:
    """Return the first-order change of the objective if no operations are held, and the largest share of an impulse."""
    held, free = (residual_between_points(method, mesh, is_held=side) for side in (True, False))
    return float((free.change - held.change).sum()), float((free.impulse - held.impulse).max(initial=0.0))
