"""Any mechanism in minimal coordinates: poses as SymPy expressions of them, solved by DOP853.

With q(s, t) the positions of all bodies, J = dq/ds and b the part of q'' that does not contain s'',

    (J^T M J) s'' = J^T (Q - M b)

from d'Alembert's principle. No constraint, and so no drift, occurs in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from . import ode

Array = NDArray[np.floating[Any]]
TIME = sympy.Symbol("t")


def coordinates(count: int) -> tuple[sympy.Symbol, ...]:
    """Return the symbols of minimal coordinates."""
    return tuple(sympy.symbols(f"s:{count}"))


@dataclass(frozen=True)
class MinimalSystem:
    """A mechanism in minimal coordinates.

    Parameters
    ----------
    poses
        x, y and angle of every body, as expressions of ``coordinates(n)`` and `TIME`.
    masses, inertias
        Of the bodies.
    start, rates
        (n,) the coordinates at t = 0, and their rates.
    load
        Forces and torques (3 B,) besides gravity, a function of t, q and v.
    gravity
        Downward acceleration of gravity [m/s^2].
    """

    poses: Sequence[tuple[Any, Any, Any]]
    masses: Sequence[float]
    inertias: Sequence[float]
    start: Sequence[float]
    rates: Sequence[float]
    load: Callable[[float, Array, Array], Array] | None = None
    gravity: float = 9.81
    symbols: tuple[sympy.Symbol, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "symbols", coordinates(len(self.start)))

    @cached_property
    def functions(self) -> Callable[..., Any]:
        """Return q, J, q' and b as one function of (t, s, s')."""
        s = self.symbols
        w = tuple(sympy.symbols(f"w:{len(s)}"))
        q = sympy.Matrix([sympy.sympify(x) for pose in self.poses for x in pose])
        jacobian = q.jacobian(s)
        rate = jacobian * sympy.Matrix(w) + q.diff(TIME)
        bias = rate.jacobian(s) * sympy.Matrix(w) + rate.diff(TIME)
        made = sympy.lambdify((TIME, s, w), [q, jacobian, rate, bias], "numpy", cse=True)
        return lambda t, x, y: [np.asarray(part, dtype=float) for part in made(t, tuple(x), tuple(y))]

    def state(self, t: float, s: Array, w: Array) -> tuple[Array, Array]:
        """Return positions and velocities (B, 3)."""
        q, _, v, _ = self.functions(t, s, w)
        return q.reshape(-1, 3), v.reshape(-1, 3)

    def solve(self, times: Array, max_step: float = np.inf) -> tuple[Array, Array]:
        """Return positions and velocities (T, B, 3) at `times` [s]."""
        n = len(self.start)
        mass = np.array([[m, m, j] for m, j in zip(self.masses, self.inertias, strict=True)]).ravel()
        weight = np.array([[0.0, -m * self.gravity, 0.0] for m in self.masses]).ravel()

        def right_side(t: Any, y: Any) -> Any:
            q, jacobian, v, bias = self.functions(t, y[:n], y[n:])
            force = weight if self.load is None else weight + self.load(t, q.ravel(), v.ravel())
            matrix = jacobian.T @ (mass[:, None] * jacobian)
            return np.concatenate([y[n:], np.linalg.solve(matrix, jacobian.T @ (force - mass * bias.ravel()))])

        rows = ode.dop853(right_side, np.array([*self.start, *self.rates], dtype=float), times, max_step=max_step)
        states = [self.state(t, row[:n], row[n:]) for t, row in zip(times, rows, strict=True)]
        return np.array([q for q, _ in states]), np.array([v for _, v in states])
