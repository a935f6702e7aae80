"""The search for a static equilibrium: damped Newton steps along which the forces do positive work."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import block_array, diags_array
from scipy.sparse.linalg import SuperLU, splu

from mbdkit.base.errors import StepError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.engine.kernels.projection import EPS, FEW_ROUNDINGS, MOST_ITERATIONS, STAGNANT
from mbdkit_statics.prepared_mechanism import PreparedMechanism
from mbdkit_statics.reduced import DENSE, at_rest, softest_motion, stiffness_scale
from mbdkit_statics.states_at_rest import StaticEquations

#: Largest number of attempted steps, including rejected ones; a search with more steps fails.
#:
#: Cantilevers under a force that bends them strongly need about 300 steps, with coarse elements that are `corrected` up
#: to 540.
MOST_STEPS = 1000

LONGEST = 0.5  #: Largest step of a coordinate, relative to the size of the mechanism or to 1 rad.

#: The search ends if the imbalance is below this fraction of the forces that balance each other.
#:
#: The imbalance is the norm of the accelerations from rest in the mass metric. The size of the forces is the attribute
#: `force` of the search.
BALANCED = 1e-13

#: The result of a search that no longer makes progress is accepted if the imbalance is below this fraction of the
#: forces.
STALLED = 1e-8

#: If the imbalance is below this fraction of the forces, a step with the true stiffness is tried first.
NEAR = 1e-2

PATIENCE = 8  #: A search counts as stagnant after this many consecutive steps that do not halve the imbalance.

#: The result of a stagnant search is also accepted if the imbalance is at most this multiple of its estimated rounding
#: error.
MUCH = 1e3

#: Length of last steps, as measured by `LONGEST`, that are left out where the imbalance is below `BALANCED`; how often
#: they are halved; and the share of its first length to which they must converge.
STILL, HALVINGS, CONVERGED = 1e-10, 6, 0.1

#: Weight of a translation by the size of the mechanism, relative to the weight of a rotation by 1 rad, in the norm
#: that corrections of open joints minimise.
PLACES = 1e-6

MOST_SADDLES = 10  #: Largest number of saddle points from which a search continues.

#: A stiffness counts as negative if it is below minus this fraction of the largest stiffness of a single coordinate.
#:
#: Smaller magnitudes are attributed to round-off.
SADDLE = 1e-9

FRICTION = (
    "friction holds nothing in an equilibrium, because its force vanishes without slip; to hold a body, give the "
    "force of friction as a load, or run the mechanism until it comes to rest"
)


@dataclass(frozen=True)
class Rest:
    """Result of a search for an equilibrium.

    Attributes
    ----------
    q : (n,) array
        Position [m, rad].
    lam : (m,) array
        Multipliers of the constraints.
    left : (n,) array
        Remaining accelerations [m/s^2, rad/s^2].
    iterations
        Number of attempted steps.
    z : (Z,) array
        First-order states.
    """

    q: np.ndarray
    lam: np.ndarray
    left: np.ndarray
    iterations: int
    z: np.ndarray


def has_friction(prepared: PreparedMechanism) -> bool:
    """Return whether an element of the mechanism has dry friction."""
    every = (element for elements in prepared.spec.mechanism().elements.values() for element in elements.values())
    return any(max(element.friction_coefficients, default=0.0) > 0.0 for element in every)


def rest(prepared: PreparedMechanism) -> Rest:
    """Return the static equilibrium; raises SpecError if none is found.

    A search can end on a saddle of the potential, because steps towards a saddle do positive work as well. The search
    is then continued from positions on both sides of the saddle, along the motion of lowest stiffness.
    """
    search = _RestSearch(prepared)
    found = search.run()
    for _ in range(MOST_SADDLES):
        if found is None or not search.has_moved or not search.leave(_descent(prepared, found)):
            break
        found = search.run()
    if found is not None:
        return found
    friction = f" ({FRICTION})" if has_friction(prepared) else ""
    here = search.x
    worst = int(np.argmax(np.abs(here)))
    name, unit = prepared.equations.bodies[worst // 3], "rad/s^2" if worst % 3 == 2 else "m/s^2"
    raise prepared.error(
        f"no static equilibrium was found from this start in {search.tried} steps: in the last position body {name!r} "
        f"still accelerates by {abs(here[worst]):.3g} {unit}; start closer to an equilibrium, or hold that body"
        f"{friction}"
    )


def _descent(prepared: PreparedMechanism, found: Rest) -> np.ndarray | None:
    """Return the motion (n,) with the most negative stiffness at rest; None if no stiffness is negative.

    Also None if the mechanism is too large to be reduced to its degrees of freedom.
    """
    if not 0 < prepared.freedoms <= prepared.equations.n <= DENSE:
        return None
    at = at_rest(prepared, found.q, found.lam)
    value, way = softest_motion(prepared, at)
    return way if value < -SADDLE * stiffness_scale(prepared, at) else None


def _factors(upper: Any, jacobian: Any) -> SuperLU:
    """Return the factors of a symmetric matrix (n, n) bordered by the rows (m, n) of the constraints."""
    return splu(block_array([[upper, jacobian.T], [jacobian, None]], format="csc"))


class _RestSearch:
    def __init__(self, prepared: PreparedMechanism):
        self.p: EquationsOfMotion = prepared.equations
        self.extent = prepared.extent
        self.none, self.no_rows = np.zeros(self.p.n), np.zeros(self.p.m)
        self.q = self.p.q0.copy()
        self.tried = 0
        #: Largest sum of the norms of applied and constraint forces in the positions so far, in the metric of the
        #: inverse mass. Rejected steps do not count: a floor that they enter by metres repels with any force.
        self.force = 0.0
        self.move(self.q, self.balance(self.q))
        stiffest = stiffness_scale(prepared, at_rest(prepared, self.q, self.lam)) if prepared.freedoms else 0.0
        #: Imbalance that rounding errors of the positions can cause, by the largest stiffness of a coordinate.
        self.blur = float(np.finfo(float).eps) * stiffest * self.extent * float(np.sqrt(np.sum(self.p.mass)))
        #: Stiffness by the mass [1/s^2] that makes motions without any stiffness determined.
        self.least = 1e-3 * float(np.finfo(float).eps) * stiffest

    def balance(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
        """Return the accelerations from rest (n,), the multipliers (m,), the imbalance, and the size of the forces.

        The imbalance is the norm of these accelerations in the mass metric.
        """
        p = self.p
        applied = p.forces(p.t0, q, self.none)
        x, lam = p.solve(p.t0, q, applied, self.no_rows)
        held = p.constraint_forces(p.t0, q, lam)
        force = np.sqrt(np.sum(applied**2 / p.mass)) + np.sqrt(np.sum(held**2 / p.mass))
        return x, lam, float(np.sqrt(np.sum(p.mass * x**2))), float(force)

    def move(self, q: np.ndarray, there: tuple[np.ndarray, np.ndarray, float, float]) -> None:
        """Move to a position with a known `balance`."""
        self.q = q
        self.x, self.lam, self.imbalance, force = there
        self.force = max(self.force, force)

    def size(self, s: np.ndarray) -> float:
        """Return the largest change of a coordinate in a step, relative to the size of the mechanism or to 1 rad."""
        return float(np.max(np.abs(s.reshape(-1, 3)) / (self.extent, self.extent, 1.0)))

    def run(self) -> Rest | None:
        # Levenberg-Marquardt: with little damping a step is a Newton step, with much damping a short step along the
        # accelerations. The initial damping limits such a step to `LONGEST`. After a rejected step, the damping has a
        # lower bound, because multiplying a vanishing value would increase it too slowly.
        idle, damping = 0, self.size(self.x) / LONGEST
        while self.tried < MOST_STEPS:
            if self.imbalance <= max(BALANCED * self.force, self.blur) or (idle >= PATIENCE and self.is_balanced):
                break
            before = self.imbalance
            if not self.step(damping):
                damping = max(4 * damping, 1e-12 * self.force / self.extent)
                idle += 1
                continue
            damping *= 0.1
            idle = 0 if self.imbalance < 0.5 * before else idle + 1
        if self.is_balanced:
            self.polish()
            z = self.p.states.solve(self.p.t0, self.q) if isinstance(self.p, StaticEquations) else np.zeros(0)
            return Rest(self.q, self.lam, self.x, self.tried, z)
        return None

    @property
    def has_moved(self) -> bool:
        """Whether the position differs from the position at the start."""
        return bool(np.any(self.q != self.p.q0))

    def leave(self, way: np.ndarray | None) -> bool:
        """Leave a saddle along `way` (n,) or in the opposite direction, if the forces do positive work along it.

        Returns whether the saddle was left; False if `way` is None.
        """
        if way is None:
            return False
        way = way / self.size(way)
        for reach in (0.1, 0.01, 0.001):
            for side in (way, -way):
                try:
                    half, end = (self.closed(self.q + part * reach * side) for part in (0.5, 1.0))
                    work, there = self.work(self.q, half, end), self.balance(end)
                except (StepError, RuntimeError):  # the joints cannot be closed there
                    continue
                if work > 0:
                    self.move(end, there)
                    return True
        return False

    def step(self, damping: float) -> bool:
        """Try a step with ``damping * M`` added to the stiffness; return whether it was taken.

        M is the mass matrix, and `damping` is in 1/s^2. Compressed elements make diagonal entries of the stiffness
        negative, so that a Newton step can point against the forces. If there are such entries, another step is tried
        as well, for which twice the magnitude of these entries is added to them, so that they are positive. Far from
        equilibrium, this other step is tried first.
        """
        p = self.p
        at = p.t0, self.q, self.none, self.none, self.lam
        try:
            stiffness, jacobian = p.tangents(*at).stiffness, p.constraint_jacobian(p.t0, self.q)
            right = np.concatenate([-p.residual(*at), self.no_rows])
            pressed = np.maximum(-stiffness.diagonal(), 0.0)
            choices = (2.0, 0.0) if self.imbalance > NEAR * self.force else (0.0, 2.0)
            for more in choices if np.any(pressed) else (0.0,):
                self.tried += 1
                upper = stiffness + diags_array(damping * p.mass + more * pressed)
                if self.take(_factors(upper, jacobian).solve(right)[: p.n]):
                    return True
        except (StepError, RuntimeError):  # the matrix is singular, or the joints cannot be closed after the step
            pass
        return False

    def polish(self) -> None:
        """Take Newton steps until they are no longer shorter than the ones before.

        Rounding errors of stiff elements may exceed the forces on soft ones. The imbalance is then small before soft
        elements have yielded, but steps are not. Without convergence, the position stays as it is.
        """
        before = self.q, self.x, self.lam, self.imbalance
        left = 1.0
        try:
            while self.tried < MOST_STEPS and (ratio := self.shorten()) < 1.0:
                left *= ratio
        except (StepError, RuntimeError):  # the matrix is singular, or the joints cannot be closed after the step
            pass
        if left > CONVERGED:
            self.q, self.x, self.lam, self.imbalance = before

    def shorten(self) -> float:
        """Take a Newton step, or a part of it after which the next one with the same tangents is shorter (P. Deuflhard,
        Newton Methods for Nonlinear Problems, Springer 2004, section 3.3). Return the ratio of their lengths; 1 if no
        step is taken.
        """
        p, at = self.p, (self.p.t0, self.q, self.none, self.none, self.lam)
        stiffness, jacobian = p.tangents(*at).stiffness, p.constraint_jacobian(p.t0, self.q)
        upper = stiffness + diags_array(self.least * p.mass)
        factors = _factors(upper, jacobian)

        def step_from(q: np.ndarray, lam: np.ndarray) -> np.ndarray:
            right = np.concatenate([-p.residual(p.t0, q, self.none, self.none, lam), self.no_rows])
            return np.asarray(factors.solve(right)[: p.n])

        s = step_from(self.q, self.lam)
        length = self.size(s)
        if not length > (FEW_ROUNDINGS * EPS if self.imbalance > BALANCED * self.force else STILL):  # also for nan
            return 1.0
        self.tried += 1
        share = min(1.0, LONGEST / length)
        for _ in range(HALVINGS):
            q = self.closed(self.q + share * s)
            there = self.balance(q)
            following = self.size(step_from(q, there[1]))
            if following <= (1.0 - 0.5 * share) * length:
                self.move(q, there)
                return following / length
            share *= 0.5
        return 1.0

    @property
    def is_balanced(self) -> bool:
        """Whether the imbalance is small enough for the result of the search to be accepted."""
        return self.imbalance <= max(STALLED * self.force, MUCH * self.blur)

    def take(self, s: np.ndarray) -> bool:
        """Take a step, shortened to `LONGEST`, if the forces do positive work along it; return whether it was taken."""
        p, before = self.p, self.imbalance
        if not np.all(np.isfinite(s)):
            return False
        s = s / max(1.0, self.size(s) / LONGEST)
        # The imbalance does not measure progress, because it also vanishes at a maximum of the potential. Instead, the
        # work of the forces must be at least a tenth of the work that follows from their values at the beginning.
        promised = float(np.sum(p.mass * self.x * s))
        if not promised > 0:
            return False
        half, end = (self.closed(self.q + part * s) for part in (0.5, 1.0))
        work = self.work(self.q, half, end)
        there = self.balance(end)
        # Close to equilibrium, the work is smaller than its rounding error; half the imbalance is then sufficient.
        near = self.is_balanced and there[2] < 0.5 * before
        if not (work >= 0.1 * promised or near):
            return False
        self.move(end, there)
        return True

    def closed(self, q: np.ndarray) -> np.ndarray:
        """Return a position near `q` at which all joints are closed.

        Translations have the small weight `PLACES`, so that bodies are translated rather than rotated.
        """
        p = self.p
        weight = np.tile([PLACES / self.extent**2, PLACES / self.extent**2, 1.0], len(p.bodies))

        def step(at: np.ndarray) -> np.ndarray:
            jacobian = p.constraint_jacobian(p.t0, at)
            right = np.concatenate([self.none, -p.constraints(p.t0, at)])
            return np.asarray(_factors(diags_array(weight), jacobian).solve(right)[: p.n])

        before = np.inf
        for _ in range(MOST_ITERATIONS):
            change = step(q)
            q = q + change
            now = p.relative_change(q, change)
            if now <= FEW_ROUNDINGS * EPS or (now >= 0.5 * before and now < STAGNANT):
                return q
            before = now
        message = f"no position that satisfies the joints was found in {MOST_ITERATIONS} iterations"
        raise StepError("newton-failed", message)

    def work(self, start: np.ndarray, half: np.ndarray, end: np.ndarray) -> float:
        """Return the work of the forces along the parabola through three positions, by Simpson's rule [J]."""
        ways = (-3 * start + 4 * half - end, end - start, start - 4 * half + 3 * end)
        total = 0.0
        for weight, q, way in zip((1, 4, 1), (start, half, end), ways, strict=True):
            total -= weight / 6 * float(way @ self.p.residual(self.p.t0, q, self.none, self.none, self.lam))
        return total
