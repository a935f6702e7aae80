"""The objective: an expression of integrals, means and final values, split into these and what is made of them."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from mbdkit.base.errors import SpecError
from mbdkit.base.units import Unit
from mbdkit.expressions.operations import OPERATIONS, REDUCE
from mbdkit.expressions.program import execute
from mbdkit.measures.measure_compiler import MeasureCompiler
from mbdkit_predict.casadi_system import CasadiSystem, operands_of
from mbdkit_predict.predict_spec import PredictSpec
from mbdkit_predict.symbols import Symbol, column

INTEGRAL, FINAL, PEAK = "integral", "final", "peak"


@dataclass(frozen=True)
class Objective:
    """What is minimized, as a function of functionals of the motion."""

    integrands: ca.SX
    finals: ca.SX
    #: Integrands, final values, and what has peaks, (K, 1) each, expressions in the symbols of the system.
    peaks: ca.SX
    operands: ca.SX  #: Operands of all operations that contain no functional, (K, 1).
    value: ca.Function  #: Function of the integrals, the final values, the peaks, and the duration.


class _ObjectiveCompiler(MeasureCompiler):
    """Compiles an objective, whose weights are numbers: it may add effort and time, and contain peaks."""

    own_functions: ClassVar[Mapping[str, int]] = {**MeasureCompiler.own_functions, PEAK: 1}

    def common(self, operation: str, values: Sequence[Any], node: ast.expr) -> Unit | None:
        """Return the unit of operands that are added or compared; None if they differ and are added."""
        try:
            return super().common(operation, values, node)
        except SpecError:
            if operation not in ("add", "sub"):
                raise
            return None


def objective_of(spec: PredictSpec, system: CasadiSystem) -> Objective:
    """Return the objective of a spec; raise SpecError if it is not valid, or a reduction in it is not smooth."""
    compiler = _ObjectiveCompiler(spec.with_states(spec.minimize), spec)
    program, _ = compiler.measure()
    results: dict[str, list[tuple[Any, Symbol]]] = {INTEGRAL: [], FINAL: [], PEAK: []}
    duration, known = ca.SX.sym("duration"), list[Any]()

    def functional(kind: str, x: object) -> Symbol:
        symbol = Symbol(ca.SX.sym(f"{kind}_{len(results[kind])}"))
        results[kind].append((x, symbol))
        return symbol

    def step(operation: str, number: float, *operands: Any) -> Any:
        if operation == "get":
            quantity = compiler.quantities[int(number)]
            return (system.quantity(quantity),) if quantity.is_vector else system.quantity(quantity)
        if operation in ("const", "t"):
            return system.time if operation == "t" else number
        if operation == "norm":
            return operands[0][0]
        if any(isinstance(operand, tuple) for operand in operands):
            raise SpecError("a vector can be minimized only as its norm, such as abs(joints.knee.force)")
        reduction = operation.removeprefix(REDUCE)
        if reduction == operation:
            known.extend(operands_of(operation, operands))
            return OPERATIONS[operation].array(*operands, *(number,) * (operation == "powi"))
        if reduction in results:
            return functional(reduction, operands[0])
        if reduction in ("mean", "rms"):
            x = operands[0] if reduction == "mean" else operands[0] ** 2
            mean = functional(INTEGRAL, x) / Symbol(duration)
            return mean if reduction == "mean" else mean**0.5
        raise SpecError(
            f"'{reduction}' is not smooth, so that it cannot be minimized; use integral, mean, rms, final or peak"
        )

    value = column([execute(tuple(program), step)])
    given = [column([symbol for _, symbol in functionals]) for functionals in results.values()]
    integrands, finals, peaks = (column([x for x, _ in functionals]) for functionals in results.values())
    inside = [x for x in ca.vertsplit(column(known)) if not ca.depends_on(x, ca.vertcat(*given, duration))]
    return Objective(
        integrands,
        finals,
        peaks,
        ca.vertcat(ca.SX(0, 1), *inside),
        ca.Function("objective", [*given, duration], [value]),
    )
