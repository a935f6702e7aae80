"""Static equilibrium by a damped Newton search. Steps follow the direction of the forces, so that the search ends in a
stable equilibrium.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Unpack

import numpy as np
from scipy.linalg import qr

from mbdkit.base import elementary
from mbdkit.base.html_view import HtmlView
from mbdkit.base.logs import warn_on_stderr
from mbdkit.base.plain_data import plain
from mbdkit.base.text import listed
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.kernels.observe import constraints_at
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.observed_states import StateObserver
from mbdkit.mechanism.beam_shape import places_with_ends, with_ends
from mbdkit.mechanism.beams import named_body
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.parameters import parameters_in_use
from mbdkit.quantities.states import States
from mbdkit.runs.coarse_beams import CoarseBeams
from mbdkit.spec.loading import RunSource, Sections
from mbdkit_statics.equilibrium_search import FRICTION, Rest, has_friction, rest
from mbdkit_statics.prepared_mechanism import PreparedMechanism
from mbdkit_statics.reduced import at_rest, in_statics
from mbdkit_statics.stability import stability_of

UNDAMPED = (
    "nothing damps the small motions of this equilibrium although its loads can supply energy, as follower loads do: a "
    "little damping may make it unstable"
)

#: Number of bodies that the text of a motion names; bodies that move less than this share of the others are left out.
SHOWN, LEFT_OUT = 3, 1e-6

CORNER = (
    "a force has a corner in this position, as a rope that is just taut or a stop that just touches: the stiffness "
    "depends on the direction, and the lowest of all sides is given"
)


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
        Lowest eigenvalue of the stiffness along the degrees of freedom, for unit mass [1/s^2]; the lowest real part if
        follower loads or feedback make eigenvalues complex. It is the resistance to slow displacements, in which
        first-order states keep their values at rest. Only if forces have a potential and damping takes energy away,
        its sign is that of the stability, and a positive stiffness without damping is the square of the lowest natural
        frequency. Otherwise motions can grow although it is positive; see `stability`. NaN without degrees of freedom.
        With more than 500 bodies and several negative eigenvalues, it is the negative eigenvalue closest to zero.
    stability
        ``stable``, ``neutral`` (a motion without restoring force exists), ``unstable``, ``fixed`` (no degrees of
        freedom), ``corner`` (a force has a corner there, and neither all sides are stable nor a motion is found that
        leads to where it is driven on), or ``unknown`` (more than 500 bodies, or beams with first-order states, whose
        forces can supply energy: the motions that were examined do not grow). Small motions decide, to first order: the
        minimum of the potential energy if forces have a potential and damping takes energy away, otherwise the
        eigenvalues of the linearised motion, with its velocities and first-order states.
    neutral_motions
        Motions without restoring force, as text such as ``ball turns about (0, 0.2)``; their bodies turn about the
        named points, or move along the named directions, at first. Combinations of them have no restoring force
        either. Empty with more than 500 bodies.
    growth
        Eigenvalue of the small motion that grows fastest [1/s], if it is unstable: a real number for divergence, a
        complex one for flutter. 0 if no motion grows exponentially.
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
    growth: complex
    iterations: int
    states: tuple[str, ...] = ()
    state: np.ndarray = field(default_factory=lambda: np.zeros(0))
    beams: Mapping[str, np.ndarray] = field(default_factory=dict)
    displacement: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    mechanism: Mechanism | None = field(default=None, repr=False, compare=False)
    warnings: tuple[str, ...] = ()
    neutral_motions: tuple[str, ...] = ()

    @property
    def flutters(self) -> bool:
        """Whether the small motion that grows fastest is an oscillation (flutter)."""
        return self.growth.imag != 0

    def __getitem__(self, body: str) -> np.ndarray:
        """Return x, y [m] and angle [rad] of a body by its name."""
        return np.asarray(self.position[self.bodies.index(named_body(body, self.bodies))])

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.bodies)


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
    result = equilibrium_of(PreparedMechanism.of(source, **sections))
    warn_on_stderr(result.warnings)
    return result


def equilibrium_of(prepared: PreparedMechanism) -> Equilibrium:
    """Find the static equilibrium of a prepared mechanism; see `equilibrium`."""
    dynamic, prepared = prepared, in_statics(prepared)
    with prepared.as_spec_errors():
        result = rest(prepared)
        p, compiled = prepared.equations, prepared.workspace.mechanism
        stability = stability_of(dynamic, prepared, at_rest(prepared, result.q, result.lam), result.z)
        rows = p.recorded_multipliers(p.t0, result.q, result.lam)
        force, torque = joint_reactions(prepared, p.t0, result.q, rows)
        residual = float(np.max(np.abs(p.constraints(p.t0, result.q)), initial=0.0))
    mechanism = prepared.spec.mechanism()
    outside = dynamic.laws_out_of_range(p.t0, result.q, p.v0 * 0.0)
    forces, warnings = _internal_forces(prepared, result) if mechanism.beams else ({}, ())
    is_noted = {FRICTION: has_friction(prepared), UNDAMPED: stability.is_undamped, CORNER: stability.is_corner}
    notes = (note for note, holds in is_noted.items() if holds)
    return Equilibrium(
        time=p.t0,
        bodies=p.bodies,
        joints=compiled.joints,
        constraints=tuple(row.label for row in compiled.rows),
        position=result.q.reshape(-1, 3),
        multiplier=rows,
        reaction_force=force,
        reaction_torque=torque,
        shared=compiled.redundancy.not_unique,
        imbalance=float(np.max(np.abs(result.left))),
        residual=residual,
        stiffness=stability.stiffness,
        stability=stability.verdict,
        growth=stability.growth,
        iterations=result.iterations,
        states=tuple(state.name for state in compiled.named_states),
        state=result.z[: len(compiled.named_states)],
        beams=forces,
        displacement=(result.q - p.q0).reshape(-1, 3),
        mechanism=mechanism,
        warnings=(*outside, *warnings, *notes),
        neutral_motions=motions_in_words(stability.neutral, p.bodies, result.q, compiled.length),
    )


def motions_in_words(motions: np.ndarray, bodies: Sequence[str], q: np.ndarray, length: float) -> tuple[str, ...]:
    """Return a text for each of k motions that combine to the same motions as the given ones (n, k) and in which as few
    bodies as possible take part.

    Angles are compared with translations by `length` [m].
    """
    if not motions.size:
        return ()
    motions = motions * np.tile([1.0, 1.0, length], len(bodies))[:, None]
    pivots = np.sort(qr(motions.T, mode="r", pivoting=True)[1][: motions.shape[1]])
    texts = []
    for motion in np.linalg.solve(motions[pivots].T, motions.T):
        parts = []
        sizes = np.linalg.norm(motion.reshape(-1, 3), axis=1)
        for k in np.flatnonzero(sizes > LEFT_OUT * np.max(sizes)).tolist():
            x, y, turn = motion[3 * k : 3 * k + 3]
            if abs(turn) > LEFT_OUT * sizes[k]:
                verb, where = "turns about", q[3 * k : 3 * k + 2] + np.array([-y, x]) * length / turn
            else:
                verb, where = "moves along", np.array([x, y]) / np.hypot(x, y)
            parts.append(f"{bodies[k]} {verb} ({', '.join(f'{c:.4g}' for c in np.round(where, 9) + 0.0)})")
        texts.append(listed(parts, "and", most=SHOWN))
    return tuple(texts)


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
    return forces, coarse.findings()


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
    angle = padded[3 * top.pairs[:, PAIR.second] + 2]
    px, py = top.pair_parameters[:, 2], top.pair_parameters[:, 3]
    c, s = elementary.cos(angle), elementary.sin(angle)
    arm_x, arm_y = c * px - s * py, s * px + c * py
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
