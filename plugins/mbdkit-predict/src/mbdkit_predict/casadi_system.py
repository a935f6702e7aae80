"""A mechanism as functions of CasADi."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

ARGUMENTS = ("q", "v", "a", "lam", "z", "u", "p", "t")
"""Arguments of all functions."""


@dataclass(frozen=True, eq=False, repr=False)
class CasadiSystem:
    """A mechanism as functions of CasADi's SX, executed from the definitions of the machine code.

    ::

        M a + Phi_q^T lam = Q(q, v, lam, z, u, p, t),      Phi(q, p, t) = 0,      z' = rates(q, v, lam, z, u, p, t)

    Functions have the arguments ``(q, v, a, lam, z, u, p, t)``. Q depends on lam only with friction in joints.
    Jacobians are those of CasADi; at corners of the model, such as the beginning of contact, they are one-sided.

    Attributes
    ----------
    bodies : tuple of str
        Names of the B bodies.
    q, v, a : (n, 1) SX
        Coordinates x, y, angle of each body in turn [m, rad], n = 3 B, their velocities and accelerations.
    lam : (m, 1) SX
        Multipliers of the independent constraint rows [N, N m].
    z : (Z, 1) SX
        First-order states, each in its own unit. Outputs and states of sampled controllers are among them, with the
        rate 0: they change only at the samples.
    u, p : SX
        Controls and parameters, (U, 1) and (P, 1).
    t : SX
        Time [s].
    constraint_names, state_names, control_names, parameter_names : tuple of str
        Names of the rows ``joint.row``, states, controls and parameters.
    q0, v0, z0, u0, p0 : arrays
        The consistent start of the mechanism, its states, and present values of controls and parameters.
    residual : casadi.Function
        ``M a + Phi_q^T lam - Q``, (n, 1).
    constraints : casadi.Function
        Three results (m, 1): ``position`` Phi, ``velocity`` its first and ``acceleration`` its second time derivative.
    rates : casadi.Function
        Derivatives of the states by time, (Z, 1).
    equilibrium : casadi.Function
        Zeros in a motion, two for each muscle whose unknowns are controls: force of the fibres along the tendon less
        that of the tendon, as a share of the largest force; and, as a share of its length, the room for the tendon less
        its length (with the curves `millard`, also a difference of forces).
    expression : function
        ``expression(text)`` returns an expression of quantities, such as ``"max(knee.force, 0)**2"``, in the symbols of
        the system. It raises SpecError if the text is not valid, or contains a quantity that cannot be exported.
    all_quantities : function
        ``all_quantities()`` returns all quantities, and the reasons why others are left out, both by name.
    """

    bodies: tuple[str, ...]
    constraint_names: tuple[str, ...]
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    parameter_names: tuple[str, ...]
    symbols: Mapping[str, ca.SX]
    q0: np.ndarray
    v0: np.ndarray
    z0: np.ndarray
    u0: np.ndarray
    p0: np.ndarray
    residual: ca.Function
    constraints: ca.Function
    rates: ca.Function
    equilibrium: ca.Function
    expression: Callable[[str], ca.SX]
    all_quantities: Callable[[], tuple[dict[str, ca.SX], dict[str, str]]]

    def __repr__(self) -> str:
        n, m, z = len(self.q0), len(self.constraint_names), len(self.state_names)
        chosen = f"{len(self.control_names)} controls, {len(self.parameter_names)} parameters"
        return f"<CasadiSystem: {n} coordinates, {m} constraint rows, {z} states, {chosen}>"

    def __getattr__(self, name: str) -> ca.SX:
        if name in ARGUMENTS:
            return self.symbols[name]
        raise AttributeError(f"a CasadiSystem has no attribute '{name}'")

    def function(self, name: str, results: Mapping[str, ca.SX]) -> ca.Function:
        """Return a function of ``(q, v, a, lam, z, u, p, t)`` with named results, expressions in these symbols."""
        return function(name, self.symbols, results)

    @cached_property
    def _quantities(self) -> tuple[dict[str, ca.SX], dict[str, str]]:
        return self.all_quantities()

    @property
    def quantity_names(self) -> tuple[str, ...]:
        """Names of the quantities in `quantities`, as expressions contain them, such as ``joints.A.force_x``."""
        return tuple(self._quantities[0])

    @property
    def refused(self) -> dict[str, str]:
        """Reasons, by name, why other quantities are not in `quantities`."""
        return self._quantities[1]

    @cached_property
    def quantities(self) -> ca.Function:
        """Function that returns all quantities of the mechanism, in the order of `quantity_names`."""
        return self.function("quantities", {"quantities": ca.vertcat(*self._quantities[0].values())})


def function(name: str, symbols: Mapping[str, ca.SX], results: Mapping[str, ca.SX]) -> ca.Function:
    """Return a function of all `ARGUMENTS`; see `CasadiSystem.function`."""
    return ca.Function(name, list(symbols.values()), ca.cse(list(results.values())), list(symbols), list(results))
