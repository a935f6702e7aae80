"""Derivatives of expressions of the state with respect to parameters: the chain rule over the parameters of their laws.

The inputs of an expression are parameters of its law (`mbdkit.engine.state_expressions`). Evaluating a state with dual
numbers stores the values and derivatives of these inputs in the array of parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.engine.kernels.table_rows import LAW_ROW, STATE_ROW
from mbdkit.mechanism.force_law import ExpressionLaw

if TYPE_CHECKING:
    import sympy

    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.engine.force_laws import CompiledLaw


class DifferentiatedLaws:
    """Evaluates laws of states and controllers with their derivatives.

    Parameters
    ----------
    mechanism
        The mechanism.
    values
        (N, 1 + K) parameters of all laws, with their derivatives with respect to K parameters of the model, as stored
        by the last evaluation.

    Raises
    ------
    SpecError
        If the rate of a state is not an expression.
    """

    def __init__(self, mechanism: CompiledMechanism, values: np.ndarray):
        self._mechanism, self._values = mechanism, values
        rows = {int(row) for row in mechanism.topology.states[:, STATE_ROW.rate] if row >= 0}
        rows |= {row for controller in mechanism.controllers for _, row in (*controller.outputs, *controller.states)}
        self._laws = {row: _with_slopes(*mechanism.laws[row]) for row in sorted(rows)}

    def value(self, row: int, t: float, arguments: np.ndarray | None = None) -> np.ndarray:
        """Return the value of a law with its derivatives, (1 + K,).

        Parameters
        ----------
        row
            Index of the law in ``Topology.laws``.
        t
            Time [s].
        arguments
            (2, 1 + K) length and rate of the pathway; None if the law has none.
        """
        evaluated, count = self._laws[row]
        first = int(self._mechanism.topology.laws[row, LAW_ROW.parameters]) + 1
        given = np.zeros((2, self._values.shape[-1])) if arguments is None else arguments
        numbers = np.concatenate([given, self._values[first : first + count]])
        value, *slopes = evaluated(*numbers[:, 0].tolist(), t)
        result = np.array(slopes, dtype=float) @ numbers
        result[0] = value
        return np.asarray(result)

    def state_rates(self, t: float, forces: np.ndarray) -> np.ndarray:
        """Return the rates of all first-order states with their derivatives with respect to parameters, (Z, 1 + K).

        Parameters
        ----------
        forces
            (F, 5, 1 + K) values of the force elements, of which the first two are length and rate.
        """
        top = self._mechanism.topology
        values = np.zeros((len(top.states), self._values.shape[-1]))
        for state, (segment, _, row) in enumerate(top.states.tolist()):
            if row >= 0:
                own = None if segment < 0 else forces[top.force_place[segment], :2]
                values[state] = self.value(row, t, own)
        return values


def _with_slopes(name: str, compiled: CompiledLaw) -> tuple[Callable[..., list[float]], int]:
    """Return a function that evaluates a law and its derivatives, and the number of parameters of the law.

    The arguments of the function are length, rate, parameters and time; the derivatives are those with respect to the
    first three.
    """
    import sympy as sp

    from mbdkit.symbolic.symbolic_law import smooth_pieces

    if not isinstance(compiled.law, ExpressionLaw):
        raise SpecError(
            f"the rates of the states of '{name}' are functions, which have no derivatives with respect to parameters; "
            "write them as SymPy expressions",
            key="gradients",
        )
    names = [name for name, _ in compiled.parameters]
    symbols = tuple(sp.Symbol(name, real=True) for name in ("length", "rate", *names))
    force, _ = smooth_pieces(compiled.law, names)
    return _function_with_slopes(force, symbols), len(names)


@lru_cache(maxsize=256)  # each run has laws of its own, whose expressions are equal
def _function_with_slopes(force: sympy.Expr, symbols: tuple[sympy.Symbol, ...]) -> Callable[..., list[float]]:
    import sympy as sp

    slopes = [force.diff(symbol) for symbol in symbols]
    function: Callable[..., list[float]] = sp.lambdify(
        [*symbols, sp.Symbol("time", real=True)], [force, *slopes], modules="math"
    )
    return function
