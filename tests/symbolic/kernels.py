"""Runs the generated kernels uncompiled, on complex numbers, for one element between two bodies or body and ground."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations_with_replacement, permutations
from typing import Any

import numpy as np

from mbdkit.engine.kernels import element_kernels

STEP = 1e-200
"""Complex step: no subtraction, so the smaller the better."""

GROUND = 2
VARIABLES = 5
"""Variables of a function of the pose: x, y, relative angle, angle of the first body, time."""


class Element:
    """One element at one configuration, chosen at random; `first` and `second` are bodies 0, 1 or `GROUND`.

    Every method evaluates a generated kernel at the arguments given, complex ones included, from arrays full of zeros:
    what a kernel does not write is zero.
    """

    def __init__(self, kind: str, first: int, second: int, seed: int):
        rng = np.random.default_rng(seed)
        self.kind, self.first, self.second = kind, first, second
        self.rows = 2 if kind in ("revolute", "moving_center") else 1
        self.q, self.v, self.acc = rng.normal(size=(3, 9))
        for x in (self.q, self.v, self.acc):
            x[6:] = 0.0
        self.p = rng.normal(size=(1, 6))
        self.p[0, 4] = 0.5 + rng.random()
        if kind == "tangent":  # a radius so small that both points are outside the circle
            self.p[0, 4] *= 0.1
        self.u = rng.normal(size=(1, 3))
        self.lam = rng.normal(size=(1, 2))
        self.center = rng.normal(size=(2, 5)) if kind == "moving_center" else None
        self.guide = rng.normal(size=(3, 5)) if kind == "guided" else None
        self.cubic = rng.normal(size=(3, *[VARIABLES] * 3)) if kind == "function" else None
        if kind == "function":  # the motion is the time
            self.u[0, 1:] = 1.0, 0.0

    @property
    def columns(self) -> list[int]:
        """Places in the state of the six coordinates that the columns of a Jacobian stand for."""
        return [3 * body + i for body in (self.first, self.second) for i in range(3)]

    def _call(self, kernel: str, q: Any, *arguments: Any) -> None:
        cs = np.column_stack([np.cos(q[2::3]), np.sin(q[2::3])])
        function = getattr(element_kernels, f"{self.kind}_{kernel}")
        if self.center is not None:  # the first of the arrays is that of the motions
            arguments = (*arguments[:-1], (self.center_at(q), *arguments[-1][1:]))
        if self.cubic is not None:
            arguments = (*arguments[:-1], (self.function_at(q, arguments[-1][0][0, 0]), *arguments[-1][1:]))
        before, after = arguments[:-1], arguments[-1]
        motion = (0,) if self.kind in (*element_kernels.CONSTRAINT_KINDS, "guided") else ()
        if self.guide is not None:
            angle = q[3 * self.second + 2] - q[3 * self.first + 2]
            values = [np.polyval(np.polyder(one, order), angle) for one in self.guide for order in range(3)]
            after = (np.array([values]), *after)
        function(0, self.first, self.second, *motion, q, *before, cs, self.p, *after)

    def center_at(self, q: Any) -> np.ndarray:
        """Return the jets (4, 3) of a center x, its derivative, y and its derivative at the relative angle.

        Both components are polynomials of degree four, so that all derivatives with respect to the angle matter.
        """
        angle = q[3 * self.second + 2] - q[3 * self.first + 2]
        jets = np.zeros((4, 3), dtype=q.dtype)
        for axis, coefficients in enumerate(self.center):
            for order in range(4):
                value = np.polyval(np.polyder(coefficients, order), angle)
                for row in (0, 1):
                    if 0 <= order - row < 3:
                        jets[2 * axis + row, order - row] = value
        return jets

    def function_at(self, q: Any, time: Any) -> np.ndarray:
        """Return the rows (19, 3) of a cubic polynomial of the pose and its derivatives to third order."""
        a, b = 3 * self.first, 3 * self.second
        ca, sa, cb, sb = np.cos(q[a + 2]), np.sin(q[a + 2]), np.cos(q[b + 2]), np.sin(q[b + 2])
        x = q[b] + cb * self.p[0, 2] - sb * self.p[0, 3] - q[a]
        y = q[b + 1] + sb * self.p[0, 2] + cb * self.p[0, 3] - q[a + 1]
        pose = [ca * x + sa * y - self.p[0, 0], ca * y - sa * x - self.p[0, 1], q[b + 2] - q[a + 2], q[a + 2], time]
        w, cubic = np.array(pose), self.cubic[0]
        third = sum(np.transpose(cubic, order) for order in permutations(range(3))) / 6
        second = self.cubic[1, 0] + self.cubic[1, 0].T + third @ w
        first = self.cubic[2, 0, 0] + (self.cubic[1, 0] + self.cubic[1, 0].T) @ w + third @ w @ w / 2
        value = self.cubic[2, 0, 0] @ w + w @ self.cubic[1, 0] @ w + third @ w @ w @ w / 6
        numbers = [value, *first]
        numbers += [second[chosen] for chosen in combinations_with_replacement(range(VARIABLES), 2)]
        numbers += [third[chosen] for chosen in combinations_with_replacement(range(VARIABLES), 3)]
        return np.array([*numbers, 0.0]).reshape(-1, 3)

    def position(self, q: Any, u: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return Phi (r,) and Phi_t (r,)."""
        phi, phi_t = np.zeros((2, 1, 2), complex)
        self._call("position", q, (u, phi, phi_t))
        return phi[0, : self.rows], phi_t[0, : self.rows]

    def acceleration(self, q: Any, v: Any, u: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the Jacobian (r, 6) and gamma (r,)."""
        jacobian, gamma = np.zeros((1, 12), complex), np.zeros((1, 2), complex)
        self._call("acceleration", q, v, (u, jacobian, gamma))
        return jacobian.reshape(2, 6)[: self.rows], gamma[0, : self.rows]

    def tangent(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return d(Phi_q^T lam)/dq (6, 6), d gamma/dv (r, 6) and d(Phi_q a - gamma)/dq (r, 6)."""
        stiffness, gamma_v, residual_q = np.zeros((1, 36)), np.zeros((1, 12)), np.zeros((1, 12))
        self._call("tangent", self.q, self.v, self.acc, (self.u, self.lam, stiffness, gamma_v, residual_q))
        return (
            stiffness.reshape(6, 6),
            gamma_v.reshape(2, 6)[: self.rows],
            residual_q.reshape(2, 6)[: self.rows],
        )

    def rate(self, q: Any, v: Any, u: Any) -> np.ndarray:
        """Return Phi_q v + Phi_t (r,)."""
        return self.acceleration(q, v, u)[0] @ v[self.columns] + self.position(q, u)[1]

    def gradient(self, q: Any) -> tuple[complex, np.ndarray]:
        """Return a pathway's length and its gradient (6,)."""
        s, gradient = np.zeros((1, 1), complex), np.zeros((1, 6), complex)
        self._call("gradient", q, (s, gradient))
        return complex(s[0, 0]), gradient[0]

    def hessian(self) -> np.ndarray:
        """Return a pathway's second derivatives (6, 6)."""
        hessian = np.zeros((1, 36))
        if hasattr(element_kernels, f"{self.kind}_hessian"):  # a pathway whose length is linear has none
            self._call("hessian", self.q, (hessian,))
        return hessian.reshape(6, 6)


def derivative(function: Callable[[Any], Any], at: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the derivative of `function` at `at` in `direction` by complex step, exact to round-off."""
    return np.asarray(function(at + 1j * STEP * direction)).imag / STEP


def partials(function: Callable[[Any], Any], at: np.ndarray, places: list[int]) -> np.ndarray:
    """Return the derivatives of `function` with respect to the entries of `at` at `places`, along the last axis."""
    return np.stack([derivative(function, at, np.eye(len(at))[i]) for i in places], axis=-1)


def assert_close(found: Any, expected: Any, size: float = 0.0) -> None:
    """Assert equality to 1e-12 of the largest number that took part."""
    expected = np.asarray(expected)
    scale = max(size, float(np.max(np.abs(expected), initial=0.0)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * scale)
