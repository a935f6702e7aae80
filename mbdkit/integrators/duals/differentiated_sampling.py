"""Derivatives of the outputs and states that sampled controllers hold between samples, and of inputs.

The chain rule is applied at each sample. The times of samples do not depend on parameters.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mbdkit.base.errors import StepError
from mbdkit.engine.kernels.dual_observe import observe_duals
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.native.number_arrays import Duals
from mbdkit.integrators.duals.dual_run import DualRun, dual_states

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.integrators.duals.differentiated_laws import DifferentiatedLaws
    from mbdkit.integrators.run.sampled_control import Sampler


class Differentiated(Protocol):
    """The part of a differentiated run that the sampler reads and changes; see `DifferentiatedSteps`."""

    run: DualRun
    workspace: Workspace
    laws: DifferentiatedLaws

    def take_up_solver(self) -> None:
        """Use the current solver of the workspace in further steps."""
        ...

    def use_states(self, z: np.ndarray) -> None:
        """Use first-order states (Z, 1 + K) with their derivatives in later evaluations."""
        ...


class DifferentiatedSampler:
    """Updates the derivatives of the outputs and states that controllers hold, and of inputs.

    Parameters
    ----------
    steps
        The differentiated run, with its state.
    sampler
        The sampler of the run.
    """

    def __init__(self, steps: Differentiated, sampler: Sampler):
        self._steps, self._sampler, width = steps, sampler, np.asarray(steps.run.q).shape[-1]
        self._pending = [np.zeros((*one.shape, width)) for one in sampler._pending]
        self._last = -math.inf

    def passed(self, stop: float, after: np.ndarray) -> None:
        """Update the derivatives for the samples at a stop; a repeated call has no effect.

        Parameters
        ----------
        stop
            Time of the stop [s].
        after
            (Z,) first-order states after the samples.

        Raises
        ------
        StepError
            If the accelerations at the stop are not unique.
        """
        controllers, z = self._steps.workspace.mechanism.controllers, np.asarray(self._steps.run.z)
        if stop <= self._last or not self._sampler.is_needed:
            return
        self._last = stop
        laws, number_of, of_inputs = self._steps.laws, self._sampler._number, self._sampler.set_states
        z[of_inputs] = 0.0  # the values to which inputs are set depend on no parameter
        z[of_inputs, 0] = after[of_inputs]
        changed, is_evaluated = z.copy(), False
        for controller, pending in zip(controllers, self._pending, strict=True):
            number = number_of(stop, controller, 0.0)
            if number is not None:
                if not is_evaluated:
                    self._evaluate(stop)
                    is_evaluated = True
                pending[number % len(pending)] = [laws.value(row, stop) for _, row in controller.outputs]
                for state, row in controller.states:
                    changed[state] = laws.value(row, stop)
            number = number_of(stop, controller, controller.delay)
            if number is not None:
                changed[[state for state, _ in controller.outputs]] = pending[number % len(pending)]
        changed[:, 0] = after
        z[...] = changed

    def _evaluate(self, t: float) -> None:
        """Evaluate the quantities that expressions use at time t, with derivatives with respect to the parameters."""
        steps, run = self._steps, self._steps.run
        steps.take_up_solver()
        steps.use_states(np.asarray(run.z))
        q, v = (np.asarray(x)[None].view(Duals) for x in (run.q, run.v))
        states = PinnedBundle(dual_states(run, steps.workspace, np.array([t]), q, v))  # must exist during the call
        status, _ = observe_duals(states.address)
        if status != OK:
            raise StepError("singular", f"the sample of a controller at t = {t:.6g} s has no derivatives")
