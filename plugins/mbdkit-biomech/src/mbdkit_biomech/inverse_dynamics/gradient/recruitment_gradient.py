"""Derivatives of recruited muscles, and of the joint forces that contain them, with respect to parameters.

The derivatives of moment arms, capacities and passive forces are given. The derivatives of tensions and reserves follow
from them and the optimality conditions. With the generalized forces P F of the tensions F, and the forces B u of
actuators and reserves, the derivatives with respect to a parameter p are

    Phi_q^T lam_p = (B u + P F)_p - (M a + Phi_q^T lam - Q - Q_loads)_p,    the last term at constant lam.

The other symbols are those of `mbdkit_biomech.inverse_dynamics.loads.dynamics`.

The implicit function theorem is applied to the optimality conditions of the programmes. Unknowns at their bounds stay
there. For the cost f, the matrix A and the right sides b of the equations, the other unknowns x and the multipliers y
of the equations satisfy

    f'(x) = A^T y,    A x = b.

Their changes are therefore the solution of

    f''(x) dx - A^T dy = dA^T y - df'(x),    A dx = db - dA x,

where ``df'`` is the change of f' with its parameters, the weights. If an unknown is about to leave or to reach a bound,
the result is a one-sided derivative.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.engine.linear_systems import products, pseudoinverses
from mbdkit.integrators.duals.dual_run import Seeds
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem
from mbdkit_biomech.inverse_dynamics.loads.dynamics import Balance
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Motion
from mbdkit_biomech.inverse_dynamics.muscles.programme import Programme
from mbdkit_biomech.inverse_dynamics.muscles.recruited import Recruited
from mbdkit_biomech.inverse_dynamics.muscles.recruitment import Recruiter
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import Shared
from mbdkit_biomech.muscles.muscle_values import Muscles

#: Arrays of the muscles of a motion; see `Contraction` and `Sharing`.
OF_MUSCLES = ("length", "rate", "fiber_length", "fiber_rate", "capacity", "passive", "pull", "arms")


def muscle_arrays(problem: InverseProblem, motion: Motion) -> dict[str, np.ndarray]:
    """Return the arrays of the muscles of a motion that may depend on parameters, and the weights of the muscles."""
    recruiter = problem.recruiter
    assert recruiter is not None
    balance = Balance(problem.fitter.manifold, motion, problem.actuators)
    own = recruiter.contraction(motion)
    arms = balance.as_actuators(own.pull)
    every = {name: arms if name == "arms" else np.nan_to_num(getattr(own, name)) for name in OF_MUSCLES}
    return {f"muscles.{name}": x for name, x in (every | {"weights": recruiter.weights}).items()}


def require_derivatives_of(recruiter: Recruiter) -> None:
    """Raise SpecError if the solution of recruitment cannot be differentiated."""
    if recruiter.asked.dynamics == "activation":
        raise SpecError("gradients are not available with `dynamics: activation`", key="recruitment.dynamics")
    if recruiter.is_elastic:
        raise SpecError("gradients are not available with elastic tendons", key="recruitment")
    if recruiter.targets:
        raise SpecError("gradients do not include the compartments of knees and EMG", key="recruitment")
    if recruiter.exponent == 1 or math.isinf(recruiter.exponent):
        raise SpecError(
            f"gradients need an exponent of 2 or more, not {recruiter.asked.exponent}: the solution of a linear "
            "programme has corners",
            key="recruitment.exponent",
        )


@dataclass(frozen=True)
class RecruitedChange:
    """Derivatives of recruited muscles with respect to K parameters.

    Attributes
    ----------
    activation, force
        (T, M, K) derivatives of activations and tensions.
    beside
        (T, U, K) derivatives of `Recruited.beside`.
    pushed
        (T, n, K) derivatives of the generalized forces of muscles, and of actuators and reserves.
    """

    activation: np.ndarray
    force: np.ndarray
    beside: np.ndarray
    pushed: np.ndarray

    @classmethod
    def of(
        cls,
        recruiter: Recruiter,
        recruited: Recruited,
        value: np.ndarray,
        columns: tuple[np.ndarray, np.ndarray],
        seeds: Seeds,
    ) -> RecruitedChange:
        """Return the derivatives.

        Parameters
        ----------
        value
            (T, U, K) derivatives of the values of the actuators without muscles.
        columns
            (T, n, U) generalized forces of unit actuators and their derivatives (T, n, U, K).
        seeds
            Derivatives of the arrays of `muscle_arrays`.
        """
        parts = [
            _change(recruiter, recruited, value[..., k], (columns[0], columns[1][..., k]), _slopes(seeds, recruited, k))
            for k in range(seeds.count)
        ]
        return cls(*(np.stack(one, axis=-1) for one in zip(*parts, strict=True)))


def _slopes(seeds: Seeds, recruited: Recruited, index: int) -> dict[str, np.ndarray]:
    """Return the derivatives of the arrays of muscles with respect to one parameter; zeros for arrays that do not
    depend on it.
    """
    contraction = recruited.contraction
    shapes = {name: recruited.sharing.arms if name == "arms" else getattr(contraction, name) for name in OF_MUSCLES}
    none: Mapping[str, np.ndarray] = {name: np.zeros_like(x) for name, x in shapes.items()} | {
        "weights": np.zeros(contraction.length.shape[1])
    }
    results = {name: seeds.get(f"muscles.{name}") for name in none}
    return {name: none[name] if x is None else x[..., index] for name, x in results.items()}


def _change(
    recruiter: Recruiter,
    recruited: Recruited,
    value: np.ndarray,
    columns: tuple[np.ndarray, np.ndarray],
    slope: Mapping[str, np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    contraction, sharing, count = recruited.contraction, recruited.sharing, recruited.activation.shape[1]
    arms, driven, programme = sharing.arms, sharing.driven, sharing.programme
    matrix = np.zeros_like(programme.matrix)
    matrix[:, :, :count] = (
        slope["arms"][:, driven] * contraction.capacity[:, None] + arms[:, driven] * slope["capacity"][:, None]
    )
    passive = products(slope["arms"][:, driven], contraction.passive) + products(arms[:, driven], slope["passive"])
    right = value[:, driven] - passive
    weight = np.zeros_like(programme.weight)
    weight[:count] = slope["weights"]
    shares = change_of_shares(programme, recruited.shared, recruiter.exponent, ProgrammeChange(matrix, right, weight))
    activation = shares[:, :count]
    force = contraction.capacity * activation + slope["capacity"] * recruited.activation + slope["passive"]
    tension = recruited.force
    beside = value - (products(arms, force) + products(slope["arms"], tension))
    beside[:, recruiter.is_taken_over(driven)] = 0.0
    pushed = products(columns[0], beside) + products(columns[1], recruited.beside)
    pushed = pushed + products(contraction.pull, force) + products(slope["pull"], tension)
    return activation, force, beside, pushed


def differentiated_muscles(
    recruiter: Recruiter, recruited: Recruited, change: RecruitedChange, seeds: Seeds
) -> Muscles:
    """Return the muscles with an additional last axis for the value and its K derivatives."""
    contraction = recruited.contraction
    slopes = [_slopes(seeds, recruited, k) for k in range(seeds.count)]
    kinematic = {name: np.stack([slope[name] for slope in slopes], axis=-1) for name in OF_MUSCLES[:4]}
    power = -(change.force * contraction.rate[..., None] + recruited.force[..., None] * kinematic["rate"])
    own = {name: getattr(recruited, name) for name in ("activation", "force", "power")}
    values = {name: getattr(contraction, name) for name in kinematic} | own
    every = kinematic | {"activation": change.activation, "force": change.force, "power": power}
    joined = {name: np.concatenate([x[..., None], every[name]], axis=-1) for name, x in values.items()}
    return Muscles(**joined, muscles=tuple(recruiter.muscles.values()))


#: Lower bound of the second derivatives of the cost, relative to the largest one in a frame; smaller ones are raised to
#: this bound.
#:
#: For exponents above 2, the second derivative vanishes at x = 0.
LEAST_CURVATURE = 1e-12
#: Singular values below this share of the largest one belong to equations that contain no free unknown.
NEGLIGIBLE = 1e-13
REFINEMENTS = 2  #: Number of iterative refinements of the solution, which remove rounding errors.


@dataclass(frozen=True)
class ProgrammeChange:
    """Derivatives of programmes with respect to one parameter; the arrays have the shapes of those in `Programme`."""

    matrix: np.ndarray
    right: np.ndarray
    weight: np.ndarray


def change_of_shares(programme: Programme, shared: Shared, exponent: float, change: ProgrammeChange) -> np.ndarray:
    """Return the derivatives (T, N) of the solutions with respect to one parameter.

    Parameters
    ----------
    programme, shared
        The programmes and their solutions.
    exponent
        p > 1, finite.
    change
        Derivatives of the programmes; their bounds are constant.
    """
    x, y, weight = shared.value, shared.multipliers, programme.weight
    is_free = (x > programme.low) & (x < programme.high)
    share = np.abs(x) / weight
    slope = exponent * np.sign(x) * elementary.pow(share, exponent - 1) / weight
    curvature = exponent * (exponent - 1) * elementary.pow(share, exponent - 2) / weight**2
    curvature = np.maximum(curvature, LEAST_CURVATURE * np.max(curvature, axis=1, keepdims=True))
    flexibility = np.where(is_free, 1.0 / curvature, 0.0)
    size = programme.size
    matrix = programme.matrix / size[..., None]
    pulled = products(np.swapaxes(change.matrix, 1, 2), y) + slope * exponent / weight * change.weight
    needed = (change.right - products(change.matrix, x)) / size
    normal = products(matrix * flexibility[:, None], np.swapaxes(matrix, 1, 2))
    inverse = pseudoinverses(normal, NEGLIGIBLE)
    values: np.ndarray = flexibility * pulled
    for _ in range(1 + REFINEMENTS):
        left = needed - products(matrix, values)
        values = values + flexibility * products(np.swapaxes(matrix, 1, 2), products(inverse, left))
    return values
