"""Fibres on elastic tendons in predictions: velocity and force are unknowns, and the equilibrium is a condition.

As functions of the state, rates of fibres are stiff, and forces of tendons grow exponentially with errors of the state.
With velocities and forces as unknowns, both are bounded during all iterations, and equilibrium is reached together with
the optimum, as in F. De Groote et al., Annals of Biomedical Engineering 44:2922-2936, 2016.
"""

from __future__ import annotations

import json

import casadi as ca
import numpy as np

from mbdkit_biomech.muscles.acting_muscles import SHORTEST
from mbdkit_predict.casadi_system import CasadiSystem
from mbdkit_predict.chosen_numbers import ChosenNumbers


class ElasticFibers:
    """The fibres of a mechanism whose velocities and forces are unknowns.

    Attributes
    ----------
    states
        Index of the length of each of the F fibres among the first-order states.
    at_rest
        (F,) expressions in the symbols of the system that are zero if the fibres are in equilibrium at rest.
    """

    def __init__(self, chosen: ChosenNumbers, system: CasadiSystem):
        self._muscles = [chosen.mechanism.muscles[name] for name in chosen.fibers]
        self.states = [system.state_names.index(f"{name}.fiber_length") for name in chosen.fibers]
        unknowns = [i for both in chosen.fibers.values() for i in both]
        still = ca.SX(system.u)
        still[unknowns] = 0.0
        pull: ca.SX = system.equilibrium(*{**system.symbols, "u": still}.values())[0::2]  # force of the fibres
        gaps = system.equilibrium(*system.symbols.values())[1::2]
        self.at_rest = ca.vertsplit(ca.substitute(gaps, system.u[unknowns[1::2]], pull)) if chosen.fibers else []
        lengths = [system.expression(f"muscles[{json.dumps(name)}].length") for name in chosen.fibers]
        self._lengths = ca.Function("lengths", [system.q, system.p], [ca.vertcat(ca.SX(0, 1), *lengths)])

    def guess(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the lengths (F, T) of the fibres on slack tendons at positions (n, T), for parameters (P,)."""
        lengths = np.array(self._lengths(q, p)).reshape(len(self.states), q.shape[1])
        numbers = [(own.tendon_length, SHORTEST * own.optimal_length, own.thickness) for own in self._muscles]
        slack, shortest, thickness = np.reshape(numbers, (-1, 3)).T[:, :, None]
        return np.asarray(np.hypot(np.maximum(lengths - slack, shortest), thickness))
