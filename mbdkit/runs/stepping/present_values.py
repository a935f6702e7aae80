"""Values of expressions in the present state of an open simulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from mbdkit.base import elementary
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.kernels.observe import PinnedStates, SelfStress, observe_pinned
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.kernels.table_rows import BODIES
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.state_expressions import POSITIONS, VELOCITIES
from mbdkit.engine.workspace import Workspace
from mbdkit.events.event_expression import RunExpression, places_of
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.quantity import Quantity
from mbdkit.quantities.states import States


class PresentState:
    """The present state of a stepper, as arrays whose identity does not change.

    `table`: times of the run. `q`, `v`: (3 (B + 1),) positions and velocities, ground last. `z`: (Z,) first-order
    states.
    """

    def __init__(self, stepper: CompiledStepper | StepHost):
        self._stepper = stepper
        self.table = stepper.timetable
        if isinstance(stepper, CompiledStepper):
            state = stepper.run_state
            self.q, self.v, self.z = state.q, state.v, state.z
        else:
            begin = stepper.now.state
            self.q, self.v, self.z = with_ground(begin.q), with_ground(begin.v), begin.z.copy()

    def refresh(self) -> None:
        """Let the arrays contain the present state; those of compiled methods always do."""
        if isinstance(self._stepper, StepHost):
            state = self._stepper.now.state
            self.q[:-3], self.v[:-3], self.z[:] = state.q, state.v, state.z


class _ObservedNow:
    """Accelerations, reactions and energies of the present state, for quantities that need the engine."""

    def __init__(self, workspace: Workspace, now: PresentState):
        self.workspace, self._now = workspace, now
        mechanism = workspace.mechanism
        self._observer = StateObserver(workspace)
        pairs, spare = len(mechanism.topology.pairs), len(mechanism.topology.spare)
        size, states = mechanism.size, len(mechanism.topology.states)
        out, near = self._observer.arrays(1), self._observer.kept
        self._has_redundant, self.out = spare > 0, out
        vectors = np.zeros((1, size)), np.zeros((1, size)), np.zeros((1, states))
        self._pinned = PinnedBundle(PinnedStates(np.zeros(1), *vectors, out, SelfStress.zeros(0, 0, pairs), near))
        self.time, self.q, self.v, self.z = self._pinned.bundle[:4]

    def at(self, t: float) -> States:
        """Return the present state with the values that the engine computes; nan if they are not unique."""
        now = self._now
        self.time[0], self.q[0], self.v[0], self.z[0] = t, now.q, now.v, now.z
        self.time[:] = now.table.before(self.time)
        status = OK + 1
        if not self._has_redundant:
            status, _ = observe_pinned(self.workspace.engine, self._pinned.address)
        if status != OK:
            singular = self._observer.observe(self.time, self.q, self.v, self.out, z=self.z)
            if singular is not None:
                for values in self.out:
                    values[...] = np.nan
        return States(self.workspace.mechanism, self.time, self.q, self.v, lambda: self.out, z=self.z)


class PresentValues:
    """Evaluates expressions in the present state of a stepper.

    `workspace`: the mechanism and the solver of the run; pivots are chosen independently. `stepper`: the stepper.
    `expressions`: the expressions.
    """

    def __init__(self, workspace: Workspace, stepper: CompiledStepper | StepHost, expressions: Sequence[RunExpression]):
        self._now = PresentState(stepper)
        places = places_of(expressions)
        self._own = own = workspace.with_own_pivots()
        names = archive_names(workspace.mechanism)
        self._values: list[float] = [0.0] * (len(places) + 1)
        self._direct: list[tuple[int, Callable[[], float]]] = []
        self._taken: list[tuple[int, Callable[[States], np.ndarray], bool]] = []
        for quantity, place in places.items():
            if (getter := self._getter(quantity, workspace)) is not None:
                self._direct.append((place, getter))
            else:
                self._taken.append((place, quantity.taker(names), quantity.is_vector))
        self._observed = _ObservedNow(own, self._now) if self._taken else None
        self._functions = [expression.function(places) for expression in expressions]

    def __call__(self, t: float) -> np.ndarray:
        """Return the values (n,) in SI units at time `t` [s]; nan where an expression is undefined."""
        values = self._values
        values[0] = t
        self._now.refresh()
        for place, get in self._direct:
            values[place] = get()
        if self._observed is not None:
            states = self._observed.at(t)
            for place, take, is_vector in self._taken:
                taken = take(states)[0]
                values[place] = elementary.hypot(*taken.tolist()) if is_vector else float(taken)
        return np.array([function(values) for function in self._functions])

    def misalignment(self, t: float) -> np.ndarray:
        """Return the misalignment (J,) of each joint [m]."""
        if self._observed is None:
            self._observed = _ObservedNow(self._own, self._now)
        self._now.refresh()
        return np.asarray(self._observed.at(t).misalignment[0])

    def _getter(self, quantity: Quantity, workspace: Workspace) -> Callable[[], float] | None:
        """Return a function that returns an entry of the state, or a difference of two; None for other quantities."""
        mechanism, now = workspace.mechanism, self._now
        kind, name, attribute = quantity.kind, quantity.name, quantity.attribute
        if kind == "bodies" and name in mechanism.bodies:
            body = list(mechanism.bodies).index(name)
            if attribute in POSITIONS:
                return partial(now.q.item, 3 * body + POSITIONS[attribute])
            if attribute in VELOCITIES:
                return partial(now.v.item, 3 * body + VELOCITIES[attribute])
        if kind == "joints" and attribute in ("angle", "angular_velocity"):
            joint = list(mechanism.joints).index(name)
            if mechanism.joint_units[joint] == "rad":
                first, second = (3 * int(body) + 2 for body in mechanism.topology.joints[joint, BODIES])
                item = now.q.item if attribute == "angle" else now.v.item
                return lambda: item(second) - item(first)
        if kind == "states":
            return partial(now.z.item, [state.name for state in mechanism.states].index(name))
        if kind == "inputs":
            return partial(now.z.item, next(one.state for one in mechanism.inputs if one.name == name))
        return None
