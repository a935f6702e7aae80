"""The motion of a device whose cuffs are on limbs with a given motion.

The limbs move on polynomials of degree five, which have the given positions, velocities and accelerations at the times
of the motion. Between these times, the Radau IIA method with two stages solves the equations of motion of the device
with its constraints on positions, and the elastic forces of the cuffs::

    M a + Phi_q^T lam = Q(t, q, v),    Phi(q) = 0

The method is stiffly accurate: stiff cuffs of light links follow the limbs without oscillations that no data show, and
a heavy link on soft tissue keeps its inertia. The device starts from its static equilibrium, with the rates at which
this equilibrium moves.

A first motion is computed step by step. Other motions nearby start from it: a Newton method with the derivatives of the
first motion corrects all steps together, and its linear system is solved by substitution from step to step.
E. Hairer and G. Wanner, Solving Ordinary Differential Equations II, Springer 1996, sections IV.5 and VII.4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from mbdkit import RunError
from mbdkit.kernels import Frames, evaluate_frames
from mbdkit.plugin import Mechanism, SpecError
from mbdkit.plugin.runs import AssembledMechanism

NODES = np.array([1 / 3, 1.0])
INVERSE = np.array([[1.5, 0.5], [-4.5, 2.5]])  #: Nodes of the method, and the inverse of its matrix.

STEP = 1e-7  #: Change of a coordinate [m, rad], and of a velocity, for derivatives of forces by differences.

SMALL = 1e-10  #: Corrections of coordinates [m, rad] below this end an iteration.

#: Largest number of corrections, and largest correction of a coordinate in the search for equilibria [m, rad].
MOST, LONGEST = 25, 0.1

#: Derivatives are renewed after this number of corrections in a step, and for all steps together if a correction is
#: larger than the second share of the previous one. A correction beyond the third number [m, rad] is not nearby.
RENEWED, SLOW, FAR = 6, 0.2, 0.5

INSTANT = 1e-4  #: Time by which the limbs move for the rates of the equilibrium [s].

States: TypeAlias = tuple[np.ndarray, np.ndarray]  #: Positions and velocities, one row each per state.
Triple: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class LimbMotion:
    """Positions, velocities and accelerations (T, L) of the limbs at times (T,)."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray

    def at_nodes(self) -> Triple:
        """Return times (T - 1, 2), positions and velocities (T - 1, 2, L) at the nodes of each interval."""
        h, s = np.diff(self.time)[:, None, None], NODES[None, :, None]
        (q0, q1), (v0, v1), (a0, a1) = ((x[:-1, None], x[1:, None]) for x in (self.q, self.v, self.a))
        # q0 + s h v0 + (s h)^2/2 a0 + s^3 c3 + s^4 c4 + s^5 c5 meets the values at s = 1
        left = q1 - q0 - h * v0 - h * h * a0 / 2
        rate, bend = h * (v1 - v0) - h * h * a0, h * h * (a1 - a0)
        c3, c4, c5 = 10 * left - 4 * rate + bend / 2, -15 * left + 7 * rate - bend, 6 * left - 3 * rate + bend / 2
        q = q0 + s * h * v0 + (s * h) ** 2 * a0 / 2 + s**3 * (c3 + s * (c4 + s * c5))
        v = v0 + s * h * a0 + s * s * (3 * c3 + s * (4 * c4 + s * 5 * c5)) / h
        return self.time[:-1, None] + NODES * np.diff(self.time)[:, None], q, v


class DeviceMotion:
    """Computes motions of a device for motions of its limbs, and the forces on the limbs.

    Parameters
    ----------
    mechanism
        The limbs, without joints between them, and the device with its cuffs.
    limbs
        Names of the limbs, the first bodies of the mechanism.
    span
        First and last time [s].
    near
        A device with slightly different numbers, whose first motion is a start for those of this one.
    """

    def __init__(
        self, mechanism: Mechanism, limbs: tuple[str, ...], span: tuple[float, float], near: DeviceMotion | None = None
    ):
        self.prepared = AssembledMechanism.at(_Given(mechanism), *span)
        equations = self.prepared.equations
        self.limbs, self._address = limbs, equations.address
        self._first = 3 * len(limbs)
        self._size, self._rows = equations.n, equations.m
        self._mass, self._start = equations.mass[self._first :], equations.q0[self._first :]
        self._weight = (equations.mass.reshape(-1, 3)[: len(limbs)] * [*mechanism.gravity, 0.0]).ravel()
        self._base: _Linearized | None = None if near is None else near._base

    def states(self, motion: LimbMotion) -> States:
        """Return positions and velocities (T, n) of limbs and device. Raise RunError if there is no such motion."""
        q0, v0, lam0 = self._begin(motion)
        found = None if self._base is None else self._corrected(motion, q0, v0, lam0)
        if found is None:
            found = self._step_by_step(motion, q0, v0, lam0)
        return np.hstack([motion.q, found[0]]), np.hstack([motion.v, found[1]])

    def forces(self, time: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the generalized forces (T, L) of the device on the limbs, for states (T, n)."""
        return np.asarray(self._frames(time, q, v).force[:, : self._first] - self._weight)

    def _frames(self, time: np.ndarray, q: np.ndarray, v: np.ndarray) -> Frames:
        out = Frames.zeros(len(time), self._size, self._rows)
        evaluate_frames(self._address, *(np.ascontiguousarray(x, dtype=float) for x in (time, q, v)), True, out)
        return out

    def _terms(self, time: np.ndarray, limbs: States, device: States, lam: np.ndarray) -> Triple:
        """Return ``Phi_q^T lam - Q`` (R, d), Phi (R, m) and Phi_q (R, m, d) of the device in R states."""
        frames = self._frames(time, *(np.hstack(both) for both in zip(limbs, device, strict=True)))
        jacobian = frames.jacobian[:, :, self._first :]
        pull = np.einsum("rmd,rm->rd", jacobian, lam) - frames.force[:, self._first :]
        return pull, frames.phi, jacobian

    def _slopes(self, time: np.ndarray, limbs: States, device: States, lam: np.ndarray) -> Triple:
        """Return derivatives (R, d, d) of ``Phi_q^T lam - Q`` with respect to q and v, and Phi_q (R, m, d)."""
        count, d = device[0].shape
        moves = np.zeros((2 * d + 1, 2, d))
        moves[1 : d + 1, 0], moves[d + 1 :, 1] = STEP * np.eye(d), STEP * np.eye(d)
        rows = 2 * d + 1
        where, rates = (np.repeat(x, rows, axis=0) for x in limbs)
        at, speed = (np.repeat(x, rows, axis=0) + np.tile(moves[:, i], (count, 1)) for i, x in enumerate(device))
        lam = np.repeat(lam, rows, axis=0)
        pull, _, jacobian = self._terms(np.repeat(time, rows), (where, rates), (at, speed), lam)
        pull = pull.reshape(count, rows, d)
        slopes = np.swapaxes(pull[:, 1:] - pull[:, :1], 1, 2) / STEP
        return slopes[..., :d], slopes[..., d:], jacobian[::rows]

    def _equilibrium(self, time: float, limbs: np.ndarray, q: np.ndarray, lam: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return position (d,) and multipliers (m,) of the equilibrium near a position, for a pose (L,) of limbs."""
        at, d = np.array([time]), len(q)
        still = np.zeros((1, d))
        pose = limbs[None], np.zeros((1, len(limbs)))
        for _ in range(2 * MOST):
            device = q[None], still
            pull, phi, _ = self._terms(at, pose, device, lam[None])
            stiffness, _, jacobian = self._slopes(at, pose, device, lam[None])
            matrix = np.block([[stiffness[0], jacobian[0].T], [jacobian[0], np.zeros((self._rows, self._rows))]])
            change = np.linalg.lstsq(matrix, -np.concatenate([pull[0], phi[0]]), rcond=1e-12)[0]
            size = float(np.max(np.abs(change[:d]), initial=0.0))
            change *= min(1.0, LONGEST / max(size, LONGEST))
            q, lam = q + change[:d], lam + change[d:]
            if size < SMALL:
                return q, lam
        raise RunError(f"the device has no equilibrium at t = {time:.6g} s, from which it could follow the limbs")

    def _begin(self, motion: LimbMotion) -> Triple:
        """Return position, velocity (d,) and multipliers (m,) at the first time."""
        time, limbs = float(motion.time[0]), motion.q[0]
        base = self._base
        guess, lam = (self._start, np.zeros(self._rows)) if base is None else (base.q[0], base.lam)
        q, lam = self._equilibrium(time, limbs, guess, lam)
        ends = [self._equilibrium(time, limbs + sign * INSTANT * motion.v[0], q, lam)[0] for sign in (1.0, -1.0)]
        return q, (ends[0] - ends[1]) / (2 * INSTANT), lam

    def _step_by_step(self, motion: LimbMotion, q: np.ndarray, v: np.ndarray, lam: np.ndarray) -> States:
        """Return positions and velocities (T, d) of the device, and keep the derivatives of this motion."""
        times, limbs, rates = motion.at_nodes()
        count, d, m = len(times), len(q), self._rows
        qs, vs, stages = np.empty((count + 1, d)), np.empty((count + 1, d)), np.empty((count, 2, d + m))
        qs[0], vs[0] = q, v
        guess = np.tile(np.concatenate([q, lam]), (2, 1))
        for k in range(count):
            h = motion.time[k + 1] - motion.time[k]
            guess[:, :d] = qs[k] + NODES[:, None] * h * vs[k]
            pose, w = (limbs[k], rates[k]), INVERSE / h
            for number in range(MOST):
                at, rate = guess[:, :d], w @ (guess[:, :d] - qs[k])
                if number % RENEWED == 0:
                    stiffness, damping, jacobian = self._slopes(times[k], pose, (at, rate), guess[:, d:])
                    inverse = np.linalg.inv(self._matrix(w[None], stiffness[None], damping[None], jacobian[None])[0])
                pull, phi, _ = self._terms(times[k], pose, (at, rate), guess[:, d:])
                left = np.hstack([self._mass * (w @ (rate - vs[k])) + pull, phi])
                change = -(inverse @ left.ravel()).reshape(2, d + m)
                guess = guess + change
                if np.max(np.abs(change[:, :d])) < SMALL:
                    break
            else:
                raise RunError(f"the device cannot follow the limbs at t = {motion.time[k + 1]:.6g} s")
            qs[k + 1], vs[k + 1], stages[k] = guess[1, :d], (w @ (guess[:, :d] - qs[k]))[1], guess
        w = INVERSE / np.diff(motion.time)[:, None, None]
        self._base = self._linearized(w, times, (limbs, rates), stages, qs, lam)
        return qs, vs

    def _matrix(self, w: np.ndarray, stiffness: np.ndarray, damping: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
        """Return the matrices (K, S, S) of steps for the unknowns q and lam of the first stage, then of the second one,
        given derivatives (K, 2, d, d) and Phi_q (K, 2, m, d) at the stages.
        """
        d, m, square = len(self._mass), self._rows, w @ w
        matrix = np.zeros((len(w), 2, d + m, 2, d + m))
        for i in range(2):
            for j in range(2):
                inertia = square[:, i, j, None, None] * np.diag(self._mass)
                matrix[:, i, :d, j, :d] = inertia + damping[:, i] * w[:, i, j, None, None]
            matrix[:, i, :d, i, :d] += stiffness[:, i]
            matrix[:, i, :d, i, d:] = np.swapaxes(jacobian[:, i], 1, 2)
            matrix[:, i, d:, i, :d] = jacobian[:, i]
        return matrix.reshape(len(w), 2 * (d + m), 2 * (d + m))

    def _linearized(
        self, w: np.ndarray, times: np.ndarray, limbs: States, stages: np.ndarray, qs: np.ndarray, lam: np.ndarray
    ) -> _Linearized:
        """Return the derivatives of K steps at stages (K, 2, d + m)."""
        count, d, m = len(w), len(self._mass), self._rows
        device = stages[..., :d], w @ (stages[..., :d] - qs[:-1, None])
        own = self._slopes(times.ravel(), _flat(limbs), _flat(device), stages[..., d:].reshape(2 * count, m))
        stiffness, damping, jacobian = (one.reshape(count, 2, *one.shape[1:]) for one in own)
        inverses = np.linalg.inv(self._matrix(w, stiffness, damping, jacobian))
        sums, squares = (one.sum(axis=2)[..., None, None] for one in (w, w @ w))
        start = np.zeros((count, 2, d + m, 2 * d))
        start[:, :, :d, :d] = -squares * np.diag(self._mass) - sums * damping
        start[:, :, :d, d:] = -sums * np.diag(self._mass)
        return _Linearized(inverses, inverses @ start.reshape(count, -1, 2 * d), stages, qs, lam)

    def _corrected(self, motion: LimbMotion, q: np.ndarray, v: np.ndarray, lam: np.ndarray) -> States | None:
        """Return positions and velocities (T, d) of the device from a motion nearby; None if that is too far."""
        base = self._base
        assert base is not None
        if len(base.stages) != len(motion.time) - 1:
            return None
        times, limbs, rates = motion.at_nodes()
        count, d, m = len(times), len(q), self._rows
        w = INVERSE / np.diff(motion.time)[:, None, None]
        stages, before = base.stages.copy(), np.inf
        pose = _flat((limbs, rates))
        for number in range(MOST):
            at = stages[..., :d]
            qs = np.vstack([q, at[:, 1]])
            rate = w @ (at - qs[:-1, None])
            vs = np.vstack([v, rate[:, 1]])
            pull, phi, _ = self._terms(times.ravel(), pose, _flat((at, rate)), stages[..., d:].reshape(2 * count, m))
            inertia = self._mass * (w @ (rate - vs[:-1, None]))
            left = np.concatenate([inertia + pull.reshape(count, 2, d), phi.reshape(count, 2, m)], axis=2)
            change = base.substituted(w, left.reshape(count, -1)).reshape(count, 2, d + m)
            stages = stages + change
            size = float(np.max(np.abs(change[..., :d])))
            if size < SMALL:
                return np.vstack([q, stages[:, 1, :d]]), np.vstack([v, (w @ (stages[..., :d] - qs[:-1, None]))[:, 1]])
            if not size < FAR:
                return None
            if size > SLOW * before and number > 0:
                qs = np.vstack([q, stages[:, 1, :d]])
                base = self._base = self._linearized(w, times, (limbs, rates), stages, qs, lam)
            before = size
        return None


def _flat(states: States) -> States:
    """Return states (K, 2, d) at the stages of K steps as one row each."""
    q, v = (x.reshape(2 * len(x), -1) for x in states)
    return q, v


@dataclass(frozen=True)
class _Linearized:
    """Derivatives of the steps of a motion: inverse matrices (K, S, S) of the steps, effects (K, S, 2 d) of the state
    at the beginning of a step, stages (K, 2, d + m), positions (K + 1, d), and multipliers (m,) at the first time.
    """

    inverses: np.ndarray
    effects: np.ndarray
    stages: np.ndarray
    q: np.ndarray
    lam: np.ndarray

    def substituted(self, w: np.ndarray, left: np.ndarray) -> np.ndarray:
        """Return corrections (K, S) of all steps for residuals (K, S), where the state at the first time is exact."""
        d, size = self.effects.shape[2] // 2, left.shape[1] // 2
        own: np.ndarray = -(self.inverses @ left[..., None])[..., 0]
        state = np.zeros(2 * d)
        for k in range(len(own)):
            own[k] -= self.effects[k] @ state
            first, last = own[k, :d], own[k, size : size + d]
            state = np.concatenate([last, w[k, 1, 0] * (first - state[:d]) + w[k, 1, 1] * (last - state[:d])])
        return own


@dataclass(frozen=True)
class _Given:
    """A mechanism without a spec."""

    whole: Mechanism

    def mechanism(self) -> Mechanism:
        return self.whole

    def placed(self, error: SpecError) -> SpecError:
        return error
