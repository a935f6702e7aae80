"""Linearisation of a mechanism about a state: natural frequencies, damping ratios and mode shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Unpack

import numpy as np
from scipy.linalg import eig, null_space

from mbdkit.base.html_view import HtmlView
from mbdkit.base.logs import warn_on_stderr
from mbdkit.mechanism.beams import Beam
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.runs.coarse_beams import advice_on_elements
from mbdkit.spec.loading import RunSource, Sections
from mbdkit_statics.equilibrium_search import rest
from mbdkit_statics.prepared_mechanism import PreparedMechanism
from mbdkit_statics.reduced import DENSE, NOISE, State, at_rest, in_statics, lowest, reduce_with_states, symmetric_modes
from mbdkit_statics.states_at_rest import CoupledStates, first_order_form

Where = Literal["equilibrium", "start"]

#: If the ratio of the largest to the smallest eigenvalue exceeds this, the smaller ones are computed from the inverse
#: matrix.
SPREAD = 1e6

FEW = 10  #: Default number of modes for a mechanism that is too large for a dense eigenvalue problem.


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
        Accelerations in this state; zero up to rounding errors in an equilibrium.
    basis : (3 B, f) array
        Basis of the f degrees of freedom: tangent to the constraint manifold, orthonormal in the mass metric
        [1/sqrt(kg)].
    stiffness, damping : (f, f) arrays
        Stiffness and damping in this basis, for unit mass [1/s^2, 1/s].
    states
        Small motions of the first-order states; None if there are no such states.
    """

    time: float
    bodies: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    basis: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    states: CoupledStates | None = None

    def state_matrix(self) -> np.ndarray:
        """Return the matrix A of the first-order form ``x' = A x``, with ``x = (y, y')`` followed by the first-order
        states.
        """
        return first_order_form(self.stiffness, self.damping, self.states)

    def input_matrix(self) -> np.ndarray:
        """Return the matrix B (2 f + Z, U) of ``x' = A x + B u``, for the inputs of the mechanism in their order."""
        f = len(self.stiffness)
        by_input = np.zeros((f, 0)) if self.states is None else self.states.by_input
        return np.vstack([np.zeros((f, by_input.shape[1])), by_input])


@dataclass(frozen=True)
class Modes(HtmlView):
    """Small motions of a mechanism about a state, each ``Re(shape exp(eigenvalue t))``.

    A pair of conjugate eigenvalues is one mode, represented by the eigenvalue with positive imaginary part. A real
    eigenvalue is a mode without oscillation. An undamped motion without restoring force has a double eigenvalue zero
    and is one mode.

    Attributes
    ----------
    time
        Time of the state [s].
    bodies
        Names of the bodies.
    position, velocity, acceleration : (B, 3) arrays
        The state: x, y [m] and angle [rad] of each body, and their first and second time derivatives.
    eigenvalues : (K,) complex array
        Eigenvalues [1/s] in ascending order of their absolute value.
    shapes : (K, B, 3) complex array
        x, y and angle of each body, scaled to unit modal mass; the largest displacement is real and positive. Every
        shape u satisfies ``Phi_q u = 0``. The angle of a point mass is zero.
    freedoms
        Number of degrees of freedom; driven coordinates are not free.
    mechanism
        The mechanism; notebooks use it to draw the modes.
    out_of_range
        Warnings about force laws outside their ranges, as sentences.
    """

    time: float
    bodies: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    eigenvalues: np.ndarray
    shapes: np.ndarray
    freedoms: int
    mechanism: Mechanism | None = field(default=None, repr=False, compare=False)
    out_of_range: tuple[str, ...] = ()

    @property
    def warnings(self) -> list[str]:
        """Warnings about force laws outside their ranges, and about beams whose elements are too coarse for some
        modes.
        """
        beams = {} if self.mechanism is None else self.mechanism.beams
        return [*self.out_of_range, *coarse_modes(beams, self.bodies, self.natural_frequency, self.shapes)]

    @property
    def natural_frequency(self) -> np.ndarray:
        """Absolute value of the eigenvalues, (K,) [rad/s]; the frequency of the undamped oscillation."""
        return np.asarray(np.abs(self.eigenvalues))

    @property
    def damped_frequency(self) -> np.ndarray:
        """Imaginary part of the eigenvalues, (K,) [rad/s]; the damped frequency, 0 without oscillation."""
        return self.eigenvalues.imag.copy()

    @property
    def frequency_hz(self) -> np.ndarray:
        """Natural frequency, (K,) [Hz]."""
        return self.natural_frequency / (2 * np.pi)

    @property
    def damping_ratio(self) -> np.ndarray:
        """Damping relative to critical damping, (K,): 1 for decay without oscillation, negative for growing modes.

        NaN for an eigenvalue of zero.
        """
        with np.errstate(invalid="ignore"):
            ratio: np.ndarray = -self.eigenvalues.real / np.abs(self.eigenvalues)
        return ratio

    @property
    def unstable(self) -> np.ndarray:
        """Whether each mode grows, (K,)."""
        return np.asarray(self.eigenvalues.real > 1e-9 * np.max(np.abs(self.eigenvalues), initial=0.0))


def linearize(source: RunSource, *, at: Where = "equilibrium", **sections: Unpack[Sections]) -> Linearization:
    """Linearise the equations of motion about a state, on the constraint manifold.

    Drivers keep their prescribed motion, and loads the values that they have at this time. If the state moves or is not
    an equilibrium, the equations describe the deviation between neighbouring motions at this instant only. The
    deviation is measured in a basis that moves with the mechanism without rotating within the tangent space (see
    `mbdkit_statics.reduced.reduce`); the stiffness then includes the centrifugal and driving terms.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism.
    at
        ``equilibrium``: at rest in the static equilibrium that `equilibrium` finds from the initial state; ``start``:
        in the initial state, with its velocities.
    **sections
        Sections of the spec that replace those of `source`.

    Returns
    -------
    Linearization
        Stiffness and damping along the degrees of freedom.

    Raises
    ------
    SpecError
        If the input is wrong, no equilibrium is found, or the mechanism has no degrees of freedom or more than 500
        bodies.
    RunError
        If a force law is outside its range in this state, and ``limits.law_range`` is ``stop``.

    Examples
    --------
    The stiffness of a pendulum of length 2 m, for unit mass, is g / l:

    >>> import mbdkit
    >>> m = mbdkit.Mechanism()
    >>> ball = m.body("ball", mass=3.0, position=(0.0, -2.0))
    >>> m.distance("string", m.ground, ball, from_=(0, 0), to=(0, -2))
    >>> found = mbdkit.linearize(m)
    >>> round(float(found.stiffness[0, 0]), 9)  # 1/s^2
    4.905
    """
    prepared = PreparedMechanism.of(source, **sections)
    state = state_of(prepared, at)
    _require_freedoms(prepared)
    if prepared.equations.n > DENSE:
        raise prepared.error(
            f"a mechanism of {len(prepared.equations.bodies)} bodies is too large to be linearised as a whole "
            f"(limit: {DENSE // 3} bodies); `modes` finds its lowest modes at rest"
        )
    with prepared.as_spec_errors():
        small, states = reduce_with_states(prepared, *state)
    warn_on_stderr(prepared.laws_out_of_range(state[0].t, state[0].q, state[0].v))
    return Linearization(
        state[0].t, prepared.equations.bodies, *_seen(state[0]), small.basis, small.stiffness, small.damping, states
    )


def modes(
    source: RunSource, *, at: Where = "equilibrium", count: int | None = None, **sections: Unpack[Sections]
) -> Modes:
    """Find natural frequencies, damping ratios and mode shapes of a mechanism.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism.
    at
        ``equilibrium``: about the static equilibrium that `equilibrium` finds from the initial state; ``start``: about
        the initial state, with its velocities, at this instant; see `linearize`.
    count
        Number of modes, in ascending order of frequency. Default: all, or ten for a mechanism of more than 500 bodies.
    **sections
        Sections of the spec that replace those of `source`.

    Returns
    -------
    Modes
        Eigenvalues and shapes.

    Raises
    ------
    SpecError
        If the input is wrong, no equilibrium is found, or the mechanism has no degrees of freedom.
    RunError
        If a force law is outside its range in this state, and ``limits.law_range`` is ``stop``.

    Examples
    --------
    A mass on a horizontal guide and a spring oscillates with the frequency sqrt(k / m):

    >>> import mbdkit
    >>> m = mbdkit.Mechanism()
    >>> cart = m.body("cart", mass=4.0, inertia=0.1, position=(1.0, 0.0))
    >>> m.prismatic("guide", m.ground, cart, at=(1, 0), axis=(1, 0))
    >>> m.spring_damper("spring", m.ground, cart, from_=(0, 0), to=(1, 0), stiffness=100.0, free_length=1.0)
    >>> [round(float(frequency), 9) for frequency in mbdkit.modes(m).natural_frequency]  # rad/s
    [5.0]
    """
    result = modes_of(PreparedMechanism.of(source, **sections), at, count)
    warn_on_stderr(result.warnings)
    return result


def modes_of(prepared: PreparedMechanism, at: Where = "equilibrium", count: int | None = None) -> Modes:
    """Find the modes of a prepared mechanism; see `modes`."""
    if count is not None and count < 1:
        raise prepared.error(f"the number of modes must be at least 1, not {count}", key="")
    state, z = state_of(prepared, at)
    _require_freedoms(prepared)
    with prepared.as_spec_errors():
        if prepared.equations.n > DENSE:
            values, shapes = _few(prepared, state, count or FEW)
        else:
            small, states = reduce_with_states(prepared, state, z)
            if states is None:
                values, shapes = oscillations(small.stiffness, small.damping)
            else:
                values, vectors = eig(first_order_form(small.stiffness, small.damping, states))
                once = values.imag >= 0
                values, shapes = values[once], vectors[: len(small.stiffness), once]
            shapes = small.basis @ shapes
    order = np.lexsort((-values.imag, -values.real, np.round(np.abs(values), 12)))[:count]
    values, shapes = values[order], _normalised(shapes[:, order], prepared.equations.mass)
    shapes = shapes.T.reshape(len(values), -1, 3)
    mechanism, outside = prepared.spec.mechanism(), prepared.laws_out_of_range(state.t, state.q, state.v)
    return Modes(
        state.t, prepared.equations.bodies, *_seen(state), values, shapes, prepared.freedoms, mechanism, outside
    )


def state_of(prepared: PreparedMechanism, at: Where) -> tuple[State, np.ndarray]:
    """Return the state to linearise about, and its first-order states (Z,)."""
    p = prepared.equations
    statics = in_statics(prepared)
    if at == "equilibrium":
        with prepared.as_spec_errors():
            result = rest(statics)
            return at_rest(prepared, result.q, result.lam), result.z
    if at != "start":
        raise prepared.error(f"a mechanism is linearised at 'equilibrium' or at 'start', not at {at!r}", key="")
    with prepared.as_spec_errors():
        z = prepared.workspace.mechanism.initial_states
        prepared.workspace.take_states(z)
        a, lam = p.accelerations(p.t0, p.q0, p.v0)
    return State(p.t0, p.q0, p.v0, a, lam), z


def oscillations(stiffness: np.ndarray, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues (K,) of ``y'' + damping y' + stiffness y = 0`` and their vectors (f, K).

    Of a conjugate pair, only the eigenvalue with positive imaginary part is returned. An undamped motion without
    restoring force has a double eigenvalue zero, which is returned once.

    Without damping and with a symmetric stiffness, the symmetric problem of size f is solved; its eigenvalues are real,
    so that no rounding error appears as damping or growth. Otherwise the first-order form of size 2 f is solved, in the
    basis of the undamped modes if the stiffness is symmetric. In this form, rounding errors would split a double zero
    into two small non-zero values. Zeros are therefore counted from the null space of the stiffness, and the same
    number of smallest eigenvalues is discarded.
    """
    f = len(stiffness)
    if np.array_equal(stiffness, stiffness.T):
        squares, basis = symmetric_modes(stiffness)
        if np.any(damping):
            values, vectors = _first_order(np.diag(squares), basis.T @ damping @ basis, np.eye(f)[:, squares == 0])
            return values, basis @ vectors
        grow = squares < 0
        roots = np.sqrt(np.abs(squares)) * np.where(grow, 1, 1j)
        return np.concatenate([roots, -roots[grow]]), np.concatenate([basis, basis[:, grow]], axis=1).astype(complex)
    return _first_order(stiffness, damping, null_space(stiffness, rcond=NOISE * f))


def _first_order(stiffness: np.ndarray, damping: np.ndarray, loose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the result of `oscillations`, computed from the first-order form.

    Parameters
    ----------
    loose
        Basis (f, k) of the motions without stiffness.
    """
    f = len(stiffness)
    dragged = np.linalg.matrix_rank(damping @ loose, tol=NOISE * f * np.linalg.norm(damping)) if loose.size else 0
    zeros = 2 * loose.shape[1] - int(dragged)
    values, vectors = eig(first_order_form(stiffness, damping))
    squares = np.diag(stiffness)
    if not np.any(stiffness - np.diag(squares)) and np.all(squares >= 0) and np.any(squares):
        values, vectors = _with_small_ones(squares, damping, values, vectors)
    order = np.argsort(np.abs(values))[zeros:]
    order = order[values[order].imag >= 0]
    return (
        np.concatenate([np.zeros(loose.shape[1]), values[order]]),
        np.concatenate([loose, vectors[:f, order]], axis=1),
    )


def _with_small_ones(
    squares: np.ndarray, damping: np.ndarray, values: np.ndarray, vectors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return eigenvalues and vectors of the first-order form, with accurate small eigenvalues.

    The stiffness is a diagonal matrix with the diagonal `squares`.

    Rounding errors of eigenvalues are relative to the largest eigenvalue. In beams with damped material, it is so large
    that the lowest eigenvalues are lost. The inverse matrix has the reciprocal eigenvalues: those of the small
    eigenvalues are its largest, and therefore accurate. As in
    `mbdkit_statics.reduced.lowest`, a shift keeps the inverse regular.
    """
    f = len(squares)
    shift = 0.5 * np.sqrt(np.min(squares[squares > 0]))
    if np.max(np.abs(values)) <= SPREAD * shift:
        return values, vectors
    matrix = np.diag(squares + shift**2) + shift * damping  # matrix of the equation for the positions
    scale = 1 / np.sqrt(np.diag(matrix))
    inverse = scale[:, None] * np.linalg.inv(scale[:, None] * matrix * scale) * scale
    by_position = (inverse * squares - np.eye(f)) / shift  # -inverse (damping + shift)
    inverted, others = eig(np.block([[by_position, -inverse], [np.eye(f) + shift * by_position, -shift * inverse]]))
    result = shift + 1 / inverted
    small = int(np.sum(np.abs(values) <= np.sqrt(np.max(np.abs(values)) * shift)))
    large = np.argsort(np.abs(values))[small:]
    few = np.argsort(np.abs(result))[:small]
    return np.concatenate([result[few], values[large]]), np.concatenate([others[:, few], vectors[:, large]], axis=1)


def _few(prepared: PreparedMechanism, state: State, count: int) -> tuple[np.ndarray, np.ndarray]:
    if np.any(state.v):
        raise prepared.error(
            f"a mechanism of {len(prepared.equations.bodies)} bodies is too large to be linearised while it moves "
            f"(limit: {DENSE // 3} bodies); linearise it about its equilibrium instead"
        )
    if 2 * count + 8 > prepared.freedoms:  # ARPACK can find only a part of the spectrum
        raise prepared.error(
            f"at most {prepared.freedoms // 2 - 4} modes can be computed for a mechanism of this size", key=""
        )
    values, shapes = lowest(prepared, state, 2 * count + 2)
    # Set real parts this small to zero: they are rounding errors, and undamped modes would seem to grow.
    values = np.where(np.abs(values.real) <= 1e-9 * np.abs(values), 1j * values.imag, values)
    once = np.flatnonzero(values.imag >= 0)
    once = once[np.argsort(np.abs(values[once]))][:count]
    return values[once], shapes[:, once]


def _normalised(shapes: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Return shapes (n, K) scaled to unit modal mass, with the largest displacement of each real and positive."""
    largest = np.argmax(np.abs(shapes) * np.sqrt(mass)[:, None], axis=0)
    phase = np.take_along_axis(shapes, largest[None], axis=0)
    shapes = shapes * (np.abs(phase) / np.where(phase == 0.0, 1.0, phase))
    norm = np.sqrt(np.sum(mass[:, None] * np.abs(shapes) ** 2, axis=0))
    norm = np.where(norm == 0.0, 1.0, norm)  # the shape is zero if only first-order states change
    return np.asarray(shapes / norm)


def _require_freedoms(prepared: PreparedMechanism) -> None:
    if prepared.freedoms == 0:
        raise prepared.error(
            "this mechanism has no degrees of freedom and so no modes: joints and drivers fix its motion"
        )


def _seen(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return state.q.reshape(-1, 3), state.v.reshape(-1, 3), state.a.reshape(-1, 3)


def coarse_modes(beams: Mapping[str, Beam], bodies: Sequence[str], rates: np.ndarray, shapes: np.ndarray) -> list[str]:
    """Return warnings about beams whose two-node elements are too coarse for bending in modes of oscillation.

    Parameters
    ----------
    beams
        The beams by name.
    bodies
        Names of the bodies.
    rates
        (K,) natural frequencies of the modes, in ascending order [rad/s].
    shapes
        (K, B, 3) shapes of the modes, scaled to unit modal mass.

    Notes
    -----
    The estimated relative error of a frequency is the share of the strain energy that is due to variations of the
    moment within elements, times the share of bending in the energy of the mode. At cantilevers of 4 to 16 elements, it
    is 1.4 times the error of the first mode, and up to 10 times that of higher ones, for which errors of stiffness and
    of mass nearly cancel.
    """
    warnings = []
    for name, beam in beams.items():
        if beam.nodes != 2 or beam.corrected or beam.elements < 2:
            continue
        angles = shapes[:, [bodies.index(node) for node in beam.node_names(name)], 2]
        curvature = np.diff(angles, axis=1) / beam.element_length
        total = np.sum(np.abs(curvature) ** 2, axis=1)
        varied = np.sum(np.abs(np.diff(curvature, axis=1)) ** 2, axis=1) * beam.elements / (beam.elements - 1)
        stiffness = beam.section_stiffness.bending * beam.element_length
        # the strain energy of a mode of unit mass is at most that of its motion, rate^2 / 2
        energy = 12.0 * total * np.maximum(rates**2, stiffness * total)
        is_bent = (rates > 0) & (energy > 0)  # not a motion of rigid bodies, and with this beam
        errors = np.divide(varied * stiffness * total, energy, out=np.zeros_like(total), where=is_bent)
        advices = [advice_on_elements(beam.elements, error) for error in errors.tolist()]
        wrong = [mode for mode, advice in enumerate(advices) if advice]
        if wrong:
            first = wrong[0]
            warnings.append(
                f"the elements of beam '{name}' are too coarse for mode {first + 1}"
                f"{' and higher modes' if len(wrong) > 1 else ''}: the frequency of mode {first + 1} may be wrong by "
                f"up to about {100.0 * errors[first]:.2g} %; {advices[first]}, or elements with three nodes"
            )
    return warnings
