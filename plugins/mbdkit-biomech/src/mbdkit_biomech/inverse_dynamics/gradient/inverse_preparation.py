"""Preparation of inverse dynamics for other values of a parameter: the arrays of mechanism, motion and muscles."""

from __future__ import annotations

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem, fit, motion_of
from mbdkit_biomech.inverse_dynamics.gradient.recruitment_gradient import muscle_arrays
from mbdkit_biomech.inverse_dynamics.loads.dynamics import columns_of, weights_of
from mbdkit_biomech.inverse_dynamics.loads.loads import loads_on
from mbdkit_biomech.inverse_dynamics.motion.reduced_motion import Motion
from mbdkit_biomech.inverse_dynamics.spec.inverse_loading import varied_inverse
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_gradients.differentiated_expressions import Definitions, numbers_of
from mbdkit_gradients.gradient_parameters import Parameter
from mbdkit_gradients.parameter_differences import Arrays, Preparation

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
