"""Linearisation about a state: natural frequencies, damping ratios and mode shapes along a mechanism's freedoms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.linalg import eig, eigh, null_space

from mbdkit.mechanics.equilibrium import rest
from mbdkit.mechanics.reduced import DENSE, State, at_rest, lowest, reduce
from mbdkit.mechanics.source import Placed

Where = Literal["equilibrium", "start"]

NOISE = 64 * float(np.finfo(float).eps)
"""Round-off of an eigenvalue for each freedom, relative to the largest."""

FEW = 10
"""Modes that are sought of a mechanism too large to have all of them found."""


@dataclass(frozen=True)
class Linearization:
    """``y'' + damping y' + stiffness y = 0``: small motions ``basis y`` of a mechanism about a state.

    Attributes
    ----------
    time
        Time of the state [s].
    bodies
        Names of the bodies.
    position, velocity : (B, 3) arrays
        The state: x, y [m] and angle [rad] of each body, and their rates.
    acceleration : (B, 3) array
        Accelerations there; about zero in an equilibrium.
    basis : (3 B, f) array
        Directions of the f freedoms, on the constraint manifold, orthonormal in the mass metric [1/sqrt(kg)].
    stiffness, damping : (f, f) arrays
        Of unit mass [1/s^2, 1/s].
    """

    time: float
    bodies: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    basis: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray

    def state_matrix(self) -> np.ndarray:
        """Return A (2 f, 2 f) of ``x' = A x`` for ``x = (y, y')``."""
        f = len(self.stiffness)
        return np.block([[np.zeros((f, f)), np.eye(f)], [-self.stiffness, -self.damping]])


@dataclass(frozen=True)
class Modes:
    """Small motions of a mechanism about a state, each ``Re(shape exp(eigenvalue t))``.

    A pair of conjugate eigenvalues is one mode, given by the one with the positive imaginary part; a real eigenvalue is
    a mode that does not oscillate; an undamped motion that meets no resistance is one mode with eigenvalue zero.

    Attributes
    ----------
    time
        Time of the state [s].
    bodies
        Names of the bodies.
    position, velocity, acceleration : (B, 3) arrays
        The state: x, y [m] and angle [rad] of each body, their rates, and the accelerations there.
    eigenvalues : (K,) complex array
        [1/s], by growing size.
    shapes : (K, B, 3) complex array
        x, y and angle of each body, of unit modal mass, the largest displacement real and positive; they satisfy
        ``Phi_q u = 0``. The angle of a point mass is zero.
    freedoms
        Degrees of freedom, drivers held to their motion.
    """

    time: float
    bodies: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    eigenvalues: np.ndarray
    shapes: np.ndarray
    freedoms: int

    @property
    def natural_frequency(self) -> np.ndarray:
        """Size of the eigenvalues, (K,) [rad/s]: the frequency that an oscillation has without its damping."""
        size: np.ndarray = np.abs(self.eigenvalues)
        return size

    @property
    def damped_frequency(self) -> np.ndarray:
        """Imaginary part of the eigenvalues, (K,) [rad/s]: the frequency that is seen; zero without oscillation."""
        return self.eigenvalues.imag.copy()

    @property
    def frequency_hz(self) -> np.ndarray:
        """Natural frequency, (K,) [Hz]."""
        return self.natural_frequency / (2 * np.pi)

    @property
    def damping_ratio(self) -> np.ndarray:
        """Damping as part of the critical one, (K,): 1 for what decays without oscillation, below 0 for what grows.

        Not a number (nan) where the eigenvalue is zero.
        """
        with np.errstate(invalid="ignore"):
            ratio: np.ndarray = -self.eigenvalues.real / np.abs(self.eigenvalues)
        return ratio

    @property
    def unstable(self) -> np.ndarray:
        """Whether a mode grows by itself, (K,)."""
        found: np.ndarray = self.eigenvalues.real > 1e-9 * np.max(np.abs(self.eigenvalues), initial=0.0)
        return found


def linearize(source: Any, *, at: Where = "equilibrium", **sections: Any) -> Linearization:
    """Linearise the equations of motion about a state, on the constraint manifold.

    Drivers are held to their motion, loads at their value of the moment. In a state that is no equilibrium, or moves,
    the deviation between neighbouring motions obeys these equations at this instant only, measured in a basis that
    moves along without turning; centrifugal and driving terms are in the stiffness.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism.
    at
        ``equilibrium``: at rest in the static equilibrium that `equilibrium` finds from the start; ``start``: in the
        start itself, with its velocities.
    **sections
        Sections of the spec that replace those of `source`.

    Returns
    -------
    Linearization
        Stiffness and damping along the freedoms.

    Raises
    ------
    SpecError
        Where the input is wrong, no equilibrium is found, or the mechanism has no freedoms, or more than 500 bodies.
    """
    placed = Placed.of(source, **sections)
    state = state_of(placed, at)
    _require_freedoms(placed)
    if placed.equations.n > DENSE:
        raise placed.error(
            f"a mechanism of {len(placed.equations.bodies)} bodies is too large to be reduced to all its freedoms "
            f"(up to {DENSE // 3} bodies); `modes` finds the lowest modes of one at rest"
        )
    with placed.blamed():
        small = reduce(placed, state)
    return Linearization(state.t, placed.equations.bodies, *_seen(state), small.basis, small.stiffness, small.damping)


def modes(source: Any, *, at: Where = "equilibrium", count: int | None = None, **sections: Any) -> Modes:
    """Find natural frequencies, damping ratios and mode shapes of a mechanism.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism.
    at
        ``equilibrium``: about the static equilibrium that `equilibrium` finds from the start; ``start``: about the
        start, with its velocities, at this instant; see `linearize`.
    count
        How many modes, the slowest first; left out: all of them, or ten of a mechanism of more than 500 bodies.
    **sections
        Sections of the spec that replace those of `source`.

    Returns
    -------
    Modes
        Eigenvalues and shapes.

    Raises
    ------
    SpecError
        Where the input is wrong, no equilibrium is found, or nothing can move.
    """
    return modes_of(Placed.of(source, **sections), at, count)


def modes_of(placed: Placed, at: Where = "equilibrium", count: int | None = None) -> Modes:
    """Find the modes of a mechanism that is built; see `modes`."""
    if count is not None and count < 1:
        raise placed.error(f"the number of modes must be at least 1, not {count}", key="")
    state = state_of(placed, at)
    _require_freedoms(placed)
    with placed.blamed():
        if placed.equations.n > DENSE:
            values, shapes = _few(placed, state, count or FEW)
        else:
            small = reduce(placed, state)
            values, shapes = oscillations(small.stiffness, small.damping)
            shapes = small.basis @ shapes
    order = np.lexsort((-values.imag, -values.real, np.round(np.abs(values), 12)))[:count]
    values, shapes = values[order], _normalised(shapes[:, order], placed.equations.mass)
    shapes = shapes.T.reshape(len(values), -1, 3)
    return Modes(state.t, placed.equations.bodies, *_seen(state), values, shapes, placed.freedoms)


def state_of(placed: Placed, at: Where) -> State:
    """Return the state to linearise about."""
    p = placed.equations
    if at == "equilibrium":
        with placed.blamed():
            found = rest(placed)
            return at_rest(placed, found.q, found.lam)
    if at != "start":
        raise placed.error(f"a mechanism is linearised at 'equilibrium' or at 'start', not at {at!r}", key="")
    with placed.blamed():
        a, lam = p.accelerations(p.t0, p.q0, p.v0)
    return State(p.t0, p.q0, p.v0, a, lam)


def oscillations(stiffness: np.ndarray, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues (K,) of ``y'' + damping y' + stiffness y = 0`` and their vectors (f, K).

    Of conjugate pairs the one with the positive imaginary part; of the double zero of an undamped motion without
    resistance one.
    """
    f = len(stiffness)
    size = float(np.linalg.norm(stiffness))
    if not np.any(damping) and np.linalg.norm(stiffness - stiffness.T) <= 1e-10 * size:
        squares, vectors = eigh(0.5 * (stiffness + stiffness.T))
        squares = np.where(np.abs(squares) <= NOISE * f * np.max(np.abs(squares), initial=0.0), 0.0, squares)
        grow = squares < 0
        roots = np.sqrt(np.abs(squares)) * np.where(grow, 1, 1j)
        return np.concatenate([roots, -roots[grow]]), np.concatenate([vectors, vectors[:, grow]], axis=1).astype(
            complex
        )
    loose = null_space(stiffness, rcond=NOISE * f)
    dragged = np.linalg.matrix_rank(damping @ loose, tol=NOISE * f * np.linalg.norm(damping)) if loose.size else 0
    zeros = 2 * loose.shape[1] - int(dragged)
    values, vectors = eig(np.block([[np.zeros((f, f)), np.eye(f)], [-stiffness, -damping]]))
    order = np.argsort(np.abs(values))[zeros:]
    order = order[values[order].imag >= 0]
    return (
        np.concatenate([np.zeros(loose.shape[1]), values[order]]),
        np.concatenate([loose, vectors[:f, order]], axis=1),
    )


def _few(placed: Placed, state: State, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the slowest modes of a large mechanism at rest."""
    if np.any(state.v):
        raise placed.error(
            f"a mechanism of {len(placed.equations.bodies)} bodies is too large to be linearised while it moves "
            f"(up to {DENSE // 3} bodies); at rest, in its equilibrium, it is not"
        )
    if 2 * count + 8 > placed.freedoms:
        raise placed.error(f"of a mechanism this large no more than {placed.freedoms // 2 - 4} modes are found", key="")
    values, shapes = lowest(placed, state, 2 * count + 2)
    values = np.where(np.abs(values.real) <= 1e-9 * np.abs(values), 1j * values.imag, values)
    once = np.flatnonzero(values.imag >= 0)
    once = once[np.argsort(np.abs(values[once]))][:count]
    return values[once], shapes[:, once]


def _normalised(shapes: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Return shapes (n, K) of unit modal mass, the largest displacement of each real and positive."""
    largest = np.argmax(np.abs(shapes) * np.sqrt(mass)[:, None], axis=0)
    phase = np.take_along_axis(shapes, largest[None], axis=0)
    shapes = shapes * (np.abs(phase) / phase)
    norm = np.sqrt(np.sum(mass[:, None] * np.abs(shapes) ** 2, axis=0))
    normalised: np.ndarray = shapes / norm
    return normalised


def _require_freedoms(placed: Placed) -> None:
    if placed.freedoms == 0:
        raise placed.error("this mechanism has no degrees of freedom, so it has no modes: drivers and joints hold it")


def _seen(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, velocity and acceleration of a state, each (B, 3)."""
    return state.q.reshape(-1, 3), state.v.reshape(-1, 3), state.a.reshape(-1, 3)
