"""Expressions of the state that determine loads and the rates of first-order states, compiled to programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from mbdkit.events.event_expression import RunCompiler
from mbdkit.expressions.program import Program, value_of
from mbdkit.mechanism.element_kinds import element_kinds
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.quantities.names import archive_names
from mbdkit.quantities.quantity import Quantity
from mbdkit.quantities.states import States


class StateCompiler(RunCompiler):
    """Compiles an expression of kinematic quantities, of lengths, rates and values of springs, and of states."""

    own_attributes: ClassVar[Mapping[str, Sequence[str]]] = {
        "bodies": ("x", "y", "angle", "vx", "vy", "angular_velocity"),
        "joints": ("angle",),
        "markers": ("x", "y", "vx", "vy"),
        "forces": ("length", "rate", "value"),
        "states": ("value",),
        "inputs": ("value",),
    }
    wanted = (
        "an expression of the state, which has numbers, t, pi, NAME.angle and other kinematic quantities of bodies, "
        "joints and markers, forces.NAME.length, states.NAME, inputs.NAME"
    )

    @property
    def attributes(self) -> Mapping[str, Sequence[str]]:  # type: ignore[override]
        """Quantities by kind, with those of the kinds of elements of plugins."""
        further = {key: tuple(kind.in_expressions) for key, kind in element_kinds().items() if kind.in_expressions}
        return {**self.own_attributes, **further}


def state_program(text: str, mechanism: Mechanism) -> tuple[Program, list[tuple[str, str, str]]]:
    """Return the program of an expression, and kind, name and attribute of each quantity that ``get`` pushes.

    Raises SpecError for the first error; it contains the position in the text.
    """
    compiler = StateCompiler(text, mechanism)
    program = tuple(compiler.program())
    return program, [(quantity.kind, quantity.name, quantity.attribute) for quantity in compiler.quantities]


def state_values(program: Program, quantities: Sequence[tuple[str, str, str]], states: States) -> np.ndarray:
    """Return the values (T,) of an expression, compiled by `state_program`, in states of a run.

    The values are computed one by one, because rounding errors of NumPy's functions depend on the length of the array.
    """
    names = archive_names(states.mechanism)
    columns = [states.time.tolist(), *(Quantity(*quantity).taker(names)(states).tolist() for quantity in quantities)]

    def value(time: float, *values: float) -> Any:
        def leaf(operation: str, number: float) -> float:
            if operation == "get":
                return values[int(number)]
            return time if operation == "t" else number

        return value_of(program, leaf)

    return np.array([value(*row) for row in zip(*columns, strict=True)])
