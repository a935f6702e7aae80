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
    """Return the initial states of mechanisms that share a solver; None for each that `assemble` has to compute."""
    if len(search.scratch.u):  # motions have to be checked
        return [None] * len(mechanisms)
    bodies = [mechanism.bodies.values() for mechanism in mechanisms]
    q, v = np.zeros((2, len(mechanisms), len(bodies[0]) + 1, 3))
    q[:, :-1] = [[(*body.position, body.angle) for body in some] for some in bodies]
    v[:, :-1] = [[(*body.velocity, body.angular_velocity) for body in some] for some in bodies]
    tolerance = [mechanism.assembly.tolerance for mechanism in mechanisms]
    return consistent_states(q.reshape(len(q), -1), v.reshape(len(v), -1), tolerance, [*mechanisms[0].bodies], search)


def consistent_states(
    q: np.ndarray, v: np.ndarray, tolerance: Sequence[float], names: Sequence[str], search: LeastChange
) -> list[AssembledState | None]:
    """Return N states that satisfy the constraints without any change; None for each that does not.

    They are bitwise equal to those of `assemble`. `q`, `v`: (N, 3 (B + 1)) positions and velocities, ground last.
    `tolerance`: (N,) tolerances of assembly. `names`: (B,) names of the bodies.
    """
    phi, rate = search.residuals(q, v)
    gap, speed, far, fast = (np.abs(x).max(axis=1, initial=0.0).tolist() for x in (phi, rate, q, v))
    none = dict.fromkeys(names, 0.0)
    positions, velocities = (x.reshape(len(x), -1, 3)[:, :-1] for x in (q, v))
    states: list[AssembledState | None] = []
    for k in range(len(q)):
        q_tolerance, v_tolerance = tolerances(tolerance[k], far[k], fast[k], search)
        is_consistent = gap[k] <= q_tolerance and speed[k] <= v_tolerance
        state = AssembledState(positions[k], velocities[k], False, none, none, none, none, gap[k], speed[k])
        states.append(state if is_consistent else None)
    return states
