"""Evaluates states with derivatives: accelerations, reactions, forces, energies and powers.

The formulas are those of `mbdkit.engine.kernels.observe`, compiled for dual numbers. Unlike
`mbdkit.engine.observed_states`, this module does not compute shared reactions of redundant joints and the distance to
singularity, which have no derivatives.
"""

from __future__ import annotations

import numpy as np

from mbdkit.integrators.duals.differentiated_stepper import DifferentiatedSteps
from mbdkit.integrators.duals.dual_run import constants
from mbdkit_gradients.differentiated_states import DifferentiatedStates, one_after_another
from mbdkit_gradients.parameter_differences import CENTRAL, weights


class StateEvaluator:
    """Evaluates states of a differentiated run.

    Parameters
    ----------
    steps
        The differentiated steps, with mechanism and solver.
    count
        Number of parameters.
    """

    def __init__(self, steps: DifferentiatedSteps, count: int):
        self.steps, self.workspace, self.width = steps, steps.workspace, 1 + count

    def states(
        self,
        time: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        z: np.ndarray,
        weight: np.ndarray | None = None,
        energy: np.ndarray | None = None,
    ) -> DifferentiatedStates:
        """Return T states with the quantities computed from them; see `DifferentiatedStates` for the arguments.

        Raises
        ------
        RunError
            If the accelerations of a state are not unique.
        """
        self.steps.take_up_solver()
        if z.shape[1] and len(time) != 1:  # the kernels evaluate only states with equal first-order states together
            given = {"q": q, "v": v, "z": z, "weight": weight, "energy": energy}
            known = {name: x for name, x in given.items() if x is not None}
            rows = (slice(k, k + 1) for k in range(len(time)))
            return one_after_another([self.states(time[k], **{name: x[k] for name, x in known.items()}) for k in rows])
        if z.shape[1]:
            self.steps.use_states(np.asarray(z)[0])
        states = self.steps.observe(time, q, v)
        if z.shape[1]:
            forces = np.asarray(states.observed.forces)[0]
            np.asarray(states.observed.state_rates)[0] = self.steps.laws.state_rates(float(time[0]), forces)
        z, energy = np.asarray(z[..., : self.width]), None if energy is None else np.asarray(energy[..., : self.width])
        return DifferentiatedStates.of_duals(
            self.workspace.mechanism, states, self.width - 1, energy, z=z, weight=weight
        )

    def around(self, here: DifferentiatedStates, unit: float) -> tuple[DifferentiatedStates, float]:
        """Return eight states near a state along the motion, without derivatives, and the time between neighbouring
        ones.

        The states are at most ``unit / 8`` [s] away. `rate_of` computes rates of quantities from them.
        """
        offsets, distance = nearby(unit)
        q, v, acc = here.q[0, :, 0], here.v[0, :, 0], here.observed.acc[0, :, 0]
        z, z_rate = here.z[0, :, 0], here.observed.state_rates[0, :, 0]
        moved = (constants(x + offsets[:, None] * rate) for x, rate in ((q, v), (v, acc), (z, z_rate)))
        return self.states(here.time[0] + offsets, *moved), distance


def nearby(unit: float) -> tuple[np.ndarray, float]:
    """Return the times (8,) [s] of the states of `StateEvaluator.around` after a state, and the time between them."""
    distance = unit / 32.0
    return distance * np.array(CENTRAL), distance


def rate_of(around: np.ndarray, here: np.ndarray | float, distance: float) -> np.ndarray:
    """Return the rate of a quantity from its values (8, ...) in the states of `StateEvaluator.around`.

    `here` is the value in the state itself, and `distance` the time [s] between neighbouring states.
    """
    return np.asarray(np.tensordot(weights(CENTRAL), around - here, 1) / distance)
