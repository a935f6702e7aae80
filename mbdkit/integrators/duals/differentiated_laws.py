"""Derivatives of expressions of the state with respect to parameters, and of what controllers hold between samples.

The inputs of an expression are parameters of its law (`mbdkit.engine.state_expressions`). Evaluating a state with dual
numbers stores the values and derivatives of these inputs in the array of parameters, over which the chain rule is
applied. The times of samples do not depend on parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.base.errors import SpecError, StepError
from mbdkit.engine.kernels.dual_observe import observe_duals
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.kernels.table_rows import LAW_ROW, STATE_ROW
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.native.number_arrays import Duals
from mbdkit.integrators.duals.dual_run import dual_states
from mbdkit.mechanism.force_law import ExpressionLaw

if TYPE_CHECKING:
    import sympy

    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.engine.force_laws import CompiledLaw
    from mbdkit.integrators.run.sampled_control import Sampler


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


class DifferentiatedSampler:
    """Updates the derivatives of the outputs and states that controllers hold, and of inputs.

    Parameters
    ----------
    steps
        The differentiated run, with its state.
    sampler
        The sampler of the run.
    """

    def __init__(self, steps: Any, sampler: Sampler):
        self._steps, self._sampler, width = steps, sampler, np.asarray(steps.run.q).shape[-1]
        self._pending = [np.zeros((*one.shape, width)) for one in sampler._pending]
        self._last = -math.inf

    def passed(self, stop: float, after: np.ndarray) -> None:
        """Update the derivatives for the samples at a stop; a repeated call has no effect.

        Parameters
        ----------
        stop
            Time of the stop [s].
        after
            (Z,) first-order states after the samples.

        Raises
        ------
        StepError
            If the accelerations at the stop are not unique.
        """
        controllers, z = self._steps.workspace.mechanism.controllers, np.asarray(self._steps.run.z)
        if stop <= self._last or not self._sampler.is_needed:
            return
        self._last = stop
        laws, number_of, of_inputs = self._steps.laws, self._sampler._number, self._sampler.set_states
        z[of_inputs] = 0.0  # the values to which inputs are set depend on no parameter
        z[of_inputs, 0] = after[of_inputs]
        changed, is_evaluated = z.copy(), False
        for controller, pending in zip(controllers, self._pending, strict=True):
            number = number_of(stop, controller, 0.0)
            if number is not None:
                if not is_evaluated:
                    self._evaluate(stop)
                    is_evaluated = True
                pending[number % len(pending)] = [laws.value(row, stop) for _, row in controller.outputs]
                for state, row in controller.states:
                    changed[state] = laws.value(row, stop)
            number = number_of(stop, controller, controller.delay)
            if number is not None:
                changed[[state for state, _ in controller.outputs]] = pending[number % len(pending)]
        changed[:, 0] = after
        z[...] = changed

    def _evaluate(self, t: float) -> None:
        """Evaluate the quantities that expressions use at time t, with derivatives with respect to the parameters."""
        steps, run = self._steps, self._steps.run
        steps.take_up_solver()
        steps.use_states(np.asarray(run.z))
        q, v = (np.asarray(x)[None].view(Duals) for x in (run.q, run.v))
        states = PinnedBundle(dual_states(run, steps.workspace, np.array([t]), q, v))  # must exist during the call
        status, _ = observe_duals(states.address)
        if status != OK:
            raise StepError("singular", f"the sample of a controller at t = {t:.6g} s has no derivatives")


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
