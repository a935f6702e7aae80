"""The recorded states of a run, from which the columns of its archive are computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.observe import Observed
from mbdkit.quantities.states import NONE, States
from mbdkit.stepping.interface import Stretch


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
    )


@dataclass(frozen=True)
class ObservedRows:
    """States and reactions of B bodies and J joints at T times.

    Parameters
    ----------
    time
        (T,) [s].
    position, velocity
        (T, B, 3) [m, rad] and [m/s, rad/s].
    force
        (T, J, 2) reaction forces [N].
    torque
        (T, J) reaction torques [N m].
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    torque: np.ndarray

    @staticmethod
    def of(states: States) -> ObservedRows:
        """Return the rows of states."""
        reactions = states.reactions
        return ObservedRows(
            states.time,
            states.by_body(states.q),
            states.by_body(states.v),
            reactions[:, :, :2],
            reactions[:, :, 2],
        )

    @classmethod
    def joined(cls, parts: Sequence[ObservedRows]) -> ObservedRows:
        """Return consecutive rows as one."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))
