"""Static equilibrium by a damped Newton search. Steps follow the direction of the forces, so that the search ends in a
stable equilibrium.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Unpack

import numpy as np
from scipy.sparse import block_array, diags_array
from scipy.sparse.linalg import splu

from mbdkit.base.errors import StepError
from mbdkit.base.html_view import HtmlView
from mbdkit.base.logs import warn_on_stderr
from mbdkit.base.plain_data import plain
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.observe import constraints_at
from mbdkit.engine.kernels.projection import STAGNANT
from mbdkit.engine.nearest_state import ROUND_OFF
from mbdkit.engine.observed_states import StateObserver
from mbdkit.mechanism.beam_shape import places_with_ends, with_ends
from mbdkit.mechanism.beams import named_body
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.parameters import parameters_in_use
from mbdkit.quantities.states import States
from mbdkit.runs.coarse_beams import CoarseBeams
from mbdkit.spec.loading import RunSource, Sections
from mbdkit_statics.prepared_mechanism import PreparedMechanism
from mbdkit_statics.reduced import (
    DENSE,
    State,
    at_rest,
    coupled_states,
    in_statics,
    least_stiffness,
    reduce,
    softest_motion,
    softest_scale,
    stiffness_scale,
)
from mbdkit_statics.states_at_rest import StaticEquations

MOST_STEPS = 1000
"""Largest number of attempted steps, including rejected ones; a search with more steps fails.

Cantilevers under a force that bends them strongly need about 300 steps, with coarse elements that are `corrected` up to
540.
"""

LONGEST = 0.5
"""Largest step of a coordinate, relative to the size of the mechanism or to 1 rad."""

BALANCED = 1e-13
"""The search ends if the imbalance is below this fraction of the forces that balance each other.

The imbalance is the norm of the accelerations from rest in the mass metric. The size of the forces is the attribute
`force` of the search.
"""

STALLED = 1e-8
"""The result of a search that no longer makes progress is accepted if the imbalance is below this fraction of the
forces.
"""

NEAR = 1e-2
"""If the imbalance is below this fraction of the forces, a step with the true stiffness is tried first."""

PATIENCE = 8
"""A search counts as stagnant after this many consecutive steps that do not halve the imbalance."""

MUCH = 1e3
"""The result of a stagnant search is also accepted if the imbalance is at most this multiple of its estimated rounding
error.
"""

PLACES = 1e-6
"""Weight of a translation by the size of the mechanism, relative to the weight of a rotation by 1 rad, in the norm
that corrections of open joints minimise."""

MOST_CLOSINGS = 20
"""Largest number of Newton steps for closing the joints."""

MOST_SADDLES = 10
"""Largest number of saddle points from which a search continues."""

SADDLE = 1e-9
"""A stiffness counts as negative if it is below minus this fraction of the largest stiffness of a single coordinate.

Smaller magnitudes are attributed to round-off.
"""

GROWS = 1e-9
"""Small motions count as growing if the real part of an eigenvalue, relative to the largest eigenvalue, is above
this.
"""

NEUTRAL = 1e-11
"""The lowest stiffness counts as zero if it is below this fraction of the sum of the magnitudes of its terms."""


@dataclass(frozen=True)
class Equilibrium(HtmlView):
    """A mechanism at rest, with its drivers held at their values at `time`.

    Attributes
    ----------
    time
        The time at which drivers and loads were evaluated [s].
    bodies, joints, constraints
        Names of the bodies, the joints, and the constraint rows as ``joint.row``.
    position : (B, 3) array
        x, y [m] and angle [rad] of each body.
    multiplier : (rows,) array
        Multipliers of the constraint rows [N, N m].
    reaction_force, reaction_torque : (J, 2) and (J,) arrays
        Force and torque that the first body of each joint exerts on the second, in the global frame, at the joint point
        of the second body [N, N m].
    shared
        Joints whose reactions are not unique because joints are redundant.
    imbalance
        Largest remaining acceleration [m/s^2, rad/s^2].
    residual
        Largest gap in the joints [m, rad].
    stiffness
        Lowest eigenvalue of the stiffness along the degrees of freedom, for unit mass [1/s^2]. If positive, it is the
        square of the lowest natural frequency. NaN without degrees of freedom. With more than 500 bodies and several
        negative eigenvalues, it is the negative eigenvalue closest to zero.
    stability
        ``stable``, ``neutral`` (a motion without restoring force exists), ``unstable``, or ``fixed`` (no degrees of
        freedom).
    iterations
        Number of Newton steps tried.
    states
        Names of the first-order states.
    state : (Z,) array
        Values of the first-order states.
    beams
        Internal forces of each beam, by name: an (E + 2, 4) array with the distance along the beam from end a [m],
        axial force, shear force [N] and moment [N m]; at end a, in the middle of each of the E elements, and at end b.
    displacement : (B, 3) array
        `position` minus the consistent initial position [m, rad].
    mechanism
        The mechanism; notebooks use it to draw the equilibrium.
    warnings
        Warnings about force laws outside their ranges, and about beams whose elements are too coarse, as sentences.
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
    states: tuple[str, ...] = ()
    state: np.ndarray = field(default_factory=lambda: np.zeros(0))
    beams: Mapping[str, np.ndarray] = field(default_factory=dict)
    displacement: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    mechanism: Mechanism | None = field(default=None, repr=False, compare=False)
    warnings: tuple[str, ...] = ()

    def __getitem__(self, body: str) -> np.ndarray:
        """Return x, y [m] and angle [rad] of a body by its name."""
        found: np.ndarray = self.position[self.bodies.index(named_body(body, self.bodies))]
        return found

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.bodies)


@dataclass(frozen=True)
class Rest:
    """Result of a search for an equilibrium.

    Attributes
    ----------
    q : (n,) array
        Position [m, rad].
    lam : (m,) array
        Multipliers of the constraints.
    left : (n,) array
        Remaining accelerations [m/s^2, rad/s^2].
    iterations
        Number of attempted steps.
    z : (Z,) array
        First-order states.
    """

    q: np.ndarray
    lam: np.ndarray
    left: np.ndarray
    iterations: int
    z: np.ndarray


def equilibrium(source: RunSource, **sections: Unpack[Sections]) -> Equilibrium:
    """Find the static equilibrium of a mechanism from its start.

    Solves ``Phi_q^T lam = Q(t, q, 0)``, ``Phi(t, q) = 0`` by Newton's method, for the constraints Phi with the
    multipliers lam and the applied forces Q. Each step is damped in the mass metric (Levenberg-Marquardt) until the
    forces do positive work along it. If a search ends on a saddle of the potential and the mechanism has at most 500
    bodies, the search is continued beside the saddle. The result is therefore usually stable, unless the start itself
    is an unstable equilibrium; see `Equilibrium.stability`. Drivers and loads are evaluated at the start time,
    ``time={"start": ...}``, and velocities are zero.

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
        If the input is wrong, or no equilibrium is found from this start.
    RunError
        If a force law is outside its range in the equilibrium, and ``limits.law_range`` is ``stop``.

    Examples
    --------
    A mass of 2 kg stretches a spring of 100 N/m by 2 kg * 9.81 m/s^2 / (100 N/m):

    >>> import mbdkit
    >>> m = mbdkit.Mechanism()
    >>> mass = m.body("mass", mass=2.0, position=(0.0, -1.0))
    >>> m.spring_damper("spring", m.ground, mass, from_=(0, 0), to=(0, -1), stiffness=100.0, free_length=1.0)
    >>> found = mbdkit.equilibrium(m)
    >>> found.stability
    'stable'
    >>> round(float(found.position[0, 1]), 9)
    -1.1962
    """
    found = equilibrium_of(PreparedMechanism.of(source, **sections))
    warn_on_stderr(found.warnings)
    return found


def equilibrium_of(prepared: PreparedMechanism) -> Equilibrium:
    """Find the static equilibrium of a prepared mechanism; see `equilibrium`."""
    dynamic, prepared = prepared, in_statics(prepared)
    with prepared.as_spec_errors():
        found = rest(prepared)
        p, compiled = prepared.equations, prepared.workspace.mechanism
        at = at_rest(prepared, found.q, found.lam)
        stiffness, stability = _stability(prepared, at)
        if compiled.states and stability != "fixed":
            small = reduce(dynamic, at, found.z)
            matrix = coupled_states(dynamic, at, small, found.z).matrix(small.stiffness, small.damping)
            values = np.linalg.eigvals(matrix)
            if np.max(values.real) > GROWS * np.max(np.abs(values)):
                stability = "unstable"
        rows = p.recorded_multipliers(p.t0, found.q, found.lam)
        force, torque = joint_reactions(prepared, p.t0, found.q, rows)
        residual = float(np.max(np.abs(p.constraints(p.t0, found.q)), initial=0.0))
    mechanism = prepared.spec.mechanism()
    outside = dynamic.laws_out_of_range(p.t0, found.q, p.v0 * 0.0)
    forces, warnings = _internal_forces(prepared, found) if mechanism.beams else ({}, ())
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
        states=tuple(one.name for one in compiled.states),
        state=found.z,
        beams=forces,
        displacement=(found.q - p.q0).reshape(-1, 3),
        mechanism=mechanism,
        warnings=(*outside, *warnings),
    )


def _internal_forces(prepared: PreparedMechanism, found: Rest) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Return the internal forces of the beams at rest by name, see `Equilibrium.beams`, and warnings about beams whose
    elements are too coarse.
    """
    mechanism, compiled = prepared.spec.mechanism(), prepared.workspace.mechanism
    observer = StateObserver(prepared.workspace.with_own_pivots())
    out = observer.arrays(1)
    q = np.append(found.q, np.zeros(3))[None]
    observed_at = np.array([prepared.equations.t0])
    observer.observe(observed_at, q, np.zeros_like(q), out, z=found.z[None])
    coarse = CoarseBeams(mechanism, compiled)
    coarse.add(States(compiled, observed_at, q, np.zeros_like(q), lambda: out))
    forces = {}
    places = {body: i for i, body in enumerate(compiled.bodies)}
    for name, beam in mechanism.beams.items():
        angles = q[0, [3 * places[node] + 2 for node in beam.node_names(name)]]
        within = with_ends(out.beams[0, compiled.beam_elements(name), :3], angles, beam.element_length)
        forces[name] = np.column_stack([places_with_ends(beam.length, beam.elements), within])
    return forces, coarse.warnings()


def _stability(prepared: PreparedMechanism, at: State) -> tuple[float, str]:
    """Return the lowest stiffness at rest [1/s^2], and the stability that it implies."""
    if prepared.freedoms == 0:
        return float("nan"), "fixed"
    stiffness = least_stiffness(prepared, at)
    if abs(stiffness) <= NEUTRAL * softest_scale(prepared, at):
        return stiffness, "neutral"
    return stiffness, "stable" if stiffness > 0 else "unstable"


def rest(prepared: PreparedMechanism) -> Rest:
    """Return the static equilibrium; raises SpecError if none is found.

    A search can end on a saddle of the potential, because steps towards a saddle do positive work as well. The search
    is then continued from positions on both sides of the saddle, along the motion of lowest stiffness.
    """
    search = _Search(prepared)
    found = search.run()
    for _ in range(MOST_SADDLES):
        if found is None or not search.has_moved or not search.leave(_descent(prepared, found)):
            break
        found = search.run()
    if found is not None:
        return found
    here = search.x
    worst = int(np.argmax(np.abs(here)))
    name, unit = prepared.equations.bodies[worst // 3], "rad/s^2" if worst % 3 == 2 else "m/s^2"
    raise prepared.error(
        f"no static equilibrium was found from this start in {search.tried} steps: in the last position body {name!r} "
        f"still accelerates by {abs(here[worst]):.3g} {unit}; start closer to an equilibrium, or hold that body"
    )


def _descent(prepared: PreparedMechanism, found: Rest) -> np.ndarray | None:
    """Return the motion (n,) with the most negative stiffness at rest; None if no stiffness is negative.

    Also None if the mechanism is too large to be reduced to its degrees of freedom.
    """
    if not 0 < prepared.freedoms <= prepared.equations.n <= DENSE:
        return None
    at = at_rest(prepared, found.q, found.lam)
    value, way = softest_motion(prepared, at)
    return way if value < -SADDLE * stiffness_scale(prepared, at) else None


class _Search:
    """A damped Newton search on the constraint manifold."""

    def __init__(self, prepared: PreparedMechanism):
        self.p: EquationsOfMotion = prepared.equations
        self.extent = prepared.extent
        self.none, self.no_rows = np.zeros(self.p.n), np.zeros(self.p.m)
        self.q = self.p.q0.copy()
        self.tried = 0
        self.force = 0.0
        """Largest sum so far of the norms of applied and constraint forces, in the metric of the inverse mass."""
        self.x, self.lam, self.imbalance = self.balance(self.q)
        stiffest = stiffness_scale(prepared, at_rest(prepared, self.q, self.lam)) if prepared.freedoms else 0.0
        self.blur = float(np.finfo(float).eps) * stiffest * self.extent * float(np.sqrt(np.sum(self.p.mass)))
        """Imbalance that rounding errors of the positions can cause, by the largest stiffness of a coordinate."""

    def balance(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the accelerations from rest (n,), the multipliers (m,), and the imbalance.

        The imbalance is the norm of these accelerations in the mass metric.
        """
        p = self.p
        applied = p.forces(p.t0, q, self.none)
        x, lam = p.solve(p.t0, q, applied, self.no_rows)
        held = p.constraint_forces(p.t0, q, lam)
        force = np.sqrt(np.sum(applied**2 / p.mass)) + np.sqrt(np.sum(held**2 / p.mass))
        self.force = max(self.force, float(force))
        return x, lam, float(np.sqrt(np.sum(p.mass * x**2)))

    def size(self, s: np.ndarray) -> float:
        """Return the largest change of a coordinate in a step, relative to the size of the mechanism or to 1 rad."""
        parts = np.abs(s.reshape(-1, 3)) / (self.extent, self.extent, 1.0)
        return float(np.max(parts))

    def run(self) -> Rest | None:
        # Levenberg-Marquardt: with little damping a step is a Newton step, with much damping a short step along the
        # accelerations. The initial damping limits such a step to `LONGEST`. After a rejected step, the damping has a
        # lower bound, because multiplying a vanishing value would increase it too slowly.
        idle, damping = 0, self.size(self.x) / LONGEST
        while self.tried < MOST_STEPS:
            if self.imbalance <= max(BALANCED * self.force, self.blur) or (idle >= PATIENCE and self.is_balanced):
                break
            before = self.imbalance
            taken = self.step(damping)
            if not taken:
                damping = max(4 * damping, 1e-12 * self.force / self.extent)
                idle += 1
                continue
            damping *= 0.1
            idle = 0 if self.imbalance < 0.5 * before else idle + 1
        if self.is_balanced:
            z = self.p.states.solve(self.p.t0, self.q) if isinstance(self.p, StaticEquations) else np.zeros(0)
            return Rest(self.q, self.lam, self.x, self.tried, z)
        return None

    @property
    def has_moved(self) -> bool:
        """Whether the position differs from the position at the start."""
        return bool(np.any(self.q != self.p.q0))

    def leave(self, way: np.ndarray | None) -> bool:
        """Leave a saddle along `way` (n,) or in the opposite direction, if the forces do positive work along it.

        Returns whether the saddle was left; False if `way` is None.
        """
        if way is None:
            return False
        way = way / self.size(way)
        for reach in (0.1, 0.01, 0.001):
            for side in (way, -way):
                try:
                    half, end = (self.closed(self.q + part * reach * side) for part in (0.5, 1.0))
                    work, there = self.work(self.q, half, end), self.balance(end)
                except (StepError, RuntimeError):  # the joints cannot be closed there
                    continue
                if work > 0:
                    self.q = end
                    self.x, self.lam, self.imbalance = there
                    return True
        return False

    def step(self, damping: float) -> bool:
        """Try a step with ``damping * M`` added to the stiffness; return whether it was taken.

        M is the mass matrix, and `damping` is in 1/s^2. Compressed elements make diagonal entries of the stiffness
        negative, so that a Newton step can point against the forces. If there are such entries, another step is tried
        as well, for which twice the magnitude of these entries is added to them, so that they are positive. Far from
        equilibrium, this other step is tried first.
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
        except (StepError, RuntimeError):  # the matrix is singular, or the joints cannot be closed after the step
            pass
        return False

    @property
    def is_balanced(self) -> bool:
        """Whether the imbalance is small enough for the result of the search to be accepted."""
        return self.imbalance <= max(STALLED * self.force, MUCH * self.blur)

    def take(self, s: np.ndarray) -> bool:
        """Take a step, shortened to `LONGEST`, if the forces do positive work along it; return whether it was taken."""
        p, before = self.p, self.imbalance
        if not np.all(np.isfinite(s)):
            return False
        s = s / max(1.0, self.size(s) / LONGEST)
        # The imbalance does not measure progress, because it also vanishes at a maximum of the potential. Instead, the
        # work of the forces must be at least a tenth of the work that follows from their values at the beginning.
        promised = float(np.sum(p.mass * self.x * s))
        if not promised > 0:
            return False
        half, end = (self.closed(self.q + part * s) for part in (0.5, 1.0))
        work = self.work(self.q, half, end)
        there = self.balance(end)
        # Close to equilibrium, the work is smaller than its rounding error; half the imbalance is then sufficient.
        near = self.is_balanced and there[2] < 0.5 * before
        if not (work >= 0.1 * promised or near):
            return False
        self.q = end
        self.x, self.lam, self.imbalance = there
        return True

    def closed(self, q: np.ndarray) -> np.ndarray:
        """Return a position near `q` at which all joints are closed.

        Translations have the small weight `PLACES`, so that bodies are translated rather than rotated.
        """
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
        raise StepError("newton-failed", "the joints cannot be closed")

    def work(self, start: np.ndarray, half: np.ndarray, end: np.ndarray) -> float:
        """Return the work of the forces along the parabola through three positions, by Simpson's rule [J]."""
        ways = (-3 * start + 4 * half - end, end - start, start - 4 * half + 3 * end)
        total = 0.0
        for weight, q, way in zip((1, 4, 1), (start, half, end), ways, strict=True):
            total -= weight / 6 * float(way @ self.p.residual(self.p.t0, q, self.none, self.none, self.lam))
        return total


def joint_reactions(
    prepared: PreparedMechanism, t: float, q: np.ndarray, multiplier: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return force (J, 2) [N] and torque (J,) [N m] of each joint on its second body, at that body's joint point."""
    compiled, w = prepared.workspace.mechanism, prepared.workspace.scratch
    top, padded = compiled.topology, with_ground(q)
    constraints_at(top, w, t, padded, np.zeros_like(padded))
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


def spec_at(prepared: PreparedMechanism, found: Equilibrium) -> dict[str, Any]:
    """Return the spec as a plain mapping in which the mechanism is given in the equilibrium, at rest.

    The numbers of the mechanism are values, not expressions. Parameters that expressions outside the model do not use
    are left out, because changing them would have no effect.
    """
    spec = prepared.spec
    kept = parameters_in_use(spec.parameters, spec.expressions_outside_model)
    left_out = {*spec.parameters} - kept
    mechanism = spec.mechanism()
    model = mechanism.to_spec()
    places = dict(zip(found.bodies, found.position.tolist(), strict=True))
    for name, value in zip(found.states, found.state.tolist(), strict=True):
        if name in model.get("states", {}):
            model["states"][name]["initial"] = value
        else:
            element, _, state = name.rpartition(".")
            model["forces"][element][state] = value
    for name, body in model["bodies"].items():
        x, y, angle = places[name]
        # As an expression, an angle above a full rotation is not taken for degrees.
        body |= {"position": [x, y], "angle": angle if abs(angle) <= 2.0 * np.pi else f"{angle / np.pi!r}*pi"}
    for name, beam in model.get("beams", {}).items():
        beam["start"] = [places[node] for node in mechanism.beams[name].node_names(name)]
    for element in (*model["bodies"].values(), *model.get("beams", {}).values()):
        for rate in ("velocity", "angular_velocity"):
            element.pop(rate, None)
    sections = {name: plain(getattr(spec, name)) for name in type(spec).model_fields if name != "model"}
    sections["parameters"] = {name: value for name, value in sections["parameters"].items() if name in kept}
    without = {*left_out, *(f"parameters.{name}" for name in left_out)}
    sections["gradients"] = [name for name in sections["gradients"] if name not in without]
    for section in sections.values():
        if isinstance(section, dict):
            for key in [key for key, value in section.items() if value is None]:
                del section[key]
    return {"mbdkit": sections.pop("mbdkit"), "model": model, **sections}
