"""Events, and discontinuities of force laws (*corners*), in adjoint gradients: from derivatives with respect to their
times to those with respect to states.

An event happens at the end of a step, or of the first part of a step. Its expression g is zero there, so that the time
has the derivatives ``-g_p / g_t``, where g_p are the derivatives of g at a constant time and g_t is its rate. The same
holds for a corner, where a condition of a force law changes its sign.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.law_conditions import LawCondition
from mbdkit.quantities.states import States
from mbdkit_gradients.adjoint_measures import Bars, Columns, NotByAdjointError
from mbdkit_gradients.derived_values import DerivedValue
from mbdkit_gradients.differentiated_run import PassedEvent
from mbdkit_gradients.differentiated_states import nearby, rate_of, series_of
from mbdkit_gradients.law_corners import ForceCondition

#: Returns the states with these times (T,), positions and velocities (T, n + 3).
MakeStates = Callable[[np.ndarray, np.ndarray, np.ndarray], States]


@dataclass(frozen=True)
class AdjointEvent:
    """An event with the state at which it happens.

    Attributes
    ----------
    event
        The event.
    states
        The state at the event.
    slope, rate
        Derivatives (C, 1) of the expression with respect to the components of its quantities, and its rate [1/s].
    """

    event: PassedEvent
    states: States
    slope: np.ndarray
    rate: float

    @classmethod
    def at(cls, event: PassedEvent, q: np.ndarray, v: np.ndarray, unit: float, states: MakeStates) -> AdjointEvent:
        """Return an event at a state; `unit` is a time [s] within which its expression is smooth."""
        if event.at_jump:
            raise NotByAdjointError(f"the expression of the event '{event.name}' jumps")
        columns = Columns(event.expression.quantities)
        constants = np.zeros((len(event.expression.program), columns.count))

        def series(states: States) -> DerivedValue:
            return series_of(event.expression, states, constants, lambda x, y: columns.value(x, y, columns.count))

        here = states(np.array([event.time]), q[None], v[None])
        offsets, distance = nearby(unit)
        moved = (x[0] + offsets[:, None] * rate for x, rate in ((here.q, here.v), (here.v, here.observed.acc)))
        try:
            value = series(here)
            rate = rate_of(series(states(event.time + offsets, *moved)).value, float(value.value[0]), distance)
        except SpecError as error:
            raise NotByAdjointError(error.message) from None
        return cls(event, here, value.slope, float(rate))

    def bars(self, by_time: float, mechanism: CompiledMechanism) -> Bars:
        """Return the derivatives with respect to the state, from that with respect to the time of the event."""
        one = Bars(-1, self.states, mechanism)
        Columns(self.event.expression.quantities).add(one, -by_time / self.rate * self.slope)
        return one


@dataclass(frozen=True)
class AdjointCorner:
    """A discontinuity of a force law, at the end of a step.

    Attributes
    ----------
    node
        Number of the end of the step.
    condition, rate
        The condition that changes, and the rate of its function [1/s].
    states
        The states before and after the corner.
    sides
        (C,) the sides of force laws before the corner.
    """

    node: int
    condition: ForceCondition | LawCondition
    rate: float
    states: States
    sides: np.ndarray

    @property
    def jump(self) -> np.ndarray:
        """Change (n + 3,) of the derivatives of the velocities, for each second by which the corner comes later."""
        before, after = self.states.observed.acc
        return np.asarray(before - after)

    def bars(self, by_time: float, mechanism: CompiledMechanism, of_laws: np.ndarray) -> Bars:
        """Return the derivatives with respect to the state before the corner, from that with respect to its time; add
        those with respect to the parameters of laws (L,) to `of_laws`.
        """
        condition, observed = self.condition, self.states.observed
        one = Bars(-1, self.states, mechanism).rows(slice(1))
        if not isinstance(condition, ForceCondition):
            self._add_of_kind(condition, one, -by_time / self.rate, of_laws)
            return one
        own = condition.own(mechanism.topology.law_parameters, observed.lam[0])
        _, *slopes = condition.function(*observed.forces[0, condition.element, :2], *own)
        by_length, by_rate, *by_numbers = -by_time / self.rate * np.array(slopes)
        one.add_force(condition.element, "length", np.array([by_length]))
        one.add_force(condition.element, "rate", np.array([by_rate]))
        of_laws[condition.parameters] += by_numbers
        pair, row, place = condition.multipliers.T
        np.add.at(one.multipliers[0], (pair, row), np.array(by_numbers)[place])
        return one

    def _add_of_kind(self, condition: LawCondition, one: Bars, factor: float, of_laws: np.ndarray) -> None:
        """Add the derivatives with respect to the state and to the parameters of laws of a condition of a kind of
        elements, times a factor.
        """
        state = self.states.q[0], self.states.v[0], one.mechanism.topology.law_parameters
        coordinates = [3 * body + i for body in condition.bodies for i in range(3)]
        indices: list[Any] = [coordinates, coordinates, condition.parameters[1:]]
        for target, some, number in zip((one.q[0], one.v[0], of_laws), indices, range(3), strict=True):
            directions = [
                tuple(np.where(k == number, np.arange(len(x)) == i, 0.0) for k, x in enumerate(state)) for i in some
            ]
            np.add.at(target, some, factor * np.array(condition.slopes(state, directions)))
