"""Compiled methods with events of rigid contacts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.integrators.run.run_state import RunState
from mbdkit.integrators.run.sampled_control import states_at_start
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit.methods.kinds import Tolerances
from mbdkit_contact.contact_section import ContactTreatment
from mbdkit_contact.contact_state import ContactState
from mbdkit_contact.events_of_contacts import ContactEvents
from mbdkit_contact.kernels.implicit_steps import constrain
from mbdkit_contact.kernels.steps_to_events import attempt, dense, keep


class CompiledEventDriven(CompiledMethod):
    """A compiled method with events of rigid contacts; see `mbdkit_contact.kernels.steps_to_events`.

    Parameters
    ----------
    between
        The method between events, which evaluates the index-1 accelerations at all of its stages.
    treatment
        Treatment of contacts in the run.
    tolerances
        Tolerances of the method; None if its steps are fixed.
    """

    attempt, keep = attempt, keep
    remembers = True

    def __init__(self, between: CompiledMethod, treatment: ContactTreatment, tolerances: Tolerances | None = None):
        super().__init__(between.workspace)
        workspace = between.workspace
        workspace.leave_out_held_loads()
        self.between = between
        self.events = ContactEvents(EquationsOfMotion(workspace, states_at_start(workspace)))
        self.events.use(treatment)
        if tolerances is not None:
            self.events.bundle.limits[3:5] = tolerances.rtol, tolerances.atol
        self.dense = None if between.dense is None else dense
        self.has_dense_output, self.stages, self.limit = between.has_dense_output, between.stages, between.limit
        self.hint, self.carries_stages = between.hint, between.carries_stages  # type: ignore[misc]
        self.pinned = self.events.pinned
        self._take_up_addresses()

    def _take_up_addresses(self) -> None:
        between = self.between
        functions = between.attempt, between.dense if between.has_dense_output else None, between.keep
        self.events.bundle.inner[:] = [between.pinned.address, *(0 if f is None else f.address for f in functions)]
        reacting = self.workspace.scratch.reacting
        reacting.constrain[0], reacting.stages[0] = constrain.address, between.pinned.address

    def kept(self, *roles: str) -> dict[str, np.ndarray]:
        """See `CompiledMethod.kept`."""
        return super().kept(*roles) | {f"between.{name}": array for name, array in self.between.kept(*roles).items()}

    def start(self, run_state: RunState, h: float) -> None:
        """See `CompiledMethod.start`."""
        self.events.bundle.power[0] = self.workspace.mechanism.does_work(self.workspace.stepping_topology)
        run_state.has_power[0] = 1  # friction and impacts dissipate energy
        self.between.start(run_state, h)
        self._take_up_addresses()

    def renew(self, run_state: RunState, t: float, h: float) -> bool:
        """See `CompiledMethod.renew`."""
        helped = self.between.renew(run_state, t, h)
        self._take_up_addresses()
        return helped

    def forget(self) -> None:
        """See `CompiledMethod.forget`: after a discontinuity, the modes are determined anew."""
        self.between.forget()
        self.events.bundle.known.determined[0] = 0

    def serve(self) -> None:
        """See `CompiledMethod.serve`."""
        self.events.serve()

    def resume(self) -> None:
        """See `CompiledMethod.resume`."""
        self.events.resume()

    def pause_at_events(self) -> None:
        """See `CompiledMethod.pause_at_events`."""
        self.events.bundle.pauses[0] = 1

    def switch_iteration(self) -> bool:
        """See `CompiledMethod.switch_iteration`."""
        return self.between.switch_iteration()

    def describe_divergence(self, report: np.ndarray) -> str:
        """See `CompiledMethod.describe_divergence`."""
        return self.between.describe_divergence(report)

    def stored_systems(self) -> object:
        """See `CompiledMethod.stored_systems`: those of the method between events, and the impacts so far."""
        state = self.reacting.stored()
        return {"between": self.between.stored_systems(), **{name: state[name] for name in ("impacts", "reactions")}}

    def restore_systems(self, state: Mapping[str, object]) -> None:
        """See `CompiledMethod.restore_systems`."""
        events = self.events
        self.between.restore_systems(state["between"])
        self._take_up_addresses()
        events.check_indices()
        own = events.state()
        stored = own.stored() | {name: state[name] for name in ("impacts", "reactions")}
        events.impacts[:] = own.restored(stored).impacts
        events.bundle.known.number[:] = 0

    @property
    def reacting(self) -> ContactState:
        """See `CompiledMethod.reacting`."""
        self.events.serve()
        return self.events.state(tuple(self.events.impacts))

    @property
    def failure(self) -> tuple[str, str] | None:
        """See `CompiledMethod.failure`."""
        failure = self.events.failure
        return None if failure is None else (failure.code, failure.sentence)
