"""Evaluates and checks the states to be recorded and writes them to the archive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.archive.run_writer import RunWriter, SharedForces
from mbdkit.base.text import listed
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.input_schedule import Setting, setting_rows
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.table_rows import SPARE
from mbdkit.engine.observed_states import SingularState, StateObserver, joint_sums
from mbdkit.engine.redundant_joints import units_of_pairs
from mbdkit.engine.singularity import describe_nearness
from mbdkit.engine.stored_arrays import fill, solver_of, stored_solver
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Failure, StepEvidence, Stretch, Timetable
from mbdkit.measures.measured_quantities import of_event
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.quantity import Quantity
from mbdkit.runs.conclusion import Extremes
from mbdkit.runs.findings import StateWatchers
from mbdkit.runs.law_ranges import LawRanges
from mbdkit.runs.recorded_states import ObservedRows, recorded_states
from mbdkit.trust.energy_record import EnergyRecord
from mbdkit.trust.finding import Finding

if TYPE_CHECKING:
    from mbdkit.archive.checkpoint import StoredState
    from mbdkit.archive.measured_values import Integrals
    from mbdkit.events.watch import Found
    from mbdkit.integrators.run.impulse import DriverImpulse, ElementImpact

#: Residuals of redundant constraint rows up to this size are attributed to round-off.
#:
#: They are relative to the characteristic length; those of angles are in radians. The limit exceeds the residuals of
#: assembly, which are at most 1e-11 of the largest coordinate.
APART = 1e-6

#: To count as a contradiction, the residual of a redundant row must also exceed this multiple of its uncertainty, as
#: returned by `unexplained_gaps`.
#:
#: Measured on parallelograms with redundant rods, with seven methods and steps up to 0.3 s: while the joints are
#: consistent, residuals stay below 0.1 of the uncertainty, near singular positions below 0.3; for drivers whose motions
#: diverge, they exceed five times the uncertainty.
SECOND_ORDER = 1.0

#: Columns of `Stretch.intervals` and of `Stretch.corrections`, and those that are integers.
INTERVALS = ("time", "steps", "size", "iterations", "iterations_max", "rejected")
CORRECTIONS = ("projections", "position_correction", "velocity_correction", "acceleration_correction")
COUNTS = ("steps", "iterations", "iterations_max", "rejected", "projections")


def shared_forces(mechanism: CompiledMechanism) -> SharedForces | None:
    """Return the description of non-unique reactions of redundant joints; None without redundant constraints."""
    redundancy = mechanism.redundancy
    if not redundancy.rows:
        return None
    drivers = [name for name in redundancy.not_unique if name in mechanism.drivers]
    return SharedForces(redundancy.describe(mechanism.drivers), redundancy.not_unique, mechanism.length, drivers)


class Recorder:
    """Writes the recorded states of a run to its archive.

    - `workspace`: the mechanism at its start. The recorder uses a copy with its own pivots.
    - `writer`: writer that receives the rows.
    - `table`: times of the run; its guards limit the misalignment of a recorded state.
    - `ranges`: checks force laws that declare a range; None if there are none.
    - `watchers`: look at all recorded states; None to give no warnings.
    - `finer`: see `mbdkit.spec.run_spec.RunSpec.finer`.
    - `largest`, `largest_angle` ((J,) arrays): largest misalignment [m] and angle misalignment [rad] of the recorded
      states.
    - `energies`: largest energies and energy errors of the recorded states.
    - `last_time` (float): time of the last recorded state [s].
    - `kept` (list of ObservedRows or None): if a list, recorded rows are also appended to it.
    """

    def __init__(
        self,
        workspace: Workspace,
        writer: RunWriter,
        table: Timetable,
        ranges: LawRanges | None = None,
        watchers: StateWatchers | None = None,
        *,
        finer: str,
    ):
        # The number of steps between two calls depends on wall time. If the recorder shared its pivots with the
        # stepper, the rounding errors of steps and of recorded rows would depend on it too.
        self.workspace, self.writer, self.table = workspace.with_own_pivots(), writer, table
        mechanism = workspace.mechanism
        self._observer = StateObserver(self.workspace)
        self._joints = joint_sums(mechanism)
        self._start_energy: float | None = None
        self._refused = False
        self.largest, self.largest_angle = np.zeros((2, len(mechanism.joints)))
        self.energies = EnergyRecord()
        self.last_time = workspace.t0
        self.event_times: dict[str, list[float]] = {}
        self.kept: list[ObservedRows] | None = None
        self.ranges, self.watchers, self._finer = ranges, watchers, finer

    @property
    def mechanism(self) -> CompiledMechanism:
        """The compiled mechanism."""
        return self.workspace.mechanism

    def record(self, stretch: Stretch, elapsed: tuple[float, float], *, start: bool = False) -> Failure | None:
        """Write the rows of a stretch.

        `elapsed`: wall time since the first step at the start and at the end of the stretch [s]; interpolated for the
        rows. `start`: whether this is the initial state, which has no preceding interval. Returns reason why a state
        cannot be recorded; this state and later ones are not written.
        """
        count = len(stretch.time)
        if count == 0:
            return None
        observed = self._observer.arrays(count)
        q, v = np.ascontiguousarray(stretch.q), np.ascontiguousarray(stretch.v)
        singular = self._observer.observe(self.table.before(stretch.time), q, v, observed, z=stretch.z)
        valid, failure = self._checked(stretch, observed, singular)
        if valid:
            part = slice(0, valid)
            times = elapsed[0] + (elapsed[1] - elapsed[0]) * np.arange(1, valid + 1) / valid
            self._write_states(stretch.rows(part), observed.rows(part), times)
        if not start:
            self._write_intervals(stretch.rows(slice(0, valid)))
        self.writer.flush_if_due()
        self._refused = self._refused or failure is not None
        return failure

    def _checked(
        self, stretch: Stretch, observed: Observed, singular: SingularState | None
    ) -> tuple[int, Failure | None]:
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
        for check in (self._contradiction, self._fallen_apart, self._out_of_range):
            if (refused := check(stretch.rows(slice(0, count)), observed.rows(slice(0, count)))) is not None:
                count, failure = refused
        return count, failure

    def _contradiction(self, stretch: Stretch, observed: Observed) -> tuple[int, Failure] | None:
        count = len(observed.phi)
        gaps, uncertainty = self._observer.gaps[:count], self._observer.gap_uncertainty[:count]
        apart = gaps > APART + SECOND_ORDER * uncertainty
        if not np.any(apart):
            return None
        row = int(np.argmax(np.any(apart, axis=1)))
        direction = int(np.argmax(np.where(apart[row], gaps[row], 0.0)))
        mechanism = self.workspace.mechanism
        pair = int(mechanism.topology.spare[direction, SPARE.pair])
        gap = float(gaps[row, direction] * units_of_pairs(mechanism)[pair])
        unit = next(constraint.unit for constraint in mechanism.rows if constraint.pair == pair)
        return row, self._contradicting(pair, f"{gap:.2g} {unit} at {_at(stretch, row)}")

    def _contradicting(self, pair: int, gap: str) -> Failure:
        """Return the failure of a redundant joint that is misaligned by `gap`; it names the joints that contradict this
        joint.

        Joints count as redundant only if they are consistent at the start and in positions near it. They are then
        consistent in all positions on the branch (the continuous set of positions that contains the start), unless
        drivers move them.
        """
        mechanism = self.workspace.mechanism
        joint, names = mechanism.joints[self._joints.joint[pair]], mechanism.redundancy.not_unique
        others = listed([name for name in names if name != joint], "and") or "other joints"
        what = f"joint '{joint}' is misaligned by {gap}, and numerical error does not explain it: it constrains the "
        if not mechanism.drivers & set(names):
            return Failure(
                "branch-left",
                f"{what}same motion as {others}. They agree on the branch of the start, so the run has left this "
                f"branch, as can happen in singular positions; {self._finer} or `stabilization: projection` may "
                f"help.",
            )
        return Failure(
            "singular",
            f"{what}same motion as {others} and contradicts them; remove one of them. If they agree, the run has left "
            "its branch in a singular position.",
        )

    def _fallen_apart(self, stretch: Stretch, observed: Observed) -> tuple[int, Failure] | None:
        guards = self.table.guards
        smallest = min(guards.misalignment, guards.angle_misalignment)
        # a joint has at most three rows, so that none can exceed a limit; the check saves time
        if np.max(np.abs(observed.phi), initial=0.0) <= smallest / 4:
            return None
        first: tuple[int, Failure] | None = None
        for values, limit, unit in (
            (self._joints.misalignment(observed.phi), guards.misalignment, "m"),
            (self._joints.angle_misalignment(observed.phi), guards.angle_misalignment, "rad"),
        ):
            beyond = ~(values <= limit)
            if not np.any(beyond):
                continue
            row = int(np.argmax(np.any(beyond, axis=1)))
            if first is None or row < first[0]:
                joint = int(np.argmax(np.where(beyond[row], values[row], -np.inf)))
                name, gap = self.workspace.mechanism.joints[joint], f"{values[row, joint]:.3g} {unit}"
                sentence = (
                    f"joint '{name}' is misaligned by {gap} at {_at(stretch, row)}, more than limits.misalignment "
                    f"allows ({limit:.3g} {unit}); this state is not recorded; use {self._finer} or, with stiff "
                    "springs or dampers, an implicit method."
                )
                first = row, Failure("fell-apart", sentence)
        return first

    def _out_of_range(self, stretch: Stretch, observed: Observed) -> tuple[int, Failure] | None:
        left = None if self.ranges is None else self.ranges.add(stretch.time, observed.forces)
        if self.ranges is None or left is None or not self.ranges.stops:
            return None
        return int(np.searchsorted(stretch.time, left)), self.ranges.failure()

    def _write_states(self, stretch: Stretch, observed: Observed, elapsed: np.ndarray) -> None:
        if self._start_energy is None:
            self._start_energy = float(observed.kinetic[0] + observed.potential[0])
        states = recorded_states(self.mechanism, stretch, observed, self._start_energy, elapsed)
        self.largest = np.maximum(self.largest, states.misalignment.max(axis=0, initial=0.0))
        # The largest residual of each row suffices here, because a joint has at most one row with an angle.
        peaks = np.abs(observed.phi).max(axis=0, keepdims=True)
        self.largest_angle = np.maximum(self.largest_angle, self._joints.angle_misalignment(peaks)[0])
        if self.watchers is not None:
            self.watchers.add(states)
        others = np.array([observed.potential, stretch.work, stretch.dissipated])
        self.last_time = float(stretch.time[-1])
        self.energies.add(observed.kinetic, others, states.balance)
        self.writer.append({key: array.take(states) for key, array in self.writer.recorded.items()})
        if self.kept is not None:
            self.kept.append(ObservedRows.of(states))

    def _write_intervals(self, stretch: Stretch) -> None:
        columns = dict(zip(INTERVALS, stretch.intervals.T, strict=True))
        if stretch.corrections is not None:  # the layout selects the columns that the stabilization fills
            columns |= zip(CORRECTIONS, stretch.corrections.T, strict=True)
        counts = {name: column.astype(np.int64) for name, column in columns.items() if name in COUNTS}
        self.writer.append_numbered("steps", columns | counts)

    def record_events(self, crossings: Sequence[Found]) -> None:
        """Write the crossings found since the last call."""
        if not crossings:
            return
        shape = (len(crossings), len(self.workspace.mechanism.bodies), 3)
        for crossing in crossings:
            self.event_times.setdefault(crossing.name, []).append(crossing.time)
        columns = {
            "name": np.array([crossing.name for crossing in crossings], dtype=object),
            "time": np.array([crossing.time for crossing in crossings]),
            "direction": np.array([crossing.direction for crossing in crossings]),
            "position": np.array([crossing.q[:-3] for crossing in crossings]).reshape(shape),
            "velocity": np.array([crossing.v[:-3] for crossing in crossings]).reshape(shape),
        }
        self.writer.append_numbered("events", columns)

    def record_inputs(self, settings: Sequence[Setting]) -> None:
        """Write the settings of inputs since the last call."""
        if settings:
            self.writer.append_numbered("inputs", setting_rows(self.mechanism, settings))

    def record_samples(self, rows: Mapping[str, np.ndarray]) -> None:
        """Write the outputs of controllers in Python since the last call."""
        if len(rows["time"]):
            self.writer.append_numbered("samples", rows)

    def record_impacts(
        self,
        impacts: Sequence[ElementImpact],
        of_drivers: Sequence[DriverImpulse],
        drivers: Mapping[float, Sequence[str]],
    ) -> None:
        """Write impacts of elements and impulses of drivers, in order of time.

        `drivers` has the names of the drivers whose velocities are discontinuous at a time [s].
        """
        mechanism = self.workspace.mechanism
        names = [] if mechanism.reacting is None else archive_names(mechanism).names_of(mechanism.reacting.key)
        rows = [
            (name, impact.time, 0.0, 0.0, -impact.energy, impact.reactions)
            for impact in of_drivers
            for name in drivers[impact.time]
        ]
        rows += [(names[impact.element], impact.time, *impact[2:]) for impact in impacts]
        if not rows:
            return
        element, time, normal, tangential, lost, reactions = zip(*sorted(rows, key=lambda row: row[1]), strict=True)
        columns = {
            "time": np.array(time),
            "contact": np.array(element, dtype=object),
            "normal_impulse": np.array(normal),
            "tangential_impulse": np.array(tangential),
            "energy_lost": np.array(lost),
            "reaction_impulse": np.array(reactions)[:, :, :2],
            "reaction_torque_impulse": np.array(reactions)[:, :, 2],
        }
        self.writer.append_numbered("impacts", columns)

    def of_event(self, quantity: Quantity) -> float:
        """Return a quantity of an event of the run so far."""
        return of_event(quantity, np.array(self.event_times.get(quantity.name, [])))

    def stored(self) -> StoredState:
        """Return the state on which later rows depend, as plain values for a checkpoint."""
        return {
            "start_energy": self._start_energy,
            "largest": self.largest,
            "largest_angle": self.largest_angle,
            "energies": [*self.energies.values],
            "last_time": self.last_time,
            "events": {name: np.array(times) for name, times in self.event_times.items()},
            "near": self._observer.kept,
            "solver": stored_solver(self.workspace.solver),
            "pivotings": self.workspace.pivotings,
            "ranges": None if self.ranges is None else self.ranges.stored(),
            "watchers": None if self.watchers is None else self.watchers.stored(),
        }

    def restore(self, state: StoredState) -> None:
        """Continue after the rows of a checkpoint; raise ValueError if its values are not valid for this run."""
        self._start_energy = float(state["start_energy"])
        fill(self.largest, state["largest"])
        fill(self.largest_angle, state["largest_angle"])
        self.energies.values = state["energies"]
        self.last_time = float(state["last_time"])
        self.event_times = {name: np.asarray(times).tolist() for name, times in state["events"].items()}
        fill(self._observer.kept, state["near"])
        self.workspace.use_solver(solver_of(self.workspace, state["solver"]))
        self.workspace.pivotings = int(state["pivotings"])
        if self.ranges is not None:
            self.ranges.restore(state["ranges"])
        if self.watchers is not None:
            self.watchers.restore(state["watchers"])

    def findings(self, integrals: Integrals) -> list[Finding]:
        """Return what is wrong, doubtful or worth a note in the recorded states, and in the extrema of the run."""
        watched = () if self.watchers is None else self.watchers.findings(self.energies, integrals)
        # if a run stops where a law leaves its range, the reason of its failure says so
        ranges = () if self.ranges is None or self.ranges.stops else self.ranges.findings()
        return [*watched, *ranges]

    def extremes(self, worst_pairs: np.ndarray, steps: StepEvidence) -> Extremes:
        """Return what was largest in the run.

        If a state was refused, only the misalignments of recorded states count: steps after the last row are not part
        of the run.

        - `worst_pairs`: (P,) largest squared norm of the constraint functions Phi of each pair of rows over the steps.
        - `steps`: quantities observed over the steps.
        """
        largest = self.largest
        if not self._refused:
            largest = np.maximum(self._joints.misalignment_of_squares(worst_pairs), largest)
        return Extremes(self.last_time, largest, self.largest_angle, self.energies, steps)


def _at(stretch: Stretch, row: int) -> str:
    return f"the state to be recorded at t = {stretch.time[row]:.6g} s"
