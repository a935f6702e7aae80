"""Accelerations, reactions, sums over joints and energies at given states, by `mbdkit.engine.kernels.observe`."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import numpy as np

from mbdkit.base.frozen import dataclass
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.kernels.misalignment import squared_misalignment
from mbdkit.engine.kernels.observe import Observed, SelfStress, observe, observe_joints
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.redundant_joints import share_evenly, unexplained_gaps
from mbdkit.engine.singularity import new_vectors
from mbdkit.engine.workspace import Workspace


class JointSums:
    """Computes values of joints from values of pairs.

    `mechanism`: the compiled mechanism. Both rows of a pair have the same unit. `joint` ((P,) int array): index of the
    joint of each pair.
    """

    def __init__(self, mechanism: CompiledMechanism):
        self._joints = len(mechanism.joints)
        self.joint = mechanism.topology.pair_joint
        pairs = len(mechanism.topology.pairs)
        longest = max(map(len, mechanism.joint_pairs), default=0)
        self._rounds = [
            np.array([sorted(members)[index] for members in mechanism.joint_pairs if index < len(members)])
            for index in range(longest)
        ]
        #: Pairs of the first round in the order of the joints; None if some joint has no pair.
        self._first = self._rounds[0] if longest and len(self._rounds[0]) == self._joints else None
        self._is_length = np.zeros(pairs, dtype=bool)
        self._is_length[[row.pair for row in mechanism.rows if row.unit == "m"]] = True
        self._has_angles = not self._is_length.all()
        self._rows = np.array([2 * row.pair + row.place for row in mechanism.rows], dtype=np.int64)

    def misalignment(self, residual: np.ndarray) -> np.ndarray:
        """Return the misalignment of joints, (T, J) [m], from the residuals (T, P, 2) of their pairs.

        If the time derivatives of the residuals are given, the result is the velocity misalignment [m/s].
        """
        return self.misalignment_of_squares(squared_misalignment(residual[..., 0], residual[..., 1]))

    def misalignment_of_squares(self, squares: np.ndarray) -> np.ndarray:
        """Return the misalignment of joints, (..., J), from the squared norms (..., P) of the residuals of pairs."""
        lengths = np.where(self._is_length, squares, 0.0) if self._has_angles else squares
        return np.sqrt(self.sum(lengths[..., None])[..., 0])

    def angle_misalignment(self, residual: np.ndarray) -> np.ndarray:
        """Return the angular misalignment of joints, (T, J) [rad], from the residuals (T, P, 2) of their pairs."""
        if not self._has_angles:
            return np.zeros((*residual.shape[:-2], self._joints))
        angles = np.where(self._is_length, 0.0, np.abs(residual[..., 0]) + np.abs(residual[..., 1]))
        return self.sum(angles[..., None])[..., 0]

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Sum values (..., P, n) of pairs over each joint: (..., J, n)."""
        if self._first is None:
            out, rounds = np.zeros((*values.shape[:-2], self._joints, values.shape[-1])), self._rounds
        else:
            out, rounds = 0.0 + values.take(self._first, axis=-2), self._rounds[1:]
        for pairs in rounds:  # a fixed order of the pairs makes sums reproducible bit by bit
            out[..., self.joint[pairs], :] += values[..., pairs, :]
        return out

    def by_row(self, values: np.ndarray) -> np.ndarray:
        """Return the values (T, m) of constraint rows, in the order of the archive, from those of pairs (T, P, 2)."""
        return values.reshape(len(values), 2 * values.shape[1]).take(self._rows, axis=1)


@lru_cache(maxsize=16)
def joint_sums(mechanism: CompiledMechanism) -> JointSums:
    """Return the `JointSums` of a mechanism, which are created only once."""
    return JointSums(mechanism)


#: Largest size of the buffer for self-stresses [bytes]. They are needed only to distribute redundant reactions.
SELF_STRESS_BYTES = 1 << 25


@dataclass(frozen=True)
class SingularState:
    """A state without unique accelerations: its index, and the unknown at which elimination failed (-1: not known)."""

    row: int
    unknown: int


@dataclass(frozen=True)
class GivenForces:
    """Given accelerations and constraint forces, used if they do not follow from the mechanism alone, as with
    actuators.

    `acceleration`: (T, 3 (B + 1)), ground last. `lam`, `reactions`: (T, P, 2) and (T, P, 3), as in `Observed`; those of
    redundant joints are distributed afterwards.
    """

    acceleration: np.ndarray
    lam: np.ndarray
    reactions: np.ndarray

    def replace(self, out: Observed, part: slice) -> None:
        """Write the states of `part` into `out`."""
        given = ((out.acc, self.acceleration), (out.lam, self.lam), (out.reactions, self.reactions))
        for array, values in given:
            array[part] = values[part]


class StateObserver:
    """Computes accelerations, reactions, forces, markers, energies and the distance to singularity at states of a run.

    The distance to singularity is computed by an iteration that starts from the result of the previous state. Therefore
    the states of a run should be passed in order of time.

    `workspace`: the mechanism and its solver. `gaps`, `gap_uncertainty` ((T, D) arrays): result of `unexplained_gaps`
    for the redundant directions of the states last observed.
    """

    def __init__(self, workspace: Workspace):
        self.workspace = workspace
        mechanism = workspace.mechanism
        self._pairs = len(mechanism.topology.pairs)
        self._directions = len(mechanism.topology.spare)
        self._near = new_vectors(mechanism)
        self._stress = SelfStress.zeros(0, self._directions, self._pairs)
        self.gaps, self.gap_uncertainty = np.zeros((2, 0, self._directions))

    @property
    def kept(self) -> np.ndarray:
        """(P, 11) vectors of the iteration for the distance to singularity, which starts from those of the previous
        state.
        """
        return self._near

    def arrays(self, states: int) -> Observed:
        """Return arrays for the results of `observe`, for T = `states`."""
        return Observed.zeros(states, self.workspace.mechanism.topology)

    def observe(
        self,
        times: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        out: Observed,
        given: GivenForces | None = None,
        z: np.ndarray | None = None,
    ) -> SingularState | None:
        """Evaluate states in order and write the results into `out`; stop at a state without unique accelerations.

        If the elimination with the current pivots fails at a state, that state is tried again with new pivots.

        - `times`: (T,) times [s].
        - `q`, `v`: (T, 3 (B + 1)) positions and velocities, ground last; C-contiguous.
        - `out`: receives the values of T states.
        - `given`: accelerations and constraint forces of the states, if they do not follow from the mechanism alone.
        - `z`: (T, Z) first-order states; may be left out if the mechanism has none.

        Raises mbdkit.base.errors.SpecError if the mechanism has first-order states and they are not given. Returns the
        state that could not be evaluated. In `out`, the rows of this state and all later ones are not valid.
        """
        if z is None:
            self.workspace.mechanism.refuse_states("the evaluation of positions and velocities alone")
            z = np.zeros((len(times), 0))
        count, done = len(times), 0
        self.gaps, self.gap_uncertainty = np.zeros((2, count, self._directions))

        def evaluate(end: int) -> int:
            """Evaluate the states from `done` to `end`, increase `done` by their number, and return a status."""
            nonlocal done
            part, stress = slice(done, end), self._self_stress(end - done)
            states: Any = times, q, v, z, out
            if end - done < count:
                states = times[part], q[part], v[part], z[part], out.rows(part)
            status, reached = observe(self.workspace.engine, *states, stress, self._near)
            new = slice(done, done + reached)
            if given is not None:
                given.replace(out, new)
            if self._directions and reached:
                self._note_gaps(new, q[new], out.rows(new), stress.rows(slice(0, reached)))
                self._share(out.rows(new), stress.rows(slice(0, reached)))
            if reached and (self._directions or given is not None):
                observe_joints(self.workspace.engine, times[new], q[new], out.rows(new))
            done += reached
            return int(status)

        while done < count:
            if evaluate(min(done + self._most_states(), count)) == OK:
                continue
            try:
                if self.workspace.retry_with_new_pivots(partial(evaluate, done + 1)) != OK:
                    return SingularState(done, self.workspace.failed_unknown)
            except SingularSystemError as error:
                return SingularState(done, error.index)
        return None

    def _note_gaps(self, rows: slice, q: np.ndarray, observed: Observed, stress: SelfStress) -> None:
        distance = observed.singularity_distance
        gaps = unexplained_gaps(self.workspace.mechanism, q, observed.phi, distance, stress.lam)
        self.gaps[rows], self.gap_uncertainty[rows] = gaps

    def _share(self, observed: Observed, stress: SelfStress) -> None:
        mechanism = self.workspace.mechanism
        joint, length = mechanism.topology.pair_joint, mechanism.length
        share_evenly(observed.lam, observed.reactions, stress.lam, stress.reactions, joint, length)

    def _most_states(self) -> int:
        size = 40 * self._directions * self._pairs
        return max(1, SELF_STRESS_BYTES // size) if size else np.iinfo(np.int64).max

    def _self_stress(self, states: int) -> SelfStress:
        if self._directions and len(self._stress.lam) < states:
            self._stress = SelfStress.zeros(states, self._directions, self._pairs)
        return self._stress
