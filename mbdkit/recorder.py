"""The recorder: turns recorded states into the rows of an archive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.writer import ArchiveNames, ArchiveWriter, SharedForces
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.elimination_order import SingularSystemError
from mbdkit.engine.kernels.observe import observe
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.redundant_reactions import share_evenly
from mbdkit.engine.singularity import describe_nearness, new_vectors
from mbdkit.engine.workspace import Workspace
from mbdkit.stepping.interface import Failure, Stretch
from mbdkit.text import listed

if TYPE_CHECKING:
    from mbdkit.events.watch import Found


def archive_names(mechanism: CompiledMechanism) -> ArchiveNames:
    """Return the names of bodies, joints and constraint rows, with the rows' units."""
    return ArchiveNames(
        bodies=list(mechanism.bodies),
        joints=list(mechanism.joints),
        constraints=[row.label for row in mechanism.rows],
        constraint_units=[row.unit for row in mechanism.rows],
        joint_bodies=list(mechanism.joint_bodies),
    )


def shared_forces(mechanism: CompiledMechanism) -> SharedForces | None:
    """Return which reactions are not unique because joints are redundant; None where all of them are."""
    redundancy = mechanism.redundancy
    if not redundancy.rows:
        return None
    return SharedForces(redundancy.describe(mechanism.drivers), redundancy.not_unique, mechanism.length)


SINGULARITY = "constraints/singularity_distance"

PARTED = 1e-6
"""Gap of a redundant row, relative to the characteristic length, from which on it may be no round-off or drift."""

ALONE = 1e3
"""How many times larger it is then than any gap of a row that is solved for."""

SELF_STRESS_BYTES = 1 << 25
"""Bound on the buffer in which the forces of redundant rows are told apart."""


class Recorder:
    """Evaluates what is recorded of each state and hands it to the archive.

    Parameters
    ----------
    workspace
        The mechanism at its start; the recorder chooses its own pivots.
    writer
        The archive in the making.
    """

    def __init__(self, workspace: Workspace, writer: ArchiveWriter):
        # Rows are recorded after a stretch of steps of any length, so pivots shared with the stepper would make the
        # last bits of both depend on the length of the stretches.
        self.workspace, self.writer = workspace.with_own_pivots(), writer
        mechanism = workspace.mechanism
        self._pair = np.array([row.pair for row in mechanism.rows], dtype=np.int64)
        self._place = np.array([row.place for row in mechanism.rows], dtype=np.int64)
        self._metres = np.array([row.unit == "m" for row in mechanism.rows], dtype=bool)
        number = {pair: j for j, pairs in enumerate(mechanism.joint_pairs) for pair in pairs}
        self._joint = np.array([number[row.pair] for row in mechanism.rows], dtype=np.int64)
        self._pair_joint = np.array([number[k] for k in range(len(mechanism.topology.pairs))], dtype=np.int64)
        self._joints = len(mechanism.joints)
        self._length = mechanism.length
        self._start_total: float | None = None
        self._near = new_vectors(workspace)
        self._spare = np.isin(np.arange(len(mechanism.topology.pairs)), mechanism.topology.spare[:, 0])
        self.largest = np.zeros(self._joints)
        """(J,) largest misalignment [m] of the recorded states."""

    def record(self, stretch: Stretch, elapsed: tuple[float, float], *, start: bool = False) -> Failure | None:
        """Write the rows of a stretch.

        Parameters
        ----------
        stretch
            States to be recorded.
        elapsed
            Wall time since the first step when the stretch began and when it ended [s]; rows are set evenly between.
        start
            Whether this is the start, which ends no interval.

        Returns
        -------
        Failure or None
            Why a recorded state has no finite, unique accelerations; nothing from there on is written.
        """
        count = len(stretch.time)
        if count == 0:
            return None
        top, pairs = self.workspace.mechanism.topology, len(self.workspace.mechanism.topology.pairs)
        q, v = np.ascontiguousarray(stretch.q), np.ascontiguousarray(stretch.v)
        acc, lam = np.zeros_like(q), np.zeros((count, pairs, 2))
        phi, rate, reactions = np.zeros_like(lam), np.zeros_like(lam), np.zeros((count, pairs, 3))
        kinetic, potential, distance = np.zeros((3, count))
        arrays = (stretch.time, q, v, acc, lam, phi, rate, reactions, kinetic, potential, distance)
        spare = len(top.spare)
        most = max(1, SELF_STRESS_BYTES // (40 * spare * pairs)) if spare else count
        failure = None
        done, renewed = 0, -1
        while done < count:
            some = slice(done, min(done + most, count))
            stress, its_reactions = (np.zeros((some.stop - done, spare, pairs, columns)) for columns in (2, 3))
            status, reached = observe(
                self.workspace.engine, *(x[some] for x in arrays), stress, its_reactions, self._near,
            )  # fmt: skip
            here, there = slice(done, done + reached), slice(0, reached)
            if spare and reached:
                share_evenly(
                    lam[here], reactions[here], stress[there], its_reactions[there], self._pair_joint, self._length
                )
            done += reached
            if status == OK:
                continue
            try:
                if renewed == done:
                    raise SingularSystemError
                self.workspace.use_pivots()
                renewed = done
            except SingularSystemError as error:
                name = self.workspace.mechanism.unknown_name(error.index)
                near = describe_nearness(self.workspace, stretch.time[done], q[done])
                why = f"no unique solution near {name} at {_at(stretch, done)}{near and '; ' + near}."
                failure, count = Failure("singular", why), done
        moving = np.all(np.isfinite(acc[:count]), axis=1) & np.all(np.isfinite(lam[:count]), axis=(1, 2))
        finite = moving & np.isfinite(kinetic[:count]) & np.isfinite(potential[:count])
        if not np.all(finite):
            count = int(np.argmin(finite))
            what = "the energy is no finite number" if moving[count] else "accelerations are no finite numbers"
            failure = Failure("not-finite", f"{what} at {_at(stretch, count)}.")
        parted = self._parted(phi[:count])
        if parted is not None:
            count, joint, gap = parted
            failure = Failure("singular", self._contradiction(joint, gap, _at(stretch, count)))
        part = slice(0, count)
        self._write_rows(stretch, part, elapsed, acc, lam, phi, rate, reactions, kinetic, potential, distance)
        if not start:
            t, steps, size, iterations, most, rejected = stretch.intervals[part].T
            self.writer.append_steps(
                {
                    "time": t,
                    "steps": steps.astype(np.int64),
                    "size": size,
                    "iterations": iterations.astype(np.int64),
                    "iterations_max": most.astype(np.int64),
                    "rejected": rejected.astype(np.int64),
                    **_corrections(stretch, part),
                }
            )
        self.writer.flush_if_due()
        return failure

    def _write_rows(
        self, stretch: Stretch, part: slice, elapsed: tuple[float, float], acc: np.ndarray, lam: np.ndarray,
        phi: np.ndarray, rate: np.ndarray, reactions: np.ndarray, kinetic: np.ndarray, potential: np.ndarray,
        distance: np.ndarray,
    ) -> None:  # fmt: skip
        times = stretch.time[part]
        count = len(times)
        if count == 0:
            return
        bodies = len(self.workspace.mechanism.bodies)

        def by_body(x: np.ndarray) -> np.ndarray:
            return x[part, : 3 * bodies].reshape(count, bodies, 3)

        residual = phi[part][:, self._pair, self._place]
        residual_rate = rate[part][:, self._pair, self._place]
        misalignment = np.sqrt(self._by_joint(np.where(self._metres, residual, 0.0) ** 2, self._joint))
        force = _sum_groups(reactions[part].swapaxes(0, 1), self._pair_joint, self._joints).swapaxes(0, 1)
        total = kinetic[part] + potential[part]
        if self._start_total is None:
            self._start_total = float(total[0])
        work, lost = stretch.work[part], stretch.dissipated[part]
        self.largest = np.maximum(self.largest, misalignment.max(axis=0, initial=0.0))
        self.writer.append(
            {
                "time": times,
                "trajectory/position": by_body(stretch.q),
                "trajectory/velocity": by_body(stretch.v),
                "trajectory/acceleration": by_body(acc),
                "trajectory/elapsed_s": elapsed[0] + (elapsed[1] - elapsed[0]) * np.arange(1, count + 1) / count,
                "joints/misalignment": misalignment,
                "joints/velocity_misalignment": np.sqrt(
                    self._by_joint(np.where(self._metres, residual_rate, 0.0) ** 2, self._joint)
                ),
                "joints/angle_misalignment": self._by_joint(np.where(self._metres, 0.0, np.abs(residual)), self._joint),
                "joints/reaction_force": force[:, :, :2],
                "joints/reaction_torque": force[:, :, 2],
                "constraints/position_residual": residual,
                "constraints/velocity_residual": residual_rate,
                "constraints/multiplier": lam[part][:, self._pair, self._place],
                **self._own_multipliers(stretch, part, lam),
                **({SINGULARITY: distance[part]} if SINGULARITY in self.writer.row_keys else {}),
                "energy/kinetic": kinetic[part],
                "energy/potential": potential[part],
                "energy/total": total,
                "energy/dissipated": lost,
                "energy/work": work,
                "energy/balance": total + lost - work - self._start_total,
            }
        )

    def record_events(self, found: Sequence[Found]) -> None:
        """Write crossings of events, those found since the last call."""
        if not found:
            return
        shape = (len(found), len(self.workspace.mechanism.bodies), 3)
        self.writer.append_events(
            {
                "name": np.array([one.name for one in found], dtype=object),
                "time": np.array([one.time for one in found]),
                "direction": np.array([one.direction for one in found]),
                "position": np.array([one.q[:-3] for one in found]).reshape(shape),
                "velocity": np.array([one.v[:-3] for one in found]).reshape(shape),
            }
        )

    def _parted(self, phi: np.ndarray) -> tuple[int, int, float] | None:
        """Return the first row of `phi` (T, P, 2) where redundant joints contradict the others; joint and gap there."""
        spare = self._spare
        if not np.any(spare) or not len(phi):
            return None
        gaps = np.abs(phi).max(axis=2)
        apart, rest = gaps[:, spare].max(axis=1), gaps[:, ~spare].max(axis=1, initial=0.0)
        bad = (apart > PARTED * self._length) & (apart > ALONE * rest)
        if not np.any(bad):
            return None
        row = int(np.argmax(bad))
        pair = int(np.argmax(np.where(spare, gaps[row], 0.0)))
        return row, int(self._pair_joint[pair]), float(gaps[row, pair])

    def _contradiction(self, joint: int, gap: float, where: str) -> str:
        """Return the sentence that names a joint which cannot meet any more because of others."""
        mechanism = self.workspace.mechanism
        units = {self._pair_joint[row.pair]: row.unit for row in mechanism.rows}
        others = [name for name in mechanism.redundancy.not_unique if name != mechanism.joints[joint]]
        return (
            f"joint '{mechanism.joints[joint]}' misses by {gap:.2g} {units[joint]} at {where}, though all others meet: "
            f"it holds the same thing as {listed(others, 'and')}, but no longer agrees; leave one of them out."
        )

    def _own_multipliers(self, stretch: Stretch, part: slice, lam: np.ndarray) -> dict[str, np.ndarray]:
        """Return the multipliers that the method itself carries; those of index 1 at the start."""
        name = "constraints/method_multiplier"
        if name not in self.writer.row_keys:
            return {}
        own = stretch.multipliers
        return {name: own[part] if own is not None else lam[part][:, self._pair, self._place]}

    def _by_joint(self, rows: np.ndarray, joint: np.ndarray) -> np.ndarray:
        """Sum constraint rows (T, m) over each joint: (T, J)."""
        return _sum_groups(rows.T, joint, self._joints).T

    def misalignment_max(self, worst_pairs: np.ndarray) -> np.ndarray:
        """Return the largest misalignment of each joint [m] over every step.

        Parameters
        ----------
        worst_pairs
            (P,) largest squared norm of each pair's Phi over the steps.
        """
        squares = np.zeros(self._joints)
        metric = np.zeros(len(worst_pairs), dtype=bool)
        metric[self._pair[self._metres]] = True
        np.add.at(squares, self._pair_joint, np.where(metric, worst_pairs, 0.0))
        return np.maximum(np.sqrt(squares), self.largest)


def _corrections(stretch: Stretch, part: slice) -> dict[str, np.ndarray]:
    """Return what stabilization did in each interval, of a run that is stabilized; the archive takes what it wants."""
    if stretch.corrections is None:
        return {}
    made, moved, changed, pulled = stretch.corrections[part].T
    return {
        "projections": made.astype(np.int64),
        "position_correction": moved,
        "velocity_correction": changed,
        "acceleration_correction": pulled,
    }


def _at(stretch: Stretch, row: int) -> str:
    return f"the state to be recorded at t = {stretch.time[row]:.6g} s"


def _sum_groups(values: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """Sum `values` (n, ...) over equal entries of `group` (n,): (groups, ...)."""
    out = np.zeros((groups, *values.shape[1:]))
    np.add.at(out, group, values)
    return out
