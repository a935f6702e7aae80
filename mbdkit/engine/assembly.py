"""A consistent start: initial positions and velocities moved onto the joints by the least amount in the mass metric."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdkit.engine.compiled import CompiledMechanism, compile_mechanism
from mbdkit.engine.constraints import KINDS
from mbdkit.engine.observe import constraints_at, stiffness_at
from mbdkit.engine.problem import finite_motions, new_scratch
from mbdkit.engine.system import Scratch
from mbdkit.errors import SpecError
from mbdkit.mechanism.elements import Table
from mbdkit.mechanism.mechanism import Mechanism

Entries = tuple[np.ndarray, np.ndarray, np.ndarray]
"""A sparse matrix as (row, column, value)."""

MOST_ITERATIONS = 60
MOST_DESCENTS = 30
NOISE = 1e-9
"""Changes below this are not told [m, rad, m/s, rad/s]."""

ROUND_OFF = 8 * np.finfo(float).eps
"""Residuals below this, relative to the largest coordinate, cannot be told from round-off."""


@dataclass(frozen=True)
class AssembledState:
    """A consistent start.

    Attributes
    ----------
    q, v
        (B, 3) positions (x, y, theta) and velocities [m, rad, m/s, rad/s].
    changed
        Whether anything moved; if not, `q` and `v` are the given values to the bit.
    moved_position, moved_angle
        How far each body's centre moved [m] and turned [rad].
    changed_velocity, changed_rate
        By how much each body's velocity [m/s] and angular velocity [rad/s] changed.
    residual, velocity_residual
        Largest |Phi| and |Phi_q v + Phi_t| that are left.
    """

    q: np.ndarray
    v: np.ndarray
    changed: bool
    moved_position: dict[str, float]
    moved_angle: dict[str, float]
    changed_velocity: dict[str, float]
    changed_rate: dict[str, float]
    residual: float
    velocity_residual: float

    def describe(self) -> str:
        """Return in a sentence what assembly moved, largest first."""
        if not self.changed:
            return "The given start meets the joints and is left untouched."
        parts = []
        for unit, moved in (
            ("m", self.moved_position),
            ("rad", self.moved_angle),
            ("m/s", self.changed_velocity),
            ("rad/s", self.changed_rate),
        ):
            most = sorted((name for name, x in moved.items() if x > NOISE), key=lambda name: -moved[name])
            if most:
                more = f" and {len(most) - 3} more" if len(most) > 3 else ""
                parts.append(", ".join(f"{name} {moved[name]:.3g} {unit}" for name in most[:3]) + more)
        told = "; ".join(parts) or "nothing by more than 1e-9"
        return f"The start was made consistent; moved by: {told}."


def assemble(mechanism: Mechanism, t0: float = 0.0, compiled: CompiledMechanism | None = None) -> AssembledState:
    """Make a mechanism's start consistent with its joints.

    Positions minimise the mass-weighted change under Phi(q, t0) = 0: Newton steps close the gaps, then Newton runs on
    the conditions of least change; velocities likewise under Phi_q v + Phi_t = 0, which is linear. Bodies named in
    ``assembly.fix`` keep their position and velocity. A start within the tolerance is left untouched to the bit.

    Parameters
    ----------
    mechanism
        Validated mechanism; its initial values may be approximate.
    t0
        Start time [s].
    compiled
        The same mechanism compiled, where that is at hand.

    Returns
    -------
    AssembledState
        The start, and what moved by how much.

    Raises
    ------
    SpecError
        Where joints cannot meet; the message names them and the gaps that are left.
    """
    work = _Assembly(mechanism, compiled or compile_mechanism(mechanism), t0)
    return work.run()


class _Assembly:
    def __init__(self, mechanism: Mechanism, compiled: CompiledMechanism, t0: float):
        self.mechanism, self.compiled, self.t0 = mechanism, compiled, t0
        self.scratch: Scratch = new_scratch(compiled)[0]
        bodies = mechanism.bodies.values()
        self.given_q = np.array([(*body.position, body.angle) for body in bodies], dtype=float).reshape(-1, 3)
        self.given_v = np.array([(*body.velocity, body.angular_velocity) for body in bodies], dtype=float).reshape(
            -1, 3
        )
        self.n = self.given_q.size
        self.mass = compiled.topology.mass[:-1].ravel()
        fixed = np.zeros_like(self.given_q, dtype=bool)
        for i, name in enumerate(mechanism.bodies):
            fixed[i] = name in mechanism.assembly.fix
        self.free = np.flatnonzero(~fixed.ravel())
        self.rows = np.array([(row.pair, row.place) for row in compiled.rows], dtype=np.int64).reshape(-1, 2)

    def run(self) -> AssembledState:
        self.check_motions()
        tolerance = self.mechanism.assembly.tolerance
        q, v = self.given_q.ravel().copy(), self.given_v.ravel().copy()
        q_tolerance = max(tolerance, ROUND_OFF * float(np.max(np.abs(q), initial=0.0)))
        phi, _, _ = self.evaluate(q)
        if np.max(np.abs(phi), initial=0.0) > q_tolerance:
            q = self.positions(q, q_tolerance)
            phi, _, _ = self.evaluate(q)
        _, jacobian, phi_t = self.evaluate(q)
        rate = self.rates(jacobian, v, phi_t)
        v_tolerance = max(tolerance, ROUND_OFF * float(np.max(np.abs(v), initial=0.0)) * self.reach)
        if np.max(np.abs(rate), initial=0.0) > v_tolerance:
            v = self.velocities(v, jacobian, phi_t, v_tolerance)
            rate = self.rates(jacobian, v, phi_t)
        return self.report(q, v, phi, rate)

    def check_motions(self) -> None:
        """Raise SpecError for the first driver or load whose motion is not a finite number at the start."""
        top, scratch = self.compiled.topology, self.scratch
        constraints_at(top, scratch, self.t0, self.padded(self.given_q.ravel()), self.padded(np.zeros(self.n)))
        if finite_motions(top, scratch.u):
            return
        written: list[tuple[str, Any]] = []
        for name, joint in self.mechanism.joints.items():
            written.append((f"model.joints.{name}.motion", getattr(joint, "motion", None)))
        for name, force in self.mechanism.forces.items():
            value = getattr(force, "value", None)
            written += [(f"model.forces.{name}.value", x) for x in (value if isinstance(value, tuple) else [value])]
        values = dict(zip(self.compiled.motions, scratch.u, strict=True))
        for key, motion in written:
            if motion is not None and not np.all(np.isfinite(values[motion][: 3 if key.endswith("motion") else 1])):
                if isinstance(motion, Table):
                    raise SpecError(
                        "the spline through this table is not finite: its values are too large or its times too close",
                        key=key,
                    )
                raise SpecError(
                    f"{motion!r} is not a finite number at the start, t = {self.t0:g} s, "
                    "or one of the first two derivatives is not, which a driver needs",
                    key=key,
                )

    @property
    def reach(self) -> float:
        """Largest arm of a joint, at least 1 m: by how much a rate of turning is magnified in a point's velocity."""
        return max(1.0, float(np.max(np.abs(self.compiled.topology.pair_parameters[:, :4]), initial=0.0)))

    def padded(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x, np.zeros(3)])

    def evaluate(self, q: np.ndarray) -> tuple[np.ndarray, Entries, np.ndarray]:
        """Return Phi (m,), the Jacobian as (row, column, value) and Phi_t (m,)."""
        w, top = self.scratch, self.compiled.topology
        constraints_at(top, w, self.t0, self.padded(q), self.padded(np.zeros(self.n)))
        pair, place = self.rows[:, 0], self.rows[:, 1]
        blocks = w.jac.reshape(-1, 2, 6)[pair, place]
        columns = np.concatenate(
            [3 * top.pairs[pair, 1:2] + np.arange(3), 3 * top.pairs[pair, 2:3] + np.arange(3)], axis=1
        )
        row = np.repeat(np.arange(len(self.rows)), 6)
        keep = (columns.ravel() < self.n) & (blocks.ravel() != 0)
        return w.phi[pair, place], (row[keep], columns.ravel()[keep], blocks.ravel()[keep]), w.phi_t[pair, place]

    def rates(self, jacobian: Entries, v: np.ndarray, phi_t: np.ndarray) -> np.ndarray:
        row, column, value = jacobian
        return phi_t + np.bincount(row, value * v[column], minlength=len(phi_t))

    def kkt(self, jacobian: Entries, stiffness: Entries | None = None) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
        """Return a solver of ``[M + K, J^T; J, -e] [step, mu] = [-gradient, -gap]`` over the free coordinates.

        A trace `e` of regularisation keeps redundant rows from stopping the solve. It acts on the change of the
        multipliers only, so that it vanishes as the iterations around it converge.
        """
        from scipy.sparse import block_array, csr_array, diags_array
        from scipy.sparse.linalg import splu

        row, column, value = jacobian
        j = csr_array((value, (row, column)), shape=(len(self.rows), self.n)).tocsc()[:, self.free]
        hessian = diags_array(self.mass[self.free]).tocsc()
        trace = 1e-13 * ((j**2) @ (1 / self.mass[self.free]))
        if stiffness is not None:
            row, column, value = stiffness
            hessian += csr_array((value, (row, column)), shape=(self.n, self.n)).tocsc()[self.free][:, self.free]
        corner = -diags_array(np.where(trace > 0, trace, 1.0))
        matrix = block_array([[hessian, j.T], [j, corner]], format="csc")
        lu = splu(matrix)

        def solve(gradient: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            right = np.concatenate([-gradient[self.free], -gap])
            solution = lu.solve(right)
            solution += lu.solve(right - matrix @ solution)
            step = np.zeros(self.n)
            step[self.free] = solution[: len(self.free)]
            return step, solution[len(self.free) :]

        return solve

    def stiffness(self, q: np.ndarray, multipliers: np.ndarray) -> Entries:
        """Return d(J^T mu)/dq as (row, column, value)."""
        w, top = self.scratch, self.compiled.topology
        lam = np.zeros((len(top.pairs), 2))
        lam[self.rows[:, 0], self.rows[:, 1]] = multipliers
        stiffness_at(top, w, self.t0, self.padded(q), self.padded(np.zeros(self.n)), lam)
        columns = np.concatenate([3 * top.pairs[:, 1:2] + np.arange(3), 3 * top.pairs[:, 2:3] + np.arange(3)], axis=1)
        row, column = np.repeat(columns, 6, axis=1).ravel(), np.tile(columns, (1, 6)).ravel()
        keep = (row < self.n) & (column < self.n) & (w.stiff.ravel() != 0)
        return row[keep], column[keep], w.stiff.ravel()[keep]

    def separated(self, q: np.ndarray) -> np.ndarray:
        """Return positions at which no distance joint has its points on top of each other, without a direction."""
        top = self.compiled.topology
        for k in np.flatnonzero(top.pairs[:, 0] == KINDS["distance"]):
            constraints_at(top, self.scratch, self.t0, self.padded(q), self.padded(np.zeros(self.n)))
            if np.all(np.isfinite(self.scratch.jac[k])):
                continue
            for body in top.pairs[k, [2, 1]]:
                if 3 * body in self.free:
                    q = q.copy()
                    q[3 * body] += top.pair_parameters[k, 4]
                    break
        return q

    def positions(self, given: np.ndarray, tolerance: float) -> np.ndarray:
        """Return the nearest positions at which the gaps close; raise SpecError where they do not close."""
        q = self.closed(self.separated(given), tolerance)
        gap = float(np.max(np.abs(self.evaluate(q)[0])))
        if gap > tolerance:
            raise self.failure(self.evaluate(q)[0], tolerance, "meet")
        for _ in range(MOST_DESCENTS):
            nearest = self.stationary(given, q, tolerance)
            if nearest is not None:
                return nearest
            nearer = self.descended(given, q, tolerance)
            if nearer is None:
                return q
            q = nearer
        return q

    def distance(self, given: np.ndarray, q: np.ndarray) -> float:
        """Return the change in the mass metric, which assembly makes as small as it can."""
        return float(self.mass @ (q - given) ** 2)

    def closed(self, q: np.ndarray, tolerance: float) -> np.ndarray:
        """Close the gaps by Newton steps of least size, damped while the gaps do not shrink."""
        phi, jacobian, _ = self.evaluate(q)
        size = max(1.0, float(np.max(np.abs(q), initial=0.0)), self.reach)
        nothing = np.zeros(self.n)
        for _ in range(MOST_ITERATIONS):
            gap = float(np.max(np.abs(phi)))
            try:
                step, _ = self.kkt(jacobian)(nothing, phi)
            except RuntimeError:
                return q
            largest = float(np.max(np.abs(step)))
            if not np.isfinite(largest):
                return q
            scale = min(1.0, 0.5 * size / largest) if largest > 0 else 1.0
            best = (q, phi, jacobian, gap)
            for _ in range(12):
                trial = q + scale * step
                phi_trial, jacobian_trial, _ = self.evaluate(trial)
                gap_trial = float(np.max(np.abs(phi_trial)))
                if gap_trial < best[3]:
                    best = (trial, phi_trial, jacobian_trial, gap_trial)
                if gap_trial <= 0.9 * gap:
                    break
                scale *= 0.5
            if best[0] is q:
                return q  # as near as round-off lets it come, or stuck
            closed_enough = gap <= tolerance
            q, phi, jacobian, _ = best
            if closed_enough:
                return q
        return q

    def stationary(self, given: np.ndarray, q: np.ndarray, tolerance: float) -> np.ndarray | None:
        """Run Newton on the conditions of least change from `q`; None where it does not come to a nearer point."""
        start = q
        size = max(1.0, float(np.max(np.abs(q), initial=0.0)), self.reach)
        multipliers: np.ndarray | None = None
        for _ in range(20):
            phi, jacobian, _ = self.evaluate(q)
            pull = self.mass * (q - given)
            try:
                if multipliers is None:
                    multipliers = self.kkt(jacobian)(pull, np.zeros(len(phi)))[1]
                row, column, value = jacobian
                gradient = pull + np.bincount(column, value * multipliers[row], minlength=self.n)
                step, change = self.kkt(jacobian, self.stiffness(q, multipliers))(gradient, phi)
            except RuntimeError:
                return None
            largest = float(np.max(np.abs(step)))
            if not largest < size:
                return None
            q, multipliers = q + step, multipliers + change
            if largest <= 1e-9 * size:  # Newton: the next change would be round-off
                gap = float(np.max(np.abs(self.evaluate(q)[0])))
                near = self.distance(given, q) <= self.distance(given, start) * (1 + 1e-9)
                return q if gap <= tolerance and near else None
        return None

    def descended(self, given: np.ndarray, q: np.ndarray, tolerance: float) -> np.ndarray | None:
        """Take a step along the joints towards the given positions; None where none is nearer."""
        _, jacobian, _ = self.evaluate(q)
        try:
            step, _ = self.kkt(jacobian)(self.mass * (q - given), np.zeros(len(self.rows)))
        except RuntimeError:
            return None
        scale = 1.0
        for _ in range(12):
            trial = self.closed(q + scale * step, tolerance)
            met = float(np.max(np.abs(self.evaluate(trial)[0]))) <= tolerance
            if met and self.distance(given, trial) < self.distance(given, q) * (1 - 1e-12):
                return trial
            scale *= 0.5
        return None

    def velocities(self, v: np.ndarray, jacobian: Entries, phi_t: np.ndarray, tolerance: float) -> np.ndarray:
        """Change velocities by the least amount; raise SpecError where joints cannot move together."""
        rate = self.rates(jacobian, v, phi_t)
        try:
            solve = self.kkt(jacobian)
        except RuntimeError:
            raise self.failure(rate, tolerance, "move together") from None
        for _ in range(6):
            v = v + solve(np.zeros(self.n), rate)[0]
            rate = self.rates(jacobian, v, phi_t)
            if np.max(np.abs(rate)) <= tolerance:
                return v
        if np.max(np.abs(rate)) <= 1e3 * tolerance:  # what round-off leaves of velocities that had to change a lot
            return v
        raise self.failure(rate, tolerance, "move together")

    def failure(self, residual: np.ndarray, tolerance: float, what: str) -> SpecError:
        """Return the error that names the joints that cannot meet, worst first."""
        gaps: dict[str, tuple[float, str]] = {}
        for row, value in zip(self.compiled.rows, residual, strict=True):
            name, unit = row.label.rsplit(".", 1)[0], row.unit if what == "meet" else f"{row.unit}/s"
            gap = abs(float(value)) if np.isfinite(value) else np.inf
            if name not in gaps or gap > gaps[name][0]:
                gaps[name] = (gap, unit)
        apart = sorted((name for name, (gap, _) in gaps.items() if gap > tolerance), key=lambda name: -gaps[name][0])
        listed = ", ".join(f"{name} ({gaps[name][0]:.3g} {gaps[name][1]})" for name in apart[:6])
        more = f" and {len(apart) - 6} more" if len(apart) > 6 else ""
        held = self.mechanism.assembly.fix
        fixed = f" while {', '.join(held)} stay{'s' * (len(held) == 1)} fixed" if held else ""
        return SpecError(
            f"these joints cannot {what} at t = {self.t0:g} s{fixed}: {listed}{more}; "
            "check lengths, points and drivers, or start nearer to a pose that fits",
            key="model.joints",
        )

    def report(self, q: np.ndarray, v: np.ndarray, phi: np.ndarray, rate: np.ndarray) -> AssembledState:
        q, v = q.reshape(-1, 3), v.reshape(-1, 3)
        dq, dv = np.abs(q - self.given_q), np.abs(v - self.given_v)
        names = tuple(self.mechanism.bodies)

        def moved(values: np.ndarray) -> dict[str, float]:
            return {name: float(x) for name, x in zip(names, values, strict=True)}

        return AssembledState(
            q=q,
            v=v,
            changed=bool(np.any(dq) or np.any(dv)),
            moved_position=moved(np.hypot(dq[:, 0], dq[:, 1])),
            moved_angle=moved(dq[:, 2]),
            changed_velocity=moved(np.hypot(dv[:, 0], dv[:, 1])),
            changed_rate=moved(dv[:, 2]),
            residual=float(np.max(np.abs(phi), initial=0.0)),
            velocity_residual=float(np.max(np.abs(rate), initial=0.0)),
        )
