"""Protection of the arrays of a state: a method cannot modify a state that the framework uses."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbdkit.methods.step_methods import StepState


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
