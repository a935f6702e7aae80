"""Evaluates the quantities in event expressions at states of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.frozen import dataclass
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.table_rows import BODIES
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.workspace import Workspace
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.quantity import Quantity
from mbdkit.quantities.states import States

MOST_KEPT = 8  #: Largest number of states whose buffers are kept for the next evaluation.


@dataclass(frozen=True)
class _WatchedStates(States):
    """States whose joint angles are computed as differences of the angles of bodies, without the engine.

    `travels`: whether the coordinates of slides are needed as well.
    """

    is_for_events: ClassVar[bool] = True

    travels: bool = False

    @property
    def coordinate(self) -> np.ndarray:
        """(T, J) angle or travel of each joint [rad or m]."""
        first, second = self.mechanism.topology.joints[:, BODIES].T
        angles = self.q[:, 3 * second + 2] - self.q[:, 3 * first + 2]
        if not self.travels:
            return np.asarray(angles)
        is_travel = np.array([unit == "m" for unit in self.mechanism.joint_units])
        return np.where(is_travel, self.observed.joints[:, :, 0], angles)


class QuantityEvaluator:
    """Evaluates quantities at states. The engine is called only if a quantity is not an entry of the state.

    `workspace`: the mechanism and the solver of the run. `quantities`: the quantities to evaluate. `observe`: function
    that replaces the engine; it receives the arguments of `columns`.
    """

    def __init__(
        self, workspace: Workspace, quantities: Sequence[Quantity], observe: Callable[..., Observed] | None = None
    ):
        self.mechanism = workspace.mechanism
        names = archive_names(self.mechanism)
        units = dict(zip(names.joints, names.joint_units, strict=True))
        self._travels = any(quantity.kind == "joints" and units[quantity.name] == "m" for quantity in quantities)
        self._takers = [(quantity.taker(names), quantity.is_vector) for quantity in quantities]
        self._observer = StateObserver(workspace)
        self._buffers: dict[int, Observed] = {}
        self._observe = observe or self._observed

    @property
    def kept(self) -> np.ndarray:
        """Vectors of the iteration for the distance to singularity; see `StateObserver.kept`."""
        return self._observer.kept

    def values(self, times: Sequence[float], q: np.ndarray, v: np.ndarray, z: np.ndarray) -> list[list[float]]:
        """Return, for each of K states, a list of the time and all quantities; undefined quantities are nan.

        Vectors are replaced by their norms.

        `times`: (K,) times [s]. `q`, `v`: (K, 3 (B + 1)) positions and velocities, ground last. `z`: (K, Z) first-order
        states.
        """
        columns = (column.tolist() for column in self.columns(np.array(times), q, v, z))
        return [list(row) for row in zip(*columns, strict=True)]

    def columns(self, time: np.ndarray, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> list[np.ndarray]:
        """Return arrays (K,) of the time and all quantities; see `values`."""
        states = _WatchedStates(
            self.mechanism, time, q, v, lambda: self._observe(time, q, v, z), travels=self._travels, z=z
        )
        taken = ((take(states), is_vector) for take, is_vector in self._takers)
        return [time, *(elementary.hypot(*values.T) if is_vector else values for values, is_vector in taken)]

    def _observed(self, times: np.ndarray, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> Observed:
        """Return the values computed by the engine; nan for states without unique accelerations."""
        count, begin = len(times), 0
        observed = self._buffers.get(count) or self._observer.arrays(count)
        if count <= MOST_KEPT:
            self._buffers[count] = observed
        while begin < count:
            rest = slice(begin, count)
            singular = self._observer.observe(times[rest], q[rest], v[rest], observed.rows(rest), z=z[rest])
            if singular is None:
                break
            row = begin + singular.row
            for values in observed:
                values[row] = np.nan
            begin = row + 1
        return observed
