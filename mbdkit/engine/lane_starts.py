"""The starts of mechanisms that differ only in their initial states, computed together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.engine.assembly import AssembledState, tolerances
from mbdkit.engine.consistent_start import CompiledForStarts, MechanismAtStart, within_double_precision
from mbdkit.engine.least_change import LeastChange
from mbdkit.mechanism.mechanism import Mechanism


def at_starts(
    compiled: CompiledForStarts, mechanisms: Sequence[Mechanism], ends: Sequence[float]
) -> list[MechanismAtStart | None]:
    """Return several mechanisms at their starts; None for each for which `CompiledForStarts.at_start` raises an error.

    States that satisfy the constraints without any change are found for all mechanisms at once.
    """
    try:
        with within_double_precision():
            states = _consistent_states(mechanisms, compiled.search)
    except SpecError:
        states = [None] * len(mechanisms)
    starts: list[MechanismAtStart | None] = []
    for mechanism, end, state in zip(mechanisms, ends, states, strict=True):
        try:
            starts.append(
                compiled.at_start(mechanism, end) if state is None else compiled.checked(mechanism, state, end)
            )
        except (Exception, SystemExit):
            starts.append(None)
    return starts


def _consistent_states(mechanisms: Sequence[Mechanism], search: LeastChange) -> list[AssembledState | None]:
    """Return the initial states of mechanisms that share a solver; None for each that `assemble` has to compute.

    Only states that satisfy the constraints without any change are returned. They are bitwise equal to those of
    `assemble`.
    """
    if len(search.scratch.u):  # motions have to be checked
        return [None] * len(mechanisms)
    bodies = [mechanism.bodies.values() for mechanism in mechanisms]
    q, v = np.zeros((2, len(mechanisms), len(bodies[0]) + 1, 3))
    q[:, :-1] = [[(*body.position, body.angle) for body in some] for some in bodies]
    v[:, :-1] = [[(*body.velocity, body.angular_velocity) for body in some] for some in bodies]
    q_flat, v_flat = q.reshape(len(q), -1), v.reshape(len(v), -1)
    phi, rate = search.residuals(q_flat, v_flat)
    gap, speed, far, fast = (np.abs(x).max(axis=1, initial=0.0).tolist() for x in (phi, rate, q_flat, v_flat))
    none = dict.fromkeys(mechanisms[0].bodies, 0.0)
    states: list[AssembledState | None] = []
    for k, mechanism in enumerate(mechanisms):
        tolerance = mechanism.assembly.tolerance
        q_tolerance, v_tolerance = tolerances(tolerance, far[k], fast[k], search)
        is_consistent = gap[k] <= q_tolerance and speed[k] <= v_tolerance
        state = AssembledState(q[k, :-1], v[k, :-1], False, none, none, none, none, gap[k], speed[k])
        states.append(state if is_consistent else None)
    return states
