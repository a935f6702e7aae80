"""A consistent start: initial positions and velocities moved onto the joints by the least amount in the mass metric."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbdkit.engine.compiled import CompiledMechanism, compile_mechanism
from mbdkit.engine.observe import constraints_at
from mbdkit.engine.problem import new_scratch
from mbdkit.engine.system import Scratch
from mbdkit.errors import SpecError
from mbdkit.mechanism.mechanism import Mechanism

MOST_ITERATIONS = 60
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
            most = sorted((name for name, x in moved.items() if x > 0), key=lambda name: -moved[name])
            if most:
                more = f" and {len(most) - 3} more" if len(most) > 3 else ""
                parts.append(", ".join(f"{name} {moved[name]:.3g} {unit}" for name in most[:3]) + more)
        return "The start was made consistent; moved by: " + "; ".join(parts) + "."


def assemble(mechanism: Mechanism, t0: float = 0.0, compiled: CompiledMechanism | None = None) -> AssembledState:
    """Make a mechanism's start consistent with its joints.

    Positions minimise the mass-weighted change under Phi(q, t0) = 0 (Newton on its optimality conditions, with the
    metric as Hessian); velocities likewise under Phi_q v + Phi_t = 0, in one linear step. Bodies named in
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
        fixed = np.zeros_like(self.given_q, dtype=bool)
        for i, name in enumerate(mechanism.bodies):
            fixed[i] = name in mechanism.assembly.fix
        self.free = np.flatnonzero(~fixed.ravel())
        self.rows = np.array([(row.pair, row.place) for row in compiled.rows], dtype=np.int64).reshape(-1, 2)

    def run(self) -> AssembledState:
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

    @property
    def reach(self) -> float:
        """Largest arm of a joint, at least 1 m: by how much a rate of turning is magnified in a point's velocity."""
        return max(1.0, float(np.max(np.abs(self.compiled.topology.pair_parameters[:, :4]), initial=0.0)))

    def padded(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x, np.zeros(3)])

    def evaluate(self, q: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...], np.ndarray]:
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

    def rates(self, jacobian: tuple[np.ndarray, ...], v: np.ndarray, phi_t: np.ndarray) -> np.ndarray:
        row, column, value = jacobian
        return phi_t + np.bincount(row, value * v[column], minlength=len(phi_t))

    def least_change(self, jacobian: tuple[np.ndarray, ...], gradient: np.ndarray, gap: np.ndarray) -> np.ndarray:
        """Return d with ``M d + J^T mu = -gradient`` and ``J d = -gap``, fixed coordinates held.

        A trace of regularisation keeps redundant rows from stopping the solve; the iteration around it removes its
        effect on the gaps.
        """
        from scipy.sparse import block_array, csr_array, diags_array
        from scipy.sparse.linalg import splu

        row, column, value = jacobian
        m, free = len(gap), self.free
        j = csr_array((value, (row, column)), shape=(m, self.n)).tocsc()[:, free]
        mass = self.compiled.topology.mass[:-1].ravel()[free]
        schur = (j**2) @ (1 / mass)
        trace = 1e-13 * float(np.max(schur, initial=1.0))
        kkt = block_array([[diags_array(mass), j.T], [j, -trace * diags_array(np.ones(m))]], format="csc")
        lu = splu(kkt)
        right = np.concatenate([-gradient[free], -gap])
        solution = lu.solve(right)
        solution += lu.solve(right - kkt @ solution)
        step = np.zeros(self.n)
        step[free] = solution[: len(free)]
        return step

    def positions(self, q: np.ndarray, tolerance: float) -> np.ndarray:
        """Run Newton until the gaps close and the change is the least one; raise SpecError where they do not close."""
        start, mass = q.copy(), self.compiled.topology.mass[:-1].ravel()
        phi, jacobian, _ = self.evaluate(q)
        size = max(1.0, float(np.max(np.abs(q), initial=0.0)), self.reach)
        for _ in range(MOST_ITERATIONS):
            gap = float(np.max(np.abs(phi)))
            try:
                step = self.least_change(jacobian, mass * (q - start), phi)
            except RuntimeError:
                break
            largest = float(np.max(np.abs(step)))
            if not np.isfinite(largest):
                break
            if gap <= tolerance and largest <= 1e-10 * size:
                return q
            scale = min(1.0, 0.5 * size / largest) if largest > 0 else 1.0
            best, best_gap = None, np.inf
            for _ in range(12):
                trial = q + scale * step
                phi_trial, jacobian_trial, _ = self.evaluate(trial)
                gap_trial = float(np.max(np.abs(phi_trial)))
                if gap_trial < best_gap:
                    best, best_gap = (trial, phi_trial, jacobian_trial), gap_trial
                if gap_trial <= max(tolerance, 0.9 * gap):
                    break
                scale *= 0.5
            if best is None:
                break
            q, phi, jacobian = best
        if float(np.max(np.abs(phi))) <= tolerance:
            return q
        raise self.failure(phi, tolerance, "m")

    def velocities(
        self, v: np.ndarray, jacobian: tuple[np.ndarray, ...], phi_t: np.ndarray, tolerance: float
    ) -> np.ndarray:
        """Change velocities by the least amount; raise SpecError where joints cannot move together."""
        rate = self.rates(jacobian, v, phi_t)
        for _ in range(4):
            try:
                v = v + self.least_change(jacobian, np.zeros(self.n), rate)
            except RuntimeError:
                break
            rate = self.rates(jacobian, v, phi_t)
            if np.max(np.abs(rate)) <= tolerance:
                return v
        if np.max(np.abs(rate)) <= 1e3 * tolerance:  # what round-off leaves of velocities that had to change a lot
            return v
        raise self.failure(rate, tolerance, "m/s")

    def failure(self, residual: np.ndarray, tolerance: float, unit: str) -> SpecError:
        """Return the error that names the joints that cannot meet, worst first."""
        gaps: dict[str, float] = {}
        for row, value in zip(self.compiled.rows, residual, strict=True):
            name = row.label.rsplit(".", 1)[0]
            gaps[name] = max(gaps.get(name, 0.0), abs(float(value)))
        apart = sorted((name for name, gap in gaps.items() if not gap <= tolerance), key=lambda name: -gaps[name])
        listed = ", ".join(f"{name} ({gaps[name]:.3g} {unit})" for name in apart[:6])
        more = f" and {len(apart) - 6} more" if len(apart) > 6 else ""
        held = self.mechanism.assembly.fix
        fixed = f" while {', '.join(held)} stay fixed" if held else ""
        what = "meet" if unit == "m" else "move together"
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
