"""Gauss-Legendre collocation of the n-rod pendulum in CasADi: the paper's equations, written down a second time.

Absolute coordinates (x, y, theta) for each rod, index-1: the stages' accelerations and multipliers solve

    M k_i + Phi_q(q_i)^T lambda_i = Q            q_i = q + h sum_j a_ij l_j         v_i = v + h sum_j a_ij k_j
    Phi_q(q_i) k_i = gamma(q_i, v_i)             l_i = v_i

and v + h sum b_i k_i, q + h sum b_i l_i is the new state. CasADi differentiates Phi by automatic differentiation
(also to gamma = -(Phi_q v)_q v), builds the collocation matrix from its own collocation points and solves with its
own Newton method; nothing is projected, so that the joints drift as the method makes them. Andersson, Gillis, Horn,
Rawlings and Diehl, CasADi: a software framework for nonlinear optimization and optimal control, Math. Prog. Comp.
11 (2019).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]


def collocation_coefficients(stages: int) -> tuple[Array, Array, Array]:
    """Return (a, b, c) of `stages`-point Gauss-Legendre collocation, from CasADi's points and Lagrange polynomials."""
    c = np.array(casadi.collocation_points(stages, "legendre"))
    a, b = np.zeros((stages, stages)), np.zeros(stages)
    for j in range(stages):
        basis = np.poly1d([1.0])
        for i in range(stages):
            if i != j:
                basis *= np.poly1d([1.0, -c[i]]) / (c[j] - c[i])
        integral = basis.integ()
        a[:, j] = integral(c)
        b[j] = integral(1.0)
    return a, b, c


@dataclass(frozen=True)
class History:
    """A run: time (T,), q and v (T, n, 3), misalignment of every joint (T, n) [m]."""

    time: Array
    q: Array
    v: Array
    misalignment: Array


@dataclass(frozen=True)
class RodChain:
    """`count` equal uniform rods, hung from the origin one after the other.

    Parameters
    ----------
    count, length, mass
        Number of rods; length [m] and mass [kg] of each.
    gravity
        Downward acceleration of gravity [m/s^2].
    """

    count: int
    length: float = 1.0
    mass: float = 1.0
    gravity: float = 9.81

    def start(self, angle: float) -> tuple[Array, Array]:
        """Return q and v (3 n,) at rest, every rod at `angle` [rad] from the +x axis."""
        along = self.length * np.array([np.cos(angle), np.sin(angle)])
        q = np.array([[*((i + 0.5) * along), angle] for i in range(self.count)])
        return q.ravel(), np.zeros(3 * self.count)

    def constraints(self, q: Any) -> Any:
        """Return Phi (2 n,): the second point of every joint minus the first, x and y."""
        rows = []
        end: Any = casadi.DM.zeros(2)
        for i in range(self.count):
            half = 0.5 * self.length * casadi.vertcat(casadi.cos(q[3 * i + 2]), casadi.sin(q[3 * i + 2]))
            centre = q[3 * i : 3 * i + 2]
            rows.append(centre - half - end)
            end = centre + half
        return casadi.vertcat(*rows)

    def equations(self) -> Any:
        """Return the function (q, v, a, lambda) -> residual of the index-1 equations, 5 n of both."""
        n = 3 * self.count
        q, v, a = (casadi.SX.sym(name, n) for name in "qva")
        multipliers = casadi.SX.sym("multipliers", 2 * self.count)
        phi = self.constraints(q)
        jacobian = casadi.jacobian(phi, q)
        gamma = -casadi.jtimes(casadi.jtimes(phi, q, v), q, v)
        inertia = self.mass * self.length**2 / 12.0
        mass = casadi.DM([self.mass, self.mass, inertia] * self.count)
        load = casadi.DM([0.0, -self.mass * self.gravity, 0.0] * self.count)
        dynamics = mass * a + jacobian.T @ multipliers - load
        return casadi.Function("equations", [q, v, a, multipliers], [dynamics, jacobian @ a - gamma])

    def step(self, stages: int) -> Any:
        """Return the function (q, v, unknowns, h) -> (q, v, unknowns) that takes one step of Gauss collocation.

        The unknowns are the accelerations and multipliers of all stages; those of the last step start the next.
        """
        n, m = 3 * self.count, 2 * self.count
        a, b, _ = collocation_coefficients(stages)
        q, v, h = casadi.MX.sym("q", n), casadi.MX.sym("v", n), casadi.MX.sym("h")
        unknowns = casadi.MX.sym("unknowns", (n + m) * stages)
        parts = [unknowns[i * (n + m) : (i + 1) * (n + m)] for i in range(stages)]
        k = [part[:n] for part in parts]
        speeds = [v + h * sum(a[i, j] * k[j] for j in range(stages)) for i in range(stages)]
        places = [q + h * sum(a[i, j] * speeds[j] for j in range(stages)) for i in range(stages)]
        equations = self.equations()
        residual = casadi.vertcat(
            *(row for i in range(stages) for row in equations(places[i], speeds[i], k[i], parts[i][n:]))
        )
        problem = {"x": unknowns, "p": casadi.vertcat(q, v, h), "g": residual}
        options = {"abstol": 1e-12, "abstolStep": 1e-13, "max_iter": 50}
        solver = casadi.rootfinder("stages", "newton", problem, options)
        solved = solver(x0=unknowns, p=casadi.vertcat(q, v, h))["x"]
        k = [solved[i * (n + m) : i * (n + m) + n] for i in range(stages)]
        speeds = [v + h * sum(a[i, j] * k[j] for j in range(stages)) for i in range(stages)]
        q_new = q + h * sum(b[i] * speeds[i] for i in range(stages))
        v_new = v + h * sum(b[i] * k[i] for i in range(stages))
        return casadi.Function("step", [q, v, unknowns, h], [q_new, v_new, solved])

    def run(self, q: Array, v: Array, stages: int, step: float, steps: int) -> History:
        """Return the history of `steps` steps of size `step` [s] from (q, v), the start included."""
        advance = self.step(stages)
        misalignment = casadi.Function(
            "phi", [(symbol := casadi.SX.sym("q", 3 * self.count))], [self.constraints(symbol)]
        )
        unknowns: Any = casadi.DM.zeros(5 * self.count * stages)
        place, speed = casadi.DM(q), casadi.DM(v)
        places, speeds = [place], [speed]
        for _ in range(steps):
            place, speed, unknowns = advance(place, speed, unknowns, step)
            places.append(place)
            speeds.append(speed)
        gaps = [np.hypot(*np.array(misalignment(p)).reshape(self.count, 2).T) for p in places]
        shape = (steps + 1, self.count, 3)
        return History(
            time=step * np.arange(steps + 1),
            q=np.array([np.array(p).ravel() for p in places]).reshape(shape),
            v=np.array([np.array(s).ravel() for s in speeds]).reshape(shape),
            misalignment=np.array(gaps),
        )
