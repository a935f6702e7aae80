"""States of a run with derivatives by parameters, and the quantities of expressions in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.engine.joint_sums import JointSums
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.workspace import Workspace
from mbdkit.events.event_expression import Quantity, RunExpression
from mbdkit.gradients.derived_values import IS_BINARY, Value, of_one, of_two
from mbdkit.measures.measured_quantities import component_of


@dataclass(frozen=True)
class States:
    """T states of a run with derivatives by K parameters, and what is computed from them.

    All arrays but `time` have a last axis of 1 + K: the value, then the derivatives.

    Parameters
    ----------
    workspace
        The mechanism.
    time
        (T,) times [s].
    weight
        (T, 1 + K) weights of an integral over time [s] with their derivatives; None for recorded states.
    q, v
        (T, 3 (B + 1), 1 + K) positions and velocities, ground last.
    energy
        (T, 2, 1 + K) work and dissipated energy [J]; None where they are not known.
    observed
        Accelerations, reactions, forces, markers and energies.
    power
        (T, 2, 1 + K) power of loads, drivers and active laws, and the dissipated power [W].
    actuators
        (T, 2, 1 + K) value and power of each actuator of inverse dynamics, by name.
    """

    workspace: Workspace
    time: np.ndarray
    weight: np.ndarray | None
    q: np.ndarray
    v: np.ndarray
    energy: np.ndarray | None
    observed: Observed
    power: np.ndarray
    actuators: Mapping[str, np.ndarray] = field(default_factory=dict)

    @cached_property
    def reactions(self) -> np.ndarray:
        """(T, J, 3, 1 + K) reaction force (x, y) [N] and torque [N m] of each joint."""
        x = self.observed.reactions
        flat = x.reshape(*x.shape[:2], 3 * x.shape[-1])
        summed = JointSums(self.workspace.mechanism).sum(flat)
        return summed.reshape(*summed.shape[:2], 3, x.shape[-1])


def quantity_of(states: States, quantity: Quantity) -> Value:
    """Return a quantity of states with derivatives: (T,), (2, T) of a vector, or (elements, T) along a beam.

    Raises
    ------
    SpecError
        If it has no derivative.
    """
    require_derivative(quantity)
    column, component, has_components = component_of(quantity)
    found = _columns(states, quantity)
    if column not in found:
        raise _refused(quantity, ", because redundant joints share their reactions")
    x = found[column]()
    if has_components:
        return Value.joined(np.moveaxis(x, 1, 0))
    return Value.joined(x if component is None else x[:, component])


def require_derivative(quantity: Quantity) -> None:
    """Raise SpecError if a quantity of runs has no derivative, whatever the mechanism."""
    if quantity.kind != "events" and component_of(quantity)[0] in _MISALIGNMENTS:
        raise _refused(quantity, ": a misalignment is an error of the method, and almost zero")


_MISALIGNMENTS = ("misalignment", "velocity_misalignment", "angle_misalignment")


def _refused(quantity: Quantity, why: str) -> SpecError:
    what = ".".join(filter(None, (quantity.kind, quantity.name, quantity.attribute)))
    return SpecError(f"{what} has no derivative by parameters{why}", key="measures")


def _columns(states: States, quantity: Quantity) -> Mapping[str, Callable[[], np.ndarray]]:
    """Return functions that give the columns of the element of a quantity, by name, (T, ..., 1 + K)."""
    mechanism, observed = states.workspace.mechanism, states.observed
    if quantity.kind == "bodies":
        first = 3 * mechanism.bodies.index(quantity.name)
        place, angle = slice(first, first + 2), first + 2
        return {
            "position": lambda: states.q[:, place],
            "angle": lambda: states.q[:, angle],
            "velocity": lambda: states.v[:, place],
            "angular_velocity": lambda: states.v[:, angle],
            "acceleration": lambda: observed.acc[:, place],
            "angular_acceleration": lambda: observed.acc[:, angle],
        }
    if quantity.kind == "joints":
        return _of_joint(states, mechanism.joints.index(quantity.name))
    if quantity.kind == "forces":
        f = [one.name for one in mechanism.forces].index(quantity.name)
        return {name: partial(_part, observed.forces, f, i) for i, name in enumerate(_FORCE_COLUMNS)}
    if quantity.kind == "markers":
        k = [name for name, _ in mechanism.markers].index(quantity.name)
        return {
            "position": lambda: observed.markers[:, k, :2],
            "velocity": lambda: observed.markers[:, k, 2:],
        }
    if quantity.kind == "beams":
        beams = observed.beams[:, mechanism.beam_elements(quantity.name)]
        return {
            "axial": lambda: beams[:, :, 0],
            "shear": lambda: beams[:, :, 1],
            "moment": lambda: beams[:, :, 2],
            "strain_energy": lambda: np.asarray(beams[:, :, 3].sum(axis=1)),
        }
    if quantity.kind == "actuators":
        own = states.actuators[quantity.name]
        return {"value": lambda: own[:, 0], "power": lambda: own[:, 1]}
    return _energies(states)


_FORCE_COLUMNS = ("length", "rate", "value", "power", "potential")


def _part(x: np.ndarray, element: int, part: int | slice) -> np.ndarray:
    return np.asarray(x[:, element, part])


def _of_joint(states: States, j: int) -> Mapping[str, Callable[[], np.ndarray]]:
    """Return the columns of joint `j`; only its coordinate if redundant joints share their reactions."""
    joints = states.observed.joints
    if states.workspace.mechanism.redundancy.rows:
        return {"angle": partial(_part, joints, j, 0)}
    return {
        "angle": partial(_part, joints, j, 0),
        "driver_power": partial(_part, joints, j, 1),
        "reaction_force": lambda: _part(states.reactions, j, slice(0, 2)),
        "reaction_torque": lambda: _part(states.reactions, j, 2),
        "reaction_force_first": partial(_part, joints, j, slice(2, 4)),
        "reaction_force_second": partial(_part, joints, j, slice(4, 6)),
    }


def _energies(states: States) -> Mapping[str, Callable[[], np.ndarray]]:
    observed, energy = states.observed, states.energy

    def total() -> np.ndarray:
        return np.asarray(observed.kinetic + observed.potential)

    found: dict[str, Callable[[], np.ndarray]] = {
        "kinetic": lambda: observed.kinetic,
        "potential": lambda: observed.potential,
        "total": total,
    }
    if energy is not None:
        found["work"] = lambda: energy[:, 0]
        found["dissipated"] = lambda: energy[:, 1]
        found["balance"] = lambda: total() + energy[:, 1] - energy[:, 0] - total()[:1]
    return found


def series_of(expression: RunExpression, states: States, constants: np.ndarray) -> Value:
    """Return the expression of an event in each of T states, (T,).

    Parameters
    ----------
    constants
        (I, K) derivatives of the numbers of its I instructions.
    """
    count = states.q.shape[-1] - 1
    stack: list[Value] = []
    with np.errstate(all="ignore"):
        for (operation, number), slope in zip(expression.program, constants, strict=True):
            if operation == "const":
                stack.append(Value.number(number, slope))
            elif operation == "t":
                stack.append(Value.constant(states.time, count))
            elif operation == "get":
                found = quantity_of(states, expression.quantities[int(number)])
                stack.append(of_one("norm", 0.0, found) if found.value.ndim > 1 else found)  # events have no vectors
            elif operation in IS_BINARY:
                right, left = stack.pop(), stack.pop()
                stack.append(of_two(operation, left, right))
            else:
                stack.append(of_one(operation, number, stack.pop()))
    return stack.pop()


def one_after_another(parts: Sequence[States]) -> States:
    """Return states that follow each other."""

    def together(arrays: Sequence[np.ndarray | None]) -> Any:
        return None if arrays[0] is None else np.concatenate(arrays)  # type: ignore[arg-type]

    def of(name: str) -> Any:
        return together([getattr(one, name) for one in parts])

    observed = Observed(*(together(x) for x in zip(*(one.observed for one in parts), strict=True)))
    return States(parts[0].workspace, of("time"), of("weight"), of("q"), of("v"), of("energy"), observed, of("power"))


def joined_states(parts: Sequence[States]) -> States:
    """Return the same states with the derivatives of several passes."""

    def together(arrays: Sequence[Any]) -> Any:
        return None if arrays[0] is None else np.concatenate([arrays[0], *(x[..., 1:] for x in arrays[1:])], axis=-1)

    def of(name: str) -> Any:
        return together([getattr(one, name) for one in parts])

    first = parts[0]
    observed = Observed(*(together(x) for x in zip(*(one.observed for one in parts), strict=True)))
    actuators = {name: together([one.actuators[name] for one in parts]) for name in first.actuators}
    return States(
        first.workspace, first.time, of("weight"), of("q"), of("v"), of("energy"), observed, of("power"), actuators
    )
