"""Static equilibrium: where forces and joints balance, sought downhill from the start so that it is a stable one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import block_array, diags_array
from scipy.sparse.linalg import splu

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.observe import constraints_at
from mbdkit.engine.nearest_state import ROUND_OFF, STAGNANT
from mbdkit.errors import StepError
from mbdkit.mechanics.reduced import State, at_rest, least_stiffness, stiffness_scale
from mbdkit.mechanics.source import Placed
from mbdkit.spec.plain_data import plain

MOST_STEPS = 500
"""Steps, refused ones included, after which there is no equilibrium to be found."""

LONGEST = 0.5
"""Longest step, relative to the mechanism's size and to 1 rad."""

BALANCED = 1e-13
"""Imbalance that is nothing but round-off, relative to the forces that balance."""

STALLED = 1e-8
"""Imbalance below which a search that comes no nearer has met round-off."""

NEAR = 1e-2
"""Imbalance below which a Newton step may lead to the end, relative to the forces that balance."""

PATIENCE = 8
"""Steps in a row that bring nothing, after which a search comes no nearer."""

MUCH = 1e3
"""Times its round-off that an imbalance may be where a search comes no nearer."""

PLACES = 1e-6
"""Weight of moving a body by the mechanism's size against turning it by 1 rad, where joints are closed."""

MOST_CLOSINGS = 20
"""Newton steps after which joints are not to be closed."""

NEUTRAL = 1e-11
"""Least stiffness that counts as none, relative to the largest of a single coordinate."""


@dataclass(frozen=True)
class Equilibrium:
    """A mechanism at rest, its drivers held where they are at `time`.

    Attributes
    ----------
    time
        The time at which drivers and loads were taken [s].
    bodies, joints, constraints
        Names of the bodies, the joints, and the constraint rows as ``joint.row``.
    position : (B, 3) array
        x, y [m] and angle [rad] of each body.
    multiplier : (rows,) array
        Multipliers of the constraint rows [N, N m].
    reaction_force, reaction_torque : (J, 2) and (J,) arrays
        What the first body of each joint exerts on the second, in the global frame, at the second body's joint point
        [N, N m].
    shared
        Joints whose reactions are not unique because joints are redundant.
    imbalance
        Largest acceleration that is left [m/s^2, rad/s^2].
    residual
        Largest gap in the joints [m, rad].
    stiffness
        Least eigenvalue of the stiffness along the freedoms, for unit mass [1/s^2]: the square of the lowest natural
        frequency where it is positive, none (nan) where nothing can move. Beyond 500 bodies, where some are negative,
        one of these next to zero.
    stability
        ``stable``, ``neutral`` (something moves without resistance), ``unstable``, or ``fixed`` (nothing can move).
    iterations
        Newton steps that were tried.
    """

    time: float
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    constraints: tuple[str, ...]
    position: np.ndarray
    multiplier: np.ndarray
    reaction_force: np.ndarray
    reaction_torque: np.ndarray
    shared: tuple[str, ...]
    imbalance: float
    residual: float
    stiffness: float
    stability: str
    iterations: int

    def __getitem__(self, body: str) -> np.ndarray:
        """Return x, y [m] and angle [rad] of a body by its name."""
        found: np.ndarray = self.position[self.bodies.index(body)]
        return found


@dataclass(frozen=True)
class Rest:
    """Where a search ended: position (n,), multipliers (m,), accelerations left (n,), steps tried."""

    q: np.ndarray
    lam: np.ndarray
    left: np.ndarray
    iterations: int


def equilibrium(source: Any, **sections: Any) -> Equilibrium:
    """Find the static equilibrium of a mechanism, downhill from its start.

    Newton steps on the balance ``Phi_q^T lam = Q(t, q, 0)``, ``Phi(t, q) = 0``, damped in the mass metric until the
    forces do positive work along each of them (Levenberg and Marquardt), so that saddles and tops repel: the end is
    stable unless the start was an unstable equilibrium itself, and `Equilibrium.stability` says which. Drivers are held
    and loads taken at the start time, ``time={"start": ...}``; velocities count as zero.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism.
    **sections
        Sections of the spec that replace those of `source`.

    Returns
    -------
    Equilibrium
        Position, reactions and stability.

    Raises
    ------
    SpecError
        Where the input is wrong, or no equilibrium is found from this start.
    """
    return equilibrium_of(Placed.of(source, **sections))


def equilibrium_of(placed: Placed) -> Equilibrium:
    """Find the static equilibrium of a mechanism that is built; see `equilibrium`."""
    with placed.blamed():
        found = rest(placed)
        p, compiled = placed.equations, placed.workspace.mechanism
        stiffness, stability = _stability(placed, at_rest(placed, found.q, found.lam))
        rows = p.recorded_multipliers(p.t0, found.q, found.lam)
        force, torque = _reactions(placed, found.q, rows)
        residual = float(np.max(np.abs(p.constraints(p.t0, found.q)), initial=0.0))
    return Equilibrium(
        time=p.t0,
        bodies=p.bodies,
        joints=compiled.joints,
        constraints=tuple(row.label for row in compiled.rows),
        position=found.q.reshape(-1, 3),
        multiplier=rows,
        reaction_force=force,
        reaction_torque=torque,
        shared=compiled.redundancy.not_unique,
        imbalance=float(np.max(np.abs(found.left))),
        residual=residual,
        stiffness=stiffness,
        stability=stability,
        iterations=found.iterations,
    )


def _stability(placed: Placed, at: State) -> tuple[float, str]:
    """Return the least stiffness at rest [1/s^2], and what it says in a word."""
    if placed.freedoms == 0:
        return float("nan"), "fixed"
    stiffness = least_stiffness(placed, at)
    if abs(stiffness) <= NEUTRAL * stiffness_scale(placed, at):
        return stiffness, "neutral"
    return stiffness, "stable" if stiffness > 0 else "unstable"


def rest(placed: Placed) -> Rest:
    """Return where the mechanism rests; raises SpecError if nowhere."""
    search = _Search(placed)
    found = search.run()
    if found is not None:
        return found
    here = search.x
    worst = int(np.argmax(np.abs(here)))
    name, unit = placed.equations.bodies[worst // 3], "rad/s^2" if worst % 3 == 2 else "m/s^2"
    raise placed.error(
        f"no static equilibrium was found from this start in {search.tried} steps: at the last one body {name!r} would "
        f"still be accelerated by {abs(here[worst]):.3g} {unit}; start nearer to one, or hold what runs away"
    )


class _Search:
    """A damped Newton search on the constraint manifold."""

    def __init__(self, placed: Placed):
        self.p: EquationsOfMotion = placed.equations
        self.extent = placed.extent
        self.none, self.no_rows = np.zeros(self.p.n), np.zeros(self.p.m)
        self.q = self.p.q0.copy()
        self.tried = 0
        self.force = 0.0
        """Size of the forces that balance, in the metric of the inverse mass, where it was largest."""
        self.x, self.lam, self.imbalance = self.balance(self.q)
        stiffest = stiffness_scale(placed, at_rest(placed, self.q, self.lam)) if placed.freedoms else 0.0
        self.blur = float(np.finfo(float).eps) * stiffest * self.extent * float(np.sqrt(np.sum(self.p.mass)))
        """Imbalance that round-off of the positions leaves of stiff springs."""

    def balance(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the accelerations from rest, the multipliers, and the accelerations' size in the mass metric."""
        p = self.p
        applied = p.forces(p.t0, q, self.none)
        x, lam = p.solve(p.t0, q, applied, self.no_rows)
        held = p.constraint_forces(p.t0, q, lam)
        force = np.sqrt(np.sum(applied**2 / p.mass)) + np.sqrt(np.sum(held**2 / p.mass))
        self.force = max(self.force, float(force))
        return x, lam, float(np.sqrt(np.sum(p.mass * x**2)))

    def size(self, s: np.ndarray) -> float:
        """Return the largest part of a step, relative to the mechanism's size and to 1 rad."""
        parts = np.abs(s.reshape(-1, 3)) / (self.extent, self.extent, 1.0)
        return float(np.max(parts))

    def run(self) -> Rest | None:
        idle, damping = 0, self.size(self.x) / LONGEST
        while self.tried < MOST_STEPS:
            if self.imbalance <= max(BALANCED * self.force, self.blur) or (idle >= PATIENCE and self.settled):
                break
            before = self.imbalance
            taken = self.step(damping)
            if not taken:
                damping = max(4 * damping, 1e-12 * self.force / self.extent)
                idle += 1
                continue
            damping *= 0.1
            idle = 0 if self.imbalance < 0.5 * before else idle + 1
        if self.settled:
            return Rest(self.q, self.lam, self.x, self.tried)
        return None

    def step(self, damping: float) -> bool:
        """Take a step with so much mass added to the stiffness [1/s^2]; return whether one was taken.

        Where bodies under pressure make the forces drive the mechanism away from the step, what their stiffness lacks
        is made up for body by body.
        """
        p = self.p
        at = p.t0, self.q, self.none, self.none, self.lam
        try:
            stiffness, jacobian = p.tangents(*at).stiffness, p.constraint_jacobian(p.t0, self.q)
            right = np.concatenate([-p.residual(*at), self.no_rows])
            pressed = np.maximum(-stiffness.diagonal(), 0.0)
            choices = (2.0, 0.0) if self.imbalance > NEAR * self.force else (0.0, 2.0)
            for more in choices if np.any(pressed) else (0.0,):
                self.tried += 1
                upper = stiffness + diags_array(damping * p.mass + more * pressed)
                matrix = block_array([[upper, jacobian.T], [jacobian, None]], format="csc")
                if self.take(splu(matrix).solve(right)[: p.n]):
                    return True
        except (StepError, RuntimeError):  # a singular matrix, or a step from which the joints cannot be met
            pass
        return False

    @property
    def settled(self) -> bool:
        """Whether what is left may be round-off."""
        return self.imbalance <= max(STALLED * self.force, MUCH * self.blur)

    def take(self, s: np.ndarray) -> bool:
        """Move by a step, or as far along it as one goes, if the forces drive it; return whether they do."""
        p, before = self.p, self.imbalance
        if not np.all(np.isfinite(s)):
            return False
        s = s / max(1.0, self.size(s) / LONGEST)
        promised = float(np.sum(p.mass * self.x * s))
        if not promised > 0:
            return False
        half, end = (self.closed(self.q + part * s) for part in (0.5, 1.0))
        work = self.work(self.q, half, end)
        there = self.balance(end)
        near = self.settled and there[2] < 0.5 * before  # work is lost in round-off here
        if not (work >= 0.1 * promised or near):
            return False
        self.q = end
        self.x, self.lam, self.imbalance = there
        return True

    def closed(self, q: np.ndarray) -> np.ndarray:
        """Return a position near `q` where all joints meet; places follow angles rather than angles places."""
        p, before = self.p, np.inf
        weight = np.tile([PLACES / self.extent**2, PLACES / self.extent**2, 1.0], len(p.bodies))
        for _ in range(MOST_CLOSINGS):
            jacobian = p.constraint_jacobian(p.t0, q)
            matrix = block_array([[diags_array(weight), jacobian.T], [jacobian, None]], format="csc")
            change = splu(matrix).solve(np.concatenate([self.none, -p.constraints(p.t0, q)]))[: p.n]
            q = q + change
            now = p.relative_change(q, change)
            if now <= ROUND_OFF or (now >= 0.5 * before and now < STAGNANT):
                return q
            before = now
        raise StepError("newton-failed", "the joints do not meet")

    def work(self, start: np.ndarray, half: np.ndarray, end: np.ndarray) -> float:
        """Return the work of the forces along the parabola through three positions, by Simpson's rule."""
        ways = (-3 * start + 4 * half - end, end - start, start - 4 * half + 3 * end)
        total = 0.0
        for weight, q, way in zip((1, 4, 1), (start, half, end), ways, strict=True):
            total -= weight / 6 * float(way @ self.p.residual(self.p.t0, q, self.none, self.none, self.lam))
        return total


def _reactions(placed: Placed, q: np.ndarray, multiplier: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return force (J, 2) and torque (J,) of each joint on its second body, at that body's joint point."""
    compiled, w = placed.workspace.mechanism, placed.workspace.scratch
    top, ground = compiled.topology, np.zeros(3)
    padded = np.concatenate([q, ground])
    constraints_at(top, w, placed.equations.t0, padded, np.zeros_like(padded))
    lam = np.zeros((len(top.pairs), 2))
    for row, value in zip(compiled.rows, multiplier, strict=True):
        lam[row.pair, row.place] = value
    on_second = -np.einsum("kr,krd->kd", lam, w.jac.reshape(-1, 2, 2, 3)[:, :, 1])
    angle = padded[3 * top.pairs[:, 2] + 2]
    px, py = top.pair_parameters[:, 2], top.pair_parameters[:, 3]
    arm_x, arm_y = np.cos(angle) * px - np.sin(angle) * py, np.sin(angle) * px + np.cos(angle) * py
    on_second[:, 2] -= arm_x * on_second[:, 1] - arm_y * on_second[:, 0]
    total = np.array([on_second[list(pairs)].sum(axis=0) for pairs in compiled.joint_pairs]).reshape(-1, 3)
    return total[:, :2], total[:, 2]


def spec_at(placed: Placed, found: Equilibrium) -> dict[str, Any]:
    """Return the spec as a plain mapping with its mechanism written out, at rest in the equilibrium."""
    spec = placed.spec
    model = spec.mechanism().to_spec()
    for name, (x, y, angle) in zip(found.bodies, found.position.tolist(), strict=True):
        body = model["bodies"][name]
        body |= {"position": [x, y], "angle": angle}
        for rate in ("velocity", "angular_velocity"):
            body.pop(rate, None)
    sections = {name: plain(getattr(spec, name)) for name in type(spec).model_fields if name != "model"}
    for section in sections.values():
        if isinstance(section, dict):
            for key in [key for key, value in section.items() if value is None]:
                del section[key]
    return {"mbdkit": sections.pop("mbdkit"), "model": model, **sections}
