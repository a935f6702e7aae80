"""Whether a method takes Baumgarte's terms at its step: what it does to e'' + 2 alpha e' + beta^2 e = 0.

The stabilized constraints are linear in the state wherever the motion is slow against them, so a Runge-Kutta method
treats a constraint error e as it treats this equation, whose eigenvalues are -alpha +- sqrt(alpha^2 - beta^2). In a
step it multiplies the error by its stability function R(z) = 1 + z b^T (1 - z A)^-1 1 at z = h times these.
"""

from __future__ import annotations

from collections.abc import Callable
from math import factorial

import numpy as np

from mbdkit.engine.stabilization import Stabilization
from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta, Method
from mbdkit.registry.items import Claims

Growth = Callable[[float], float]
"""What an error is multiplied by in a step, or in an iteration, of a size [s]."""


def stiff_baumgarte(name: str, method: Method, claims: Claims, wanted: Stabilization, step: float | None) -> str:
    """Return a sentence where Baumgarte's terms are stiff against a fixed step; empty where all is well.

    Parameters
    ----------
    name
        What the method is called.
    method, claims
        The method and what it claims; one written in Python that asks for no tangents is taken for an explicit one,
        with as many stages as its order.
    wanted
        The stabilization.
    step
        The fixed step [s].
    """
    if wanted.kind != "baumgarte" or step is None or claims.adaptive:
        return ""
    growth, does = _growth(method, claims, wanted)
    if growth(step) < 1:
        return ""
    alpha, beta = wanted.alpha, wanted.beta
    most = alpha * _limit(growth, step)
    return (
        f"Baumgarte's alpha = {alpha:g} and beta = {beta:g} 1/s are stiff against the step of {step:g} s: "
        f"with '{name}' {does} {growth(step):.3g} times as large, not smaller; "
        f"alpha times the step is {alpha * step:.4g}, and with beta = {beta / alpha:g} alpha it should be "
        f"below {most:.4g}: take a smaller step or a smaller alpha"
    )


def _growth(method: Method, claims: Claims, wanted: Stabilization) -> tuple[Growth, str]:
    """Return what an error is multiplied by as a function of the step, and in words what makes it so."""
    alpha, beta = wanted.alpha, wanted.beta
    root = np.sqrt(complex(alpha**2 - beta**2))
    eigenvalues = np.array([-alpha + root, -alpha - root])
    in_a_step = "each step makes an error of the constraints"
    if isinstance(method, ImplicitRungeKutta) and method.stage_solver == "fixed-point":
        mu = np.linalg.eigvals(method.tableau.floats()[0])

        def iterated(h: float) -> float:
            return float(np.max(np.abs(2 * alpha * h * mu + (beta * h * mu) ** 2)))

        return iterated, "each fixed-point iteration makes an error of the stages"
    if isinstance(method, ExplicitRungeKutta | ImplicitRungeKutta):
        a, b, _ = method.tableau.floats()
        one, unit = np.ones(len(b)), np.eye(len(b))

        def stepped(h: float) -> float:
            return float(max(abs(1 + h * x * (b @ np.linalg.solve(unit - h * x * a, one))) for x in eigenvalues))

        return stepped, in_a_step
    if "tangents" in claims.needs:
        return lambda h: 0.0, in_a_step
    series = [1 / factorial(k) for k in range(int(claims.order or 1) + 1)]
    return lambda h: float(np.max(np.abs(np.polyval(series[::-1], h * eigenvalues)))), in_a_step


def _limit(growth: Growth, step: float) -> float:
    """Return the step [s] up to which no error grows, below `step`, at which one does."""
    sizes = step * np.linspace(0.0, 1.0, 2001)[1:]
    first = next(i for i, size in enumerate(sizes) if growth(size) >= 1)
    low, high = sizes[first] - sizes[0], sizes[first]
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if growth(middle) >= 1 else (middle, high)
    return float(low)
