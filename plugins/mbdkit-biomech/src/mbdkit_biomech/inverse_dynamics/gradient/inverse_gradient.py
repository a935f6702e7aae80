"""`inverse_gradient`: measures of inverse dynamics and their derivatives with respect to parameters, without
integration.

The motion is part of the preparation (`mbdkit_gradients.parameter_differences`): if the motion depends on a parameter,
such as a length, it is fitted again for other values of this parameter. The derivatives of the forces that produce the
motion are exact: differentiation of ``M a + Phi_q^T lam = Q + Q_loads + B u`` with respect to a parameter p gives

    B u_p - Phi_q^T lam_p = (M a + Phi_q^T lam - Q - Q_loads - B u)_p,   the right side at constant u and lam,

where the subscript p denotes the derivative, and the other symbols are those of
`mbdkit_biomech.inverse_dynamics.loads.dynamics`.
These equations have the same matrix as the equations of each frame. Muscles are added by
`mbdkit_biomech.inverse_dynamics.gradient.recruitment_gradient`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from scipy.integrate import cumulative_simpson

from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.engine.kernels.dual_observe import DualStates
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.linear_systems import products
from mbdkit.engine.native.arithmetic import DIRECTIONS
from mbdkit.integrators.duals.differentiated_stepper import GivenDuals
from mbdkit.integrators.duals.dual_run import Seeds
from mbdkit.quantities.names import archive_names
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem, compute, fit, motion_of
from mbdkit_biomech.inverse_dynamics.gradient.recruitment_gradient import (
    RecruitedChange,
    differentiated_muscles,
    muscle_arrays,
    require_derivatives_of,
)
from mbdkit_biomech.inverse_dynamics.loads.dynamics import Balance, columns_of, weights_of
from mbdkit_biomech.inverse_dynamics.loads.loads import loads_on
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Motion
from mbdkit_biomech.inverse_dynamics.muscles.recruited import Recruited
from mbdkit_biomech.inverse_dynamics.results.inverse_run import compute_run
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import (
    InverseSource,
    InverseSpec,
    load_inverse_spec,
    varied_inverse,
)
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import members_of_actuators
from mbdkit_biomech.muscles.muscle_values import Muscles
from mbdkit_gradients.differentiated_expressions import Definitions, Measures, expressions_of, numbers_of
from mbdkit_gradients.differentiated_run import DifferentiatedRun
from mbdkit_gradients.differentiated_states import DifferentiatedStates, joined_states
from mbdkit_gradients.gradient_check import Settings
from mbdkit_gradients.gradient_parameters import Names, Parameter
from mbdkit_gradients.measure_gradients import Gradient, GradientProblem
from mbdkit_gradients.parameter_differences import Arrays, Preparation, PreparedDerivatives


def inverse_gradient(
    source: InverseSource,
    measures: Measures,
    names: Names | None = None,
    *,
    parameters: Names | None = None,
    check: bool = True,
    **sections: object,
) -> Gradient:
    """Compute inverse dynamics, and return the derivatives of measures of the result with respect to parameters of the
    model.

    Parameters
    ----------
    source
        A file, a mapping, or an InverseSpec.
    measures
        Expressions such as ``"rms(actuators.knee.value)"``: one, several, or a mapping as in the section `measures` of
        a spec. Names of measures that the spec defines may stand for their expressions.
    names, parameters
        Names of `parameters` of the spec, or key paths of numbers of its model such as
        ``model.forces.spring.stiffness``; see `mbdkit.gradient`. The model of a person is the scaled one, with
        ``model.body_mass``, ``model.thigh_length`` and ``model.shank_length``.
    check
        Whether to check the gradient in one direction by differences of four computations.
    **sections
        Sections of the spec, such as ``motion={...}``; they replace those of `source`.

    Returns
    -------
    Gradient
        As that of `mbdkit.gradient`.

    Raises
    ------
    SpecError
        If the input is wrong, or a measure has no derivative.
    RunError
        If no pose of the mechanism fits the data, or the mechanism passes a singular position.

    Examples
    --------
    Sensitivity of the torque that swings a pendulum to its mass:

    >>> import mbdkit, numpy as np
    >>> m = mbdkit.Mechanism()
    >>> rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.0, -0.5))
    >>> m.revolute("hip", m.ground, rod, at=(0, 0))
    >>> t = np.linspace(0.0, 2.0, 201)
    >>> motion = {"data": {"time": t, "hip": 0.5 * np.sin(3 * t)}, "columns": {"hip.angle": "hip"}}
    >>> spec = {"mbdkit": 1, "model": m.to_spec(), "motion": motion}
    >>> found = mbdkit.inverse_gradient(spec, "rms(actuators.hip.value)", "model.bodies.rod.mass")
    >>> found.check.is_passed
    True
    """

    def loaded(*given: Any, **more: Any) -> InverseSpec:
        return load_inverse_spec(*given, **more).expanded

    with one_thread_of_linear_algebra():
        problem, chosen = _InverseDynamics.asked(loaded, source, measures, names, parameters, sections)
        return problem.gradient(chosen, check=check)


def gradient_of_inverse(
    spec: InverseSpec, definitions: Definitions, parameters: Sequence[Parameter], *, check: bool
) -> Gradient:
    """Return the gradient of measures of a validated spec; see `inverse_gradient`."""
    return _InverseDynamics(spec, definitions).gradient(parameters, check=check)


class _InverseDynamics(GradientProblem[InverseSpec]):
    """Inverse dynamics without error bars, with its measures."""

    def __init__(self, spec: InverseSpec, definitions: Definitions):
        # measures do not need error bars, which take ten times as long as the rest
        if spec.follows is not None:
            raise SpecError("derivatives do not include bodies that follow the motion", key="follows")
        spec = varied_inverse(spec, [(("motion", "errors"), "none")])
        problem = InverseProblem.of(spec)
        if problem.recruiter is not None:
            require_derivatives_of(problem.recruiter)
        super().__init__(spec, definitions)
        self._result = compute(problem)

    def prepared(self, parameters: Sequence[Parameter]) -> PreparedDerivatives:
        prepared = InversePreparation(self._result, self.definitions).derivatives(parameters)
        _require_unique_forces(self._result, parameters, prepared)
        return prepared

    def run(self, parameters: Sequence[Parameter], prepared: PreparedDerivatives) -> DifferentiatedRun:
        firsts = range(0, len(parameters), DIRECTIONS)
        parts = [_Frames(self._result, prepared.seeds.only(slice(k, k + DIRECTIONS))).states() for k in firsts]
        return DifferentiatedRun(joined_states(parts), None, np.zeros(len(parameters)), (), None)

    def measured(self, run: DifferentiatedRun, settings: Settings) -> list[float]:
        varied = varied_inverse(self.spec, settings)
        try:
            with compute_run(varied) as other:
                return [one.of(other) for one in expressions_of(varied, self.definitions).values()]
        except MbdkitError:
            return [np.nan] * len(self.definitions)


def _require_unique_forces(result: Inverse, parameters: Sequence[Parameter], prepared: PreparedDerivatives) -> None:
    """Raise SpecError if the motion does not determine the values of the actuators, and depends on a parameter.

    A change of the parameter would then change the directions in which the actuators act, and thus their shares.
    """
    problem = result.problem
    if not result.dynamics.surplus and len(problem.actuators) == problem.fitter.manifold.freedoms:
        return
    moved = [x for name in MOTION if (x := prepared.seeds.get(name)) is not None]
    for k, parameter in enumerate(parameters):
        if any(np.any(x[..., k]) for x in moved):
            raise SpecError(
                f"the motion depends on '{parameter.name}'. There is no derivative with respect to this parameter, "
                f"because the motion does not determine the values of the actuators; use parameters that do not affect "
                f"the motion, such as masses and stiffnesses",
                key="gradients",
            )


class _Frames:
    """The frames of a result, with derivatives with respect to up to `DIRECTIONS` parameters.

    Parameters
    ----------
    result
        The result.
    seeds
        Derivatives of mechanism and motion.
    """

    def __init__(self, result: Inverse, seeds: Seeds):
        self.result, self.seeds = result, seeds
        self.workspace = result.problem.prepared.workspace
        self.workspace.clamp_motions(-np.inf, np.inf)
        self._given = GivenDuals(self.workspace, seeds)

    def states(self) -> DifferentiatedStates:
        """Return the states with all quantities computed from them."""
        motion, dynamics = self.result.motion, self.result.dynamics
        lam = self._of_pairs(dynamics.lam)
        value, change = self._changes(np.asarray(self._described(lam, None).lack))
        actuators, muscles, recorded = self._actuators(dynamics.value, value), None, self.result.problem.actuators
        supplied = actuators[:, :, 1].sum(axis=1) + self._load_power()
        if (recruited := self.result.recruited) is not None:
            lam, recorded = self._of_pairs(recruited.lam), self.result.problem.recorded_actuators
            lack = np.asarray(self._described(lam, None).lack)
            change, actuators, muscles = self._with_muscles(recruited, value, lack)
        by_pairs = [self._of_pairs(by_parameter) for by_parameter in np.moveaxis(change, -1, 0)]
        states = self._described(lam, np.stack(by_pairs, axis=-1))
        power = np.asarray(states.power[..., : 1 + self.seeds.count])
        supplied = np.stack([power[:, 0] + supplied, power[:, 1]], axis=1)
        mechanism, count = self.workspace.mechanism, self.seeds.count
        members: dict[str, Any] = {"actuators": members_of_actuators(recorded)}
        handles: dict[str, object] = {"actuators": actuators}
        if muscles is not None:
            members["muscles"] = [(name, ()) for name in self.result.problem.names.mechanism.muscles]
            handles["muscles"] = muscles
        names = archive_names(mechanism).with_members(**members)
        energy = cumulative_simpson(supplied, x=motion.time, axis=0, initial=0)
        return DifferentiatedStates.of_duals(mechanism, states, count, energy, handles=handles, names=names)

    def _of_pairs(self, lam: np.ndarray) -> np.ndarray:
        """Return the multipliers (T, P, 2) of all P pairs of constraint rows from the multipliers (T, m) of the
        independent rows.
        """
        motion = self.result.motion
        return self.result.problem.fitter.manifold.reactions(motion.time, motion.q, motion.v, lam).lam

    def _with_muscles(
        self, recruited: Recruited, value: np.ndarray, lack: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Muscles]:
        """Return the derivatives (T, m, K) of the multipliers, the recorded actuators (T, A, 2, 1 + K), and muscles.

        Parameters
        ----------
        value
            (T, U, K) derivatives of the values of the actuators without muscles.
        lack
            Unbalanced generalized forces, ground last, with their derivatives at constant multipliers of the result
            with muscles.
        """
        recruiter, balance = self.result.problem.recruiter, self._balance
        assert recruiter is not None
        turned = self._slope("motion.columns", balance.columns.shape)
        change = RecruitedChange.of(recruiter, recruited, value, (balance.columns, turned), self.seeds)
        left = change.pushed - self._needed(lack)
        lam = np.stack([balance.directions.multipliers(force) for force in np.moveaxis(left, -1, 0)], axis=-1)
        driven, places = recruited.sharing.driven, recruiter.reserve_places
        values = recruited.actuators[:, : value.shape[1], 0]
        own = self._actuators(values, np.where(driven[:, None], value, change.beside))
        left_over = np.where(driven, recruited.beside, 0.0), np.where(driven[:, None], change.beside, 0.0)
        spare = self._actuators(*left_over)[:, places]
        muscles = differentiated_muscles(recruiter, recruited, change, self.seeds)
        return lam, np.concatenate([own, spare], axis=1), muscles

    def _slope(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """Return the derivatives (..., K) of an array of the motion; zeros if the array does not depend on
        parameters.
        """
        found = self.seeds.get(name)
        return np.zeros((*shape, self.seeds.count)) if found is None else found

    def _described(self, lam: np.ndarray, slope: np.ndarray | None) -> DualStates:
        """Return the states for multipliers `lam` (T, P, 2) of all rows, with derivatives `slope` (T, P, 2, K)."""
        motion = self.result.motion
        given = (
            (np.column_stack([x, np.zeros((len(x), 3))]), np.pad(self._slope(name, x.shape), ((0, 0), (0, 3), (0, 0))))
            for name, x in zip(MOTION, (motion.q, motion.v, motion.a), strict=False)
        )
        return self._given.states(motion.time, given, (lam, slope))

    @cached_property
    def _balance(self) -> Balance:
        problem = self.result.problem
        return Balance(problem.fitter.manifold, self.result.motion, problem.actuators)

    def _needed(self, lack: np.ndarray) -> np.ndarray:
        """Return the derivatives (T, n, K) of the generalized forces that actuators and joints supply."""
        of_loads = self._slope("motion.loads", self.result.motion.q.shape)
        return np.asarray(lack[:, :-3, 1 : 1 + self.seeds.count] - of_loads)

    def _changes(self, lack: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives (T, U, K) of the actuators and (T, m, K) of the multipliers."""
        columns = self._slope("motion.columns", self._balance.columns.shape)
        needed = self._needed(lack) - np.sum(columns * self.result.dynamics.value[:, None, :, None], axis=2)
        values, multipliers, _ = zip(*map(self._balance.solved, np.moveaxis(needed, -1, 0)), strict=True)
        return np.stack(values, axis=-1), np.stack(multipliers, axis=-1)

    def _actuators(self, value: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Return values and powers (T, U, 2, 1 + K) of the actuators with values (T, U) and derivatives (T, U, K)."""
        motion, columns = self.result.motion, self._balance.columns
        rate = products(np.swapaxes(columns, 1, 2), motion.v)
        turned = np.sum(self._slope("motion.columns", columns.shape) * motion.v[:, :, None, None], axis=1)
        faster = products(np.swapaxes(columns, 1, 2), self._slope("motion.v", motion.v.shape))
        power = slope * rate[..., None] + value[..., None] * (turned + faster)
        both = [np.concatenate([x[..., None], y], axis=-1) for x, y in ((value, slope), (value * rate, power))]
        return np.stack(both, axis=2)

    def _load_power(self) -> np.ndarray:
        motion, loads = self.result.motion, self.result.loads
        changed = products(np.swapaxes(self._slope("motion.loads", motion.v.shape), 1, 2), motion.v)
        changed += products(np.swapaxes(self._slope("motion.v", motion.v.shape), 1, 2), loads.generalized)
        return np.column_stack([loads.power.sum(axis=1), changed])


#: Names of the arrays of a motion.
#:
#: In this order: positions, velocities and accelerations, (T, n) each, generalized forces of unit actuators (T, n, U),
#: generalized forces of the loads (T, n), and weights of the actuators (U,).
MOTION = ("motion.q", "motion.v", "motion.a", "motion.columns", "motion.loads", "motion.weights")


class InversePreparation(Preparation):
    """Prepares a spec of inverse dynamics, including the motion, with other values of a parameter."""

    ROUNDED = MOTION[:3]

    def __init__(self, result: Inverse, definitions: Definitions):
        self.result, self.definitions = result, definitions
        self.mechanism = result.problem.prepared.workspace.mechanism
        self._motion = self._arrays_of(result.problem, result.motion)
        self._muscles = self._muscles_of(result.problem, result.motion)
        numbers = self._numbers(result.problem.spec)
        self.base = {**self.mechanism_arrays(self.mechanism), **self._motion, **self._muscles, **numbers}

    def _numbers(self, spec: InverseSpec) -> dict[str, np.ndarray]:
        return numbers_of(spec, self.definitions) if spec.parameters else {}

    def _arrays_of(self, problem: InverseProblem, motion: Motion) -> dict[str, np.ndarray]:
        loads = loads_on(motion, problem.loads, problem.fitter.bodies).generalized
        columns = columns_of(motion.q, problem.actuators)
        weights = weights_of(problem.fitter.manifold, problem.actuators)
        return dict(zip(MOTION, (motion.q, motion.v, motion.a, columns, loads, weights), strict=True))

    def _muscles_of(self, problem: InverseProblem, motion: Motion) -> dict[str, np.ndarray]:
        return {} if problem.recruiter is None else muscle_arrays(problem, motion)

    def at(self, parameter: Parameter, value: float) -> Arrays:
        """Return the arrays for another value of a parameter; see `Preparation.at`."""
        problem = InverseProblem.of(varied_inverse(self.result.problem.spec, [(parameter.path, value)]))
        mechanism, numbers = problem.prepared.workspace.mechanism, self._numbers(problem.spec)
        self.require_same_structure(mechanism, parameter, value)
        self.require_same_form(numbers, parameter)
        motion, muscles = self._motion, self._muscles
        if not self._moves_alike(problem):
            moved = self._moved(problem, parameter)
            motion, muscles = self._arrays_of(problem, moved), self._muscles_of(problem, moved)
        elif problem.names.mechanism.muscles != self.result.problem.names.mechanism.muscles:
            muscles = self._muscles_of(problem, self.result.motion)
        return {**self.mechanism_arrays(mechanism), **motion, **muscles, **numbers}

    def _moved(self, problem: InverseProblem, parameter: Parameter) -> Motion:
        independent, motion = motion_of(problem, fit(problem))
        own = self.result.independent
        if own is not None and independent is not None and own.intervals != independent.intervals:
            raise SpecError(
                "the independent coordinates of the motion depend on the value of this parameter, so that the result "
                f"has no derivative with respect to '{parameter.name}'",
                key="gradients",
            )
        return motion

    def _moves_alike(self, other: InverseProblem) -> bool:
        """Return whether the mechanism of another problem has the same motion as that of the result, because its
        joints, observed quantities and actuators are the same.
        """
        own = self.result.problem
        a, b = (one.prepared.workspace.mechanism for one in (own, other))
        driven = bool(np.any(a.topology.pairs[:, PAIR.motion] >= 0))
        return bool(
            np.array_equal(a.topology.pair_parameters, b.topology.pair_parameters)
            and (not driven or np.array_equal(a.topology.motion_values, b.topology.motion_values))
            and own.fitter.manifold.length == other.fitter.manifold.length
            and own.measured.quantities.quantities == other.measured.quantities.quantities
            and [actuator.quantity for actuator in own.actuators] == [actuator.quantity for actuator in other.actuators]
            and own.names.candidates() == other.names.candidates()
        )
