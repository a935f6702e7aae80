"""Expressions of the state that determine loads and rates of first-order states, as programs."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from typing import ClassVar

from mbdkit.base.text import did_you_mean, listed
from mbdkit.events.event_expression import RunCompiler
from mbdkit.expressions.parser import Code
from mbdkit.expressions.program import Program
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.quantities.quantity import Quantity


class StateCompiler(RunCompiler):
    """Compiles an expression of kinematic quantities, of lengths, rates and values of springs, and of states."""

    attributes: ClassVar[Mapping[str, Sequence[str]]] = {
        "bodies": ("x", "y", "angle", "vx", "vy", "angular_velocity"),
        "joints": ("angle",),
        "markers": ("x", "y", "vx", "vy"),
        "forces": ("length", "rate", "value"),
        "beams": (),
    }
    wanted = (
        "an expression of the state, which has numbers, t, pi, NAME.angle and other kinematic quantities of bodies, "
        "joints and markers, forces.NAME.length, states.NAME"
    )

    def operand(self, node: ast.expr) -> Code:
        """Return the program of a quantity."""
        match node:
            case ast.Attribute(ast.Name(id="states"), attr=name) | ast.Subscript(
                ast.Name(id="states"), ast.Constant(value=str() as name)
            ):
                return self.of_first_order(name, node)
            case ast.Attribute(ast.Attribute(ast.Name(id="controllers"), attr=name), attr=value) | ast.Attribute(
                ast.Subscript(ast.Name(id="controllers"), ast.Constant(value=str() as name)), attr=value
            ):
                return self.of_controller(name, value, node)
            case ast.Attribute(ast.Name(id="energy")):
                self.refuse("an energy cannot be part of an expression of the state", node)
        return super().operand(node)

    def of_first_order(self, name: str, node: ast.expr) -> Code:
        """Return the program of a first-order state."""
        known = self.mechanism.state_names()
        if name not in known:
            hint = did_you_mean(name, known) or (f"; there are {listed(known)}" if known else "; there are none")
            self.refuse(f"there is no state '{name}'{hint}", node)
        return self.get(Quantity("states", name, "value"))

    def of_controller(self, name: str, value: str, node: ast.expr) -> Code:
        """Return the program of an output or a state of a controller."""
        controllers = self.mechanism.controllers
        if name not in controllers:
            self.unknown(name, [*controllers], "controller", node)
        known = [*controllers[name].outputs, *controllers[name].states]
        if value not in known:
            hint = f"{did_you_mean(value, known)}; it has {listed(known, 'and')}"
            self.refuse(f"controller '{name}' has no '{value}'{hint}", node)
        return self.get(Quantity("controllers", name, value))


def state_program(text: str, mechanism: Mechanism) -> tuple[Program, list[tuple[str, str, str]]]:
    """Return the program of an expression, and kind, name and attribute of each quantity that ``get`` pushes.

    Raises
    ------
    SpecError
        With the position in the text of the first error.
    """
    compiler = StateCompiler(text, mechanism)
    program = tuple(compiler.program())
    return program, [(one.kind, one.name, one.attribute) for one in compiler.quantities]
