"""Steps of methods in Python as the framework uses them: checked, with copies of their arrays that are not modified."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from mbdkit.base.errors import MbdkitError, StepError, in_this_process
from mbdkit.base.text import message_of, one_line
from mbdkit.engine.iteration_matrix import vector
from mbdkit.methods.step_methods import Step, StepState

if TYPE_CHECKING:
    from mbdkit.engine.equations_of_motion import EquationsOfMotion


P = ParamSpec("P")
T = TypeVar("T")

#: Dense output of a step: function of the share of the step that returns (q, v, z), and possibly work and energy; None
#: if the step has no dense output, or if that raises StepError.
Inside = Callable[[float], "tuple[np.ndarray, ...] | None"]


def called(name: str, function: Callable[P, T], *given: P.args, **more: P.kwargs) -> T:
    """Return what a function of a method returns; `name` is that of the function.

    StepError and ordinary exceptions are passed on. Other errors of mbdkit, and exits, become RuntimeError.
    """
    try:
        with in_this_process():
            return function(*given, **more)
    except (KeyboardInterrupt, StepError):
        raise
    except BaseException as error:  # a plugin may raise any exception, including SystemExit
        if isinstance(error, ValueError) and "read-only" in message_of(error):
            raise ValueError(f"{name} changes an array in place that belongs to a state ({error})") from error
        if isinstance(error, Exception) and not isinstance(error, MbdkitError):
            raise
        raise RuntimeError(one_line(error)) from error


def kept(value: object) -> Any:
    """Return a value of `StepState.memory` with read-only copies of its arrays, also inside lists, tuples and dicts.

    Other objects are returned as they are.
    """
    if value is None or type(value) is float:  # most values of most methods
        return value
    match value:
        case np.ndarray():
            copy = value.copy()
            copy.setflags(write=False)
            return copy
        case tuple():
            items = [kept(item) for item in value]
            return type(value)._make(items) if hasattr(value, "_make") else tuple(items)
        case list():
            return [kept(item) for item in value]
        case dict():
            return {key: kept(item) for key, item in value.items()}
    return value


def protect(state: StepState) -> None:
    """Make the arrays of a state that is passed to a method read-only."""
    for array in (state.q, state.v, state.z, state.multipliers, *state.low):
        if isinstance(array, np.ndarray):
            array.setflags(write=False)


class StepResults:
    """Checks the steps of a method.

    `name`: name of the class of the method. `equations`: the equations of motion of the run. `states`: number of
    first-order states Z. `multipliers`: whether the method computes multipliers.
    """

    def __init__(self, name: str, equations: EquationsOfMotion, states: int, multipliers: bool):
        self._name, self._equations, self._states, self._multipliers = name, equations, states, multipliers

    def state(self, new: StepState, what: str) -> StepState:
        """Return a state with copies of its arrays.

        Raises TypeError or ValueError if it is invalid, and StepError if its multipliers have overflowed.
        """
        n, m = self._equations.n, self._equations.m
        q, v = self._array(new.q, "q", n, what).copy(), self._array(new.v, "v", n, what).copy()
        z = self._array(new.z, "z", self._states, what).copy() if self._states or len(new.z) else new.z
        multipliers = kept(new.multipliers)
        if self._multipliers:
            # The method may reuse its arrays; without copies, recorded states and those of a checkpoint would change
            # later.
            multipliers = self._array(new.multipliers, "multipliers", m, what).copy()
            if not np.all(np.isfinite(multipliers)):
                raise StepError("not-finite", "multipliers overflowed")
        return StepState(q, v, multipliers, kept(new.memory), new.work, new.dissipated, kept(new.low), z)

    def step(self, new: object, what: str) -> tuple[Step, StepState]:
        """Return a checked step, and its checked state, which replaces that of the step; see `state`."""
        if isinstance(new, StepState):
            return Step(new), self.state(new, what)
        if not isinstance(new, Step):
            raise TypeError(f"{self._name}.{what} returned {type(new).__name__}, not a StepState or a Step")
        if not isinstance(new.state, StepState):
            raise TypeError(f"{self._name}.{what} returned a Step whose state is a {type(new.state).__name__}")
        if new.error is not None:
            self._array(new.error, "error", 2 * self._equations.n + self._states, what)
        size = new.next_step
        if size is not None and not (math.isfinite(size) and size > 0.0):
            raise ValueError(f"{self._name}.{what} returned next_step = {size!r}, which is not a positive number")
        return new, self.state(new.state, what) if new.accepted else new.state

    def inside(self, made: Step) -> Inside:
        """Return the checked dense output of a step."""

        def inside(theta: float) -> tuple[np.ndarray, ...] | None:
            if made.dense is None:
                return None
            try:
                values = called(f"{self._name}.dense", made.dense, theta)
            except StepError:
                return None
            if not isinstance(values, tuple) or len(values) not in (3, 5):
                raise TypeError(f"the dense output of {self._name} did not return (q, v, z)")
            sizes = self._equations.n, self._equations.n, self._states
            arrays = (self._array(x, name, size, "dense") for x, name, size in zip(values, "qvz", sizes, strict=False))
            return (*arrays, *values[3:])

        return inside

    def _array(self, value: Any, name: str, size: int, what: str) -> np.ndarray:
        try:
            return vector(value, size)
        except (TypeError, ValueError) as error:
            reason = "it is missing (None)" if value is None else message_of(error)
            raise ValueError(f"{self._name}.{what} returned an invalid `{name}`: {reason}") from None
