"""Evaluates and checks the states to be recorded and writes them to the archive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.writer import ArchiveNames, ArchiveWriter, SharedForces
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.joint_sums import JointSums
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.observed_states import SingularState, StateObserver
from mbdkit.engine.singularity import describe_nearness
from mbdkit.engine.workspace import Workspace
from mbdkit.recorded_columns import COLUMNS, ConstraintRows, ObservedRows, RecordedStates
from mbdkit.stepping.interface import Failure, Stretch
from mbdkit.text import listed

if TYPE_CHECKING:
    from mbdkit.events.watch import Found

APART = 1e-6
"""Largest gap of a redundant joint, relative to the characteristic length, that drift and round-off can explain.

The joint is reported only if its gap also exceeds `ALONE` times the largest gap of the rows that are solved for.
"""

ALONE = 1e3
"""See `APART`."""


def archive_names(mechanism: CompiledMechanism) -> ArchiveNames:
    """Return the names of bodies, joints and constraint rows, with the units of the rows."""
    return ArchiveNames(
        bodies=list(mechanism.bodies),
        joints=list(mechanism.joints),
        constraints=[row.label for row in mechanism.rows],
        constraint_units=[row.unit for row in mechanism.rows],
        joint_bodies=list(mechanism.joint_bodies),
    )


def shared_forces(mechanism: CompiledMechanism) -> SharedForces | None:
    """Return the description of non-unique reactions of redundant joints; None without redundant constraints."""
    redundancy = mechanism.redundancy
    if not redundancy.rows:
        return None
    return SharedForces(redundancy.describe(mechanism.drivers), redundancy.not_unique, mechanism.length)


class Recorder:
    """Writes the recorded states of a run to its archive.

    Parameters
    ----------
    workspace
        The mechanism at its start. The recorder uses a copy with its own pivots.
    writer
        The archive being written.

    Attributes
    ----------
    largest : (J,) array
        Largest misalignment [m] of the recorded states.
    kept : list of ObservedRows or None
        If a list, recorded rows are also appended to it.
    """

    def __init__(self, workspace: Workspace, writer: ArchiveWriter):
        # The number of steps between two calls depends on wall time. If pivots were shared with the stepper, the last
        # bits of both results would depend on it.
        self.workspace, self.writer = workspace.with_own_pivots(), writer
        mechanism = workspace.mechanism
        self._observer = StateObserver(self.workspace)
        self._rows, self._joints = ConstraintRows(mechanism), JointSums(mechanism)
        self._redundant = np.isin(np.arange(len(mechanism.topology.pairs)), mechanism.topology.spare[:, 0])
        self._start_energy: float | None = None
        self.largest = np.zeros(len(mechanism.joints))
        self.kept: list[ObservedRows] | None = None

    def record(self, stretch: Stretch, elapsed: tuple[float, float], *, start: bool = False) -> Failure | None:
        """Write the rows of a stretch.

        Parameters
        ----------
        stretch
            States to be recorded.
        elapsed
            Wall time since the first step at the start and at the end of the stretch [s]; interpolated for the rows.
        start
            Whether this is the initial state, which has no preceding interval.

        Returns
        -------
        Failure or None
            Reason why a state cannot be recorded; this state and later ones are not written.
        """
        count = len(stretch.time)
        if count == 0:
            return None
        observed = self._observer.arrays(count)
        q, v = np.ascontiguousarray(stretch.q), np.ascontiguousarray(stretch.v)
        singular = self._observer.observe(stretch.time, q, v, observed)
        valid, failure = self._checked(stretch, observed, singular)
        if valid:
            part = slice(0, valid)
            times = elapsed[0] + (elapsed[1] - elapsed[0]) * np.arange(1, valid + 1) / valid
            self._write_states(stretch.rows(part), observed.rows(part), times)
        if not start:
            self._write_intervals(stretch.rows(slice(0, valid)))
        self.writer.flush_if_due()
        return failure

    def _checked(
        self, stretch: Stretch, observed: Observed, singular: SingularState | None
    ) -> tuple[int, Failure | None]:
        """Return the number of leading states that can be recorded, and the reason why the next one cannot."""
        mechanism = self.workspace.mechanism
        count, failure = len(stretch.time), None
        if singular is not None:
            count = singular.row
            near = describe_nearness(self.workspace, stretch.time[count], stretch.q[count])
            where = f"near {mechanism.unknown_name(singular.unknown)} at {_at(stretch, count)}"
            failure = Failure("singular", f"no unique solution {where}{near and '; ' + near}.")
        good = observed.rows(slice(0, count))
        moving = np.all(np.isfinite(good.acc), axis=1) & np.all(np.isfinite(good.lam), axis=(1, 2))
        finite = moving & np.isfinite(good.kinetic) & np.isfinite(good.potential)
        if not np.all(finite):
            count = int(np.argmin(finite))
            what = "the energy is not a finite number" if moving[count] else "accelerations are not finite numbers"
            failure = Failure("not-finite", f"{what} at {_at(stretch, count)}.")
        contradiction = self._contradiction(observed.phi[:count])
        if contradiction is not None:
            count, pair, gap = contradiction
            failure = Failure("singular", self._describe_contradiction(pair, gap, _at(stretch, count)))
        return count, failure

    def _contradiction(self, phi: np.ndarray) -> tuple[int, int, float] | None:
        """Return row, pair and gap of the first state in `phi` (T, P, 2) where a redundant joint contradicts others."""
        redundant = self._redundant
        if not np.any(redundant) or not len(phi):
            return None
        gaps = np.abs(phi).max(axis=2)
        largest, others = gaps[:, redundant].max(axis=1), gaps[:, ~redundant].max(axis=1, initial=0.0)
        apart = (largest > APART * self.workspace.mechanism.length) & (largest > ALONE * others)
        if not np.any(apart):
            return None
        row = int(np.argmax(apart))
        pair = int(np.argmax(np.where(redundant, gaps[row], 0.0)))
        return row, pair, float(gaps[row, pair])

    def _describe_contradiction(self, pair: int, gap: float, where: str) -> str:
        """Return a sentence naming a misaligned redundant joint and the joints that it contradicts."""
        mechanism = self.workspace.mechanism
        joint = self._joints.joint[pair]
        unit = next(row.unit for row in mechanism.rows if row.pair == pair)
        others = [name for name in mechanism.redundancy.not_unique if name != mechanism.joints[joint]]
        return (
            f"joint '{mechanism.joints[joint]}' is misaligned by {gap:.2g} {unit} at {where}, unlike the other joints: "
            f"it constrains the same motion as {listed(others, 'and')} and contradicts them; remove one of them."
        )

    def _write_states(self, stretch: Stretch, observed: Observed, elapsed: np.ndarray) -> None:
        if self._start_energy is None:
            self._start_energy = float(observed.kinetic[0] + observed.potential[0])
        states = RecordedStates(stretch, observed, elapsed, self._start_energy, self._rows, self._joints)
        self.largest = np.maximum(self.largest, states.misalignment.max(axis=0, initial=0.0))
        self.writer.append({key: COLUMNS[key](states) for key in self.writer.row_keys})
        if self.kept is not None:
            self.kept.append(states.essence)

    def _write_intervals(self, stretch: Stretch) -> None:
        time, steps, size, iterations, iterations_max, rejected = stretch.intervals.T
        rows = {
            "time": time,
            "steps": steps.astype(np.int64),
            "size": size,
            "iterations": iterations.astype(np.int64),
            "iterations_max": iterations_max.astype(np.int64),
            "rejected": rejected.astype(np.int64),
        }
        if stretch.corrections is not None:  # the layout selects those of the stabilization
            projections, position, velocity, acceleration = stretch.corrections.T
            rows |= {
                "projections": projections.astype(np.int64),
                "position_correction": position,
                "velocity_correction": velocity,
                "acceleration_correction": acceleration,
            }
        self.writer.append_steps(rows)

    def record_events(self, found: Sequence[Found]) -> None:
        """Write the crossings found since the last call."""
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

    def misalignment_max(self, worst_pairs: np.ndarray) -> np.ndarray:
        """Return the largest misalignment of each joint over all steps, recorded or not, (J,) [m].

        Parameters
        ----------
        worst_pairs
            (P,) largest squared norm of each pair's Phi over the steps.
        """
        return np.asarray(np.maximum(self._joints.misalignment_of_squares(worst_pairs), self.largest))


def _at(stretch: Stretch, row: int) -> str:
    return f"the state to be recorded at t = {stretch.time[row]:.6g} s"
