"""The recorded states of a run, from which the columns of its archive are computed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbdkit.base.frozen import dataclass, fields
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.observed_states import StateObserver, joint_sums
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Stretch
from mbdkit.quantities.states import NONE, States


def recorded_states(
    mechanism: CompiledMechanism,
    stretch: Stretch,
    observed: Observed,
    start_energy: float | np.ndarray = 0.0,
    elapsed: np.ndarray = NONE,
) -> States:
    """Return the states of a stretch of a run; see `States` for the arguments."""
    return States(
        mechanism,
        stretch.time,
        stretch.q,
        stretch.v,
        lambda: observed,
        work=stretch.work,
        dissipated=stretch.dissipated,
        start_energy=start_energy,
        elapsed=elapsed,
        multipliers=stretch.multipliers,
        z=NONE if stretch.z is None else stretch.z,
    )


@dataclass(frozen=True)
class ObservedRows:
    """States and reactions of B bodies and J joints at T times.

    `time`: (T,) [s]. `position`, `velocity`: (T, B, 3) [m, rad] and [m/s, rad/s]. `force`: (T, J, 2) reaction forces
    [N]. `torque`: (T, J) reaction torques [N m].
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    torque: np.ndarray

    @classmethod
    def at(
        cls,
        workspace: Workspace,
        times: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        z: np.ndarray | None = None,
        *,
        seen: np.ndarray,
    ) -> ObservedRows:
        """Return states with their reactions; rows are nan from the first missing or singular state on.

        Positions and velocities are (T, 3 (B + 1)); first-order states, if there are any, are (T, Z). Motions and loads
        are evaluated at the times `seen` (T,); see `Timetable.before`.
        """
        count = int(np.sum(np.minimum.accumulate(np.all(np.isfinite(q) & np.isfinite(v), axis=1))))
        observer = StateObserver(workspace.with_own_pivots())
        observed = observer.arrays(count)
        singular = observer.observe(seen[:count], q[:count], v[:count], observed, z=None if z is None else z[:count])
        count = count if singular is None else singular.row
        position, velocity = (x[:, :-3].reshape(len(times), -1, 3).copy() for x in (q, v))
        wrench = np.full((len(times), len(workspace.mechanism.joints), 3), np.nan)
        position[count:] = velocity[count:] = np.nan
        wrench[:count] = joint_sums(workspace.mechanism).sum(observed.reactions)[:count]
        return cls(times, position, velocity, wrench[..., :2], wrench[..., 2])

    @staticmethod
    def of(states: States) -> ObservedRows:
        """Return the rows of states."""
        reactions = states.reactions
        return ObservedRows(
            states.time, states.by_body(states.q), states.by_body(states.v), reactions[:, :, :2], reactions[:, :, 2]
        )

    @classmethod
    def joined(cls, parts: Sequence[ObservedRows]) -> ObservedRows:
        """Return the rows of consecutive parts as one object."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))
