"""Impulses: those of drivers whose velocities are discontinuous, and those of elements of plugins.

The velocities after the impulse of drivers are the nearest ones that satisfy the constraints.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from mbdkit.base.frozen import dataclass
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Impact


@dataclass(frozen=True)
class DriverImpulse(Impact):
    """An impulse of the drivers, with the impulses that it causes in the joints.

    `reactions`: (J, 3) impulses of the joints, drivers included, on their second bodies [N s, N m s]; see
    `EquationsOfMotion.reactions`.
    """

    reactions: np.ndarray


class ElementImpact(NamedTuple):
    """An impact of an element whose reactions the steps determine.

    Time [s], index of the element among those of its kind, its impulses [N s], energy dissipated by all of them
    together [J], and impulses (J, 3) of the joints caused by all of them [N s, N m s]; see
    `EquationsOfMotion.reactions`.
    """

    time: float
    element: int
    normal_impulse: float
    tangential_impulse: float
    energy_lost: float
    reactions: np.ndarray


class ReactingMemory(Protocol):
    """What the memory of a method that determines reactions of elements offers; see `Treatment.method`."""

    @property
    def impacts(self) -> Sequence[ElementImpact]:
        """All impacts so far."""
        ...

    def remarks(self) -> Sequence[str]:
        """Return sentences about the elements for the user, which do not question the results."""
        ...

    def agrees(self, others: Sequence[ReactingMemory], section: Any) -> tuple[float, str]:
        """Return the time until which the elements of comparison runs behave in the same way [s], and why not later.

        The reason is a sentence after a space, empty if the time is infinite. `section` is that of the spec.
        """
        ...


def reacting_memory(stepper: object) -> ReactingMemory | None:
    """Return the memory of the reactions of elements, with the impacts so far; None if the run of a stepper has
    none.
    """
    memory = getattr(getattr(getattr(stepper, "now", None), "state", None), "memory", None)
    if hasattr(stepper, "method"):  # of a compiled method
        memory = getattr(stepper.method, "reacting", memory)
    return cast(ReactingMemory, memory) if hasattr(memory, "impacts") else None


def impulse(
    workspace: Workspace, t: float, q: np.ndarray, v: np.ndarray, stop: float
) -> tuple[DriverImpulse, np.ndarray]:
    """Return the impulse at a stop, and the velocities after it (3 (B + 1),), ground last.

    The impulse Lambda of the constraints leads to ``M (v+ - v) + Phi_q^T Lambda = 0`` with ``Phi_q v+ + Phi_t+ = 0``:
    v+ is, in the mass metric, the velocity nearest to v that satisfies the constraints. The work of the impulse is the
    change of the kinetic energy.

    `workspace`: the mechanism. Its pivots are renewed if necessary. `t`: time just after the jump [s]. `q`, `v`: (3 (B
    + 1),) positions, and velocities before the jump. `stop`: time of the discontinuity [s]. Raises
    mbdkit.base.errors.StepError if the position is singular.
    """
    p = EquationsOfMotion(workspace)
    old = v[: p.n].copy()
    new = p.project_velocities(t, q[: p.n], old)
    work = 0.5 * float(np.sum((new - old) * p.mass * (new + old)))
    moved = float(np.sqrt(np.sum(p.mass * (new - old) ** 2) / np.sum(p.mass[::3])))
    multipliers = p.solve(t, q[: p.n], p.mass * (old - new), np.zeros(p.m))[1]
    return DriverImpulse(stop, work, moved, p.reactions(t, q[: p.n], multipliers)), with_ground(new)
