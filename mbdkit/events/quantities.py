"""Evaluates the quantities of event expressions at states of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mbdkit.engine.joint_sums import JointSums
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.workspace import Workspace
from mbdkit.events.event_expression import BEAM, BODY, BODY_FRAMES, FORCE, MARKER, Quantity

_REACTION = ("force_x", "force_y", "torque")
_STATE = frozenset(BODY[:6])
"""Attributes of a body that are entries of the state."""
_IN_OBSERVED = ("angle", "driver_power", *BODY_FRAMES)
"""Attributes of joints in the order of `Observed.joints`."""


class _States(NamedTuple):
    """K states and the values computed from them by the engine; `observed` is None if no quantity needs these."""

    q: np.ndarray
    v: np.ndarray
    observed: Observed | None

    @property
    def dynamics(self) -> Observed:
        """Values computed by the engine, such as accelerations and reactions."""
        assert self.observed is not None
        return self.observed


class QuantityEvaluator:
    """Evaluates quantities at states. The engine is not called if all of them are entries of the state.

    Parameters
    ----------
    workspace
        The mechanism and the solver of the run.
    """

    def __init__(self, workspace: Workspace, quantities: Sequence[Quantity]):
        self.workspace, self.quantities = workspace, quantities
        mechanism = workspace.mechanism
        self._body = {name: index for index, name in enumerate([*mechanism.bodies, "ground"])}
        self._joint = {name: index for index, name in enumerate(mechanism.joints)}
        self._joint_units = dict(zip(mechanism.joints, mechanism.joint_units, strict=True))
        self._joints = JointSums(mechanism)
        self._columns = [self._column(quantity) for quantity in quantities]
        self._needs_engine = not all(self._is_in_state(quantity) for quantity in quantities)
        self._observer = StateObserver(workspace)
        self._buffers: dict[int, Observed] = {}

    @property
    def kept(self) -> np.ndarray:
        """See `StateObserver.kept`."""
        return self._observer.kept

    def values(self, times: Sequence[float], q: np.ndarray, v: np.ndarray) -> list[list[float]]:
        """Return, for each of K states, a list of its time and all quantities; undefined quantities are nan.

        Parameters
        ----------
        times
            (K,) times [s].
        q, v
            (K, 3 (B + 1)) positions and velocities, ground last.
        """
        states = _States(q, v, self._observed(np.array(times), q, v) if self._needs_engine else None)
        columns = [times, *(column(states).tolist() for column in self._columns)]
        return [list(row) for row in zip(*columns, strict=True)]

    def _is_in_state(self, quantity: Quantity) -> bool:
        """Whether a quantity is an entry of the state, or a difference of two."""
        if quantity.kind == "joints":
            return quantity.attribute == "angle" and self._joint_units[quantity.name] == "rad"
        return quantity.kind == "bodies" and quantity.attribute in _STATE

    def _column(self, quantity: Quantity) -> Callable[[_States], np.ndarray]:
        """Return a function for the (K,) values of a quantity."""
        mechanism, name, attribute = self.workspace.mechanism, quantity.name, quantity.attribute
        if quantity.kind == "energy":
            kinetic, potential = attribute != "potential", attribute != "kinetic"
            return lambda states: kinetic * states.dynamics.kinetic + potential * states.dynamics.potential
        if quantity.kind == "bodies":
            level, coordinate = divmod(BODY.index(attribute), 3)
            place = 3 * self._body[name] + coordinate
            if level == 2:
                return lambda states: states.dynamics.acc[:, place]
            return lambda states: (states.v if level else states.q)[:, place]
        if quantity.kind == "forces":
            force, column = [one.name for one in mechanism.forces].index(name), FORCE.index(attribute)
            return lambda states: states.dynamics.forces[:, force, column]
        if quantity.kind == "markers":
            marker, column = [marker for marker, _ in mechanism.markers].index(name), MARKER.index(attribute)
            return lambda states: states.dynamics.markers[:, marker, column]
        if quantity.kind == "beams":
            elements, value = mechanism.beam_elements(name), BEAM.index(attribute)
            if quantity.element is None:
                return lambda states: np.sum(states.dynamics.beams[:, elements, value], axis=1)
            element = elements.start + quantity.element
            return lambda states: states.dynamics.beams[:, element, value]
        joint = self._joint[name]
        if self._is_in_state(quantity):
            first, second = (3 * self._body[body] + 2 for body in mechanism.joint_bodies[joint])
            return lambda states: states.q[:, second] - states.q[:, first]
        if attribute in _IN_OBSERVED:
            column = _IN_OBSERVED.index(attribute)
            return lambda states: states.dynamics.joints[:, joint, column]
        if attribute == "misalignment":
            return lambda states: self._joints.misalignment(states.dynamics.phi)[:, joint]
        pairs = list(mechanism.joint_pairs[joint])
        if attribute == "force":
            return lambda states: np.hypot(*np.sum(states.dynamics.reactions[:, pairs, :2], axis=1).T)
        component = _REACTION.index(attribute)
        return lambda states: np.sum(states.dynamics.reactions[:, pairs, component], axis=1)

    def _observed(self, times: np.ndarray, q: np.ndarray, v: np.ndarray) -> Observed:
        """Return the values computed by the engine; nan for states without unique accelerations."""
        count, begin = len(times), 0
        if count not in self._buffers:
            self._buffers[count] = self._observer.arrays(count)
        observed = self._buffers[count]
        while begin < count:
            rest = slice(begin, count)
            singular = self._observer.observe(times[rest], q[rest], v[rest], observed.rows(rest))
            if singular is None:
                break
            row = begin + singular.row
            for values in observed:
                values[row] = np.nan
            begin = row + 1
        return observed
