"""Collects the state of a run from which it can continue with bitwise identical results, and restores it.

A checkpoint is written between two stretches of steps, when all rows and crossings so far have been written to the
archive. It contains the complete state of the stepper: positions and velocities with the compensation terms of their
sums, step-size control, stage values, matrix factors and pivots. It also contains the state of the recorder and of
event detection.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from mbdkit.archive.checkpoint import StoredState
from mbdkit.archive.writer import ArchiveWriter
from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.base.logs import logger_of
from mbdkit.base.text import one_line
from mbdkit.engine.kernels.bundle_types import RECORD, STATE, kept
from mbdkit.engine.stored_arrays import fill, restore, restore_solver, solver_of, stored_solver
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.methods.kinds import Method
from mbdkit.runs import stored_python_steps
from mbdkit.runs.run_record import RunRecord

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.events.watch import Watch
    from mbdkit.spec import RunSpec

_LOG = logger_of(__name__)

INTERVAL = 5.0  #: Smallest wall time between two checkpoints [s].

SHARE = 0.01  #: Largest share of the wall time that checkpoints may take.


@dataclass(frozen=True)
class Parts:
    """The objects of a run whose state a checkpoint contains."""

    workspace: Workspace
    stepper: CompiledStepper | StepHost
    watch: Watch | None
    record: RunRecord

    def stored(self) -> StoredState:
        """Return the state of these objects as plain values; arrays are not copied."""
        return {**self.motion(), **self.record.stored()}

    def motion(self) -> StoredState:
        """Return the part of the state on which later steps depend."""
        workspace = self.workspace
        return {
            "workspace": {
                "solver": stored_solver(workspace.solver),
                "sides": workspace.scratch.sides,
                "pivotings": workspace.pivotings,
            },
            "stepper": (
                stored_python_steps.stored_stepper(self.stepper)
                if isinstance(self.stepper, StepHost)
                else _stored_stepper(self.stepper)
            ),
            "watch": None if self.watch is None else self.watch.stored(),
        }

    def restore(self, state: StoredState) -> None:
        """Restore a stored state to these objects, which belong to a run at its start.

        Raises SpecError if the state is not valid for the run. Since the hash of a checkpoint detects accidental
        damage, such a state was modified on purpose.
        """
        try:
            self.restore_motion(state)
            self.record.restore(state)
        except (LookupError, TypeError, AttributeError, ValueError, OverflowError) as error:
            raise SpecError(
                f"this run cannot be resumed: the state of its checkpoint does not fit its spec ({one_line(error)})"
            ) from error

    def restore_motion(self, state: StoredState) -> None:
        """Restore what `motion` has returned; raise an exception of the kinds above if it is not valid."""
        kept, workspace = state["workspace"], self.workspace
        restore_solver(workspace, kept["solver"])
        fill(workspace.scratch.sides, kept["sides"])
        workspace.pivotings = int(kept["pivotings"])
        if isinstance(self.stepper, StepHost):
            stored_python_steps.restore_stepper(self.stepper, state["stepper"])
        else:
            _restore_stepper(self.stepper, state["stepper"])
        if self.watch is not None:
            self.watch.restore(state["watch"])


def why_without(spec: RunSpec, method: Method) -> str:
    """Return the reason why a run cannot write checkpoints, as a clause; empty if it can."""
    if spec.is_to_be_chosen:
        return "its method or step is chosen by pilot runs, whose results are not stored"
    if method.traits.why_no_checkpoint:
        return method.traits.why_no_checkpoint
    if spec.estimates_errors and "joints" not in spec.output.recorded:
        return "the check of its accuracy needs the reactions of all rows, which it does not record"
    return ""


class Checkpoints:
    """Writes checkpoints of a run from time to time.

    `writer`: writer of the rows and the checkpoints. `state`: function that returns the state to be stored.
    """

    def __init__(self, writer: ArchiveWriter, state: Callable[[], StoredState]):
        self._writer, self._state = writer, state
        self._due, self._is_told = time.monotonic() + INTERVAL, False

    def write(self) -> None:
        """Write a checkpoint; if the memory of the method cannot be stored, say so once."""
        try:
            self._writer.keep_checkpoint(self._state())
        except stored_python_steps.MemoryNotStoredError as error:
            if not self._is_told:
                _LOG.warning("this run cannot be resumed if it is interrupted: %s", error)
            self._is_told = True

    def write_if_due(self) -> None:
        """Write a checkpoint if enough time has passed since the last one."""
        begin = time.monotonic()
        if begin < self._due:
            return
        self.write()
        end = time.monotonic()
        self._due = end + max(INTERVAL, (end - begin) / SHARE)


def _stored_stepper(stepper: CompiledStepper) -> StoredState:
    own = stepper.run_state.solver
    return {
        "run": kept(stepper.run_state, STATE, RECORD),
        "method": stepper.kept_of_method(STATE, RECORD),
        "systems": stepper.method.stored_systems(),
        # the evaluation of an event may have chosen new pivots, which the stepper does not use
        "solver": None if own is stepper.workspace.solver else stored_solver(own),
        "renewed": sorted(stepper.failed_steps.renewed),
        "sampler": stepper.sampler.stored(),
        "inserted": stepper.inserted,
        **stored_python_steps.stored_impulses(stepper.impacts),
    }


def _restore_stepper(stepper: CompiledStepper, state: StoredState) -> None:
    workspace, bundle = stepper.workspace, stepper.method.pinned.bundle
    restore(kept(stepper.run_state, STATE, RECORD), state["run"])
    for stop in state["inserted"]:
        stepper.stop_at(float(stop))
    if stepper.run_state.progress.passed[0] > len(stepper.timetable.stops):
        raise ValueError("it has passed more stops than exist")
    restore(stepper.kept_of_method(STATE, RECORD), state["method"])
    past = getattr(bundle, "past", None)  # methods that extrapolate over several steps have this
    if past is not None and past.known[0] > len(past.acc):
        raise ValueError("it refers to more steps than are stored")
    stepper.method.restore_systems(state["systems"])
    stepper.failed_steps.take_up_pivots()
    if state["solver"] is not None:
        solver = solver_of(workspace, state["solver"])
        stepper.pinned_state.replace(stepper.run_state._replace(solver=solver))
    stepper.failed_steps.renewed = {(int(done), int(status)) for done, status in state["renewed"]}
    stepper.sampler.restore(state["sampler"])
    stepper.impacts[:] = stored_python_steps.impulses_of(state, len(workspace.mechanism.joints))
    stepper.count()
