"""Numerical stability of Baumgarte's terms: whether a method is stable for e'' + 2 alpha e' + beta^2 e = 0 with its
step size.

If the motion is slow compared with Baumgarte's terms, a constraint error e satisfies this linear equation, whose
eigenvalues are -alpha +- sqrt(alpha^2 - beta^2). In a step of size h, a Runge-Kutta method multiplies the error by its
stability function R(z) = 1 + z b^T (1 - z A)^-1 1 at z = h times an eigenvalue, where A and b are the coefficients of
the method.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import factorial

import numpy as np

from mbdkit.engine.stabilization import Stabilization
from mbdkit.methods.kinds import Method
from mbdkit.registry.items import Claims

#: Function from the step size [s] to the growth factor of an error in a step, or in an iteration.
Growth = Callable[[float], float]


def stiff_baumgarte(
    name: str, method: Method, claims: Claims, wanted: Stabilization, step: float | None
) -> Iterator[str]:
    """Yield a warning if Baumgarte's terms are unstable with a fixed step.

    `method`, `claims`: the method and its claims. A method written in Python that does not use tangents is treated as
    an explicit Runge-Kutta method with as many stages as its order. `step`: the fixed step [s]; None if there is none.
    """
    if step is None or claims.adaptive:
        return
    growth, does = _growth(method, claims, wanted)
    if growth(step) < 1:
        return
    alpha, beta = wanted.alpha, wanted.beta
    most = alpha * _limit(growth, step)
    yield (
        f"Baumgarte's alpha = {alpha:g} and beta = {beta:g} 1/s are too large for the step of {step:g} s: "
        f"with '{name}' {does} by {growth(step):.3g} instead of reducing them. "
        f"alpha times the step is {alpha * step:.4g}, with beta / alpha = {beta / alpha:g} it should be "
        f"below {most:.4g}: take a smaller step or a smaller alpha"
    )


def _growth(method: Method, claims: Claims, wanted: Stabilization) -> tuple[Growth, str]:
    """Return the growth factor of an error as a function of the step, and a clause that names the iteration."""
    alpha, beta = wanted.alpha, wanted.beta
    root = np.sqrt(complex(alpha**2 - beta**2))
    eigenvalues = np.array([-alpha + root, -alpha - root])
    in_a_step = "each step multiplies constraint errors"
    tableau = method.traits.tableau
    if tableau is not None and method.traits.iterates_without_tangents:
        mu = np.linalg.eigvals(tableau.floats()[0])

        def iterated(h: float) -> float:
            return float(np.max(np.abs(2 * alpha * h * mu + (beta * h * mu) ** 2)))

        return iterated, "each fixed-point iteration multiplies errors of the stages"
    if tableau is not None:
        a, b, _ = tableau.floats()
        ones, unit = np.ones(len(b)), np.eye(len(b))

        def stepped(h: float) -> float:
            return float(max(abs(1 + h * x * (b @ np.linalg.solve(unit - h * x * a, ones))) for x in eigenvalues))

        return stepped, in_a_step
    if "tangents" in claims.needs:
        return lambda h: 0.0, in_a_step
    series = [1 / factorial(k) for k in range(int(claims.order or 1) + 1)]
    return lambda h: float(np.max(np.abs(np.polyval(series[::-1], h * eigenvalues)))), in_a_step


def _limit(growth: Growth, step: float) -> float:
    """Return the largest stable step [s]; `step` is a step that is unstable."""
    from scipy.optimize import bisect  # runs import this module, but rarely need SciPy's

    sizes = step * np.linspace(0.0, 1.0, 2001)[1:]
    first = next(i for i, size in enumerate(sizes) if growth(size) >= 1)
    low, high = sizes[first] - sizes[0], sizes[first]
    return float(bisect(lambda size: growth(size) - 1, low, high, xtol=1e-9 * step))
