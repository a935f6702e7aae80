"""The objective: an expression of integrals, means and final values, split into these and what is made of them."""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from mbdkit.base.errors import SpecError
from mbdkit.base.units import Unit
from mbdkit.expressions.operations import OPERATIONS, REDUCE
from mbdkit.expressions.program import execute
from mbdkit.measures.measure_compiler import MeasureCompiler
from mbdkit.quantities.quantity import Quantity
from mbdkit_predict.predict_spec import PredictSpec
from mbdkit_predict.symbols import Symbol, column

INTEGRAL, FINAL = "integral", "final"


@dataclass(frozen=True)
class Objective:
    """What is minimized, as a function of functionals of the motion.

    Attributes
    ----------
    functionals
        Kind, INTEGRAL or FINAL, and integrand or final value, an expression in the symbols of the system.
    value
        Function of the values of the functionals, and of the duration.
    """

    functionals: tuple[tuple[str, ca.SX], ...]
    value: ca.Function


class _ObjectiveCompiler(MeasureCompiler):
    """Compiles an objective, whose weights are numbers: it may add effort and time."""

    def common(self, operation: str, values: Sequence[Any], node: ast.expr) -> Unit | None:
        """Return the unit of operands that are added or compared; None if they differ and are added."""
        try:
            return super().common(operation, values, node)
        except SpecError:
            if operation not in ("add", "sub"):
                raise
            return None


def objective_of(spec: PredictSpec, quantity: Callable[[Quantity], Any], t: Any) -> Objective:
    """Return the objective of a spec.

    Parameters
    ----------
    quantity
        Function that returns a quantity as a symbol.
    t
        The time as a symbol.

    Raises
    ------
    SpecError
        If the expression is not valid, or contains a reduction that is not smooth.
    """
    try:
        return _objective(spec, quantity, t)
    except SpecError as error:
        raise SpecError(spec.with_controls(error.message), key="minimize") from None


def _objective(spec: PredictSpec, quantity: Callable[[Quantity], Any], t: Any) -> Objective:
    compiler = _ObjectiveCompiler(spec.with_states(spec.minimize), spec)
    program, _ = compiler.measure()
    functionals: list[tuple[str, ca.SX]] = []
    symbols: list[ca.SX] = []
    duration = ca.SX.sym("duration")

    def functional(kind: str, x: Any) -> Symbol:
        functionals.append((kind, column([x])))
        symbols.append(ca.SX.sym(f"functional_{len(functionals)}"))
        return Symbol(symbols[-1])

    def step(operation: str, number: float, *operands: Any) -> Any:
        if operation == "get":
            found_quantity = compiler.quantities[int(number)]
            return (quantity(found_quantity),) if found_quantity.is_vector else quantity(found_quantity)
        if operation in ("const", "t"):
            return t if operation == "t" else number
        if operation == "norm" and isinstance(operands[0], tuple):
            return operands[0][0]
        if any(isinstance(operand, tuple) for operand in operands):
            raise SpecError("a vector can be minimized only as its norm, such as abs(joints.knee.force)")
        reduction = operation.removeprefix(REDUCE)
        if reduction == operation:
            return OPERATIONS[operation].array(*operands, *(number,) * (operation == "powi"))
        if reduction == INTEGRAL:
            return functional(INTEGRAL, operands[0])
        if reduction == FINAL:
            return functional(FINAL, operands[0])
        if reduction in ("mean", "rms"):
            x = operands[0] if reduction == "mean" else operands[0] ** 2
            mean = functional(INTEGRAL, x) / Symbol(duration)
            return mean if reduction == "mean" else mean**0.5
        raise SpecError(
            f"'{reduction}' is not smooth, so that it cannot be minimized; use integral, mean, rms or final"
        )

    value = column([execute(tuple(program), step)])
    return Objective(
        tuple(functionals), ca.Function("objective", [ca.vertcat(ca.SX(0, 1), *symbols), duration], [value])
    )
