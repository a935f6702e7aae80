"""States of a run with derivatives with respect to parameters, and the quantities in them that expressions use.

Accelerations, reactions, forces, energies and powers follow from the formulas of `mbdkit.engine.kernels.observe`,
compiled for dual numbers. Unlike `mbdkit.engine.observed_states`, they do not include shared reactions of redundant
joints and the distance to singularity, which have no derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.kernels.dual_observe import DualStates
from mbdkit.engine.kernels.observe import Observed
from mbdkit.events.event_expression import RunExpression
from mbdkit.expressions.program import execute
from mbdkit.integrators.duals.differentiated_stepper import DifferentiatedSteps
from mbdkit.integrators.duals.dual_run import constants
from mbdkit.quantities.names import ArchiveNames, archive_names
from mbdkit.quantities.quantity import Quantity
from mbdkit.quantities.states import NONE, States
from mbdkit_gradients.derived_values import DerivedValue, of_operands
from mbdkit_gradients.parameter_differences import CENTRAL, weights


@dataclass(frozen=True)
class DifferentiatedStates(States):
    """T states of a run with derivatives with respect to K parameters, and the quantities computed from them.

    All arrays but `time` have a last axis of 1 + K: the value, then the derivatives.

    Parameters
    ----------
    weight
        (T, 1 + K) weights of an integral over time [s] with their derivatives; None for recorded states.
    power
        (T, 2, 1 + K) power of loads, drivers and active laws, and the dissipated power [W].
    names
        Names of the elements; by default, those of the mechanism.
    """

    weight: np.ndarray | None = None
    power: np.ndarray = field(default_factory=lambda: NONE)
    names: ArchiveNames | None = None

    @staticmethod
    def of_duals(
        mechanism: CompiledMechanism, states: DualStates, count: int, energy: np.ndarray | None, **more: Any
    ) -> DifferentiatedStates:
        """Return states, with the first `count` of their derivatives, from what a kernel has computed.

        Parameters
        ----------
        energy
            (T, 2, 1 + K) work and dissipated energy [J]; None if they are not known.
        more
            Further arguments of the class.
        """
        some = slice(1 + count)
        observed = Observed(*(np.asarray(x[..., some]) for x in states.observed))
        q, v, power = (np.asarray(x[..., some]) for x in (states.q, states.v, states.power))
        if energy is not None:
            start = (observed.kinetic + observed.potential)[:1]
            more |= {"work": energy[:, 0], "dissipated": energy[:, 1], "start_energy": start}
        return DifferentiatedStates(mechanism, states.time, q, v, lambda: observed, power=power, **more)


def quantity_of(states: DifferentiatedStates, quantity: Quantity) -> DerivedValue:
    """Return a quantity of states with derivatives: (T,), (2, T) of a vector, or (elements, T) along a beam.

    Raises
    ------
    SpecError
        If the quantity has no derivative.
    """
    require_derivative(quantity)
    if quantity.recorded.array.is_shared and states.mechanism.redundancy.rows:
        raise _refused(quantity, ", because redundant joints share their reactions")
    result = quantity.taker(states.names or archive_names(states.mechanism))(states)
    return DerivedValue.joined(np.moveaxis(result, 1, 0) if result.ndim > 2 else result)


def require_derivative(quantity: Quantity) -> None:
    """Raise SpecError if a quantity has no derivative for any mechanism."""
    if quantity.is_over_time and (why := quantity.recorded.array.no_derivative):
        raise _refused(quantity, f": {why}")


def _refused(quantity: Quantity, why: str) -> SpecError:
    return SpecError(f"{quantity} has no derivative with respect to parameters{why}", key="measures")


def series_of(
    expression: RunExpression,
    states: Any,
    constants: np.ndarray,
    take: Callable[[Any, Quantity], DerivedValue] = quantity_of,
) -> DerivedValue:
    """Return the values of the expression of an event in T states, (T,).

    Parameters
    ----------
    constants
        (I, K) derivatives of the numbers in the I instructions of the expression.
    take
        Returns a quantity in the states with its derivatives.
    """
    count, slopes = constants.shape[1], iter(constants)

    def step(operation: str, number: float, *operands: DerivedValue) -> DerivedValue:
        slope = next(slopes)
        if operation == "const":
            return DerivedValue.number(number, slope)
        if operation == "t":
            return DerivedValue.constant(states.time, count)
        if operation == "get":
            value = take(states, expression.quantities[int(number)])
            return of_operands("norm", 0.0, value) if value.value.ndim > 1 else value  # events have no vectors
        return of_operands(operation, number, *operands)

    with np.errstate(all="ignore"):
        return execute(expression.program, step)


def one_after_another(parts: Sequence[DifferentiatedStates]) -> DifferentiatedStates:
    """Return the states of several parts, in the order of the parts."""
    return _together(parts, np.concatenate, ("time", *_ARRAYS))


def merged_states(
    known: DifferentiatedStates, rows: np.ndarray, others: DifferentiatedStates | None, is_known: np.ndarray
) -> DifferentiatedStates:
    """Return T states, some of which are rows of `known`.

    Parameters
    ----------
    rows
        Indices of the known states, in the order of the result.
    others
        The other states, in the order of the result; None if there are none.
    is_known
        (T,) whether each state is known.
    """
    if others is None:
        return _together([known], lambda x: x[0][rows], ("time", *_ARRAYS))

    def merged(arrays: Sequence[np.ndarray]) -> np.ndarray:
        result = np.empty((len(is_known), *arrays[0].shape[1:]))
        result[is_known], result[~is_known] = arrays[0][rows], arrays[1]
        return result

    return _together([known, others], merged, ("time", *_ARRAYS))


def joined_states(parts: Sequence[DifferentiatedStates]) -> DifferentiatedStates:
    """Return states with the derivatives of all parts, which have the same states and different parameters."""

    def joined(arrays: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate([arrays[0], *(x[..., 1:] for x in arrays[1:])], axis=-1)

    return _together(parts, joined, (*_ARRAYS, "start_energy"))


#: Names of arrays that have one row per state, and derivatives.
_ARRAYS = ("q", "v", "z", "work", "dissipated", "weight", "power")


def _together(
    parts: Sequence[DifferentiatedStates], join: Callable[[Sequence[np.ndarray]], np.ndarray], names: Sequence[str]
) -> DifferentiatedStates:
    """Return states in which the arrays with these `names` are joined from those of the parts."""
    first = parts[0]
    known = [name for name in names if np.ndim(getattr(first, name)) > 1 or name == "time"]
    arrays: dict[str, Any] = {name: join([getattr(part, name) for part in parts]) for name in known}
    handles = {kind: _joined([part.handles[kind] for part in parts], join) for kind in first.handles}

    def observe() -> Observed:
        return Observed(*(join(x) for x in zip(*(part.observed for part in parts), strict=True)))

    return replace(first, observe=observe, handles=handles, **arrays)


def _joined(handles: Sequence[Any], join: Callable[[Sequence[np.ndarray]], np.ndarray]) -> object:
    """Return joined arrays, or an object with joined arrays in its fields; other fields are those of the first."""
    first = handles[0]
    if isinstance(first, np.ndarray):
        return join(handles)
    names = [item.name for item in fields(first) if isinstance(getattr(first, item.name), np.ndarray)]
    return replace(first, **{name: join([getattr(handle, name) for handle in handles]) for name in names})


class StateEvaluator:
    """Evaluates states of a differentiated run.

    Parameters
    ----------
    steps
        The differentiated steps, with mechanism and solver.
    count
        Number of parameters.
    """

    def __init__(self, steps: DifferentiatedSteps, count: int):
        self.steps, self.workspace, self.width = steps, steps.workspace, 1 + count

    def states(
        self,
        time: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        z: np.ndarray,
        weight: np.ndarray | None = None,
        energy: np.ndarray | None = None,
    ) -> DifferentiatedStates:
        """Return T states with the quantities computed from them; see `DifferentiatedStates` for the arguments.

        Raises
        ------
        RunError
            If the accelerations of a state are not unique.
        """
        self.steps.take_up_solver()
        if z.shape[1] and len(time) != 1:  # the kernels evaluate only states with equal first-order states together
            given = {"q": q, "v": v, "z": z, "weight": weight, "energy": energy}
            known = {name: x for name, x in given.items() if x is not None}
            rows = (slice(k, k + 1) for k in range(len(time)))
            return one_after_another([self.states(time[k], **{name: x[k] for name, x in known.items()}) for k in rows])
        if z.shape[1]:
            self.steps.use_states(np.asarray(z)[0])
        states = self.steps.observe(time, q, v)
        if z.shape[1]:
            forces = np.asarray(states.observed.forces)[0]
            np.asarray(states.observed.state_rates)[0] = self.steps.laws.state_rates(float(time[0]), forces)
        z, energy = np.asarray(z[..., : self.width]), None if energy is None else np.asarray(energy[..., : self.width])
        return DifferentiatedStates.of_duals(
            self.workspace.mechanism, states, self.width - 1, energy, z=z, weight=weight
        )

    def around(self, here: DifferentiatedStates, unit: float) -> tuple[DifferentiatedStates, float]:
        """Return eight states near a state along the motion, without derivatives, and the time between neighbouring
        ones.

        The states are at most ``unit / 8`` [s] away. `rate_of` computes rates of quantities from them.
        """
        offsets, distance = nearby(unit)
        q, v, acc = here.q[0, :, 0], here.v[0, :, 0], here.observed.acc[0, :, 0]
        z, z_rate = here.z[0, :, 0], here.observed.state_rates[0, :, 0]
        moved = (constants(x + offsets[:, None] * rate) for x, rate in ((q, v), (v, acc), (z, z_rate)))
        return self.states(here.time[0] + offsets, *moved), distance


def nearby(unit: float) -> tuple[np.ndarray, float]:
    """Return the times (8,) [s] of the states of `StateEvaluator.around` after a state, and the time between them."""
    distance = unit / 32.0
    return distance * np.array(CENTRAL), distance


def rate_of(around: np.ndarray, here: np.ndarray | float, distance: float) -> np.ndarray:
    """Return the rate of a quantity from its values (8, ...) in the states of `StateEvaluator.around`.

    `here` is the value in the state itself, and `distance` the time [s] between neighbouring states.
    """
    return np.asarray(np.tensordot(weights(CENTRAL), around - here, 1) / distance)
