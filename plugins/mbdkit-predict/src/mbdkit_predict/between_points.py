"""What a solution leaves of the equations between its collocation points, by a second quadrature with many nodes.

A solution satisfies the equations at its collocation points, whatever they contain in between: a pulse that no point
meets is not part of the problem on its mesh, and a mesh of twice as many intervals may miss it as well. The polynomials
of the solution are therefore put into the equations at `NODES` times of the motion. What remains of the equations of
motion, the constraints and the rates of the states, and the error of the quadrature of integrands, change the objective
to first order by their integrals times the multipliers (dual-weighted residuals: R. Becker and R. Rannacher, Acta
Numerica 10:1-102, 2001). The forces that remain are also compared with those that act, because multipliers may vanish
where these remain.

Where a force jumps at a certain state, as steep friction does, the motion may pass this state at the end of an
interval. Nothing remains of the equations then, but the optimizer does not know how a change of the motion changes the
time of the jump.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdkit.mechanism.values import curve_of
from mbdkit_predict.grid import weights
from mbdkit_predict.transcription import Mesh, Transcription

NODES = 10_000
"""Least number of nodes in a motion, as many as there are samples of a motion in runs."""
PANEL = 5
"""Nodes of the Gauss-Legendre formula of each of the panels into which an interval is divided."""
ARGUMENTS = "q", "v", "a", "lam", "z", "u"
BESIDE = 1e-3
"""Distance from the ends of intervals at which forces are compared, as a share of the shortest interval."""


class Residual(NamedTuple):
    """What a solution leaves of the equations, for each of N intervals."""

    change: np.ndarray
    """(N,) First-order change of the objective."""
    impulse: np.ndarray
    """(N,) Largest impulse of the forces that remain, as a share of the largest impulse of the forces that act in the
    whole motion. Forces, moments and the rates of each state are compared apart."""
    jump: np.ndarray
    """(N,) Largest jump of forces and rates, as functions of the state, at the end of each interval, as a share of the
    largest force or rate; zero at the ends of phases, where conditions may fix the state."""

    def is_large(self, change: float, impulse: float) -> np.ndarray:
        """Return the intervals (N,) that contribute to sums beyond these limits; none if both are within them."""
        sums = abs(self.change).sum(), self.impulse.sum()
        return np.asarray(
            (sums[0] > change) & (abs(self.change) * len(self.change) > change)
            | (sums[1] > impulse) & (self.impulse * len(self.impulse) > impulse)
        )


def residual_between_points(method: Transcription, mesh: Mesh) -> Residual:
    """Return what a solution leaves of the equations between its collocation points."""
    values, lengths = mesh.values, mesh.values["duration"] @ mesh.grid.lengths
    count, s = len(lengths), len(method.c)
    panels = -(-NODES // (count * PANEL))
    nodes, weight = np.polynomial.legendre.leggauss(PANEL)
    shares = ((np.arange(panels)[:, None] + 0.5 * (nodes + 1.0)) / panels).ravel()
    weight = np.tile(0.5 * weight / panels, panels)
    times = (values["duration"] @ mesh.grid.ends - lengths)[:, None] + lengths[:, None] * shares
    x = {name: method.values_at(mesh, name, shares) for name in (*ARGUMENTS, "mu")}
    for name, table in method.spec.tables.items():
        x["u"][method.spec.chosen.control_states.index(f"measured.{name}")] = curve_of(table)(times)
    x = {name: rows.reshape(len(rows), times.size) for name, rows in x.items()}
    at_nodes = np.array([weights(method.c, share) for share in shares]).T

    def evaluated(given: dict[str, np.ndarray], at: np.ndarray) -> list[np.ndarray]:
        """Return constraints, rates, integrands and forces (rows, N, K)."""
        p = ca.repmat(values["p"], 1, at.size)
        results = method.stage.map(at.size)(*(given[name] for name in ARGUMENTS), p, at.reshape(1, -1), given["mu"])
        rows = [np.array(results[k]) for k in (0, 2, 3, 4)]
        return [row.reshape(len(row), count, at.size // count) for row in rows]

    def between(at_points: np.ndarray) -> np.ndarray:
        return np.asarray(at_points.reshape(len(at_points), count, s) @ at_nodes)

    closed, rates, integrands, forces = evaluated(x, times)
    _, own_rates, own_integrands, _ = evaluated(dict(values), mesh.times)
    whole, defects = own_integrands @ method.b, between(own_rates) - rates
    by_integrals, by_motion, by_rates = method.multipliers(mesh, whole @ lengths)
    missed = (between(by_motion) * np.concatenate([forces, closed])).sum(axis=0)
    missed += (between(by_rates) * defects).sum(axis=0)
    change = lengths * (by_integrals @ (integrands @ weight - whole) - missed @ weight)
    at_rest = evaluated(x | {"a": 0.0 * x["a"]}, times)[-1]

    at_end = {name: method.values_at(mesh, name, np.ones(1))[..., 0] for name in (*ARGUMENTS, "mu")}
    at_end |= dict(zip("qvz", np.split(method.nodes(mesh)[:, 1:], np.cumsum([len(x["q"]), len(x["v"])])), strict=True))
    slopes = {"q": at_end["v"], "v": at_end["a"], "z": own_rates @ weights(method.c, 1.0)}
    still, ends = {"a": 0.0 * at_end["a"]}, values["duration"] @ mesh.grid.ends

    def change_beside(distance: float) -> np.ndarray:
        """Return by how much forces and rates differ on both sides of the ends of intervals, with equal controls."""
        after, before = (
            evaluated(at_end | {name: at_end[name] + side * slopes[name] for name in slopes} | still, ends)
            for side in (distance, -distance)
        )
        return np.concatenate([after[-1] - before[-1], after[1] - before[1]])[..., 0]

    distance = BESIDE * float(lengths.min())
    jumps = abs(2.0 * change_beside(distance) - change_beside(2.0 * distance))  # zero where forces are smooth
    jumps[:, mesh.grid.ends_of_phases()] = 0.0
    remaining = abs(np.concatenate([forces, defects]) @ weight) * lengths
    acting = np.concatenate([abs(forces - at_rest) + abs(at_rest), abs(rates)])
    largest, kinds = abs(np.concatenate([at_rest, rates])).max(axis=(1, 2), initial=0.0), np.arange(len(acting))
    kinds[: len(forces)] = -1 - (kinds[: len(forces)] % 3 == 2)
    impulse, jump = np.zeros(count), np.zeros(count)
    for kind in np.unique(kinds):
        rows = kinds == kind
        whole_impulse, size = float((acting[rows] @ weight @ lengths).max()), float(largest[rows].max())
        impulse = np.maximum(impulse, remaining[rows].max(axis=0) / (whole_impulse or np.inf))
        jump = np.maximum(jump, jumps[rows].max(axis=0) / (size or np.inf))
    return Residual(change, impulse, jump)
