"""States in equilibrium in predictions: their rates and the forces are unknowns, and the equilibrium is a condition.

As functions of the state, rates of fibres on an elastic tendon are stiff, and forces of tendons grow exponentially with
errors of the state. With velocities and forces as unknowns, both are bounded during all iterations, and equilibrium is
reached together with the optimum, as in F. De Groote et al., Annals of Biomedical Engineering 44:2922-2936, 2016.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from mbdkit_predict.casadi_system import CasadiSystem
from mbdkit_predict.chosen_numbers import ChosenNumbers


class StatesInEquilibrium:
    """The states of a mechanism whose rates are unknowns.

    Attributes
    ----------
    states
        Index of each of the F states among the first-order states.
    at_rest
        (F,) expressions in the symbols of the system that are zero if the states are in equilibrium at rest.
    """

    def __init__(self, chosen: ChosenNumbers, system: CasadiSystem):
        self._chosen = chosen.equilibria
        self.states = [system.state_names.index(f"{one.name}.{one.equilibrium.state}") for one in self._chosen]
        still = ca.SX(system.u)
        still[[index for one in self._chosen for index in one.unknowns]] = 0.0
        pull: ca.SX = system.equilibrium(*{**system.symbols, "u": still}.values())[0::2]  # the forces
        gaps = system.equilibrium(*system.symbols.values())[1::2]
        forces = [one.force for one in self._chosen]
        self.at_rest = ca.vertsplit(ca.substitute(gaps, system.u[forces], pull)) if self._chosen else []
        lengths = [system.expression(one.length) for one in self._chosen]
        self._lengths = ca.Function("lengths", [system.q, system.p], [ca.vertcat(ca.SX(0, 1), *lengths)])

    def guess(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the states (F, T) at rest, without forces, at positions (n, T), for parameters (P,)."""
        lengths = np.array(self._lengths(q, p)).reshape(len(self.states), q.shape[1])
        rows = [one.equilibrium.at_rest(row) for one, row in zip(self._chosen, lengths, strict=True)]
        return np.reshape(rows, lengths.shape)
