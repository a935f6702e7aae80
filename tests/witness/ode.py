"""Two integrators for the witnesses' equations: SciPy's DOP853 at its tightest, and extrapolation to check it with.

The witnesses hold mbdkit against DOP853 (Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I,
section II.5, in SciPy's implementation). How many digits of it are right is not taken on trust: `extrapolate`
solves the same equations by Gragg's midpoint rule and Bulirsch-Stoer extrapolation (ibid., section II.9), in
extended precision where the platform has it, and the tests compare the two.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.floating[Any]]
RightSide = Callable[[Any, Array], Array]


def solved_once(solve: Callable[..., Any]) -> Callable[..., Any]:
    """Let a method compute its result once for equal objects and arguments: many tests compare with the same motion."""
    known: dict[tuple[Any, ...], tuple[Any, Any]] = {}

    @functools.wraps(solve)
    def found(self: Any, *arguments: Any) -> Any:
        key = (repr(self), *(np.asarray(one).tobytes() for one in arguments))
        if key not in known:
            known[key] = self, solve(self, *arguments)  # `self` is kept: its functions are named by their addresses
        return known[key][1].copy()

    return found


def dop853(
    right_side: RightSide, start: Array, times: Array, *, start_time: float = 0.0, max_step: float = np.inf
) -> Array:
    """Return the states at `times` [s], shape (T, n), by SciPy's DOP853 with rtol 1e-13 and atol 1e-15.

    The integration is stopped at each of the times, so that no state comes from the dense output, whose order is lower.
    """
    state = np.asarray(start, dtype=float)
    rows = []
    before = start_time
    for time in np.asarray(times, dtype=float):
        if time > before:
            solution = solve_ivp(
                right_side, (before, time), state, method="DOP853", rtol=1e-13, atol=1e-15, max_step=max_step
            )
            if not solution.success:
                raise RuntimeError(f"DOP853 stopped before t = {time} s: {solution.message}")
            state, before = solution.y[:, -1], time
        rows.append(state)
    return np.array(rows)


def extrapolate(right_side: RightSide, start: Array, end: float, steps: int, columns: int = 10) -> Array:
    """Return the state at `end` [s], shape (n,), by `steps` equal steps of Gragg-Bulirsch-Stoer, in long double.

    Every step extrapolates the midpoint rule with 2, 4, 6, ... 2 `columns` substeps to order 2 `columns`.
    """
    state = np.asarray(start, dtype=np.longdouble)
    size = np.longdouble(end) / steps
    numbers = [2 * (k + 1) for k in range(columns)]
    for step in range(steps):
        time = size * step
        table: list[Array] = []
        for k, number in enumerate(numbers):
            substep = size / number
            before, now = state, state + substep * right_side(time, state)
            for i in range(1, number):
                before, now = now, before + 2 * substep * right_side(time + i * substep, now)
            entry = (before + now + substep * right_side(time + size, now)) / 2
            row: list[Array] = [entry]
            for j in range(1, k + 1):
                ratio = (np.longdouble(number) / numbers[k - j]) ** 2
                row.append(row[j - 1] + (row[j - 1] - table[j - 1]) / (ratio - 1))
            table = row
        state = table[-1]
    return state
