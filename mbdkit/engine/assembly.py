"""Assembly: make the initial state satisfy the constraints, with the least change in the mass metric."""

from __future__ import annotations

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.base.plain_data import quoted
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.motions import OF_CENTER
from mbdkit.engine.least_change import LeastChange
from mbdkit.engine.workspace import finite_motions
from mbdkit.mechanism.beams import written_key
from mbdkit.mechanism.joints import Revolute
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.values import Motion, Table

NOISE = 1e-9  #: Changes below this are not reported [m, rad, m/s, rad/s].

#: After a correction, velocity residuals are accepted up to this multiple of the tolerance.
#:
#: If velocities change by much more than their own size, round-off leaves residuals above the tolerance.
MUCH_CHANGED = 1e3

#: Residuals count as round-off below this times the largest coordinate or, for velocities, below this times the largest
#: velocity times the largest lever arm.
ROUND_OFF = 8 * np.finfo(float).eps


@dataclass(frozen=True)
class AssembledState:
    """An initial state that satisfies the constraints.

    - `q`, `v`: (B, 3) positions (x, y, theta) and velocities [m, rad, m/s, rad/s].
    - `changed`: whether any value changed; if not, `q` and `v` are bitwise equal to the given values.
    - `moved_position`, `moved_angle`: displacement of each body's centre of mass [m] and rotation of each body [rad],
      as absolute values.
    - `changed_velocity`, `changed_rate`: change of each body's velocity [m/s] and angular velocity [rad/s], as absolute
      values.
    - `residual`, `velocity_residual`: largest remaining |Phi| [m, rad] and |Phi_q v + Phi_t| [m/s, rad/s] of the
      constraints Phi(q, t) = 0.
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
        """Return a sentence about the changes made by assembly; of each kind, it lists the three largest."""
        if not self.changed:
            return "The given initial state satisfies the constraints and is left untouched."
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
        changes = "; ".join(parts) or "none above 1e-9"
        return f"The start was made consistent; changes: {changes}."


def search_for(mechanism: Mechanism, compiled: CompiledMechanism, t0: float) -> LeastChange:
    """Return the solver for `assemble`, which can be used for all initial states of a mechanism at time `t0`."""
    fixed = [name in mechanism.assembly.fix for name in mechanism.bodies]
    return LeastChange(compiled, t0, np.repeat(np.array(fixed, dtype=bool), 3))


def assemble(
    mechanism: Mechanism, t0: float = 0.0, compiled: CompiledMechanism | None = None, search: LeastChange | None = None
) -> AssembledState:
    """Correct the initial state of a mechanism so that it satisfies the constraints.

    The positions minimise the mass-weighted change subject to Phi(q, t0) = 0: Newton steps reduce the residuals to
    zero, then Newton's method is applied to the optimality conditions. The velocities minimise the mass-weighted change
    subject to Phi_q v + Phi_t = 0, a linear problem. Bodies named in ``assembly.fix`` keep their position and velocity.
    Positions and velocities whose residuals are within the tolerance are not changed, not even in the last bit.

    `mechanism`: validated mechanism. Its initial values may be approximate. `t0`: start time [s]. `compiled`: the
    compiled mechanism, if it is available already. `search`: the result of `search_for`, if it is available already.
    Returns the consistent initial state and the changes that were made. Raises SpecError if a driver, a load or a
    moving center is not finite at the start, or if the constraints cannot be satisfied. In the latter case, the message
    names the joints with the largest remaining residuals.
    """
    compiled = compiled or compile_mechanism(mechanism)
    return _Assembly(mechanism, search or search_for(mechanism, compiled, t0)).run()


def assemble_from(
    mechanism: Mechanism, search: LeastChange, q: np.ndarray, v: np.ndarray, tolerance: float
) -> AssembledState:
    """Correct another initial state (B, 3) than that of a mechanism; see `assemble`. Errors are about the mechanism."""
    assembly = _Assembly(mechanism, search)
    assembly.given_q, assembly.given_v, assembly.tolerance = q, v, tolerance
    return assembly.run()


def tolerances(tolerance: float, far: float, fast: float, search: LeastChange) -> tuple[float, float]:
    """Return the tolerances of position and velocity residuals; `far` and `fast` are the largest coordinate and the
    largest velocity.
    """
    return max(tolerance, ROUND_OFF * far), max(tolerance, ROUND_OFF * fast * search.reach)


class _Assembly:
    def __init__(self, mechanism: Mechanism, search: LeastChange):
        self.mechanism, self.search, self.compiled, self.t0 = mechanism, search, search.compiled, search.t0
        bodies = mechanism.bodies.values()
        q = [(*body.position, body.angle) for body in bodies]
        v = [(*body.velocity, body.angular_velocity) for body in bodies]
        self.given_q, self.given_v = (np.array(x, dtype=float).reshape(-1, 3) for x in (q, v))
        self.tolerance = mechanism.assembly.tolerance

    def run(self) -> AssembledState:
        self.check_motions()
        search, tolerance = self.search, self.tolerance
        q, v = self.given_q.ravel().copy(), self.given_v.ravel().copy()
        q_tolerance, v_tolerance = tolerances(tolerance, _largest(q), _largest(v), search)
        phi, jacobian, phi_t = search.evaluate(q)
        if not _largest(phi) <= q_tolerance:
            q = search.positions(q, q_tolerance)
            phi, jacobian, phi_t = search.evaluate(q)
            if not _largest(phi) <= q_tolerance:
                raise self.failure(phi, q_tolerance, "be assembled")
        rate = search.rates(jacobian, v, phi_t)
        if not _largest(rate) <= v_tolerance:
            v = search.velocities(v, jacobian, phi_t, v_tolerance)
            rate = search.rates(jacobian, v, phi_t)
            if not _largest(rate) <= MUCH_CHANGED * v_tolerance:
                raise self.failure(rate, v_tolerance, "have consistent velocities")
        return self.report(q, v, phi, rate)

    def check_motions(self) -> None:
        """Raise SpecError for the first driver, load or moving center that is not finite at the start."""
        top, scratch = self.compiled.topology, self.search.scratch
        if not len(scratch.u):
            return
        self.search.evaluate(self.given_q.ravel())
        if finite_motions(top, scratch.u):
            return
        written: list[tuple[str, Motion | None]] = []
        for name, joint in self.mechanism.joints.items():
            written.append((f"model.joints.{quoted(name)}.motion", getattr(joint, "motion", None)))
        for name, force in self.mechanism.forces.items():
            value, key = getattr(force, "value", None), written_key(self.mechanism.beams, "forces", name, "value")
            written += [(key, x) for x in (value if isinstance(value, tuple) else [value])]
        # In `scratch.u`, rows of moving centers follow those of the motions, hence strict=False.
        values = dict(zip(self.compiled.motions, scratch.u, strict=False))
        for key, motion in written:
            if motion is not None and not np.all(np.isfinite(values[motion][: 3 if key.endswith("motion") else 1])):
                sentence = (
                    f"{motion!r} is not finite at the start, t = {self.t0:g} s; a driver also needs finite first and "
                    "second time derivatives"
                )
                raise SpecError(_not_finite_table("times") if isinstance(motion, Table) else sentence, key=key)
        self.check_centers()

    def check_centers(self) -> None:
        """Raise SpecError for the first moving center that is not finite at the start."""
        top, u = self.compiled.topology, self.search.scratch.u
        functions = [
            (f"model.joints.{quoted(name)}.center.{key}", function)
            for name, joint in self.mechanism.joints.items()
            if isinstance(joint, Revolute) and joint.center is not None
            for key, function in joint.center.functions
        ]
        count = len(top.motion_start) - 1
        of_centers = u[count - OF_CENTER * len(top.centers) : count]
        for (key, function), jets in zip(functions, of_centers.reshape(-1, 2, 3), strict=True):
            if not np.all(np.isfinite(jets)):
                sentence = (
                    f"{function!r} is not finite at the initial angle of the joint, or its first three derivatives are "
                    "not"
                )
                raise SpecError(_not_finite_table("angles") if isinstance(function, Table) else sentence, key=key)

    def failure(self, residual: np.ndarray, tolerance: float, what: str) -> SpecError:
        """Return the error that names up to six joints with residuals above the tolerance, largest first."""
        gaps: dict[str, tuple[float, str]] = {}
        for row, value in zip(self.compiled.rows, residual, strict=True):
            name, unit = row.label.rsplit(".", 1)[0], row.unit if what == "be assembled" else f"{row.unit}/s"
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
            "check lengths, points and drivers, or start closer to a consistent pose",
            key="model.joints",
        )

    def report(self, q: np.ndarray, v: np.ndarray, phi: np.ndarray, rate: np.ndarray) -> AssembledState:
        q, v = q.reshape(-1, 3), v.reshape(-1, 3)
        change = np.abs(np.hstack([q - self.given_q, v - self.given_v]))
        changed = bool(change.any())
        moves = np.zeros((4, len(q)))
        if changed:
            moved, speed = elementary.hypot(change[:, 0::3], change[:, 1::3]).T
            moves[:] = moved, change[:, 2], speed, change[:, 5]
        position, angle, velocity, spin = (dict(zip(self.mechanism.bodies, row, strict=True)) for row in moves.tolist())
        return AssembledState(q, v, changed, position, angle, velocity, spin, _largest(phi), _largest(rate))


def _not_finite_table(arguments: str) -> str:
    return f"the spline through this table is not finite: its values are too large or its {arguments} too close"


def _largest(x: np.ndarray) -> float:
    return float(np.abs(x).max(initial=0.0))
